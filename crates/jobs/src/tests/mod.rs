//! The store: its rules one by one, and what its tests share.

mod engine;
mod faults;
mod fleet;
mod gate;
mod migrations;
mod model;
mod proxy;
mod records;
mod scaler;
#[cfg(target_os = "linux")]
mod server;
mod tiles;
mod worker;

use std::io::{Read, Write};
use std::path::Path;

use super::*;
use engine::{Bench, over_each_engine};

const DISK: u64 = 10_000;
const ATTEMPTS: u32 = 3;
const BOUNDS: Bounds = Bounds { disk: DISK, jobs: 1000, client_jobs: 1000, attempts: ATTEMPTS };
/// What a result is taken for beforehand: more than any here is, with what is told of it.
const RESULT: u64 = 300;

fn open(bench: &Bench, now: Time) -> Store {
    bench.store(BOUNDS, now)
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
        result_bytes: RESULT,
        input: std::sync::Arc::new(input.to_vec()),
    }
}

/// As the server does it.
/// A cloud's file.
fn bytes(file: &dyn CloudFile) -> Vec<u8> {
    let mut bytes = Vec::new();
    file.copy_to(&mut bytes).expect("memory");
    bytes
}

/// All that a job is.
fn told(job: &NewJob) -> String {
    format!("{job:?} {:?}", bytes(&*job.input))
}

fn try_submit(store: &Store, job: &NewJob, now: Time) -> Result<Submitted, StoreError> {
    let draft = Draft::new(job.clone()).expect("a draft");
    match store.admit(&draft)? {
        Admitted::Known(record) => Ok(Submitted::Known(*record)),
        Admitted::New(id) => store.insert(&draft, store.write_input(&id, &draft)?, now),
    }
}

fn submit(store: &Store, job: &NewJob, now: Time) -> String {
    match try_submit(store, job, now).expect("room") {
        Submitted::New(record) => record.id,
        Submitted::Known(record) => panic!("known: {record:?}"),
    }
}

fn claim(store: &Store, now: Time) -> Option<Lease> {
    store.claim("worker", now, Time::MAX).expect("no fault")
}

fn write(store: &Store, lease: &Lease, bytes: &[u8]) -> ResultFile {
    let mut writer = store.result_writer(lease).expect("a result");
    writer.write_all(bytes).expect("room");
    writer.finish("about".to_owned()).expect("a result")
}

/// The bytes of a job's result, where it is done.
fn result(store: &Store, id: &str) -> Option<Vec<u8>> {
    let (_, result) = store.result(id).expect("its file").expect("the job");
    let mut bytes = Vec::new();
    result?.1.read_to_end(&mut bytes).expect("a file");
    Some(bytes)
}

fn files(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder.join("files")).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

fn of(client: &str, key: Option<&str>) -> NewJob {
    NewJob { owner: client.into(), client: client.into(), ..job("4x", key, b"abc") }
}

over_each_engine!(
    a_job_that_ends_the_program_again_and_again_fails,
    a_job_whose_leases_run_out_again_and_again_fails,
    a_result_is_seen_whole_with_its_hash_or_not_at_all,
    what_a_stale_worker_writes_is_not_the_result_and_does_not_stay,
    what_is_refused_leaves_no_file,
);

fn a_job_that_ends_the_program_again_and_again_fails(bench: Bench) {
    let mut id = String::new();
    for attempt in 1..=ATTEMPTS {
        let store = open(&bench, 0);
        if attempt == 1 {
            id = submit(&store, &job("a", None, b"cloud"), 0);
        }
        assert_eq!(claim(&store, 1).expect("a job").record.attempts, attempt);
    }
    let store = open(&bench, 5);
    let job = store.get(&id).expect("no fault").expect("a job");
    assert_eq!((job.state, job.finished), (State::Failed, Some(5)));
    assert_eq!(job.failure, Some(Failure::GaveUp { attempts: ATTEMPTS, tile: None }));
    assert_eq!(claim(&store, 6), None);
    assert_eq!(files(bench.path()), [""; 0]);
}

fn a_job_whose_leases_run_out_again_and_again_fails(bench: Bench) {
    let store = open(&bench, 0);
    let id = submit(&store, &job("a", None, b"cloud"), 0);
    for now in 1..=i64::from(ATTEMPTS) {
        let lease = store.claim("worker", now, now + 1).expect("no fault").expect("a job");
        assert_eq!(i64::from(lease.record.attempts), now);
    }
    assert_eq!(claim(&store, 5), None);
    let job = store.get(&id).expect("no fault").expect("a job");
    assert_eq!((job.state, job.finished), (State::Failed, Some(5)));
    assert_eq!(files(bench.path()), [""; 0]);
}

fn a_result_is_seen_whole_with_its_hash_or_not_at_all(bench: Bench) {
    let store = open(&bench, 0);
    let id = submit(&store, &job("a", None, b"cloud"), 0);
    let lease = claim(&store, 1).expect("a job");
    let mut writer = store.result_writer(&lease).expect("a result");
    writer.write_all(b"half of i").expect("room");
    drop(writer);
    assert_eq!(files(bench.path()), [format!("{id}.in")]);
    let made = write(&store, &lease, b"abc");
    assert_eq!(result(&store, &id), None, "not before it is done");
    assert!(store.done(&lease, &made, 2).expect("no fault"));
    assert_eq!(result(&store, &id).as_deref(), Some(&b"abc"[..]));
    assert!(store.delete(&id).expect("no fault"));
    assert!(store.result(&id).expect("no fault").is_none(), "what is gone is not one that is not done");
    let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
    assert_eq!((made.sha256.as_str(), made.bytes), (abc, 3));
}

fn what_a_stale_worker_writes_is_not_the_result_and_does_not_stay(bench: Bench) {
    let store = open(&bench, 0);
    let id = submit(&store, &job("a", None, b"cloud"), 0);
    let stale = store.claim("slow", 1, 10).expect("no fault").expect("a job");
    let lease = claim(&store, 10).expect("the same, since the lease has run out");
    assert_eq!((&lease.record.id, lease.record.attempts), (&id, 2));
    let (early, made) = (write(&store, &stale, b"stale"), write(&store, &lease, b"right"));
    assert!(!store.done(&stale, &early, 11).expect("no fault"));
    assert!(store.done(&lease, &made, 12).expect("no fault"));
    // Again, from the beginning to the end.
    let late = write(&store, &stale, b"stale");
    assert!(!store.done(&stale, &late, 13).expect("no fault"));
    assert!(!store.put_back(&stale).expect("no fault"));
    assert_eq!(result(&store, &id).as_deref(), Some(&b"right"[..]));
    assert_eq!(files(bench.path()), [made.blob]);
}

#[test]
fn a_folder_is_open_once_and_a_later_version_is_not_touched() {
    let dir = tempfile::tempdir().expect("a folder");
    let store = Store::open(dir.path(), BOUNDS, 0).expect("a store");
    assert!(matches!(Store::open(dir.path(), BOUNDS, 0), Err(StoreError::Locked)));
    drop(store);
    let database = rusqlite::Connection::open(dir.path().join("jobs.sqlite")).expect("a database");
    database.pragma_update(None, "user_version", 6).expect("a version");
    drop(database);
    let refused = Store::open(dir.path(), BOUNDS, 0);
    assert!(matches!(refused, Err(StoreError::Version { found: 6, known: 5 })));
}

fn what_is_refused_leaves_no_file(bench: Bench) {
    let store = bench.store(Bounds { jobs: 1, ..BOUNDS }, 0);
    let draft = Draft::new(job("a", None, b"cloud")).expect("a draft");
    let Admitted::New(late) = store.admit(&draft).expect("room") else { panic!("new") };
    let input = store.write_input(&late, &draft).expect("room");
    let first = submit(&store, &job("b", None, b"cloud"), 0);
    assert!(matches!(store.insert(&draft, input, 1), Err(StoreError::Full { .. })), "another was quicker");
    assert_eq!(files(bench.path()), [format!("{first}.in")]);
}
