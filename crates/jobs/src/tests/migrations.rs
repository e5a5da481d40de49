//! Databases of earlier versions.

use rusqlite::Connection;

use super::*;

#[test]
fn databases_of_before_are_brought_up_to_date() {
    for version in [1, 2, 3, 4] {
        let dir = tempfile::tempdir().expect("a folder");
        let store = Store::open(dir.path(), BOUNDS, 0).expect("a store");
        let long = NewJob { request: "a".repeat(500), ..job("a", Some("key"), b"abc") };
        let (queued, done) = (submit(&store, &long, 0), submit(&store, &job("b", None, b"x"), 0));
        let last = submit(&store, &job("c", None, b"x"), 0);
        let used = store.used().expect("a sum");
        drop(store);
        let database = Connection::open(dir.path().join("jobs.sqlite")).expect("a database");
        let tiles = "
            DROP TRIGGER jobs_end; DROP INDEX jobs_that_wait; DROP TABLE tiles;
            ALTER TABLE jobs DROP COLUMN waits; ALTER TABLE jobs DROP COLUMN plan;
            ALTER TABLE jobs DROP COLUMN tiles; ALTER TABLE jobs DROP COLUMN tiles_done;
            ALTER TABLE jobs DROP COLUMN points_done; ALTER TABLE jobs DROP COLUMN tile_bytes;
            PRAGMA user_version = 4;";
        let leases = "
            ALTER TABLE jobs DROP COLUMN claims;
            ALTER TABLE jobs DROP COLUMN worker;
            ALTER TABLE jobs DROP COLUMN until;
            ALTER TABLE jobs DROP COLUMN blob;
            PRAGMA user_version = 3;";
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
        for step in [tiles, leases, rows, columns].into_iter().take(5 - version) {
            database.execute_batch(step).unwrap_or_else(|error| panic!("version {version}: {error}"));
        }
        drop(database);
        let store = Store::open(dir.path(), BOUNDS, 1).expect("a store");
        assert_eq!(store.used().expect("a sum"), used, "with its rows");
        let known = try_submit(&store, &long, 2);
        assert!(matches!(known, Ok(Submitted::Known(_))), "{known:?}");
        let place =
            |id: &str| store.ahead(&store.get(id).expect("no fault").expect("the job")).expect("no fault").0;
        assert_eq!([&queued, &done, &last].map(|id| place(id)), [0, 1, 2]);
        let lease = claim(&store, 3).expect("a job");
        assert_eq!(lease.record.id, queued);
        write(&store, &lease, b"abc");
        let ids = store.list(None, 10, Some("")).expect("a list").into_iter().map(|job| job.id);
        assert_eq!(ids.collect::<Vec<_>>(), [last, done, queued]);
        assert_eq!(store.list(None, 10, Some("a")).expect("a list").len(), 0, "nobody's");
        drop(store);
        drop(Store::open(dir.path(), BOUNDS, 4).expect("a store"));
    }
}

/// A database as version 3 left it when it was killed: `d` done at the second attempt, `r` running, `e` running at the
/// last attempt that it has, `q` queued, and `f` failed.
const OF_3: &str = r#"
    CREATE TABLE jobs (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        state TEXT NOT NULL,
        request TEXT NOT NULL,
        owner TEXT NOT NULL,
        client TEXT NOT NULL,
        key TEXT,
        fingerprint TEXT NOT NULL,
        request_id TEXT NOT NULL,
        points_in INTEGER NOT NULL,
        points_out INTEGER NOT NULL,
        row_bytes INTEGER NOT NULL,
        bytes INTEGER NOT NULL,
        turn INTEGER NOT NULL,
        attempts INTEGER NOT NULL DEFAULT 0,
        created INTEGER NOT NULL,
        started INTEGER,
        finished INTEGER,
        result TEXT,
        failure TEXT,
        UNIQUE (owner, key)
    ) STRICT;
    CREATE INDEX jobs_by_turn ON jobs (state, turn, number);
    CREATE INDEX jobs_by_end ON jobs (finished);
    CREATE INDEX jobs_by_client ON jobs (client, state, turn);
    CREATE TABLE totals (used INTEGER NOT NULL, clock INTEGER NOT NULL) STRICT;
    INSERT INTO totals VALUES (0, 0);
    CREATE TRIGGER jobs_come AFTER INSERT ON jobs
        BEGIN UPDATE totals SET used = used + new.bytes; END;
    CREATE TRIGGER jobs_change AFTER UPDATE OF bytes ON jobs
        BEGIN UPDATE totals SET used = used + new.bytes - old.bytes; END;
    CREATE TRIGGER jobs_go AFTER DELETE ON jobs
        BEGIN UPDATE totals SET used = used - old.bytes; END;
    CREATE TRIGGER jobs_start AFTER UPDATE OF state ON jobs WHEN new.state = 'running'
        BEGIN UPDATE totals SET clock = max(clock, new.turn); END;
    PRAGMA user_version = 3;
    INSERT INTO jobs VALUES
        (1, 'd', 'done', '4x', 'o', 'c', 'k', 'same', 'r1', 3, 12, 1030, 1100, 1, 2, 10, 20, 30,
            '{"bytes":4,"sha256":"0","about":"about"}', NULL),
        (2, 'r', 'running', '4x', 'o', 'c', NULL, 'x', 'r2', 3, 12, 1030, 1330, 2, 1, 11, 31, NULL, NULL, NULL),
        (3, 'e', 'running', '4x', 'o', 'c', NULL, 'x', 'r3', 3, 12, 1030, 1330, 3, 3, 12, 32, NULL, NULL, NULL),
        (4, 'q', 'queued', '4x', 'o', 'c', NULL, 'x', 'r4', 3, 12, 1030, 1330, 4, 0, 13, NULL, NULL, NULL, NULL),
        (5, 'f', 'failed', '4x', 'o', 'c', NULL, 'x', 'r5', 3, 12, 1030, 1040, 0, 1, 14, 33, 34, NULL,
            '"Crashed"');
    UPDATE totals SET clock = 3;"#;

#[test]
fn a_folder_of_version_3_is_gone_on_with() {
    let dir = tempfile::tempdir().expect("a folder");
    std::fs::create_dir(dir.path().join("files")).expect("a folder");
    let names = ["d.out", "e.in", "e.out.part", "q.in", "r.in", "r.out"];
    for name in names {
        std::fs::write(dir.path().join("files").join(name), name).expect("a file");
    }
    let database = Connection::open(dir.path().join("jobs.sqlite")).expect("a database");
    database.execute_batch(OF_3).expect("the database of then");
    drop(database);

    let store = Store::open(dir.path(), BOUNDS, 100).expect("a store");
    assert_eq!(files(dir.path()), ["d.out", "q.in", "r.in"]);
    assert_eq!(result(&store, "d").as_deref(), Some(&b"d.out"[..]));
    let get = |id: &str| store.get(id).expect("no fault").expect("the job");
    let done = get("d");
    assert_eq!((done.state, done.attempts, done.finished), (State::Done, 2, Some(30)));
    let told = ResultFile { blob: "d.out".into(), bytes: 4, sha256: "0".into(), about: "about".into() };
    assert_eq!(done.result, Some(told));
    assert_eq!(get("e").failure, Some(Failure::GaveUp { attempts: 3, tile: None }));
    assert_eq!(get("f").failure, Some(Failure::Crashed));

    for (id, attempts) in [("r", 2), ("q", 1)] {
        let lease = claim(&store, 101).expect("a job");
        assert_eq!((lease.record.id.as_str(), lease.record.attempts, lease.attempt), (id, attempts, 1));
        let mut input = String::new();
        store.input(id).expect("its cloud").read_to_string(&mut input).expect("text");
        assert_eq!(input, format!("{id}.in"));
        let made = write(&store, &lease, id.as_bytes());
        assert!(store.done(&lease, &made, 102).expect("no fault"));
    }
    drop(store);

    let store = Store::open(dir.path(), BOUNDS, 103).expect("a store");
    assert_eq!(files(dir.path()), ["d.out", "q.1.out", "r.1.out"]);
    assert_eq!(result(&store, "r").as_deref(), Some(&b"r"[..]));
    assert!(store.delete("d").expect("no fault"));
    assert_eq!(store.expire(103, 10).expect("no fault").len(), 4);
    assert_eq!(files(dir.path()), [""; 0]);
    assert_eq!(store.used().expect("a sum"), 0);
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_database_of_the_first_version_is_gone_on_with() {
    use super::records::{claim, put};
    let bench = Bench::of(engine::Engine::Postgres);
    bench.execute(&format!("CREATE SCHEMA {}; {}", bench.schema(), Postgres::first())).expect("rights");
    let records = bench.postgres(bench.port(), "kind", BOUNDS);
    assert_eq!(records.ask("SELECT version FROM version"), 2);
    put(&records, &of("a", None), 0);
    let plan = claim(&records, 1);
    assert!(records.split(&plan, "plan", &[1; 2], 0).expect("no fault"));
    assert_eq!([claim(&records, 2).step, claim(&records, 2).step], [Step::Tile(0), Step::Tile(1)]);
    assert_eq!(records.ask("SELECT oldest FROM version"), 1, "programs of before go on beside it");
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn programs_that_start_at_once_make_one_schema() {
    let bench = Bench::of(engine::Engine::Postgres);
    std::thread::scope(|scope| {
        let opened: Vec<_> = (0..8).map(|_| scope.spawn(|| bench.records(BOUNDS).used())).collect();
        for one in opened {
            assert!(one.join().expect("it opens").is_ok());
        }
    });
}
