use std::time::{Duration, Instant};

use super::*;
use crate::backend::Fake;

fn engine(fake: &Fake, queue_points: u64) -> Engine {
    let config = EngineConfig { threads: 2, concurrency: 1, queue_points };
    Engine::with_backend(Arc::new(fake.clone()), config).unwrap()
}

fn request(points: u32, ratio: f64) -> Request {
    let positions: Vec<_> = (0..points)
        .map(|i| {
            let t = f64::from(i) * 0.1;
            [t.cos(), t.sin(), t * 0.3]
        })
        .collect();
    Request {
        cloud: positions.into(),
        target: Target::Ratio(ratio),
        settings: Settings::default(),
        finish: Finish::default(),
    }
}

fn wait_until(what: &str, done: impl Fn() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < Duration::from_secs(20), "never happened: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn a_job_gives_what_the_cascade_gives() {
    let engine = engine(&Fake::new(), 1_000_000);
    let request = request(200, 4.0);
    let workers = Workers::new(Arc::new(Fake::new()), 1).unwrap();
    let direct =
        cascade::upsample(&request.cloud.positions, request.target, &request.settings, &workers, &Silent)
            .unwrap();
    let outcome = engine.submit(request).unwrap().wait().unwrap();
    assert_eq!(outcome.positions, direct.positions);
    assert!(outcome.stages.total() > Duration::ZERO);
    assert_eq!(engine.queued_points(), 0);
}

#[test]
fn jobs_can_be_awaited() {
    let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
    let engine = engine(&Fake::new(), 1_000_000);
    let outcome = runtime.block_on(async { engine.submit(request(100, 2.0)).unwrap().await }).unwrap();
    assert_eq!(outcome.positions.len(), 200);
}

#[test]
fn beyond_the_budget_requests_are_refused() {
    let engine = engine(&Fake::slow(Duration::from_millis(20)), 1000);
    let first = engine.submit(request(200, 4.0)).unwrap();
    assert_eq!(engine.queued_points(), 800);
    let refused = engine.submit(request(200, 2.0)).err().unwrap();
    assert!(matches!(refused, EngineError::Full { wanted: 400, queued: 800, limit: 1000 }), "{refused}");
    assert!(refused.to_string().contains("--queue-points"));
    let second = engine.submit(request(100, 2.0)).unwrap();
    assert_eq!(engine.queued_points(), 1000);
    first.wait().unwrap();
    second.wait().unwrap();
    assert_eq!(engine.queued_points(), 0);
}

#[test]
fn one_request_above_the_budget_runs_alone() {
    let engine = engine(&Fake::new(), 10);
    assert_eq!(engine.submit(request(100, 2.0)).unwrap().wait().unwrap().positions.len(), 200);
}

#[test]
fn dropping_a_job_stops_it_and_frees_its_points() {
    let fake = Fake::slow(Duration::from_millis(5));
    let engine = engine(&fake, 1_000_000);
    let running = engine.submit(request(2000, 64.0)).unwrap();
    let waiting = engine.submit(request(2000, 64.0)).unwrap();
    wait_until("the first batch", || fake.batches() > 0);
    drop(waiting);
    assert_eq!(engine.queued_points(), 128_000, "a waiting job is freed at once");
    drop(running);
    wait_until("the running job's points are free", || engine.queued_points() == 0);
    let batches = fake.batches();
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(fake.batches(), batches, "work goes on for nobody");
    assert!(batches < 500, "ran to its end");
}

#[test]
fn progress_grows_to_the_last_stage() {
    let fake = Fake::slow(Duration::from_millis(2));
    let engine = engine(&fake, 1_000_000);
    let job = engine.submit(request(300, 4.0)).unwrap();
    let handle = job.progress_handle();
    let (mut last, mut levels) = (0.0, 0);
    let waiter = std::thread::spawn(move || job.wait());
    while !waiter.is_finished() {
        let progress = handle.progress();
        assert!(progress.fraction >= last && progress.fraction <= 1.0, "{progress:?} after {last}");
        (last, levels) = (progress.fraction, progress.levels);
        std::thread::sleep(Duration::from_millis(1));
    }
    waiter.join().unwrap().unwrap();
    assert!(last > 0.3, "only {last} was ever seen");
    assert_eq!(levels, 2);
}

#[test]
fn errors_reach_the_caller() {
    let engine = engine(&Fake::failing_at(2), 1_000_000);
    assert!(matches!(engine.submit(request(100, 99.0)), Err(EngineError::Cascade(CascadeError::Ratio(_)))));
    let few = engine.submit(request(5, 2.0)).unwrap().wait().unwrap_err();
    assert!(matches!(few, EngineError::Cascade(CascadeError::TooFewPoints { .. })), "{few}");
    let failed = engine.submit(request(500, 2.0)).unwrap().wait().unwrap_err();
    assert!(matches!(failed, EngineError::Cascade(CascadeError::Backend(_))), "{failed}");
    assert_eq!(engine.submit(request(500, 2.0)).unwrap().wait().unwrap().positions.len(), 1000);
}

#[test]
fn warm_up_learns_a_rate() {
    let engine = engine(&Fake::slow(Duration::from_millis(1)), 1_000_000_000);
    engine.warm_up().unwrap();
    assert_eq!(engine.retry_after(), Duration::from_secs(1), "nothing waits");
    let _job = engine.submit(request(20_000, 64.0)).unwrap();
    assert!(engine.retry_after() > Duration::from_secs(1));
}

#[test]
fn a_dropped_engine_cancels_what_waits() {
    let engine = engine(&Fake::slow(Duration::from_millis(5)), 1_000_000);
    let _running = engine.submit(request(1000, 16.0)).unwrap();
    let waiting = engine.submit(request(100, 2.0)).unwrap();
    drop(engine);
    assert!(matches!(waiting.wait(), Err(EngineError::Cancelled)));
}

#[test]
fn a_small_request_does_not_wait_for_a_large_one() {
    let fake = Fake::slow(Duration::from_millis(2));
    let engine = engine(&fake, 1_000_000);
    let large = engine.submit(request(10_000, 64.0)).unwrap();
    let queued = engine.submit(request(5_000, 64.0)).unwrap();
    wait_until("the first batch", || fake.batches() > 0);
    for _ in 0..3 {
        assert_eq!(engine.submit(request(100, 4.0)).unwrap().wait().unwrap().positions.len(), 400);
    }
    assert_eq!(engine.queued_points(), 960_000, "neither of the large ones is done");
    drop((large, queued));
    wait_until("the rest stopped", || engine.queued_points() == 0);
}
