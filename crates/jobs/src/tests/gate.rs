//! A store that does not answer one call, beside others.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

use densecloud_blobs::Listed;

use super::worker::{LONG, keep, told, wait_until};
use super::*;

/// Files of which one is not deleted before that may be.
struct Gated {
    files: Folder,
    name: Mutex<String>,
    at: Mutex<Sender<()>>,
    go: Mutex<Receiver<()>>,
}

impl Blobs for Gated {
    fn create(&self, name: &str) -> std::io::Result<Box<dyn BlobWriter>> {
        self.files.create(name)
    }

    fn open(&self, name: &str) -> std::io::Result<Box<dyn BlobReader>> {
        self.files.open(name)
    }

    fn delete(&self, name: &str) -> std::io::Result<()> {
        if *self.name.lock().expect("no panic under it") == name {
            self.at.lock().expect("no panic under it").send(()).expect("the test listens");
            self.go.lock().expect("no panic under it").recv().expect("the test speaks");
        }
        self.files.delete(name)
    }

    fn list(&self, prefix: &str) -> std::io::Result<Vec<Listed>> {
        self.files.list(prefix)
    }
}

/// Jobs over a gate, which says when a call is held there, and lets it go when told.
struct Held {
    jobs: Arc<Jobs>,
    gate: Arc<Gated>,
    at: Receiver<()>,
    go: Sender<()>,
}

impl Held {
    fn new(bench: &Bench) -> Self {
        let ((said, at), (go, going)) = (channel(), channel());
        let files = Folder::open(bench.path().join("files")).expect("a folder");
        let gate = Gated { files, name: Mutex::default(), at: Mutex::new(said), go: Mutex::new(going) };
        let gate = Arc::new(gate);
        let records = bench.records(Bounds { attempts: 1, ..BOUNDS });
        let store = Store::new(records, Arc::clone(&gate) as Arc<dyn Blobs>);
        let settings = Settings { running: 1, ..Settings::new(PathBuf::new()) };
        Self { jobs: Arc::new(Jobs::new(store, settings, Arc::new(SystemClock))), gate, at, go }
    }

    /// A job whose cloud is not removed before that may be.
    fn keep(&self) -> String {
        let id = keep(&self.jobs, &job("held", None, b"x"));
        *self.gate.name.lock().expect("no panic under it") = format!("{id}.in");
        id
    }

    /// Once a call is held, others go on.
    fn others_go_on(&self) {
        self.at.recv().expect("a call");
        let (jobs, (done, told)) = (Arc::clone(&self.jobs), channel());
        std::thread::spawn(move || {
            let other = keep(&jobs, &of("other", None));
            assert!(jobs.at_work(&other).is_empty());
            assert_eq!(jobs.delete(&other).expect("no fault"), Some(Deleted::Cancelled));
            done.send(()).expect("the test listens");
        });
        told.recv_timeout(LONG).expect("they wait for the one that is held");
        self.go.send(()).expect("the call waits");
    }

    fn end(&self, id: &str) {
        let over = || self.jobs.store().get(id).expect("no fault").expect("the job").state == State::Failed;
        wait_until(&self.jobs, || over() && self.jobs.at_work(id).is_empty());
        self.jobs.stop();
        self.jobs.join();
    }
}

over_each_engine!(nobody_waits_while_the_end_of_a_step_is_kept, nobody_waits_while_a_step_is_claimed,);

fn nobody_waits_while_the_end_of_a_step_is_kept(bench: Bench) {
    let held = Held::new(&bench);
    let id = held.keep();
    let (work, (arrived, go)) = told();
    held.jobs.start(&work).expect("a thread");
    assert_eq!(arrived.recv().expect("a job"), id);
    go.send(Err(Stopped::Refused("why".into()))).expect("the work listens");
    held.others_go_on();
    held.end(&id);
}

fn nobody_waits_while_a_step_is_claimed(bench: Bench) {
    let held = Held::new(&bench);
    let id = held.keep();
    // Whoever claims a step next has to remove what is left of this one.
    assert!(held.jobs.store().claim("lost", 0, 0).expect("no fault").is_some());
    let (work, _ends) = told();
    held.jobs.start(&work).expect("a thread");
    held.others_go_on();
    held.end(&id);
}
