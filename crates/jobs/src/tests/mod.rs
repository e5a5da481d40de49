//! The store: its rules one by one, and what its tests share.

mod model;
mod worker;

use std::io::{self, Write};
use std::path::Path;

use super::*;
use densecloud::provenance::hexadecimal;

const DISK: u64 = 10_000;
const BOUNDS: Bounds = Bounds { disk: DISK, jobs: 1000, client_jobs: 1000 };
const ATTEMPTS: u32 = 3;
/// What a result is taken for beforehand: more than any here is, with what is told of it.
const RESULT: u64 = 300;

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
        result_bytes: RESULT,
        input: input.into(),
    }
}

/// As the server does it.
fn try_submit(store: &Store, job: &NewJob, now: Time) -> Result<Submitted, StoreError> {
    let draft = Draft::new(job.clone());
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
    let result_of =
        |id: &str| store.result(id).expect("no fault").map(|(job, result)| (job.state, result.is_some()));
    assert_eq!(result_of(&id), Some((State::Running, false)), "not before it is done");
    assert!(store.done(&id, &result, 2).expect("no fault"));
    assert_eq!(result_of(&id), Some((State::Done, true)));
    assert!(!store.done(&id, &result, 3).is_ok_and(|done| done), "once");
    assert!(store.delete(&id).expect("no fault"));
    assert_eq!(result_of(&id), None, "what is gone is not one that is not done");
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
    database.pragma_update(None, "user_version", 4).expect("a version");
    drop(database);
    assert!(matches!(Store::open(dir.path(), BOUNDS, ATTEMPTS, 0), Err(StoreError::Version(4))));
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
    assert_eq!(try_submit(&store, &of("b", Some("key")), 5).expect("room"), {
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
    let refused = try_submit(&store, &of("a", None), 0);
    assert!(matches!(refused, Err(StoreError::ClientFull { queued: 2, limit: 2 })), "{refused:?}");
    assert!(
        matches!(try_submit(&store, &of("a", Some("key")), 0), Ok(Submitted::Known(_))),
        "it is there already"
    );
    submit(&store, &of("b", None), 0);
    assert!(matches!(store.has_room("b"), Err(StoreError::Full { queued: 3, limit: 3 })));
    assert_eq!(store.load("a").expect("no fault"), Load { jobs: 3, points: 36, clients: 2, own: 2 });
    assert!(store.cancel(&first, 1).expect("no fault"));
    assert!(store.has_room("a").is_ok());
    assert_eq!(files(dir.path()).len(), 2, "what was refused leaves nothing");
}

#[test]
fn nobody_starves_whoever_else_comes_whatever_the_time() {
    let dir = tempfile::tempdir().expect("a folder");
    let store = Store::open(dir.path(), Bounds { disk: 1 << 20, ..BOUNDS }, ATTEMPTS, 0).expect("a store");
    let kept = submit(&store, &of("patient", None), 0);
    let run = |now| {
        let job = store.claim(now).expect("no fault").expect("a job");
        let result = write(&store, &job.id, b"x");
        assert!(store.done(&job.id, &result, now).expect("no fault"));
        job.id
    };
    // Its last start is known, and later than all that will be.
    assert_eq!(run(1_000_000), kept);
    let patient = [submit(&store, &of("patient", None), 0), submit(&store, &of("patient", None), 0)];
    // Two that fetch and forget, and others that come anew, while the clock goes back.
    let mut waiting = Vec::new();
    for client in ["a", "b"] {
        waiting.push(submit(&store, &of(client, None), 0));
        waiting.push(submit(&store, &of(client, None), 0));
    }
    let mut served = Vec::new();
    for turn in 0..12_i64 {
        let id = run(1000 - turn);
        if patient.contains(&id) {
            served.push(turn);
        } else {
            assert!(store.delete(&id).expect("no fault"));
            submit(&store, &of(["a", "b"][turn as usize % 2], None), 0);
        }
        submit(&store, &of(&format!("new {turn}"), None), 0);
        let expected: Vec<String> = {
            let mut queued = store.list(None, 1000, None).expect("a list");
            queued.retain(|job| job.state == State::Queued);
            queued.sort_by_key(|job| store.ahead(job).expect("no fault").0);
            let places: Vec<u64> = queued.iter().map(|job| store.ahead(job).expect("no fault").0).collect();
            assert_eq!(places, (0..queued.len() as u64).collect::<Vec<_>>());
            queued.into_iter().map(|job| job.id).collect()
        };
        let next = store.claim(0).expect("no fault").expect("a job").id;
        assert_eq!(Some(&next), expected.first(), "as its position said");
        assert!(store.put_back(&next).expect("no fault"));
    }
    assert_eq!(served, [0, 3], "each time one of every other client's is between");
}

#[test]
fn a_job_that_finds_no_room_lets_other_clients_go_on() {
    let dir = tempfile::tempdir().expect("a folder");
    let store = open(dir.path(), 0);
    let large = submit(&store, &of("a", None), 0);
    let next = submit(&store, &of("a", None), 0);
    let others = [submit(&store, &of("b", None), 0), submit(&store, &of("b", None), 0)];
    let claim = || store.claim(7).expect("no fault").expect("a job").id;
    let mut order = Vec::new();
    for _ in 0..4 {
        let id = claim();
        if id == large {
            assert!(store.defer(&id).expect("no fault"));
            let job = store.get(&id).expect("no fault").expect("the job");
            assert_eq!((job.state, job.attempts, job.started), (State::Queued, 0, None));
        }
        order.push(id);
    }
    assert_eq!(order, [&large, &others[0], &large, &others[1]].map(Clone::clone));
    assert_eq!([claim(), claim()], [large, next], "its client's own are in the order in which they came");
}

#[test]
fn rows_count_whatever_their_state_so_jobs_that_are_cancelled_do_not_fill_the_disk() {
    let dir = tempfile::tempdir().expect("a folder");
    let store = open(dir.path(), 0);
    let new = job(&"4x".repeat(1000), None, b"abc");
    let mut kept = 0;
    loop {
        match try_submit(&store, &new, 0) {
            Ok(Submitted::New(job)) => assert!(store.cancel(&job.id, 1).expect("no fault")),
            Err(StoreError::OverBudget { used, .. }) => {
                assert!(used > kept * 3000, "{used}");
                break;
            }
            other => panic!("{other:?}"),
        }
        kept += 1;
        assert!(kept < 100);
    }
    let used = store.used().expect("a sum");
    drop(store);
    let store = open(dir.path(), 0);
    assert_eq!(store.used().expect("a sum"), used);
    assert_eq!(store.expire(2, 2).expect("no fault").len(), 2, "as many at once as may");
    assert_eq!(store.expire(2, 2).expect("no fault").len() as u64, kept - 2);
    assert_eq!(store.used().expect("a sum"), 0);
}

#[test]
fn databases_of_before_are_brought_up_to_date() {
    for version in [1, 2] {
        let dir = tempfile::tempdir().expect("a folder");
        let store = open(dir.path(), 0);
        let long = NewJob { request: "a".repeat(500), ..job("a", Some("key"), b"abc") };
        let (queued, done) = (submit(&store, &long, 0), submit(&store, &job("b", None, b"x"), 0));
        let last = submit(&store, &job("c", None, b"x"), 0);
        let used = store.used().expect("a sum");
        drop(store);
        let database = rusqlite::Connection::open(dir.path().join("jobs.sqlite")).expect("a database");
        let rows = "
            UPDATE jobs SET bytes = bytes - row_bytes;
            DROP TRIGGER jobs_come; DROP TRIGGER jobs_change; DROP TRIGGER jobs_go; DROP TRIGGER jobs_start;
            DROP TABLE totals;
            DROP INDEX jobs_by_client; DROP INDEX jobs_by_turn;
            ALTER TABLE jobs DROP COLUMN row_bytes;
            ALTER TABLE jobs DROP COLUMN turn;
            CREATE INDEX jobs_by_state ON jobs (state, number);
            CREATE INDEX jobs_by_client ON jobs (client, started);
            PRAGMA user_version = 2;";
        let columns = "
            DROP INDEX jobs_by_client; DROP INDEX jobs_by_state; DROP INDEX jobs_by_end;
            CREATE TABLE old (
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
            PRAGMA user_version = 1;";
        for step in [rows, columns].into_iter().take(if version == 1 { 2 } else { 1 }) {
            database.execute_batch(step).unwrap_or_else(|error| panic!("version {version}: {error}"));
        }
        drop(database);
        let store = open(dir.path(), 1);
        assert_eq!(store.used().expect("a sum"), used, "with its rows");
        let known = try_submit(&store, &long, 2);
        assert!(matches!(known, Ok(Submitted::Known(_))), "{known:?}");
        let place =
            |id: &str| store.ahead(&store.get(id).expect("no fault").expect("the job")).expect("no fault").0;
        assert_eq!([&queued, &done, &last].map(|id| place(id)), [0, 1, 2]);
        assert_eq!(store.claim(3).expect("no fault").map(|job| job.id), Some(queued.clone()));
        write(&store, &queued, b"abc");
        let ids = store.list(None, 10, Some("")).expect("a list").into_iter().map(|job| job.id);
        assert_eq!(ids.collect::<Vec<_>>(), [last, done, queued]);
        assert_eq!(store.list(None, 10, Some("a")).expect("a list").len(), 0, "nobody's");
        drop(store);
        drop(open(dir.path(), 4));
    }
}
