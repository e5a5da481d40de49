//! What every keeper of records has to do, whatever it keeps them in: each test is a function over the trait.

use std::collections::BTreeMap;
use std::sync::Mutex;

use super::tiles::*;
use super::*;

/// Of the records under test, which are empty.
pub(super) const BOUNDS: Bounds = Bounds { disk: 1 << 20, jobs: 40, client_jobs: 20, attempts: ATTEMPTS };

over_each_engine!(|bench| &*bench.records(BOUNDS) =>
    clients_take_turns_and_have_their_own_names_for_requests,
    nobody_starves_whoever_else_comes_whatever_the_time,
    a_job_that_finds_no_room_lets_other_clients_go_on,
    no_more_jobs_wait_than_may,
    a_key_names_one_request,
    jobs_take_no_more_of_the_disk_than_they_may,
    rows_count_whatever_their_state_so_jobs_that_are_cancelled_do_not_fill_the_disk,
    a_stale_lease_changes_nothing,
    a_lease_that_ran_out_is_given_anew_as_often_as_may_be,
    a_beat_extends_a_lease,
    no_job_has_two_workers_or_two_ends,
    what_is_over_is_forgotten_when_its_time_has_come,
    records_are_found_counted_and_listed,
    tiles_are_claimed_by_many_and_joined_by_one,
    clients_take_turns_tile_by_tile,
    a_tile_that_is_lost_is_given_anew_as_often_as_may_be,
    a_step_that_fails_of_its_machine_is_given_anew_as_often_as_may_be,
    a_stale_lease_on_a_tile_changes_nothing,
    a_job_whose_tiles_are_of_no_use_begins_anew,
);

pub(super) fn try_put(records: &dyn Records, job: &NewJob, now: Time) -> Result<Submitted, StoreError> {
    let draft = Draft::new(job.clone()).expect("a draft");
    match records.admit(&draft)? {
        Admitted::Known(record) => Ok(Submitted::Known(*record)),
        Admitted::New(id) => records.insert(&id, &draft, now),
    }
}

pub(super) fn put(records: &dyn Records, job: &NewJob, now: Time) -> String {
    match try_put(records, job, now).expect("room") {
        Submitted::New(record) => record.id,
        Submitted::Known(record) => panic!("known: {record:?}"),
    }
}

pub(super) fn claim(records: &dyn Records, now: Time) -> Lease {
    records.claim("worker", now, now + 100).expect("no fault").expect("a job")
}

pub(super) fn get(records: &dyn Records, id: &str) -> Record {
    records.get(id).expect("no fault").expect("the job")
}

pub(super) fn made(bytes: u64) -> ResultFile {
    ResultFile { blob: "x".into(), bytes, sha256: "0".into(), about: "about".into() }
}

fn clients_take_turns_and_have_their_own_names_for_requests(records: &dyn Records) {
    let first: Vec<_> = (0..3).map(|now| put(records, &of("a", None), now)).collect();
    let key = put(records, &of("a", Some("key")), 3);
    let b = put(records, &of("b", Some("key")), 4);
    assert_ne!(key, b, "another owner's key is another key");
    let again = try_put(records, &of("b", Some("key")), 5).expect("room");
    assert_eq!(again, Submitted::Known(get(records, &b)));
    let ahead = |id: &String| records.ahead(&get(records, id)).expect("no fault");
    assert_eq!([&first[0], &first[1], &first[2], &b].map(|id| ahead(id).0), [0, 2, 3, 1]);
    assert_eq!(ahead(&b).1, 12, "the points out of the one before it");
    let order: Vec<_> = (10..15).map(|now| claim(records, now).record.id).collect();
    assert_eq!(order, [&first[0], &b, &first[1], &first[2], &key].map(Clone::clone));
    assert_eq!(records.claim("worker", 15, 16).expect("no fault"), None);
}

fn nobody_starves_whoever_else_comes_whatever_the_time(records: &dyn Records) {
    let kept = put(records, &of("patient", None), 0);
    let run = |now| {
        let lease = claim(records, now);
        assert!(records.done(&lease, &made(1), now).expect("no fault"));
        lease.record.id
    };
    // Its last start is known, and later than all that will be.
    assert_eq!(run(1_000_000), kept);
    let patient = [put(records, &of("patient", None), 0), put(records, &of("patient", None), 0)];
    // Two that fetch and forget, and others that come anew, while the clock goes back.
    for client in ["a", "b"] {
        put(records, &of(client, None), 0);
        put(records, &of(client, None), 0);
    }
    let mut served = Vec::new();
    for turn in 0..12_i64 {
        let id = run(1000 - turn);
        if patient.contains(&id) {
            served.push(turn);
        } else {
            assert!(records.delete(&id).expect("no fault").is_some());
            put(records, &of(["a", "b"][turn as usize % 2], None), 0);
        }
        put(records, &of(&format!("new {turn}"), None), 0);
        let expected: Vec<String> = {
            let mut queued = records.list(None, 1000, None).expect("a list");
            queued.retain(|job| job.state == State::Queued);
            queued.sort_by_key(|job| records.ahead(job).expect("no fault").0);
            let places: Vec<u64> = queued.iter().map(|job| records.ahead(job).expect("no fault").0).collect();
            assert_eq!(places, (0..queued.len() as u64).collect::<Vec<_>>());
            queued.into_iter().map(|job| job.id).collect()
        };
        let next = claim(records, 0);
        assert_eq!(Some(&next.record.id), expected.first(), "as its position said");
        assert!(records.put_back(&next).expect("no fault"));
    }
    assert_eq!(served, [0, 3], "each time one of every other client's is between");
}

fn a_job_that_finds_no_room_lets_other_clients_go_on(records: &dyn Records) {
    let large = put(records, &of("a", None), 0);
    let next = put(records, &of("a", None), 0);
    let others = [put(records, &of("b", None), 0), put(records, &of("b", None), 0)];
    let mut order = Vec::new();
    for _ in 0..4 {
        let lease = claim(records, 7);
        if lease.record.id == large {
            assert!(records.defer(&lease).expect("no fault"));
            let job = get(records, &large);
            assert_eq!((job.state, job.attempts, job.started), (State::Queued, 0, None));
        }
        order.push(lease.record.id);
    }
    assert_eq!(order, [&large, &others[0], &large, &others[1]].map(Clone::clone));
    let own = [claim(records, 7).record.id, claim(records, 7).record.id];
    assert_eq!(own, [large, next], "its client's own are in the order in which they came");
}

fn no_more_jobs_wait_than_may(records: &dyn Records) {
    let first = put(records, &of("a", Some("key")), 0);
    (1..BOUNDS.client_jobs).for_each(|_| drop(put(records, &of("a", None), 0)));
    let refused = try_put(records, &of("a", None), 0);
    assert!(matches!(refused, Err(StoreError::ClientFull { queued: 20, limit: 20 })), "{refused:?}");
    let known = try_put(records, &of("a", Some("key")), 0);
    assert!(matches!(known, Ok(Submitted::Known(_))), "it is there already");
    (0..20).for_each(|i| drop(put(records, &of(&format!("b{}", i % 2), None), 0)));
    let full = records.has_room("b0");
    assert!(matches!(full, Err(StoreError::Full { queued: 40, limit: 40 })), "{full:?}");
    // One that came between question and insertion.
    let late = records.insert("late", &Draft::new(of("c", None)).expect("a draft"), 0);
    assert!(matches!(late, Err(StoreError::Full { .. })), "{late:?}");
    let load = records.load("a").expect("no fault");
    assert_eq!(load, Load { jobs: 40, points: 40 * 12, clients: 3, own: 20 });
    claim(records, 1);
    assert!(records.has_room("c").is_err(), "one that runs counts");
    assert!(records.cancel(&first, 1).expect("no fault"));
    assert!(records.has_room("a").is_ok());
}

fn a_key_names_one_request(records: &dyn Records) {
    let new = job("4x", Some("key"), b"abc");
    let id = put(records, &new, 0);
    for other in [job("5x", Some("key"), b"abc"), job("4x", Some("key"), b"abd")] {
        let refused = try_put(records, &other, 1);
        assert!(matches!(refused, Err(StoreError::OtherRequest)), "{refused:?}");
    }
    // As does one that came between question and insertion.
    let known = records.insert("another", &Draft::new(new.clone()).expect("a draft"), 1);
    assert_eq!(known.expect("no fault"), Submitted::Known(get(records, &id)));
    // It is known whatever becomes of it, until it is forgotten.
    assert!(records.cancel(&id, 2).expect("no fault"));
    assert!(matches!(try_put(records, &new, 3), Ok(Submitted::Known(_))));
    assert!(records.delete(&id).expect("no fault").is_some());
    assert_ne!(put(records, &new, 4), id);
}

fn jobs_take_no_more_of_the_disk_than_they_may(records: &dyn Records) {
    let large = NewJob { result_bytes: 400_000, ..of("a", None) };
    let ids = [put(records, &large, 0), put(records, &large, 0)];
    let used = records.used().expect("a sum");
    let refused = try_put(records, &large, 0);
    assert!(
        matches!(refused, Err(StoreError::OverBudget { used: sum, limit, wanted }) if sum == used
            && limit == BOUNDS.disk && wanted == used / 2),
        "{refused:?}"
    );
    // The result is smaller than it was taken for.
    let lease = claim(records, 1);
    assert!(records.done(&lease, &made(1000), 2).expect("no fault"));
    let after = records.used().expect("a sum");
    assert!((used - 400_000..used - 398_000).contains(&after), "{after} of {used}");
    assert!(records.cancel(&ids[1], 3).expect("no fault"));
    assert!(records.used().expect("a sum") < 5000);
    put(records, &large, 4);
}

fn rows_count_whatever_their_state_so_jobs_that_are_cancelled_do_not_fill_the_disk(records: &dyn Records) {
    let new = job(&"4x".repeat(50_000), None, b"abc");
    let mut kept = 0;
    loop {
        match try_put(records, &new, 0) {
            Ok(Submitted::New(job)) => assert!(records.cancel(&job.id, 1).expect("no fault")),
            Err(StoreError::OverBudget { used, .. }) => {
                assert!(used > kept * 100_000, "{used}");
                break;
            }
            other => panic!("{other:?}"),
        }
        kept += 1;
        assert!(kept < 100);
    }
    assert_eq!(records.expire(2, 2).expect("no fault").len(), 2, "as many at once as may");
    assert_eq!(records.expire(2, 100).expect("no fault").len() as u64, kept - 2);
    assert_eq!(records.used().expect("a sum"), 0);
}

/// Says all that can be said under a lease, which is not the job's any more.
pub(super) fn assert_stale(records: &dyn Records, lease: &Lease) {
    let before = records.get(&lease.record.id).expect("no fault");
    let used = records.used().expect("a sum");
    let words = [
        records.done(lease, &made(7), 50),
        records.failed(lease, &Failure::Crashed, 50),
        records.put_back(lease),
        records.defer(lease),
        records.beat(lease, 1_000_000),
        records.split(lease, "plan", &[1, 2], 3),
        records.tile_done(lease, "part", 1),
        records.unsplit(lease),
    ];
    assert!(words.into_iter().all(|word| !word.expect("no fault")), "{lease:?}");
    assert_eq!(records.retry(lease, &Failure::Crashed, 50).expect("no fault"), None);
    assert_eq!(records.get(&lease.record.id).expect("no fault"), before);
    assert_eq!(records.used().expect("a sum"), used);
}

fn a_stale_lease_changes_nothing(records: &dyn Records) {
    let id = put(records, &of("a", None), 0);
    let mut stale = vec![claim(records, 1)];
    assert_eq!(
        (stale[0].record.id.as_str(), stale[0].worker.as_str(), stale[0].until),
        (&*id, "worker", 101)
    );
    // Put back, deferred and run out: each time another has it, and the number that users see tells nothing.
    assert!(records.put_back(&stale[0]).expect("no fault"));
    assert_stale(records, &stale[0]);
    stale.push(claim(records, 2));
    assert_eq!(stale.iter().map(|lease| lease.record.attempts).collect::<Vec<_>>(), [1, 1]);
    assert!(records.defer(&stale[1]).expect("no fault"));
    stale.push(claim(records, 3));
    assert_eq!(records.lapse(1000, 1000).expect("no fault").len(), 1);
    stale.iter().for_each(|lease| assert_stale(records, lease));
    let held = claim(records, 4);
    assert!(stale.iter().all(|lease| lease.attempt < held.attempt));
    stale.iter().for_each(|lease| assert_stale(records, lease));
    // Its own end, a user's, and none at all.
    assert!(records.done(&held, &made(3), 5).expect("no fault"));
    let job = get(records, &id);
    assert_eq!((job.state, job.finished, job.result), (State::Done, Some(5), Some(made(3))));
    stale.push(held);
    stale.iter().for_each(|lease| assert_stale(records, lease));
    assert!(records.delete(&id).expect("no fault").is_some());
    stale.iter().for_each(|lease| assert_stale(records, lease));
    let id = put(records, &of("a", None), 6);
    let held = claim(records, 7);
    assert!(records.cancel(&id, 8).expect("no fault"));
    assert_stale(records, &held);
}

fn a_lease_that_ran_out_is_given_anew_as_often_as_may_be(records: &dyn Records) {
    let id = put(records, &of("a", None), 0);
    let other = put(records, &of("b", None), 0);
    for attempt in 1..=ATTEMPTS {
        let lease = records.claim("worker", 10, 100).expect("no fault").expect("a job");
        assert_eq!((lease.record.id.as_str(), lease.record.attempts), (&*id, attempt), "at its old turn");
        assert_eq!(records.lapse(99, 50).expect("no fault"), []);
        let lapsed = Lapsed { id: id.clone(), tile: None, attempts: attempt, again: attempt < ATTEMPTS };
        assert_eq!(records.lapse(100, 50).expect("no fault"), [lapsed]);
        assert_eq!(records.lapse(100, 50).expect("no fault"), []);
    }
    let job = get(records, &id);
    assert_eq!((job.state, job.finished), (State::Failed, Some(50)));
    assert_eq!(job.failure, Some(Failure::GaveUp { attempts: ATTEMPTS, tile: None }));
    assert_eq!(claim(records, 60).record.id, other);
}

fn a_beat_extends_a_lease(records: &dyn Records) {
    let id = put(records, &of("a", None), 0);
    let lease = records.claim("worker", 0, 100).expect("no fault").expect("a job");
    assert!(records.beat(&lease, 200).expect("no fault"));
    assert_eq!(records.lapse(150, 150).expect("no fault"), []);
    // It has run out, and nobody has taken the job.
    assert!(records.beat(&lease, 400).expect("no fault"));
    assert_eq!(records.lapse(300, 300).expect("no fault"), []);
    assert_eq!(get(records, &id).attempts, 1);
    assert!(records.failed(&lease, &Failure::Crashed, 301).expect("no fault"));
    assert_eq!(get(records, &id).failure, Some(Failure::Crashed));
}

fn no_job_has_two_workers_or_two_ends(records: &dyn Records) {
    const JOBS: usize = 24;
    (0..JOBS).for_each(|i| drop(put(records, &of(&format!("client {}", i % 3), None), 0)));
    let held: Mutex<Vec<(String, u64)>> = Mutex::default();
    let ends: Mutex<BTreeMap<String, usize>> = Mutex::default();
    let end = |id: &String| *ends.lock().expect("no panic").entry(id.clone()).or_default() += 1;
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for i in 0.. {
                    let Some(lease) = records.claim("worker", 0, 0).expect("no fault") else { break };
                    held.lock().expect("no panic").push((lease.record.id.clone(), lease.attempt));
                    // All leases run out at once; now and then somebody sees it, this lease's holder among them.
                    if i % 3 == 0 {
                        let lapsed = records.lapse(0, 0).expect("no fault");
                        lapsed.iter().filter(|lapsed| !lapsed.again).for_each(|lapsed| end(&lapsed.id));
                    }
                    if records.done(&lease, &made(1), 0).expect("no fault") {
                        end(&lease.record.id);
                    }
                }
            });
        }
    });
    // What a worker let go of after the others had found nothing left.
    while let Some(lease) = records.claim("worker", 0, 0).expect("no fault") {
        assert!(records.done(&lease, &made(1), 0).expect("no fault"));
        end(&lease.record.id);
    }
    let mut held = held.into_inner().expect("no panic");
    let claims = held.len();
    held.sort();
    held.dedup();
    assert_eq!(held.len(), claims, "each lease is one worker's");
    let ends = ends.into_inner().expect("no panic");
    assert_eq!(ends.len(), JOBS);
    assert!(ends.values().all(|&count| count == 1), "{ends:?}");
}

fn what_is_over_is_forgotten_when_its_time_has_come(records: &dyn Records) {
    let ids: Vec<_> = (0..4).map(|_| put(records, &of("a", None), 0)).collect();
    let done = claim(records, 1);
    assert!(records.done(&done, &made(3), 10).expect("no fault"));
    let failed = claim(records, 1);
    assert!(records.failed(&failed, &Failure::Crashed, 20).expect("no fault"));
    claim(records, 1);
    for id in &ids[2..] {
        assert_eq!(records.delete(id).expect("no fault"), None, "it runs, or waits");
    }
    assert_eq!(records.expire(10, 9).expect("no fault"), [], "its last moment");
    let forgotten =
        |id: &String, blob: Option<&str>| Forgotten { id: id.clone(), blob: blob.map(Into::into) };
    assert_eq!(records.expire(11, 9).expect("no fault"), [forgotten(&ids[0], Some("x"))]);
    assert_eq!(records.delete(&ids[1]).expect("no fault"), Some(forgotten(&ids[1], None)));
    assert_eq!(records.delete(&ids[1]).expect("no fault"), None);
    assert_eq!(records.expire(Time::MAX, 9).expect("no fault"), [], "what is not over is kept");
    assert_eq!(records.get(&ids[0]).expect("no fault"), None);
}

fn records_are_found_counted_and_listed(records: &dyn Records) {
    let ids: Vec<_> =
        [("a", 1), ("b", 2), ("a", 3)].map(|(client, now)| put(records, &of(client, None), now)).into();
    let lease = claim(records, 7);
    assert!(records.done(&lease, &made(3), 8).expect("no fault"));
    claim(records, 9);
    let job = get(records, &ids[0]);
    assert_eq!((job.created, job.started, job.finished), (1, Some(7), Some(8)));
    assert_eq!((job.owner.as_str(), job.client.as_str(), job.request_id.as_str()), ("a", "a", "r"));
    assert_eq!((job.request.as_str(), job.points_in, job.points_out), ("4x", 3, 12));
    let counts = [(State::Queued, 1), (State::Running, 1), (State::Done, 1)];
    let rest = [(State::Failed, 0), (State::Cancelled, 0)];
    assert_eq!(records.counts().expect("counts").to_vec(), [&counts[..], &rest].concat());
    let list = |before, limit, owner| -> Vec<String> {
        let listed = records.list(before, limit, owner).expect("a list");
        listed.into_iter().map(|job| job.id).collect()
    };
    assert_eq!(list(None, 10, None), [&*ids[2], &ids[1], &ids[0]]);
    assert_eq!(list(None, 1, None), [&*ids[2]]);
    assert_eq!(list(Some(job.number + 1), 10, None), [&*ids[0]]);
    assert_eq!(list(None, 10, Some("a")), [&*ids[2], &ids[0]]);
    assert_eq!(list(None, 10, Some("c")), [""; 0]);
    let promised = records.promised().expect("names");
    assert_eq!(promised.len(), 3);
    assert!(promised.contains(&Promised::Result("x".to_owned())));
    assert!(ids[1..].iter().all(|id| promised.contains(&Promised::Input(id.clone()))));
}
