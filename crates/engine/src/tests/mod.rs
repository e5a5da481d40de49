mod machine;

use std::time::Duration;

use proptest::prelude::*;

use super::*;
use densecloud_cascade::{Demand, Fake};
use machine::Machine;

fn sizes(queue_points: u64) -> EngineConfig {
    let client_points = queue_points;
    EngineConfig { threads: 2, concurrency: 1, queue_points, client_points, ..EngineConfig::default() }
}

fn engine(machine: &Machine, queue_points: u64) -> Engine {
    machine.engine(sizes(queue_points))
}

fn request(points: u32, ratio: f64) -> Request {
    let positions: Vec<_> = (0..points)
        .map(|i| {
            let t = f64::from(i) * 0.1;
            [t.cos(), t.sin(), t * 0.3]
        })
        .collect();
    let finish = densecloud::attributes::Finish::default();
    Request::new(positions.into(), Target::Ratio(ratio), CascadeOptions::default(), finish)
}

/// Longer than anything here takes.
const LONG: Duration = Duration::from_secs(60);

/// What another thread is about to do.
fn wait_until(done: impl Fn() -> bool) {
    let begun = std::time::Instant::now();
    while !done() {
        assert!(begun.elapsed() < LONG, "what was waited for has not happened");
        std::thread::yield_now();
    }
}

#[test]
fn a_request_gives_what_the_cascade_gives() {
    let engine = engine(&Machine::new(1), 1_000_000);
    let request = request(200, 4.0);
    let direct = densecloud_cascade::upsample(
        &request.cloud.positions,
        request.target,
        &request.settings,
        &Patchwise::new(Arc::new(Fake::new())),
        &Silent,
    )
    .unwrap();
    let outcome = engine.submit(request).unwrap().wait().unwrap();
    assert_eq!(outcome.made.positions, direct.positions);
    assert!(outcome.stages.total() > Duration::ZERO && outcome.stages.total() == outcome.took);
    assert_eq!(engine.queued_points(), 0);
}

#[test]
fn requests_can_be_awaited() {
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    let engine = Engine::with_backend(Arc::new(Fake::new()), sizes(1_000_000)).unwrap();
    let outcome = runtime.block_on(async { engine.submit(request(100, 2.0)).unwrap().await }).unwrap();
    assert_eq!(outcome.made.positions.len(), 200);
}

#[test]
fn the_defaults_refuse_nobody() {
    let machine = Machine::new(1000);
    let engine = machine.engine(EngineConfig::default());
    engine.warm_up().unwrap();
    machine.close();
    let waiting: Vec<_> = (0..100).map(|_| engine.submit(request(1000, 64.0)).unwrap()).collect();
    assert!(engine.backlog() > Duration::from_secs(3600));
    let large = engine.reserve(&Caller::default(), cost(4_000_000_000, 256_000_000_000)).unwrap();
    drop((waiting, large));
    machine.open_gate();
}

#[test]
fn beyond_the_budget_requests_are_refused() {
    let machine = Machine::new(20);
    let engine = engine(&machine, 1000);
    machine.close();
    let first = engine.submit(request(200, 4.0)).unwrap();
    assert_eq!(engine.queued_points(), 800);
    let refused = engine.submit(request(200, 2.0)).err().unwrap();
    assert!(
        matches!(refused, EngineError::Refused(Refusal::Full { wanted: 400, queued: 800, limit: 1000, .. })),
        "{refused}"
    );
    let second = engine.submit(request(100, 2.0)).unwrap();
    assert_eq!(engine.queued_points(), 1000);
    machine.open_gate();
    first.wait().unwrap();
    second.wait().unwrap();
    assert_eq!(engine.queued_points(), 0);
}

#[test]
fn one_request_above_the_budget_runs_alone() {
    let engine = engine(&Machine::new(1), 10);
    assert_eq!(engine.submit(request(100, 2.0)).unwrap().wait().unwrap().made.positions.len(), 200);
}

#[test]
fn dropping_a_request_stops_it_and_frees_its_points() {
    let machine = Machine::new(5);
    let engine = engine(&machine, 1_000_000);
    machine.close();
    let running = engine.submit(request(2000, 64.0)).unwrap();
    let waiting = engine.submit(request(2000, 64.0)).unwrap();
    machine.wait_for_a_batch();
    drop(waiting);
    assert_eq!(engine.queued_points(), 128_000, "a waiting request is freed at once");
    drop(running);
    assert_eq!(engine.queued_points(), 128_000, "a running one when its work has stopped");
    machine.open_gate();
    wait_until(|| engine.queued_points() == 0);
    assert!(machine.batches() <= 2, "one a thread was begun: {}", machine.batches());
}

#[test]
fn progress_grows_to_the_last_stage() {
    let machine = Machine::new(2);
    let engine = engine(&machine, 1_000_000);
    let pending = engine.submit(request(300, 4.0)).unwrap();
    let handle = pending.progress_handle();
    let waiter = std::thread::spawn(move || pending.wait());
    let mut last = 0.0;
    while !waiter.is_finished() {
        let progress = handle.progress();
        assert!(progress.fraction >= last && progress.fraction <= 1.0, "{progress:?} after {last}");
        last = progress.fraction;
        std::thread::yield_now();
    }
    waiter.join().unwrap().unwrap();
    let progress = handle.progress();
    assert_eq!((progress.fraction, progress.level, progress.levels), (1.0, 2, 2));
}

#[test]
fn errors_reach_the_caller() {
    let engine = engine(&Machine::over(Fake::failing_at(2), 1), 1_000_000);
    assert!(matches!(engine.submit(request(100, 99.0)), Err(EngineError::Cascade(CascadeError::Ratio(_)))));
    let few = engine.submit(request(5, 2.0)).unwrap().wait().unwrap_err();
    assert!(matches!(few, EngineError::Cascade(CascadeError::TooFewPoints { .. })), "{few}");
    let failed = engine.submit(request(500, 2.0)).unwrap().wait().unwrap_err();
    assert!(matches!(failed, EngineError::Cascade(CascadeError::Backend(_))), "{failed}");
    assert_eq!(engine.submit(request(500, 2.0)).unwrap().wait().unwrap().made.positions.len(), 1000);
}

#[test]
fn warm_up_learns_what_work_takes() {
    let machine = Machine::new(1);
    let engine = engine(&machine, 1_000_000_000);
    assert_eq!(engine.estimate(cost(1000, 4000)), None);
    assert_eq!(engine.backlog(), Duration::ZERO);
    engine.warm_up().unwrap();
    assert_eq!(engine.backlog(), Duration::ZERO, "nothing waits");
    // A millisecond a patch of 32 points, and each point in two patches.
    let milliseconds = |read: f64| read * 2.0 / 32.0;
    for (size, read) in [(cost(1000, 4000), 3.0 * 1000.0), (cost(20_000, 1_280_000), 63.0 * 20_000.0)] {
        let share = engine.estimate(size).unwrap().as_secs_f64() * 1000.0 / milliseconds(read);
        assert!((0.8..1.5).contains(&share), "{share} of what {size:?} takes");
    }
    machine.close();
    let large = engine.estimate(cost(20_000, 1_280_000)).unwrap();
    let _pending = engine.submit(request(20_000, 64.0)).unwrap();
    assert_eq!(engine.backlog().as_millis(), large.as_millis());
    machine.open_gate();
}

#[test]
fn a_dropped_engine_cancels_what_waits() {
    let machine = Machine::new(5);
    let engine = engine(&machine, 1_000_000);
    machine.close();
    // Both large, which one thread alone takes: a small one may go to the other thread, and then neither waits.
    let _running = engine.submit(request(5000, 64.0)).unwrap();
    machine.wait_for_a_batch();
    let waiting = engine.submit(request(5000, 64.0)).unwrap();
    drop(engine);
    assert!(matches!(waiting.wait(), Err(EngineError::Cancelled)));
    machine.open_gate();
}

#[test]
fn a_small_request_does_not_wait_for_a_large_one() {
    let machine = Machine::new(2);
    let engine = engine(&machine, 1_000_000);
    machine.close();
    let large = engine.submit(request(10_000, 64.0)).unwrap();
    let queued = engine.submit(request(5_000, 64.0)).unwrap();
    machine.wait_for_a_batch();
    machine.open_gate();
    for _ in 0..3 {
        assert_eq!(engine.submit(request(100, 4.0)).unwrap().wait().unwrap().made.positions.len(), 400);
    }
    assert_eq!(engine.queued_points(), 960_000, "neither of the large ones is done");
    drop((large, queued));
    wait_until(|| engine.queued_points() == 0);
}

fn cost(points_in: u64, points_out: u64) -> Cost {
    Cost::new(points_in, points_out)
}

fn caller(name: &str) -> Caller {
    Caller { client: Client::new(name), deadline: None }
}

#[test]
fn a_client_has_a_share_and_the_others_the_rest() {
    let config =
        EngineConfig { threads: 1, queue_points: 1000, client_points: 500, ..EngineConfig::default() };
    let engine = Machine::new(1).engine(config);
    let (a, b) = (caller("a"), caller("b"));
    let first = engine.reserve(&a, cost(100, 400)).unwrap();
    let refused = engine.reserve(&a, cost(50, 101)).err().unwrap();
    assert!(
        matches!(refused, Refusal::Share { wanted: 101, used: 400, limit: 500, retry_after } if retry_after >= Duration::from_secs(1)),
        "{refused}"
    );
    let _second = engine.reserve(&a, cost(50, 100)).unwrap();
    let large = engine.reserve(&b, cost(100, 501)).err().unwrap();
    assert!(matches!(large, Refusal::Full { wanted: 501, queued: 500, .. }), "{large}");
    let _third = engine.reserve(&b, cost(100, 500)).unwrap();
    assert!(matches!(engine.reserve(&caller("c"), cost(1, 1)), Err(Refusal::Full { .. })));
    drop(first);
    assert_eq!(engine.queued_points(), 600);
    // Alone, a client may have more than its share.
    let _alone = engine.reserve(&caller("c"), cost(100, 400)).unwrap();
}

#[test]
fn a_reservation_becomes_the_works_own() {
    let engine = engine(&Machine::new(1), 1000);
    let me = caller("me");
    let permit = engine.reserve(&me, cost(100, 300)).unwrap();
    let job = engine.submit_for(&me, request(100, 2.0), Some(permit)).unwrap();
    assert_eq!(job.wait().unwrap().made.positions.len(), 200);
    assert_eq!(engine.queued_points(), 0);
    // More than was guessed: there must be room for it.
    let (permit, other) = (engine.reserve(&me, cost(100, 100)).unwrap(), engine.reserve(&me, cost(100, 850)));
    let refused = engine.submit_for(&me, request(100, 2.0), Some(permit)).err().unwrap();
    assert!(
        matches!(refused, EngineError::Refused(Refusal::Full { wanted: 200, queued: 850, .. })),
        "{refused}"
    );
    drop(other);
    assert!(engine.inner.queue.is_clean());
}

#[test]
fn retry_after_grows_with_what_waits() {
    let engine = engine(&Machine::new(5), 400_000);
    engine.warm_up().unwrap();
    let retry = |engine: &Engine, points: u64| match engine.reserve(&caller("b"), cost(points / 4, points)) {
        Err(Refusal::Full { retry_after, .. }) => retry_after,
        other => panic!("{:?}", other.err()),
    };
    let _permit = engine.reserve(&caller("a"), cost(100_000, 400_000)).unwrap();
    let (small, large) = (retry(&engine, 40_000), retry(&engine, 400_000));
    assert!(small > Duration::from_secs(1) && large > 9 * small, "{small:?} {large:?}");
    // Of one whose size is not known: as large as the others.
    let Err(refused) = engine.would_admit(&caller("b"), cost(1, 1)) else { panic!("there is no room") };
    assert!(refused.retry_after().is_some_and(|unknown| unknown > 9 * small), "{refused:?}");
    assert!(large <= engine.backlog());
}

#[test]
fn what_waits_is_bounded_in_time_for_all_and_for_each_client() {
    let machine = Machine::new(5);
    let config = EngineConfig { threads: 1, concurrency: 1, ..EngineConfig::default() };
    let engine = machine.engine(config);
    engine.warm_up().unwrap();
    let one = engine.estimate(cost(2000, 8000)).unwrap();
    let engine = machine.engine(EngineConfig { queue_time: Some(8 * one), ..config });
    engine.warm_up().unwrap();
    machine.close();
    // An upload that takes minutes keeps nobody out: others' work is done in the meantime.
    let _slow = engine.reserve(&caller("z"), cost(20_000, 80_000)).unwrap();
    machine.clock.advance(9 * one);
    let mut taken = Vec::new();
    let (mut share, mut long) = (0, 0);
    for client in ["a", "b", "c", "d", "e", "f", "g"] {
        for _ in 0..20 {
            match engine.submit_for(&caller(client), request(2000, 4.0), None) {
                Ok(pending) => taken.push(pending),
                Err(EngineError::Refused(Refusal::Busy { own, waiting, limit, retry_after })) => {
                    assert!(waiting > limit && retry_after >= Duration::from_secs(1));
                    *(if own { &mut share } else { &mut long }) += 1;
                }
                Err(other) => panic!("{other}"),
            }
        }
    }
    // Nine wait, the last of which found eight, and up to two threads have taken one each. A client's share is a quarter,
    // and a request that finds less is taken whole.
    assert!((9..=11).contains(&taken.len()), "{} were taken", taken.len());
    assert!(share > 0 && long > 0, "{share} and {long}");
    // The other lane is another queue.
    assert!(engine.would_admit(&caller("h"), cost(1, 1)).is_ok(), "it may be a large one");
    assert!(engine.reserve(&caller("h"), cost(100_000, 400_000)).is_ok());
    drop(taken);
    machine.open_gate();
}

#[test]
fn a_burst_is_held_before_any_of_it_has_come() {
    let machine = Machine::new(5);
    let (queue_points, client_points) = (1_000_000, 300_000);
    let config =
        EngineConfig { threads: 1, concurrency: 1, queue_points, client_points, ..EngineConfig::default() };
    let engine = machine.engine(config);
    engine.warm_up().unwrap();
    let size = cost(2000, 8000);
    let one = engine.estimate(size).unwrap();
    let engine = machine.engine(EngineConfig { queue_time: Some(one.mul_f64(8.5)), ..config });
    engine.warm_up().unwrap();
    machine.close();
    let mut permits = Vec::new();
    let mut refused = [0, 0];
    for client in ["a", "b", "c", "d"] {
        for _ in 0..24 {
            match engine.reserve(&caller(client), size) {
                Ok(permit) => permits.push(permit),
                Err(Refusal::Busy { own, .. }) => refused[usize::from(own)] += 1,
                Err(other) => panic!("{other}"),
            }
        }
    }
    // The first two do not wait, since two threads are idle. Then each client has until it is above its share, which is two
    // and a half: three, that count as its share for the others. So there is one left for the last.
    assert_eq!((permits.len(), refused), (2 + 3 * 3 + 1, [23, 19 + 21 + 21]));
    let busy =
        |engine: &Engine| matches!(engine.reserve(&caller("e"), size), Err(Refusal::Busy { own: false, .. }));
    assert!(busy(&engine));
    // That two of them come and are begun changes nothing.
    let come = |permit| engine.submit_for(&caller("a"), request(2000, 4.0), Some(permit)).unwrap();
    let pending = [come(permits.remove(0)), come(permits.remove(0))];
    wait_until(|| engine.inner.queue.running() == 2);
    assert!(busy(&engine));
    drop(permits.pop());
    drop(engine.reserve(&caller("e"), size).unwrap());
    // Those whose parsing takes its time count on, those that are still being sent do not.
    for permit in &permits[..3] {
        permit.arrived();
    }
    machine.clock.advance(9 * one);
    let room = (0..).map_while(|i| engine.reserve(&caller(&i.to_string()), size).ok()).collect::<Vec<_>>();
    assert_eq!(room.len(), 6, "beside three");
    drop((permits, room, pending));
    machine.open_gate();
    wait_until(|| engine.inner.queue.is_clean());
}

#[test]
fn what_one_client_announces_keeps_no_other_out() {
    let machine = Machine::new(5);
    let config = EngineConfig { threads: 2, concurrency: 2, ..EngineConfig::default() };
    let engine = machine.engine(config);
    engine.warm_up().unwrap();
    let large = cost(100_000, 400_000);
    let one = engine.estimate(large).unwrap();
    let engine = machine.engine(EngineConfig { queue_time: Some(one / 3), ..config });
    engine.warm_up().unwrap();
    // Two threads are idle; the third would wait for three times what may wait of all.
    let _announced = [(); 3].map(|()| engine.reserve(&caller("a"), large).unwrap());
    let refused = engine.reserve(&caller("a"), large).err().unwrap();
    // Until the third is nearly done, its share of what may wait.
    assert!(
        matches!(refused, Refusal::Busy { own: true, retry_after: told, .. } if told > one.mul_f64(0.9)),
        "{refused:?}"
    );
    drop(engine.reserve(&caller("b"), large).unwrap());
}

#[test]
fn a_hundred_requests_of_one_client_do_not_hold_up_anothers() {
    let machine = Machine::new(1);
    let engine = machine.engine(EngineConfig { threads: 1, concurrency: 1, ..EngineConfig::default() });
    let submit = |name: &str| engine.submit_for(&caller(name), request(100, 4.0), None).unwrap();
    let start = machine.clock.now();
    submit("greedy").wait().unwrap();
    let one = machine.clock.now() - start;
    machine.close();
    let greedy: Vec<_> = (0..100).map(|_| submit("greedy")).collect();
    machine.wait_for_a_batch();
    let modest = submit("modest");
    let handle = modest.progress_handle();
    machine.open_gate();
    modest.wait().unwrap();
    // Two threads take small requests: what they were at goes before it, and one more of the greedy client's.
    let before = handle.waited().as_secs_f64() / one.as_secs_f64();
    assert!(before <= 4.0, "{before} went before it");
    drop(greedy);
}

/// Of someone who waits no longer than this.
fn until(machine: &Machine, left: Duration) -> Caller {
    Caller { deadline: Some(machine.clock.now() + left), ..caller("hurried") }
}

#[test]
fn a_task_past_its_deadline_is_never_started() {
    let machine = Machine::new(0);
    let engine = engine(&machine, 10_000_000);
    machine.close();
    let running = engine.submit(request(20_000, 8.0)).unwrap();
    machine.wait_for_a_batch();
    let soon = until(&machine, Duration::from_millis(30));
    let waiting = engine.submit_for(&soon, request(20_000, 8.0), None).unwrap();
    machine.clock.advance(Duration::from_millis(40));
    drop(running);
    machine.open_gate();
    match waiting.wait() {
        Err(EngineError::Deadline { waited, worked: Duration::ZERO }) => {
            assert_eq!(waited, Duration::from_millis(40));
        }
        other => panic!("{other:?}"),
    }
    wait_until(|| engine.inner.queue.is_clean());
}

#[test]
fn work_at_its_deadline_stops_within_a_batch() {
    let machine = Machine::new(5);
    let engine = engine(&machine, 10_000_000);
    let soon = until(&machine, Duration::from_millis(100));
    match engine.submit_for(&soon, request(20_000, 8.0), None).unwrap().wait() {
        Err(EngineError::Deadline { waited: Duration::ZERO, worked }) => {
            assert!((100..=110).contains(&worked.as_millis()), "{worked:?}");
        }
        other => panic!("{other:?}"),
    }
    assert!((20..=22).contains(&machine.batches()), "{} batches", machine.batches());
    wait_until(|| engine.inner.queue.is_clean());
}

#[test]
fn a_deadline_that_the_backlog_rules_out_is_refused_at_once() {
    let machine = Machine::new(5);
    let engine = engine(&machine, 10_000_000);
    engine.warm_up().unwrap();
    let until = |seconds: u64| until(&machine, Duration::from_secs(seconds));
    // Alone it is tried, whatever the estimate.
    drop(engine.reserve(&until(1), cost(100_000, 6_400_000)).unwrap());
    let _before = engine.reserve(&caller("before"), cost(100_000, 800_000)).unwrap();
    let backlog = engine.backlog();
    assert!(backlog > Duration::from_secs(10), "{backlog:?}");
    let refused = engine.reserve(&until(2), cost(100_000, 400_000)).err().unwrap();
    let Refusal::Late { needed, left, retry_after } = refused else { panic!("{refused}") };
    assert!(needed > left && retry_after >= (needed - left) && needed <= 3 * backlog);
    assert!(engine.reserve(&until(100_000), cost(100_000, 400_000)).is_ok());
}

#[test]
fn work_waits_for_memory_and_is_refused_where_there_is_never_enough() {
    let machine = Machine::new(2);
    let one = cost(10_000, 640_000).memory(Demand::default());
    let config = EngineConfig { threads: 2, concurrency: 2, memory: 2 * one - 1, ..EngineConfig::default() };
    let engine = machine.engine(config);
    let refused = engine.reserve(&caller("a"), cost(30_000, 1_920_000)).err().unwrap();
    assert!(matches!(refused, Refusal::TooBig { .. }), "{refused}");
    machine.close();
    let first = engine.submit(request(10_000, 64.0)).unwrap();
    let second = engine.submit(request(10_000, 64.0)).unwrap();
    machine.wait_for_a_batch();
    let waits = second.progress_handle();
    assert_eq!(engine.memory(), one, "one of the two");
    assert_eq!(waits.progress().levels, 0);
    machine.open_gate();
    // A small one fits beside it.
    assert_eq!(engine.submit(request(100, 4.0)).unwrap().wait().unwrap().made.positions.len(), 400);
    drop(first);
    wait_until(|| waits.progress().levels > 0);
    drop(second);
    wait_until(|| engine.memory() == 0 && engine.inner.queue.is_clean());
}

/// What can happen to requests.
#[derive(Debug, Clone)]
enum Step {
    Reserve(u8, u32, u32),
    Submit(u8, u32, u32),
    /// With the permit that was taken longest ago.
    Use(u32),
    DropPermit,
    DropPending,
    Wait,
}

fn step() -> impl Strategy<Value = Step> {
    let ratio = 1_u32..6;
    prop_oneof![
        2 => (0_u8..3, 20_u32..120, ratio.clone()).prop_map(|(c, n, r)| Step::Reserve(c, n, r)),
        2 => (0_u8..3, 1_u32..120, ratio).prop_map(|(c, n, r)| Step::Submit(c, n, r)),
        2 => (1_u32..120).prop_map(Step::Use),
        1 => Just(Step::DropPermit),
        1 => Just(Step::DropPending),
        1 => Just(Step::Wait),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Permits in are permits out: whatever becomes of requests (refused, failed, dropped while they wait or
    /// run, past their deadline, done), in the end no point is taken, and nothing of a client is remembered.
    #[test]
    fn whatever_happens_all_points_come_back(steps in prop::collection::vec(step(), 1..40)) {
        let config = EngineConfig {
            threads: 2, queue_points: 1500, client_points: 900, ..EngineConfig::default()
        };
        let machine = Machine::over(Fake::failing_at(7), 1);
        let engine = machine.engine(config);
        let (mut permits, mut pending) = (std::collections::VecDeque::new(), std::collections::VecDeque::new());
        for step in steps {
            match step {
                Step::Reserve(client, points, ratio) => {
                    let of = caller(&client.to_string());
                    let size = cost(u64::from(points), u64::from(points * ratio));
                    permits.extend(engine.reserve(&of, size).ok().map(|permit| (of, permit)));
                }
                Step::Submit(client, points, ratio) => {
                    let deadline = (ratio == 5).then(|| machine.clock.now() + Duration::from_millis(3));
                    let of = Caller { deadline, ..caller(&client.to_string()) };
                    pending.extend(engine.submit_for(&of, request(points, f64::from(ratio)), None));
                }
                Step::Use(points) => {
                    if let Some((of, permit)) = permits.pop_front() {
                        pending.extend(engine.submit_for(&of, request(points, 3.0), Some(permit)));
                    }
                }
                Step::DropPermit => drop(permits.pop_back()),
                Step::DropPending => drop(pending.pop_back()),
                Step::Wait => drop(pending.pop_front().map(Pending::wait)),
            }
            prop_assert!(engine.queued_points() <= 1500);
        }
        drop((permits, pending));
        wait_until(|| engine.inner.queue.is_clean());
    }
}

#[test]
fn a_work_in_parts_has_the_points_of_what_is_left_and_the_memory_of_one() {
    let machine = Machine::new(1);
    let demand = Demand::default();
    let at_once = cost(500, 2000).memory(demand);
    let engine = machine.engine(EngineConfig { memory: at_once, ..sizes(1_000_000) });
    let whole = cost(100_000, 400_000);
    assert!(matches!(engine.reserve(&Caller::default(), whole), Err(Refusal::TooBig { .. })));
    let mut left = engine.reserve(&Caller::default(), whole.in_parts(400)).unwrap();
    for part in 1..=3_u64 {
        let permit = left.part(cost(10_000, 40_000));
        assert_eq!(engine.queued_points(), 400_000 - (part - 1) * 40_000);
        let of = Part { cost: cost(500, 2000), is_typical: true };
        let work = move |runner: &dyn LevelRunner, _: &dyn Observer| Ok(runner.units() as u64 * part);
        let made = engine.submit_part(&Caller::default(), permit, of, work).wait().unwrap().made;
        assert_eq!(made, Fake::new().units() as u64 * part);
        assert_eq!(engine.queued_points(), 400_000 - part * 40_000);
    }
    // A last one that is larger than what is left of it.
    let last = left.part(cost(100_000, 400_000));
    drop(left);
    assert_eq!(engine.queued_points(), 280_000);
    let late = Caller { deadline: Some(machine.clock.now()), ..Caller::default() };
    let of = Part { cost: cost(500, 2000), is_typical: false };
    let ended = engine.submit_part(&late, last, of, |_, _| Ok(())).wait();
    assert!(matches!(ended, Err(EngineError::Deadline { .. })), "{ended:?}");
    assert!(engine.queued_points() == 0 && engine.inner.queue.is_clean());
}
