//! The store under random use and random ends, and the worker over it without a server.

use std::collections::{BTreeMap, HashMap};
use std::io::{self, Write};
use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

use proptest::prelude::*;

use super::*;
use crate::provenance::hexadecimal;

const DISK: u64 = 1000;
const BOUNDS: Bounds = Bounds { disk: DISK, jobs: 1000, client_jobs: 1000 };
const ATTEMPTS: u32 = 3;

fn open(folder: &Path, now: Time) -> Store {
    Store::open(folder, BOUNDS, ATTEMPTS, now).expect("a store")
}

fn job(request: &str, key: Option<&str>, input: &[u8]) -> NewJob {
    NewJob {
        request: request.into(),
        key: key.map(str::to_owned),
        owner: String::new(),
        client: String::new(),
        request_id: "r".into(),
        points_in: input.len() as u64,
        points_out: 4 * input.len() as u64,
        result_bytes: 100,
        input: input.into(),
    }
}

fn submit(store: &Store, job: &NewJob, now: Time) -> String {
    match store.submit(job, now).expect("room") {
        Submitted::New(record) => record.id,
        Submitted::Known(record) => panic!("known: {record:?}"),
    }
}

fn write(store: &Store, id: &str, bytes: &[u8]) -> ResultFile {
    let fill = |sink: &mut dyn Write| sink.write_all(bytes).map(|()| "about".to_owned());
    store.write_result::<io::Error>(id, fill).expect("a result")
}

fn files(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder.join("files")).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

/// One thing that can happen to a store.
#[derive(Debug, Clone)]
enum Step {
    Submit {
        key: Option<u8>,
        request: u8,
        size: usize,
    },
    Claim,
    Done(usize),
    Failed(usize),
    PutBack(usize),
    Cancel(usize),
    Delete(usize),
    Expire(Time),
    /// A result is on the disk, but its row does not say so yet.
    Written(usize),
    /// The program ends, in the middle of writing a file, and is started again.
    Reopen,
}

fn step() -> impl Strategy<Value = Step> {
    let which = 0_usize..8;
    prop_oneof![
        4 => (prop::option::of(0_u8..3), 0_u8..2, 0_usize..200)
            .prop_map(|(key, request, size)| Step::Submit { key, request, size }),
        4 => Just(Step::Claim),
        2 => which.clone().prop_map(Step::Done),
        1 => which.clone().prop_map(Step::Failed),
        1 => which.clone().prop_map(Step::PutBack),
        1 => which.clone().prop_map(Step::Cancel),
        1 => which.clone().prop_map(Step::Delete),
        1 => which.prop_map(Step::Written),
        1 => (0_i64..20).prop_map(Step::Expire),
        2 => Just(Step::Reopen),
    ]
}

/// What a store should know of a job.
#[derive(Debug, Clone)]
struct Model {
    state: State,
    attempts: u32,
    finished: Time,
    job: NewJob,
    bytes: u64,
}

fn check(store: &Store, folder: &Path, model: &BTreeMap<String, Model>) -> Result<(), TestCaseError> {
    let listed = store.list(None, 1000, None).expect("a list");
    prop_assert_eq!(listed.len(), model.len());
    for record in &listed {
        let known = &model[&record.id];
        prop_assert_eq!(record.state, known.state);
        prop_assert_eq!(record.attempts, known.attempts);
        match record.state {
            State::Queued | State::Running => {
                prop_assert_eq!(&store.input(&record.id).expect("its cloud"), &known.job.input);
            }
            State::Done => {
                let (_, result, _) = store.result(&record.id).expect("its file").expect("a result");
                let bytes =
                    std::fs::read(folder.join("files").join(format!("{}.out", record.id))).expect("a file");
                prop_assert_eq!(&bytes, record.id.as_bytes());
                prop_assert_eq!(result.bytes, bytes.len() as u64);
            }
            State::Failed | State::Cancelled => {}
        }
        if record.state != State::Done {
            prop_assert!(store.result(&record.id).expect("no fault").is_none());
        }
    }
    for (state, count) in store.counts().expect("counts") {
        prop_assert_eq!(count, model.values().filter(|known| known.state == state).count() as u64);
    }
    let used: u64 = model.values().map(|known| known.bytes).sum();
    prop_assert_eq!(store.used().expect("a sum"), used);
    prop_assert!(used <= DISK);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Whatever happens: a job is where the model has it, its files are those that its state promises, it
    /// is never done twice, and after a new start there is no other file.
    #[test]
    fn a_store_is_what_happened_to_it(steps in prop::collection::vec(step(), 0..40)) {
        let dir = tempfile::tempdir().expect("a folder");
        let folder = dir.path();
        let mut store = Some(open(folder, 0));
        let mut model: BTreeMap<String, Model> = BTreeMap::new();
        let mut order: Vec<String> = Vec::new();
        for (now, step) in (1..).zip(steps) {
            let open_store = store.as_ref().expect("open");
            let pick = |i: usize| order.get(i).cloned().unwrap_or_else(|| "none".into());
            let state = |model: &BTreeMap<String, Model>, id: &String| model.get(id).map(|known| known.state);
            match step {
                Step::Submit { key, request, size } => {
                    let key = key.map(|key| format!("key {key}"));
                    let new = job(&format!("request {request}"), key.as_deref(), &vec![7; size]);
                    let holder = model.iter().find(|(_, known)| key.is_some() && known.job.key == key);
                    let used: u64 = model.values().map(|known| known.bytes).sum();
                    match (open_store.submit(&new, now), holder) {
                        (Ok(Submitted::Known(record)), Some((id, known))) => {
                            prop_assert_eq!(&record.id, id);
                            prop_assert_eq!(&known.job, &new);
                        }
                        (Err(StoreError::OtherRequest), Some((_, known))) => prop_assert_ne!(&known.job, &new),
                        (Err(StoreError::OverBudget { .. }), None) => {
                            prop_assert!(used + size as u64 + 100 > DISK);
                        }
                        (Ok(Submitted::New(record)), None) => {
                            order.push(record.id.clone());
                            let bytes = size as u64 + 100;
                            let known =
                                Model { state: State::Queued, attempts: 0, finished: 0, job: new, bytes };
                            model.insert(record.id, known);
                        }
                        other => prop_assert!(false, "{other:?}"),
                    }
                }
                Step::Claim => {
                    let first = order.iter().find(|id| state(&model, id) == Some(State::Queued)).cloned();
                    let claimed = open_store.claim(now).expect("no fault").map(|record| record.id);
                    prop_assert_eq!(&claimed, &first, "in the order in which they came");
                    if let Some(known) = first.and_then(|id| model.get_mut(&id)) {
                        known.state = State::Running;
                        known.attempts += 1;
                    }
                }
                Step::Written(i) if state(&model, &pick(i)) == Some(State::Running) => {
                    write(open_store, &pick(i), b"not the one");
                }
                Step::Done(i) if state(&model, &pick(i)) != Some(State::Done) => {
                    let id = pick(i);
                    let result = write(open_store, &id, id.as_bytes());
                    let done = open_store.done(&id, &result, now).expect("no fault");
                    prop_assert_eq!(done, state(&model, &id) == Some(State::Running));
                    if let Some(known) = model.get_mut(&id).filter(|_| done) {
                        (known.state, known.finished, known.bytes) = (State::Done, now, id.len() as u64);
                    }
                }
                Step::Failed(i) => {
                    let id = pick(i);
                    let failed = open_store.failed(&id, &Failure::Crashed, now).expect("no fault");
                    prop_assert_eq!(failed, state(&model, &id) == Some(State::Running));
                    if let Some(known) = model.get_mut(&id).filter(|_| failed) {
                        (known.state, known.finished, known.bytes) = (State::Failed, now, 0);
                    }
                }
                Step::PutBack(i) => {
                    let id = pick(i);
                    let put = open_store.put_back(&id).expect("no fault");
                    prop_assert_eq!(put, state(&model, &id) == Some(State::Running));
                    if let Some(known) = model.get_mut(&id).filter(|_| put) {
                        known.state = State::Queued;
                        known.attempts -= 1;
                    }
                }
                Step::Cancel(i) => {
                    let id = pick(i);
                    let cancelled = open_store.cancel(&id, now).expect("no fault");
                    let waits = matches!(state(&model, &id), Some(State::Queued | State::Running));
                    prop_assert_eq!(cancelled, waits);
                    if let Some(known) = model.get_mut(&id).filter(|_| cancelled) {
                        (known.state, known.finished, known.bytes) = (State::Cancelled, now, 0);
                    }
                }
                Step::Delete(i) => {
                    let id = pick(i);
                    let over = state(&model, &id).is_some_and(State::is_final);
                    prop_assert_eq!(open_store.delete(&id).expect("no fault"), over);
                    if over {
                        model.remove(&id);
                    }
                }
                Step::Expire(age) => {
                    let expired = open_store.expire(now - age).expect("no fault");
                    let old = |known: &Model| known.state.is_final() && known.finished < now - age;
                    prop_assert_eq!(expired.len(), model.values().filter(|known| old(known)).count());
                    model.retain(|_, known| !old(known));
                }
                Step::Reopen => {
                    std::fs::write(folder.join("files/x.in.part"), b"half").expect("a file");
                    drop(store.take());
                    store = Some(open(folder, now));
                    for known in model.values_mut().filter(|known| known.state == State::Running) {
                        if known.attempts < ATTEMPTS {
                            known.state = State::Queued;
                        } else {
                            (known.state, known.finished, known.bytes) = (State::Failed, now, 0);
                        }
                    }
                    let mut promised: Vec<String> = model
                        .iter()
                        .filter_map(|(id, known)| match known.state {
                            State::Queued | State::Running => Some(format!("{id}.in")),
                            State::Done => Some(format!("{id}.out")),
                            State::Failed | State::Cancelled => None,
                        })
                        .collect();
                    promised.sort();
                    prop_assert_eq!(files(folder), promised);
                }
                Step::Written(_) | Step::Done(_) => {}
            }
            check(store.as_ref().expect("open"), folder, &model)?;
        }
    }
}

#[test]
fn a_job_that_ends_the_program_again_and_again_fails() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut id = String::new();
    for attempt in 1..=ATTEMPTS {
        let store = open(dir.path(), 0);
        if attempt == 1 {
            id = submit(&store, &job("a", None, b"cloud"), 0);
        }
        assert_eq!(store.claim(1).expect("no fault").expect("a job").attempts, attempt);
    }
    let store = open(dir.path(), 5);
    let job = store.get(&id).expect("no fault").expect("a job");
    assert_eq!((job.state, job.finished), (State::Failed, Some(5)));
    assert_eq!(job.failure, Some(Failure::GaveUp { attempts: ATTEMPTS }));
    assert_eq!(store.claim(6).expect("no fault"), None);
    assert_eq!(files(dir.path()), [""; 0]);
}

#[test]
fn a_result_is_seen_whole_with_its_hash_or_not_at_all() {
    let dir = tempfile::tempdir().expect("a folder");
    let store = open(dir.path(), 0);
    let id = submit(&store, &job("a", None, b"cloud"), 0);
    store.claim(1).expect("no fault");
    let full = store.write_result::<io::Error>(&id, |sink| {
        sink.write_all(b"half of i")?;
        Err(io::ErrorKind::StorageFull.into())
    });
    assert!(StoreError::from(full.expect_err("full")).is_full());
    assert_eq!(files(dir.path()), [format!("{id}.in")]);
    let result = write(&store, &id, b"abc");
    assert!(store.result(&id).expect("no fault").is_none(), "not before it is done");
    assert!(store.done(&id, &result, 2).expect("no fault"));
    assert!(!store.done(&id, &result, 3).is_ok_and(|done| done), "once");
    let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!((result.sha256.as_str(), result.bytes), (abc, 3));
    assert_eq!(hexadecimal(&[0xab]), "ab");
}

#[test]
fn a_folder_is_open_once_and_a_later_version_is_not_touched() {
    let dir = tempfile::tempdir().expect("a folder");
    let store = open(dir.path(), 0);
    assert!(matches!(Store::open(dir.path(), BOUNDS, ATTEMPTS, 0), Err(StoreError::Locked)));
    drop(store);
    let database = rusqlite::Connection::open(dir.path().join("jobs.sqlite")).expect("a database");
    database.pragma_update(None, "user_version", 3).expect("a version");
    drop(database);
    assert!(matches!(Store::open(dir.path(), BOUNDS, ATTEMPTS, 0), Err(StoreError::Version(3))));
}

fn of(client: &str, key: Option<&str>) -> NewJob {
    NewJob { owner: client.into(), client: client.into(), ..job("4x", key, b"abc") }
}

#[test]
fn clients_take_turns_and_have_their_own_names_for_requests() {
    let dir = tempfile::tempdir().expect("a folder");
    let store = open(dir.path(), 0);
    let first: Vec<_> = (0..3).map(|now| submit(&store, &of("a", None), now)).collect();
    let key = submit(&store, &of("a", Some("key")), 3);
    let b = submit(&store, &of("b", Some("key")), 4);
    assert_ne!(key, b, "another owner's key is another key");
    assert_eq!(store.submit(&of("b", Some("key")), 5).expect("room"), {
        Submitted::Known(store.get(&b).expect("no fault").expect("the job"))
    });
    let ahead =
        |id: &String| store.ahead(&store.get(id).expect("no fault").expect("the job")).expect("no fault").0;
    assert_eq!([&first[0], &first[1], &first[2], &b].map(ahead), [0, 2, 3, 1]);
    let claim = |now| store.claim(now).expect("no fault").map(|job| job.id);
    let order: Vec<_> = (10..15).filter_map(claim).collect();
    assert_eq!(order, [&first[0], &b, &first[1], &first[2], &key].map(Clone::clone));
    let listed = |owner| store.list(None, 10, owner).expect("a list").len();
    assert_eq!([listed(None), listed(Some("a")), listed(Some("b")), listed(Some("c"))], [5, 4, 1, 0]);
}

#[test]
fn no_more_jobs_wait_than_may() {
    let dir = tempfile::tempdir().expect("a folder");
    let bounds = Bounds { jobs: 3, client_jobs: 2, ..BOUNDS };
    let store = Store::open(dir.path(), bounds, ATTEMPTS, 0).expect("a store");
    let first = submit(&store, &of("a", Some("key")), 0);
    submit(&store, &of("a", None), 0);
    let refused = store.submit(&of("a", None), 0);
    assert!(matches!(refused, Err(StoreError::ClientFull { queued: 2, limit: 2 })), "{refused:?}");
    assert!(matches!(store.submit(&of("a", Some("key")), 0), Ok(Submitted::Known(_))), "it is there already");
    submit(&store, &of("b", None), 0);
    assert!(matches!(store.has_room("b"), Err(StoreError::Full { queued: 3, limit: 3 })));
    assert_eq!(store.load("a").expect("no fault"), Load { jobs: 3, points: 36, clients: 2, own: 2 });
    assert!(store.cancel(&first, 1).expect("no fault"));
    assert!(store.has_room("a").is_ok());
    assert_eq!(files(dir.path()).len(), 2, "what was refused leaves nothing");
}

#[test]
fn a_database_without_clients_is_brought_up_to_date() {
    let dir = tempfile::tempdir().expect("a folder");
    let store = open(dir.path(), 0);
    let (queued, done) =
        (submit(&store, &job("a", Some("key"), b"abc"), 0), submit(&store, &job("b", None, b"x"), 0));
    drop(store);
    let database = rusqlite::Connection::open(dir.path().join("jobs.sqlite")).expect("a database");
    database
        .execute_batch(
            "CREATE TABLE old (
                number INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, state TEXT NOT NULL,
                request TEXT NOT NULL, key TEXT UNIQUE, fingerprint TEXT NOT NULL, request_id TEXT NOT NULL,
                points_in INTEGER NOT NULL, points_out INTEGER NOT NULL, bytes INTEGER NOT NULL,
                attempts INTEGER NOT NULL DEFAULT 0, created INTEGER NOT NULL, started INTEGER,
                finished INTEGER, result TEXT, failure TEXT) STRICT;
            INSERT INTO old SELECT number, id, state, request, key, fingerprint, request_id, points_in, points_out,
                bytes, attempts, created, started, finished, result, failure FROM jobs;
            DROP TABLE jobs;
            ALTER TABLE old RENAME TO jobs;
            CREATE INDEX jobs_by_state ON jobs (state, number);
            CREATE INDEX jobs_by_end ON jobs (finished);
            PRAGMA user_version = 1;",
        )
        .expect("a database of version 1");
    drop(database);
    let store = open(dir.path(), 1);
    assert!(matches!(store.submit(&job("a", Some("key"), b"abc"), 2), Ok(Submitted::Known(_))));
    assert_eq!(store.claim(3).expect("no fault").map(|job| job.id), Some(queued.clone()));
    write(&store, &queued, b"abc");
    let ids = store.list(None, 10, Some("")).expect("a list").into_iter().map(|job| job.id);
    assert_eq!(ids.collect::<Vec<_>>(), [done, queued]);
    assert_eq!(store.list(None, 10, Some("a")).expect("a list").len(), 0, "nobody's");
    drop(store);
    drop(open(dir.path(), 4));
}

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

#[test]
fn each_end_of_the_work_is_its_jobs_state() {
    let dir = tempfile::tempdir().expect("a folder");
    let settings = Settings { disk: DISK, ..Settings::new(dir.path().to_owned()) };
    let jobs = Arc::new(Jobs::open(settings).expect("a store"));
    let (at, arrived) = channel();
    let (go, going) = channel();
    let work: Arc<dyn Work> = Arc::new(Told(Mutex::new((at, going))));
    jobs.start(&work).expect("a thread");
    let mut ids = HashMap::new();
    for name in ["done", "refused", "later", "panic", "disk", "stopped"] {
        let Submitted::New(job) = jobs.submit(&job(name, None, b"x")).expect("room") else { panic!("new") };
        ids.insert(job.id, name);
    }
    let mut later = 0;
    loop {
        let id = arrived.recv().expect("a job");
        let outcome = match ids[&id] {
            "refused" => Err(Stopped::Refused("why".into())),
            "later" if later == 0 => {
                later += 1;
                Err(Stopped::Later)
            }
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
            "done" | "later" => (State::Done, 1),
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
    // One cloud that waits, two results.
    assert_eq!(files(dir.path()).len(), 3);
}
