//! A database that is away, or is lost at the worst moment.

use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};

use super::engine::Engine;
use super::proxy::{Fault, Proxy};
use super::records::{claim, get, made, put, try_put};
use super::*;

/// One database: `far` asks it over a network that fails.
struct Faulty {
    // First, so that nobody uses the database when it goes.
    far: Arc<Postgres>,
    near: Arc<dyn Records>,
    proxy: Proxy,
    bench: Bench,
}

impl Faulty {
    fn new() -> Self {
        let bench = Bench::of(Engine::Postgres);
        let near = bench.records(BOUNDS);
        let proxy = Proxy::to(bench.port());
        let far = Arc::new(bench.postgres(proxy.port, "kind", BOUNDS));
        Self { far, near, proxy, bench }
    }

    /// Says a word over a network that fails once.
    fn under<T>(&self, fault: Fault, word: impl FnOnce(&Postgres) -> T) -> T {
        self.proxy.set(fault);
        let said = word(&self.far);
        assert!(self.proxy.has_failed(), "nothing was changed");
        said
    }
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn what_is_lost_before_or_after_it_is_kept_happens_once() {
    for fault in [Fault::Before, Fault::After] {
        let world = Faulty::new();
        let near = &*world.near;
        let new = Draft::new(of("a", Some("key"))).expect("a draft");
        let submitted = world.under(fault, |far| far.insert("id", &new, 1)).expect("no fault");
        assert_eq!(submitted, Submitted::New(get(near, "id")), "{fault:?}");
        assert_eq!(near.counts().expect("counts")[0], (State::Queued, 1));
        let lease = claim(near, 1);
        assert!(world.under(fault, |far| far.beat(&lease, 500)).expect("no fault"));
        assert!(world.under(fault, |far| far.put_back(&lease)).expect("no fault"));
        assert_eq!((get(near, "id").state, get(near, "id").attempts), (State::Queued, 0));
        let lease = claim(near, 1);
        let full = Failure::Storage { why: "no room".into(), full: true };
        assert_eq!(world.under(fault, |far| far.retry(&lease, &full, 1)).expect("no fault"), Some(true));
        assert_eq!((get(near, "id").state, get(near, "id").attempts), (State::Queued, 1));
        let lease = claim(near, 2);
        let turn = get(near, "id").turn;
        assert!(world.under(fault, |far| far.defer(&lease)).expect("no fault"));
        assert_eq!((get(near, "id").turn, get(near, "id").attempts), (turn + 1, 1));
        let lease = claim(near, 3);
        assert!(world.under(fault, |far| far.split(&lease, "plan", &[1, 1], 10)).expect("no fault"));
        let tile = claim(near, 4);
        assert!(world.under(fault, |far| far.tile_done(&tile, "part", 1)).expect("no fault"));
        assert_eq!(get(near, "id").tiles.expect("tiles").done, 1);
        let tile = claim(near, 5);
        assert!(world.under(fault, |far| far.unsplit(&tile)).expect("no fault"));
        assert_eq!((get(near, "id").state, get(near, "id").tiles), (State::Queued, None));
        let lease = claim(near, 6);
        assert!(world.under(fault, |far| far.done(&lease, &made(3), 7)).expect("no fault"));
        assert_eq!(get(near, "id").result, Some(made(3)));
        let gone = Forgotten { id: "id".to_owned(), blob: Some("x".to_owned()) };
        assert_eq!(world.under(fault, |far| far.delete("id")).expect("no fault"), Some(gone));
        put(near, &of("a", None), 8);
        let lease = claim(near, 8);
        assert!(world.under(fault, |far| far.failed(&lease, &Failure::Crashed, 9)).expect("no fault"));
        let gone = Forgotten { id: lease.record.id, blob: None };
        assert_eq!(world.under(fault, |far| far.expire(Time::MAX, 9)).expect("no fault"), [gone]);
        let id = put(near, &of("a", None), 10);
        assert!(world.under(fault, |far| far.cancel(&id, 11)).expect("no fault"));
        assert_eq!(world.far.used().expect("a sum"), near.used().expect("a sum"));
        assert!(near.delete(&id).expect("no fault").is_some());
        assert_eq!(near.used().expect("a sum"), 0);
    }
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn leases_that_nobody_heard_of_run_out() {
    for (fault, attempts) in [(Fault::Before, 1), (Fault::After, 2)] {
        let world = Faulty::new();
        let id = put(&*world.near, &of("a", None), 0);
        let lost = world.under(fault, |far| far.claim("far", 1, 100)).expect_err("nobody can know");
        assert!(lost.is_unsure() && lost.is_away(), "{lost:?}");
        let lapsed = world.near.lapse(100, 100).expect("no fault");
        assert_eq!(lapsed.len(), usize::from(fault == Fault::After));
        let lease = claim(&*world.near, 101);
        assert_eq!((lease.record.attempts, lease.attempt), (attempts, u64::from(attempts)));
        // The same for whoever lets go of them.
        let lapsed = world.under(fault, |far| far.lapse(1000, 1000)).expect("no fault");
        assert_eq!(lapsed.len(), usize::from(fault == Fault::Before));
        assert_eq!(get(&*world.near, &id).state, State::Queued);
    }
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn the_cloud_of_a_job_that_may_have_been_kept_stays() {
    let world = Faulty::new();
    let files = Arc::new(Folder::open(world.bench.path().join("files")).expect("a folder"));
    let store = Store::new(Arc::clone(&world.far) as Arc<dyn Records>, files);
    let draft = Draft::new(of("a", None)).expect("a draft");
    let Admitted::New(id) = store.admit(&draft).expect("room") else { panic!("new") };
    let input = store.write_input(&id, &draft).expect("room");
    let unsure = world.under(Fault::AfterAll, |_| store.insert(&draft, input, 1)).expect_err("it is lost");
    assert!(unsure.is_unsure(), "{unsure:?}");
    assert_eq!(get(&*world.near, &id).state, State::Queued);
    let mut bytes = Vec::new();
    store.input(&id).expect("its cloud").read_to_end(&mut bytes).expect("a file");
    assert_eq!(bytes, b"abc");
    // What cannot have been kept leaves nothing.
    let Err(away) = try_submit(&store, &of("b", None), 1) else { panic!("nobody is there") };
    assert!(away.is_away() && !away.is_unsure(), "{away:?}");
    assert_eq!(super::files(world.bench.path()), [format!("{id}.in")]);
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_database_that_does_not_answer_is_an_error_and_comes_back_by_itself() {
    let world = Faulty::new();
    let id = put(&*world.far, &of("a", None), 0);
    let late = Draft::new(of("late", None)).expect("a draft");
    for fault in [Fault::Silence, Fault::Refused] {
        world.proxy.set(fault);
        if fault == Fault::Refused {
            world.proxy.cut();
        }
        for away in [world.far.get(&id).map(drop), world.far.insert("late", &late, 0).map(drop)] {
            let away = away.expect_err("nobody answers");
            assert!(away.is_away() && !away.is_unsure(), "{away:?}");
        }
        world.proxy.set(Fault::None);
        assert_eq!(get(&*world.far, &id).id, id);
        assert_eq!(world.far.get("late").expect("no fault"), None, "what was not kept is not kept later");
    }
    // Connections that are lost while nobody uses them cost nothing.
    world.proxy.cut();
    assert!(world.far.cancel(&id, 1).expect("no fault"));
    world.proxy.cut();
    assert_eq!(get(&*world.far, &id).state, State::Cancelled);
}

/// Waits for something to be told.
fn hear(told: &Receiver<Change>, what: &Change) {
    while told.recv().expect("the records are there") != *what {}
}

/// What is told by these records from now on.
fn listen(records: &Postgres) -> Receiver<Change> {
    let (tell, told) = channel();
    let tell = Mutex::new(tell);
    records.listen(Arc::new(move |change| {
        // Nobody may listen any more.
        let _ = tell.lock().expect("no panic under it").send(change);
    }));
    // Whatever was missed.
    hear(&told, &Change::Other);
    told
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn of_many_tiles_each_hundredth_is_told() {
    let bench = Bench::of(Engine::Postgres);
    let records = bench.postgres(bench.port(), "kind", BOUNDS);
    let id = put(&records, &of("a", None), 0);
    let told = listen(&records);
    let lease = claim(&records, 1);
    assert!(records.split(&lease, "plan", &[1; 1000], 0).expect("no fault"));
    for _ in 0..25 {
        let tile = claim(&records, 2);
        assert!(records.tile_done(&tile, "part", 1).expect("no fault"));
    }
    assert!(records.cancel(&id, 3).expect("no fault"));
    let mut changes: Vec<_> = told.iter().take_while(|change| *change != Change::Over(id.clone())).collect();
    changes.extend(told.try_iter());
    let others = changes.iter().filter(|change| **change == Change::Other).count();
    assert!(others <= 4, "it was begun and planned, and 10 and 20 tiles were done: {changes:?}");
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn changes_are_told_to_all_again_once_a_lost_connection_is_back() {
    let world = Faulty::new();
    let told = listen(&world.far);
    for round in 0..2 {
        if round > 0 {
            hear(&told, &Change::Other);
        }
        let id = put(&*world.near, &of("a", None), 0);
        hear(&told, &Change::Waits);
        let lease = claim(&*world.near, 1);
        assert!(world.near.put_back(&lease).expect("no fault"));
        hear(&told, &Change::Over(id.clone()));
        assert!(world.near.cancel(&id, 2).expect("no fault"));
        hear(&told, &Change::Over(id));
        while told.try_recv().is_ok() {}
        world.proxy.cut();
    }
    let refused = try_put(&*world.far, &of("a", None), 3);
    assert!(refused.is_ok(), "{refused:?}");
}
