//! The worker over a store, without a server.

use std::collections::{HashMap, HashSet};
use std::io::{self, Write};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use super::*;

/// Work that says when it is at it, and goes on when told how.
struct Told(Mutex<Wire>);

/// Ids of jobs one way, ends of their work the other.
type Wire = (Sender<String>, Receiver<Result<(), Stopped>>);

impl Work for Told {
    fn run(
        &self,
        job: &Record,
        input: Vec<u8>,
        _task: &Task,
        sink: &mut dyn Write,
    ) -> Result<String, Stopped> {
        let told = self.0.lock().expect("no panic under it");
        told.0.send(job.id.clone()).expect("the test listens");
        let outcome = told.1.recv().expect("the test speaks");
        drop(told);
        sink.write_all(&input)?;
        assert_ne!(job.request, "panic");
        outcome.map(|()| String::new())
    }
}

/// Its other ends.
type Ends = (Receiver<String>, Sender<Result<(), Stopped>>);

fn told() -> (Arc<dyn Work>, Ends) {
    let (at, arrived) = channel();
    let (go, going) = channel();
    (Arc::new(Told(Mutex::new((at, going)))), (arrived, go))
}

fn keep(jobs: &Jobs, job: &NewJob) -> String {
    let draft = Draft::new(job.clone());
    let Admitted::New(id) = jobs.store().admit(&draft).expect("room") else { panic!("new") };
    let input = jobs.store().write_input(&id, &draft).expect("room");
    assert!(matches!(jobs.insert(&draft, input), Ok(Submitted::New(_))));
    id
}

#[test]
fn jobs_expire_while_all_threads_are_at_work() {
    let dir = tempfile::tempdir().expect("a folder");
    let settings = Settings { expiry: Duration::from_millis(1), ..Settings::new(dir.path().to_owned()) };
    let jobs = Arc::new(Jobs::open(settings).expect("a store"));
    let (work, (arrived, go)) = told();
    jobs.start(&work).expect("threads");
    let first = keep(&jobs, &job("done", None, b"x"));
    arrived.recv().expect("a job");
    let long = keep(&jobs, &job("long", None, b"x"));
    go.send(Ok(())).expect("the work listens");
    arrived.recv().expect("a job");
    // The row goes before its file.
    let (start, left) = (Instant::now(), [format!("{long}.in"), format!("{long}.out.part")]);
    while jobs.store().get(&first).expect("no fault").is_some() || files(dir.path()) != left {
        assert!(start.elapsed() < Duration::from_secs(60), "it expires");
        std::thread::sleep(Duration::from_millis(10));
    }
    jobs.stop();
    go.send(Ok(())).expect("the work listens");
    jobs.join();
}

#[test]
fn each_end_of_the_work_is_its_jobs_state() {
    let dir = tempfile::tempdir().expect("a folder");
    let settings = Settings::new(dir.path().to_owned());
    let jobs = Arc::new(Jobs::open(settings).expect("a store"));
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
    assert_eq!(files(dir.path()).len(), 5);
}
