//! The worker over a store, without a server.

use std::collections::{HashMap, HashSet};
use std::io::{self, Write};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::*;

/// Work that says when it is at it, and goes on when told how.
struct Told {
    at: Mutex<Sender<String>>,
    go: Mutex<Receiver<Result<(), Stopped>>>,
}

impl Work for Told {
    fn begin(
        &self,
        job: &Record,
        mut input: Box<dyn BlobReader>,
        place: &Place,
        _task: &Task,
        sink: &mut dyn Write,
    ) -> Result<Begun, Stopped> {
        let outcome = self.outcome(job.id.clone());
        if job.request == "tiles" {
            put(place, "plan")?;
            return outcome.map(|()| Begun::Split { sizes: vec![1; 3], bytes: 10 });
        }
        io::copy(&mut input, sink)?;
        assert_ne!(job.request, "panic");
        outcome.map(|()| Begun::Done(String::new()))
    }

    fn tile(&self, job: &Record, tile: u32, place: &Place, _task: &Task) -> Result<u64, Stopped> {
        let outcome = self.outcome(format!("{}/{tile}", job.id));
        assert_eq!(read(place, place.plan.as_ref().expect("a plan")), "plan");
        put(place, &format!("part {tile};"))?;
        outcome.map(|()| 1)
    }

    fn join(
        &self,
        job: &Record,
        parts: Parts,
        place: &Place,
        _task: &Task,
        sink: &mut dyn Write,
    ) -> Result<String, Stopped> {
        let outcome = self.outcome(format!("{}/join", job.id));
        for name in &parts.names {
            sink.write_all(read(place, name).as_bytes())?;
        }
        outcome.map(|()| String::new())
    }
}

impl Told {
    fn outcome(&self, step: String) -> Result<(), Stopped> {
        self.at.lock().expect("no panic under it").send(step).expect("the test listens");
        self.go.lock().expect("no panic under it").recv().expect("the test speaks")
    }
}

fn put(place: &Place, text: &str) -> io::Result<()> {
    let mut blob = place.blobs.create(&place.own)?;
    blob.write_all(text.as_bytes())?;
    blob.finish()
}

fn read(place: &Place, name: &str) -> String {
    let mut text = String::new();
    place.blobs.open(name).expect("a blob").read_to_string(&mut text).expect("text");
    text
}

/// Its other ends: ids of jobs one way, ends of their work the other.
pub(super) type Ends = (Receiver<String>, Sender<Result<(), Stopped>>);

pub(super) fn told() -> (Arc<dyn Work>, Ends) {
    let (at, arrived) = channel();
    let (go, going) = channel();
    (Arc::new(Told { at: Mutex::new(at), go: Mutex::new(going) }), (arrived, go))
}

/// A clock that stands still until it is set.
struct Watch(AtomicI64);

impl Watch {
    fn at(now: Time) -> Arc<Self> {
        Arc::new(Self(now.into()))
    }
}

impl Clock for Watch {
    fn now(&self) -> Time {
        self.0.load(Ordering::SeqCst)
    }
}

/// Longer than anything here takes.
pub(super) const LONG: Duration = Duration::from_secs(60);

/// Until something is so, each time that a job changes.
pub(super) fn wait_until(jobs: &Jobs, mut so: impl FnMut() -> bool) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime");
    let mut changes = jobs.changes();
    // Asked beside the runtime: what is asked may wait.
    while !so() {
        let changed = runtime.block_on(async { tokio::time::timeout(LONG, changes.changed()).await });
        changed.expect("what was waited for has not happened").expect("the jobs are there");
    }
}

pub(super) fn keep(jobs: &Jobs, job: &NewJob) -> String {
    let draft = Draft::new(job.clone()).expect("a draft");
    let Admitted::New(id) = jobs.store().admit(&draft).expect("room") else { panic!("new") };
    let input = jobs.store().write_input(&id, &draft).expect("room");
    assert!(matches!(jobs.insert(&draft, input), Ok(Submitted::New(_))));
    id
}

over_each_engine!(
    jobs_expire_while_all_threads_are_at_work,
    each_end_of_the_work_is_its_jobs_state,
    a_worker_whose_lease_ran_out_does_not_spoil_what_another_makes,
    no_time_takes_a_job_from_a_thread_that_is_at_it,
    the_tiles_of_a_job_are_worked_on_and_joined_and_others_are_between,
    a_tile_is_tried_again_or_its_job_fails_or_begins_anew,
    a_job_in_tiles_goes_on_where_the_program_ended,
    a_step_that_finds_no_room_on_one_machine_is_done_by_another,
);

fn jobs_expire_while_all_threads_are_at_work(bench: Bench) {
    let settings = Settings { expiry: Duration::from_millis(1), ..Settings::new(bench.path().to_owned()) };
    let jobs = Arc::new(bench.jobs(settings));
    let (work, (arrived, go)) = told();
    jobs.start(&work).expect("threads");
    let first = keep(&jobs, &job("done", None, b"x"));
    arrived.recv().expect("a job");
    let long = keep(&jobs, &job("long", None, b"x"));
    go.send(Ok(())).expect("the work listens");
    arrived.recv().expect("a job");
    // The row goes before its file.
    let left = [format!("{long}.1.out.part"), format!("{long}.in")];
    let gone = || jobs.store().get(&first).expect("no fault").is_none();
    wait_until(&jobs, || gone() && files(bench.path()) == left);
    jobs.stop();
    go.send(Ok(())).expect("the work listens");
    jobs.join();
}

fn each_end_of_the_work_is_its_jobs_state(bench: Bench) {
    let settings = Settings::new(bench.path().to_owned());
    let jobs = Arc::new(bench.jobs(settings));
    let (work, (arrived, go)) = told();
    jobs.start(&work).expect("a thread");
    let mut ids = HashMap::new();
    for name in ["done", "refused", "later", "descriptors", "memory", "panic", "disk", "stopped"] {
        ids.insert(keep(&jobs, &job(name, None, b"x")), name);
    }
    let mut again = HashSet::new();
    loop {
        let id = arrived.recv().expect("a job");
        let outcome = match ids[&id] {
            "refused" => Err(Stopped::Refused("why".into())),
            "later" if again.insert(id.clone()) => Err(Stopped::Later),
            // EMFILE and ENOMEM.
            "descriptors" if again.insert(id.clone()) => {
                Err(Stopped::Storage(io::Error::from_raw_os_error(24)))
            }
            "memory" if again.insert(id.clone()) => Err(Stopped::Storage(io::Error::from_raw_os_error(12))),
            "disk" => Err(Stopped::Storage(io::ErrorKind::StorageFull.into())),
            "stopped" => {
                jobs.stop();
                Ok(())
            }
            _ => Ok(()),
        };
        go.send(outcome).expect("the work listens");
        if ids[&id] == "stopped" {
            break;
        }
    }
    jobs.join();
    for job in jobs.store().list(None, 100, None).expect("a list") {
        let (state, attempts) = match ids[&job.id] {
            "done" | "later" | "descriptors" | "memory" => (State::Done, 1),
            "stopped" => (State::Queued, 0),
            _ => (State::Failed, 1),
        };
        assert_eq!((job.state, job.attempts), (state, attempts), "{}", ids[&job.id]);
        let failure = match ids[&job.id] {
            "refused" => Some(Failure::Refused("why".into())),
            "panic" => Some(Failure::Crashed),
            "disk" => match &job.failure {
                Some(Failure::Storage { full: true, .. }) => job.failure.clone(),
                other => panic!("{other:?}"),
            },
            _ => None,
        };
        assert_eq!(job.failure, failure);
    }
    // One cloud that waits, four results.
    assert_eq!(files(bench.path()).len(), 5);
}

fn a_worker_whose_lease_ran_out_does_not_spoil_what_another_makes(bench: Bench) {
    let settings = Settings::new(bench.path().to_owned());
    let store = bench.store(BOUNDS, 0);
    let start = |clock: &Arc<Watch>| {
        let jobs = Arc::new(Jobs::new(store.clone(), settings.clone(), Arc::clone(clock) as Arc<dyn Clock>));
        let (work, ends) = told();
        jobs.start(&work).expect("threads");
        (jobs, ends)
    };
    // The clock of the first stands still, as that of a machine that sleeps.
    let (slow, (slow_at, slow_go)) = start(&Watch::at(0));
    let id = keep(&slow, &job("a", None, b"cloud"));
    assert_eq!(slow_at.recv().expect("a job"), id);
    let (quick, (quick_at, quick_go)) = start(&Watch::at(3_600_000));
    assert_eq!(quick_at.recv().expect("a job"), id);
    // The late one ends first, and then the right one.
    slow_go.send(Ok(())).expect("the work listens");
    wait_until(&slow, || slow.at_work(&id).is_empty());
    slow.stop();
    slow.join();
    assert_eq!(files(bench.path()), [format!("{id}.2.out.part"), format!("{id}.in")]);
    assert_eq!(store.get(&id).expect("no fault").expect("the job").state, State::Running);
    quick_go.send(Ok(())).expect("the work listens");
    wait_until(&quick, || quick.at_work(&id).is_empty());
    quick.stop();
    quick.join();
    let job = store.get(&id).expect("no fault").expect("the job");
    assert_eq!((job.state, job.attempts, job.finished), (State::Done, 2, Some(3_600_000)));
    assert_eq!(result(&store, &id).as_deref(), Some(&b"cloud"[..]));
    assert_eq!(files(bench.path()), [format!("{id}.2.out")]);
}

fn no_time_takes_a_job_from_a_thread_that_is_at_it(bench: Bench) {
    let settings = Settings { running: 2, ..Settings::new(bench.path().to_owned()) };
    let store = bench.store(BOUNDS, 0);
    let clock = Watch::at(0);
    let jobs = Arc::new(Jobs::new(store, settings, Arc::clone(&clock) as Arc<dyn Clock>));
    let (work, (arrived, go)) = told();
    jobs.start(&work).expect("threads");
    let first = keep(&jobs, &job("first", None, b"x"));
    assert_eq!(arrived.recv().expect("a job"), first);
    // As when the computer has slept: by this time its lease has run out, and its turn is the earliest.
    clock.0.store(3_600_000, Ordering::SeqCst);
    let second = keep(&jobs, &job("second", None, b"x"));
    assert_eq!(arrived.recv().expect("a job"), second);
    go.send(Ok(())).expect("the work listens");
    go.send(Ok(())).expect("the work listens");
    let get = |id: &str| jobs.store().get(id).expect("no fault").expect("the job");
    wait_until(&jobs, || [&first, &second].iter().all(|id| get(id).state == State::Done));
    assert_eq!([get(&first).attempts, get(&second).attempts], [1, 1]);
    jobs.stop();
    jobs.join();
}

fn the_tiles_of_a_job_are_worked_on_and_joined_and_others_are_between(bench: Bench) {
    let jobs = Arc::new(bench.jobs(Settings::new(bench.path().to_owned())));
    let (work, (arrived, go)) = told();
    jobs.start(&work).expect("a thread");
    let large = keep(&jobs, &job("tiles", None, b"x"));
    assert_eq!(arrived.recv().expect("a step"), large);
    let small = keep(&jobs, &of("another", None));
    let steps: Vec<_> = ["", "/0", "/1", "/2", "/join"].map(|step| format!("{large}{step}")).into();
    let mut order = vec![large.clone()];
    go.send(Ok(())).expect("the work listens");
    for _ in 0..5 {
        order.push(arrived.recv().expect("a step"));
        go.send(Ok(())).expect("the work listens");
    }
    let place = order.iter().position(|step| *step == small).expect("the small one");
    assert!(place <= 2, "one of the large one's at most after it was planned: {order:?}");
    order.retain(|step| *step != small);
    assert_eq!(order, steps);
    let job = || jobs.store().get(&large).expect("no fault").expect("the job");
    wait_until(&jobs, || job().state == State::Done && jobs.at_work(&large).is_empty());
    assert_eq!(result(jobs.store(), &large).as_deref(), Some(&b"part 0;part 1;part 2;"[..]));
    let tiles = job().tiles.expect("tiles");
    assert_eq!((tiles.count, tiles.done, tiles.points), (3, 3, 3));
    jobs.stop();
    jobs.join();
    assert_eq!(files(bench.path()).len(), 2, "the results");
}

fn a_tile_is_tried_again_or_its_job_fails_or_begins_anew(bench: Bench) {
    let jobs = Arc::new(bench.jobs(Settings::new(bench.path().to_owned())));
    let (work, (arrived, go)) = told();
    jobs.start(&work).expect("a thread");
    let id = keep(&jobs, &job("tiles", None, b"x"));
    let step = |expected: &str, outcome| {
        assert_eq!(arrived.recv().expect("a step"), format!("{id}{expected}"));
        go.send(outcome).expect("the work listens");
    };
    step("", Ok(()));
    step("/0", Err(Stopped::Later));
    step("/0", Ok(()));
    step("/1", Err(Stopped::Differs));
    step("", Ok(()));
    step("/0", Ok(()));
    step("/1", Err(Stopped::Refused("why".into())));
    let job = || jobs.store().get(&id).expect("no fault").expect("the job");
    wait_until(&jobs, || job().state == State::Failed && jobs.at_work(&id).is_empty());
    assert_eq!(job().failure, Some(Failure::Refused("why".into())));
    jobs.stop();
    jobs.join();
    assert_eq!(files(bench.path()), [""; 0]);
}

fn a_job_in_tiles_goes_on_where_the_program_ended(bench: Bench) {
    let mut steps = Vec::new();
    let mut id = String::new();
    for stop_at in [2, 1, 9] {
        let jobs = Arc::new(bench.jobs(Settings::new(bench.path().to_owned())));
        let (work, (arrived, go)) = told();
        jobs.start(&work).expect("a thread");
        if id.is_empty() {
            id = keep(&jobs, &job("tiles", None, b"x"));
        }
        for step in 1.. {
            steps.push(arrived.recv().expect("a step"));
            if step == stop_at {
                jobs.stop();
            }
            go.send(Ok(())).expect("the work listens");
            if step == stop_at || steps.last().is_some_and(|step| step.ends_with("join")) {
                break;
            }
        }
        let is_over = || jobs.store().get(&id).expect("no fault").expect("the job").state == State::Done;
        wait_until(&jobs, || jobs.at_work(&id).is_empty() && (steps.len() < 5 || is_over()));
        jobs.stop();
        jobs.join();
    }
    let expected = ["", "/0", "/0", "/0", "/1", "/2", "/join"].map(|step| format!("{id}{step}"));
    assert_eq!(steps, expected);
    assert_eq!(files(bench.path()).len(), 1, "the result");
}

fn a_step_that_finds_no_room_on_one_machine_is_done_by_another(bench: Bench) {
    let store = bench.store(BOUNDS, 0);
    let keeping = Keeping::Shared {
        database: String::new(),
        password: None,
        store: String::new(),
        process: String::new(),
        kind: String::new(),
    };
    let settings = Settings { keeping, ..Settings::new(bench.path().to_owned()) };
    let machine = || {
        let jobs = Arc::new(Jobs::new(store.clone(), settings.clone(), Arc::new(SystemClock)));
        let (work, ends) = told();
        jobs.start(&work).expect("a thread");
        (jobs, ends)
    };
    let get = |id: &str| store.get(id).expect("no fault").expect("the job");
    let full = || Err(Stopped::Storage(io::ErrorKind::StorageFull.into()));
    let mut machines = vec![machine()];
    let id = keep(&machines[0].0, &job("a", None, b"cloud"));
    for (attempt, outcome) in [(1, full()), (2, full()), (3, Ok(()))] {
        let (jobs, (arrived, go)) = machines.last().expect("one");
        assert_eq!(arrived.recv().expect("a job"), id);
        assert_eq!(get(&id).attempts, attempt);
        go.send(outcome).expect("the work listens");
        // It leaves the job to others, and then the next one comes.
        wait_until(jobs, || jobs.at_work(&id).is_empty());
        machines.push(machine());
    }
    assert_eq!(result(&store, &id).as_deref(), Some(&b"cloud"[..]));
    machines.iter().for_each(|(jobs, _)| jobs.stop());
    machines.iter().for_each(|(jobs, _)| jobs.join());
}
