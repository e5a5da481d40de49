//! What every keeper of records has to do of jobs in tiles.

use super::records::{assert_stale, claim, get, made, put};
use super::*;

/// A job of a client, planned to so many tiles of a point each.
fn split(records: &dyn Records, client: &str, tiles: usize) -> String {
    let id = put(records, &of(client, None), 0);
    let lease = claim(records, 1);
    assert_eq!((&lease.record.id, lease.step), (&id, Step::Whole));
    assert!(records.split(&lease, "plan", &vec![1; tiles], 100).expect("no fault"));
    id
}

fn steps(records: &dyn Records, count: usize) -> Vec<(String, Step)> {
    let leases = (0..count).map(|_| claim(records, 2));
    leases.map(|lease| (lease.record.id, lease.step)).collect()
}

fn nothing_waits(records: &dyn Records) -> bool {
    records.claim("worker", 3, 4).expect("no fault").is_none()
}

pub(super) fn tiles_are_claimed_by_many_and_joined_by_one(records: &dyn Records) {
    let before = records.used().expect("a sum");
    let id = split(records, "a", 3);
    let all = records.used().expect("a sum") - before;
    let job = get(records, &id);
    let tiles = |done| Some(Tiles { plan: "plan".to_owned(), count: 3, done, points: u64::from(done) });
    assert_eq!((job.state, job.tiles, job.started), (State::Running, tiles(0), Some(1)));
    assert_eq!(records.promised().expect("names"), [Promised::Tiles(id.clone())]);
    let waiting = || records.waiting().expect("counts");
    assert_eq!((waiting().whole, waiting().tiles, waiting().joins, waiting().oldest), (0, 3, 0, None));
    let leases: Vec<_> = (0..3).map(|_| claim(records, 2)).collect();
    assert_eq!(waiting().tiles, 0);
    assert_eq!(leases.iter().map(|lease| lease.step).collect::<Vec<_>>(), [0, 1, 2].map(Step::Tile));
    assert!(nothing_waits(records));
    // In another order, and the second is put back once.
    assert!(records.tile_done(&leases[2], "part 2", 1).expect("no fault"));
    assert!(records.put_back(&leases[1]).expect("no fault"));
    assert!(records.tile_done(&leases[0], "part 0", 1).expect("no fault"));
    assert_eq!(get(records, &id).tiles, tiles(2));
    let again = claim(records, 5);
    assert_eq!(again.step, Step::Tile(1));
    assert!(nothing_waits(records), "not joined before the last is done");
    assert!(records.tile_done(&again, "part 1", 1).expect("no fault"));
    let names = [(0, "part 0"), (1, "part 1"), (2, "part 2")].map(|(tile, name)| (tile, name.to_owned()));
    assert_eq!(records.parts(&id).expect("names"), names);
    assert_eq!((waiting().tiles, waiting().joins), (0, 1));
    let join = claim(records, 6);
    assert_eq!((join.step, &join.record.tiles), (Step::Join, &tiles(3)));
    assert!(nothing_waits(records));
    assert!(records.put_back(&join).expect("no fault"));
    assert_eq!(get(records, &id).state, State::Running);
    let join = claim(records, 7);
    assert!(records.done(&join, &made(3), 8).expect("no fault"));
    let job = get(records, &id);
    assert_eq!((job.state, job.started, job.finished, job.tiles), (State::Done, Some(1), Some(8), tiles(3)));
    assert_eq!(records.parts(&id).expect("names"), []);
    assert!(records.used().expect("a sum") < before + all - 100, "what the tiles took is free");
    assert!(nothing_waits(records));
}

pub(super) fn clients_take_turns_tile_by_tile(records: &dyn Records) {
    let large = split(records, "a", 4);
    let own = put(records, &of("a", None), 2);
    let others = [put(records, &of("b", None), 2), put(records, &of("b", None), 2)];
    // A tile of the large one is its client's turn, and then its other job's.
    let order = steps(records, 7);
    let tile = |tile| (large.clone(), Step::Tile(tile));
    let whole = |id: &String| (id.clone(), Step::Whole);
    let expected = [tile(0), whole(&own), whole(&others[0]), tile(1), whole(&others[1]), tile(2), tile(3)];
    assert_eq!(order.len(), expected.len());
    assert_eq!(order[0], expected[0]);
    for (client, steps) in [
        ("a", [tile(0), whole(&own), tile(1), tile(2), tile(3)].to_vec()),
        ("b", others.each_ref().map(whole).to_vec()),
    ] {
        let of_client = order.iter().filter(|step| steps.contains(step)).cloned().collect::<Vec<_>>();
        assert_eq!(of_client, steps, "{client}");
    }
    let last_of_b = order.iter().position(|step| *step == whole(&others[1])).expect("it was claimed");
    assert!(last_of_b <= 4, "{order:?}");
}

pub(super) fn a_tile_that_is_lost_is_given_anew_as_often_as_may_be(records: &dyn Records) {
    let id = split(records, "a", 2);
    let done = claim(records, 2);
    assert!(records.tile_done(&done, "part", 1).expect("no fault"));
    for attempt in 1..=ATTEMPTS {
        let lease = records.claim("worker", 10, 100).expect("no fault").expect("a tile");
        assert_eq!(lease.step, Step::Tile(1));
        assert!(records.beat(&lease, 200).expect("no fault"));
        assert_eq!(records.lapse(199, 50).expect("no fault"), []);
        let again = attempt < ATTEMPTS;
        let lapsed = Lapsed { id: id.clone(), tile: Some(1), attempts: attempt, again };
        assert_eq!(records.lapse(200, 50).expect("no fault"), [lapsed]);
        assert_eq!(records.lapse(200, 50).expect("no fault"), []);
    }
    let job = get(records, &id);
    assert_eq!((job.state, job.finished), (State::Failed, Some(50)));
    assert_eq!(job.failure, Some(Failure::GaveUp { attempts: ATTEMPTS, tile: Some(1) }));
    assert!(nothing_waits(records));
    let id = split(records, "a", 1);
    let tile = claim(records, 60);
    assert!(records.tile_done(&tile, "part", 1).expect("no fault"));
    for attempt in 1..=ATTEMPTS {
        let lease = records.claim("worker", 70, 100).expect("no fault").expect("a join");
        assert_eq!(lease.step, Step::Join);
        let lapsed = records.lapse(100, 80).expect("no fault");
        assert_eq!(
            lapsed,
            [Lapsed { id: id.clone(), tile: None, attempts: attempt, again: attempt < ATTEMPTS }]
        );
    }
    assert_eq!(get(records, &id).state, State::Failed);
}

pub(super) fn a_step_that_fails_of_its_machine_is_given_anew_as_often_as_may_be(records: &dyn Records) {
    let full = Failure::Storage { why: "no room".into(), full: true };
    let fails = |expected: Step, id: &str| {
        for attempt in 1..=ATTEMPTS {
            let lease = claim(records, 2);
            assert_eq!((&*lease.record.id, lease.step), (id, expected));
            let waits = records.retry(&lease, &full, 50).expect("no fault");
            assert_eq!(waits, Some(attempt < ATTEMPTS));
            assert_stale(records, &lease);
        }
        let job = get(records, id);
        assert_eq!((job.state, job.finished, job.failure.as_ref()), (State::Failed, Some(50), Some(&full)));
        assert!(nothing_waits(records));
    };
    fails(Step::Whole, &put(records, &of("a", None), 0));
    fails(Step::Tile(0), &split(records, "a", 2));
    let id = split(records, "a", 1);
    let tile = claim(records, 2);
    assert!(records.tile_done(&tile, "part", 1).expect("no fault"));
    fails(Step::Join, &id);
}

pub(super) fn a_stale_lease_on_a_tile_changes_nothing(records: &dyn Records) {
    let id = put(records, &of("a", None), 0);
    let planner = claim(records, 1);
    assert!(records.split(&planner, "plan", &[1, 1], 0).expect("no fault"));
    let mut stale = vec![planner, claim(records, 2)];
    assert_stale(records, &stale[0]);
    assert!(records.defer(&stale[1]).expect("no fault"));
    stale.push(claim(records, 3));
    assert_eq!(records.lapse(1000, 1000).expect("no fault").len(), 1);
    stale.push(claim(records, 4));
    assert_eq!(stale[3].step, Step::Tile(0));
    stale[..3].iter().for_each(|lease| assert_stale(records, lease));
    assert!(records.tile_done(&stale[3], "part", 1).expect("no fault"));
    stale.push(claim(records, 5));
    assert!(records.unsplit(&stale[4]).expect("no fault"));
    stale.iter().for_each(|lease| assert_stale(records, lease));
    // The same tile by another plan.
    let planner = claim(records, 6);
    assert!(records.split(&planner, "plan", &[1, 1], 0).expect("no fault"));
    let held = [claim(records, 7), claim(records, 8)];
    stale.iter().for_each(|lease| assert_stale(records, lease));
    assert!(records.failed(&held[0], &Failure::Crashed, 9).expect("no fault"));
    assert_eq!(get(records, &id).state, State::Failed);
    stale.iter().chain(&held).for_each(|lease| assert_stale(records, lease));
    let id = split(records, "a", 1);
    let held = claim(records, 10);
    assert!(records.cancel(&id, 11).expect("no fault"));
    assert_stale(records, &held);
    assert!(nothing_waits(records));
}

pub(super) fn a_job_whose_tiles_are_of_no_use_begins_anew(records: &dyn Records) {
    let id = split(records, "a", 3);
    let used = records.used().expect("a sum");
    let lease = claim(records, 2);
    assert!(records.unsplit(&lease).expect("no fault"));
    let job = get(records, &id);
    assert_eq!((job.state, job.tiles, job.attempts, job.started), (State::Queued, None, 0, None));
    assert!(records.used().expect("a sum") < used - 100);
    assert_eq!(records.promised().expect("names"), [Promised::Input(id.clone())]);
    let waiting = records.waiting().expect("counts");
    assert_eq!((waiting.whole, waiting.tiles, waiting.oldest), (1, 0, Some(0)));
    assert_eq!(steps(records, 1), [(id, Step::Whole)]);
}
