//! Many programs over one database.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use super::engine::Engine;
use super::records::{assert_stale, claim, get, made, put, try_put};
use super::*;

const MANY: Bounds = Bounds { disk: 1 << 30, jobs: 1000, client_jobs: 1000, attempts: 100 };

/// Again until the database is there.
fn insist<T>(mut word: impl FnMut() -> Result<T, StoreError>) -> T {
    loop {
        match word() {
            Ok(said) => return said,
            Err(error) => assert!(error.is_away(), "{error:?}"),
        }
    }
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn each_job_is_done_once_while_connections_are_killed_in_the_middle() {
    const JOBS: usize = 200;
    let bench = Bench::of(Engine::Postgres);
    let near = bench.records(MANY);
    (0..JOBS).for_each(|i| drop(put(&*near, &of(&format!("client {}", i % 7), None), 0)));
    let ends: Mutex<BTreeMap<String, usize>> = Mutex::default();
    let over = AtomicBool::new(false);
    // Those in the middle of a change have a lock.
    let kill = format!(
        "SELECT pg_terminate_backend(pid) FROM pg_locks \
         WHERE relation = '{}.totals'::regclass AND pid <> pg_backend_pid()",
        bench.schema()
    );
    std::thread::scope(|scope| {
        let killer = scope.spawn(|| {
            let mut rounds = 0;
            while !over.load(Ordering::Relaxed) {
                bench.execute(&kill).expect("no fault");
                rounds += 1;
            }
            rounds
        });
        let workers: Vec<_> = (0..8)
            .map(|i| {
                let (ends, bench) = (&ends, &bench);
                scope.spawn(move || {
                    let own = bench_records(bench);
                    while let Some(lease) = insist(|| own.claim(&format!("worker {i}"), 0, Time::MAX)) {
                        if insist(|| own.done(&lease, &made(1), 1)) {
                            *ends.lock().expect("no panic").entry(lease.record.id).or_default() += 1;
                        }
                    }
                })
            })
            .collect();
        workers.into_iter().for_each(|worker| worker.join().expect("no panic"));
        over.store(true, Ordering::Relaxed);
        assert!(killer.join().expect("no panic") > 0);
    });
    let mut ends = ends.into_inner().expect("no panic");
    // Those whose leases nobody heard of.
    near.lapse(Time::MAX, 2).expect("no fault");
    while let Some(lease) = near.claim("last", 3, Time::MAX).expect("no fault") {
        assert!(near.done(&lease, &made(1), 4).expect("no fault"));
        *ends.entry(lease.record.id).or_default() += 1;
    }
    assert_eq!(near.counts().expect("counts")[2], (State::Done, JOBS as u64));
    assert_eq!((ends.len(), ends.values().max()), (JOBS, Some(&1)));
}

/// A program's own, whatever is killed meanwhile.
fn bench_records(bench: &Bench) -> Postgres {
    let (address, password) = bench.address(bench.port());
    let limits = Limits { connections: 2, ..Limits::default() };
    insist(|| Postgres::open(&address, Some(&password), limits, "kind", MANY))
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn servers_beside_each_other_never_take_more_than_may_be() {
    let bench = Bench::of(Engine::Postgres);
    let bounds = Bounds { client_jobs: 20, jobs: 30, ..MANY };
    let servers = [bench.records(bounds), bench.records(bounds)];
    let taken = |client: &str| -> usize {
        std::thread::scope(|scope| {
            let insert = |server: &Arc<dyn Records>| match try_put(&**server, &of(client, None), 0) {
                Ok(Submitted::New(_)) => 1,
                Err(StoreError::ClientFull { .. } | StoreError::Full { .. }) => 0,
                other => panic!("{other:?}"),
            };
            let threads: Vec<_> = servers.iter().cycle().take(6).collect();
            let threads = threads
                .into_iter()
                .map(|server| scope.spawn(move || (0..8).map(|_| insert(server)).sum::<usize>()));
            let threads: Vec<_> = threads.collect();
            threads.into_iter().map(|thread| thread.join().expect("no panic")).sum()
        })
    };
    assert_eq!([taken("a"), taken("b")], [20, 10]);
    assert_eq!(servers[0].load("a").expect("no fault").jobs, 30);
    // One request, sent to both at once, is one job.
    let free = claim(&*servers[0], 1);
    assert!(servers[0].done(&free, &made(1), 2).expect("no fault"));
    let ids: Vec<_> = std::thread::scope(|scope| {
        let send =
            |server: &Arc<dyn Records>| match try_put(&**server, &of("c", Some("key")), 0).expect("room") {
                Submitted::New(job) | Submitted::Known(job) => job.id,
            };
        let threads: Vec<_> = servers.iter().map(|server| scope.spawn(move || send(server))).collect();
        threads.into_iter().map(|thread| thread.join().expect("no panic")).collect()
    });
    assert_eq!(ids[0], ids[1]);
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn programs_of_a_kind_do_what_came_to_it_until_the_last_of_them_is_gone() {
    const MINUTE: Time = 60_000;
    let bench = Bench::of(Engine::Postgres);
    let old = bench.postgres(bench.port(), "old", MANY);
    let new = bench.postgres(bench.port(), "new", MANY);
    let now = new.clock().now();
    let ids = [put(&old, &of("a", None), now), put(&old, &of("b", None), now)];
    assert_eq!(old.attend("old 1", now).expect("no fault"), [""; 0]);
    assert_eq!(new.attend("new 1", now).expect("no fault"), [""; 0]);
    assert_eq!(new.waiting().expect("counts").processes, 2);
    assert_eq!(new.claim("new 1", now, now + 1).expect("no fault"), None);
    let lease = claim(&old, now);
    assert!(old.split(&lease, "plan", &[1, 1], 10).expect("no fault"));
    let stale = [lease, claim(&old, now), claim(&old, now)];
    assert_eq!(new.attend("new 1", now + 9 * MINUTE).expect("no fault"), [""; 0]);
    let mut taken = new.attend("new 1", now + 11 * MINUTE).expect("no fault");
    taken.sort_by_key(|id| ids.iter().position(|known| known == id));
    assert_eq!(taken, ids);
    stale.iter().for_each(|lease| assert_stale(&old, lease));
    let job = get(&new, &ids[0]);
    assert_eq!((job.state, job.tiles, job.attempts), (State::Queued, None, 0));
    let own = [claim(&new, now).record.id, claim(&new, now).record.id];
    assert!(ids.iter().all(|id| own.contains(id)), "{own:?}");
    assert_eq!(new.parts(&ids[0]).expect("names"), []);
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn tables_are_made_once_and_later_ones_are_left_or_refused() {
    let bench = Bench::of(Engine::Postgres);
    let (address, password) = bench.address(bench.port());
    let open = || Postgres::open(&address, Some(&password), Limits::default(), "kind", MANY);
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| open().map(drop))).collect();
        threads.into_iter().for_each(|thread| thread.join().expect("no panic").expect("a database"));
    });
    let records = open().expect("a database");
    let id = put(&records, &of("a", None), 0);
    bench
        .execute("UPDATE version SET version = 99; ALTER TABLE jobs ADD COLUMN more INTEGER DEFAULT 1")
        .expect("rights");
    put(&open().expect("what is only more is no hindrance"), &of("a", None), 0);
    assert_eq!(get(&records, &id).id, id, "nor for who was there before");
    bench.execute("UPDATE version SET oldest = 98").expect("rights");
    let refused = open().map(drop);
    assert!(matches!(refused, Err(StoreError::Version { found: 99, known: 2 })), "{refused:?}");
    bench.execute("UPDATE version SET version = 2, oldest = 1").expect("rights");
    // A role that may use the tables, and nothing else.
    let (schema, role) = (bench.schema(), format!("{}_user", bench.schema()));
    bench
        .execute(&format!(
            "CREATE ROLE {role} LOGIN PASSWORD 'secret'; GRANT USAGE ON SCHEMA {schema} TO {role}; \
             GRANT SELECT, INSERT, UPDATE, DELETE ON ALL TABLES IN SCHEMA {schema} TO {role}"
        ))
        .expect("rights");
    let text =
        format!("postgres://{role}@127.0.0.1:{}/postgres?sslmode=disable&schema={schema}", bench.port());
    let address = Address::parse(&text).expect("an address");
    let open = |password: &str| {
        let password = password.to_owned().into();
        Postgres::open(&address, Some(&password), Limits::default(), "kind", MANY)
    };
    let opened = open("secret");
    let wrong = open("wrong secret").map(drop);
    let done = opened.map(|records| put(&records, &of("b", None), 0));
    bench.execute(&format!("DROP OWNED BY {role}; DROP ROLE {role}")).expect("rights");
    done.expect("rights enough");
    let told = format!("{:?} {}", wrong, wrong.as_ref().expect_err("no such password"));
    assert!(!told.contains("secret"), "{told}");
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn a_password_of_the_settings_counts_whatever_the_environment_has() {
    let bench = Bench::of(Engine::Postgres);
    let open = |password: Option<&str>| {
        let keeping = Keeping::Shared {
            database: format!(
                "postgres://test@127.0.0.1:{}/postgres?sslmode=disable&schema={}",
                bench.port(),
                bench.schema()
            ),
            password: password.map(|text| text.to_owned().into()),
            store: bench.path().display().to_string(),
            process: String::new(),
            kind: String::new(),
        };
        Jobs::open(Settings { keeping, ..Settings::new(bench.path().to_owned()) }).map(drop)
    };
    open(None).expect("the environment's");
    let refused = open(Some("another")).expect_err("it is not its password").to_string();
    assert!(refused.contains("password authentication failed"), "{refused}");
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn what_the_database_says_is_one_line() {
    let raise = "DO 'BEGIN RAISE EXCEPTION ''no'' USING DETAIL = ''more'', HINT = ''less''; END'";
    let error = Bench::of(Engine::Postgres).execute(raise).expect_err("it is raised").to_string();
    assert!(error.ends_with("ERROR: no; DETAIL: more; HINT: less"), "{error}");
}

#[test]
#[ignore = "needs scripts/with-services.sh"]
fn words_are_said_and_records_dropped_on_whatever_thread() {
    let bench = Bench::of(Engine::Postgres);
    for runtime in
        [tokio::runtime::Builder::new_current_thread(), tokio::runtime::Builder::new_multi_thread()]
    {
        let said = { runtime }.enable_all().build().expect("threads").block_on(async {
            // More than a task of a runtime may do at once.
            let records = bench.records(MANY);
            (0..200).map(|_| records.used().expect("a sum")).sum::<u64>()
        });
        assert_eq!(said, 0);
    }
}
