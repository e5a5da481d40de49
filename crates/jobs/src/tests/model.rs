//! The store under random use and random ends, beside a model of it.

use std::collections::BTreeMap;

use proptest::prelude::*;
use proptest::test_runner::TestRunner;

use super::engine::Engine;
use super::*;
use crate::columns::{failure_text, result_text};

/// One thing that can happen to a store.
#[derive(Debug, Clone)]
enum Step {
    Submit {
        key: Option<u8>,
        request: u8,
        size: usize,
    },
    /// For so long.
    Claim(Time),
    // With a lease that the job had, the newest first.
    Done(usize, usize),
    Failed(usize, usize),
    Retry(usize, usize),
    PutBack(usize, usize),
    /// Into so many tiles.
    Split(usize, usize, usize),
    Unsplit(usize, usize),
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
    let of_lease = (which.clone(), prop_oneof![3 => Just(0_usize), 1 => 1_usize..4]);
    prop_oneof![
        4 => (prop::option::of(0_u8..3), 0_u8..2, 0_usize..200)
            .prop_map(|(key, request, size)| Step::Submit { key, request, size }),
        4 => (1_i64..12).prop_map(Step::Claim),
        2 => of_lease.clone().prop_map(|(i, lease)| Step::Done(i, lease)),
        1 => of_lease.clone().prop_map(|(i, lease)| Step::Failed(i, lease)),
        1 => of_lease.clone().prop_map(|(i, lease)| Step::Retry(i, lease)),
        1 => of_lease.clone().prop_map(|(i, lease)| Step::PutBack(i, lease)),
        2 => (of_lease.clone(), 1_usize..4).prop_map(|((i, lease), tiles)| Step::Split(i, lease, tiles)),
        1 => of_lease.prop_map(|(i, lease)| Step::Unsplit(i, lease)),
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
    turn: Time,
    finished: Time,
    job: NewJob,
    /// Of its files.
    bytes: u64,
    /// All leases that it ever had.
    leases: Vec<Lease>,
    /// Those that are on it.
    held: Vec<Lease>,
    /// Once it is split.
    tiles: Option<Vec<Tile>>,
    /// The files of its plan and its result.
    plan: Option<String>,
    result: Option<String>,
}

#[derive(Debug, Clone, Default)]
struct Tile {
    attempts: u32,
    /// The file of its part.
    part: Option<String>,
}

/// Bytes of each plan.
const PLAN: u64 = 50;
/// And of the row of each tile.
const TILE: u64 = 256;

impl Model {
    /// With its row, without what is told of its end.
    fn used(&self) -> u64 {
        self.bytes + Draft::new(self.job.clone()).expect("a draft").row_bytes
    }

    fn is_held(&self, lease: &Lease) -> bool {
        self.held.contains(lease)
    }

    fn is_over(&mut self, state: State, now: Time) {
        (self.state, self.finished, self.bytes) = (state, now, 0);
        self.held.clear();
    }

    /// The step that waits.
    fn waits(&self) -> Option<crate::Step> {
        let is_held = |step| self.held.iter().any(|lease| lease.step == step);
        match (self.state, &self.tiles) {
            (State::Queued, _) => Some(crate::Step::Whole),
            (State::Running, Some(tiles)) => {
                let tile = (0..).map(crate::Step::Tile).zip(tiles);
                let mut waiting = tile.filter(|(step, tile)| tile.part.is_none() && !is_held(*step));
                let join = tiles.iter().all(|tile| tile.part.is_some()) && !is_held(crate::Step::Join);
                waiting.next().map(|(step, _)| step).or(join.then_some(crate::Step::Join))
            }
            _ => None,
        }
    }

    /// How often a step was started.
    fn attempts(&mut self, step: crate::Step) -> &mut u32 {
        match (step, &mut self.tiles) {
            (crate::Step::Tile(tile), Some(tiles)) => &mut tiles[tile as usize].attempts,
            _ => &mut self.attempts,
        }
    }

    /// A step waits again.
    fn free(&mut self, lease: &Lease) {
        self.held.retain(|one| one != lease);
        if lease.step == crate::Step::Whole {
            self.state = State::Queued;
        }
    }

    /// The workers of these leases are gone.
    fn lapse(&mut self, leases: &[Lease], now: Time) {
        for lease in leases {
            if *self.attempts(lease.step) >= ATTEMPTS {
                return self.is_over(State::Failed, now);
            }
        }
        leases.iter().for_each(|lease| self.free(lease));
    }

    fn unsplit(&mut self) {
        let tiles = self.tiles.take().map_or(0, |tiles| PLAN + TILE * tiles.len() as u64);
        (self.state, self.attempts, self.plan) = (State::Queued, 0, None);
        self.bytes -= tiles;
        self.held.clear();
    }

    /// The files that are promised.
    fn files(&self, id: &str) -> Vec<String> {
        let parts = self.tiles.iter().flatten().filter_map(|tile| tile.part.clone());
        match self.state {
            State::Queued | State::Running => {
                parts.chain(self.plan.clone()).chain([format!("{id}.in")]).collect()
            }
            State::Done => self.result.iter().cloned().collect(),
            State::Failed | State::Cancelled => Vec::new(),
        }
    }
}

/// A store and what should be in it.
struct World {
    bench: Bench,
    // None only while it is opened anew.
    store: Option<Store>,
    model: BTreeMap<String, Model>,
    /// Names of all jobs that ever came, the first one first.
    order: Vec<String>,
    now: Time,
    /// The turn of the last step that was started.
    clock: Time,
}

impl World {
    fn new(bench: Bench) -> Self {
        let store = Some(open(&bench, 0));
        Self { bench, store, model: BTreeMap::new(), order: Vec::new(), now: 0, clock: 0 }
    }

    fn store(&self) -> &Store {
        self.store.as_ref().expect("open")
    }

    fn pick(&self, i: usize) -> String {
        self.order.get(i).cloned().unwrap_or_else(|| "none".into())
    }

    fn state(&self, id: &str) -> Option<State> {
        self.model.get(id).map(|known| known.state)
    }

    /// One of the leases that a job ever had, and whether it is still its own.
    fn lease(&self, id: &str, which: usize) -> Option<(Lease, bool)> {
        let known = self.model.get(id)?;
        let lease = known.leases.iter().rev().cycle().nth(which)?;
        Some((lease.clone(), known.is_held(lease)))
    }

    fn known(&mut self, id: &str) -> &mut Model {
        self.model.get_mut(id).expect("a job of the model")
    }

    fn take(&mut self, step: Step) -> Result<(), TestCaseError> {
        self.now += 1;
        match step {
            Step::Submit { key, request, size } => self.submit(key, request, size)?,
            Step::Claim(time) => self.claim(time)?,
            Step::Written(i) => {
                if let Some((lease, true)) = self.lease(&self.pick(i), 0) {
                    write(self.store(), &lease, b"not the one");
                }
            }
            Step::Done(i, which) => self.done(&self.pick(i), which)?,
            Step::Failed(i, which) => self.failed(&self.pick(i), which)?,
            Step::Retry(i, which) => self.retry(&self.pick(i), which)?,
            Step::PutBack(i, which) => self.put_back(&self.pick(i), which)?,
            Step::Split(i, which, tiles) => self.split(&self.pick(i), which, tiles)?,
            Step::Unsplit(i, which) => self.unsplit(&self.pick(i), which)?,
            Step::Cancel(i) => self.cancel(&self.pick(i))?,
            Step::Delete(i) => self.delete(&self.pick(i))?,
            Step::Expire(age) => self.expire(age)?,
            Step::Reopen => self.reopen()?,
        }
        self.check()
    }

    fn submit(&mut self, key: Option<u8>, request: u8, size: usize) -> Result<(), TestCaseError> {
        let key = key.map(|key| format!("key {key}"));
        let new = job(&format!("request {request}"), key.as_deref(), &vec![7; size]);
        let holder = self.model.iter().find(|(_, known)| key.is_some() && known.job.key == key);
        let used = self.store().used().expect("a sum");
        match (try_submit(self.store(), &new, self.now), holder) {
            (Ok(Submitted::Known(record)), Some((id, known))) => {
                prop_assert_eq!(&record.id, id);
                prop_assert_eq!(told(&known.job), told(&new));
            }
            (Err(StoreError::OtherRequest), Some((_, known))) => {
                prop_assert_ne!(told(&known.job), told(&new))
            }
            (Err(StoreError::OverBudget { .. }), None) => {
                prop_assert!(used + Draft::new(new).expect("a draft").bytes() > DISK);
            }
            (Ok(Submitted::New(record)), None) => {
                self.order.push(record.id.clone());
                let known = Model {
                    state: State::Queued,
                    attempts: 0,
                    turn: self.next_turn(),
                    finished: 0,
                    job: new,
                    bytes: size as u64 + RESULT,
                    leases: Vec::new(),
                    held: Vec::new(),
                    tiles: None,
                    plan: None,
                    result: None,
                };
                self.model.insert(record.id, known);
            }
            other => prop_assert!(false, "{other:?}"),
        }
        Ok(())
    }

    /// After those of all jobs that are not over: they are one client's.
    fn next_turn(&self) -> Time {
        let open = self.model.values().filter(|known| !known.state.is_final());
        1 + open.map(|known| known.turn).fold(self.clock, Time::max)
    }

    /// The leases that have run out by now.
    fn lapse(&mut self, now: Time) {
        for known in self.model.values_mut() {
            let lapsed: Vec<_> = known.held.iter().filter(|lease| lease.until <= now).cloned().collect();
            known.lapse(&lapsed, self.now);
        }
    }

    fn claim(&mut self, time: Time) -> Result<(), TestCaseError> {
        let now = self.now;
        self.lapse(now);
        let waiting = self.order.iter().filter_map(|id| {
            let known = self.model.get(id)?;
            Some((known.turn, id.clone(), known.waits()?))
        });
        let first = waiting.min_by_key(|(turn, ..)| *turn).map(|(_, id, step)| (id, step));
        let claimed = self.store().claim("worker", now, now + time).expect("no fault");
        let step = claimed.as_ref().map(|lease| (lease.record.id.clone(), lease.step));
        prop_assert_eq!(&step, &first, "in the order of their turns");
        let Some(lease) = claimed else { return Ok(()) };
        let id = lease.record.id.clone();
        self.clock = self.clock.max(self.known(&id).turn);
        let next = self.next_turn();
        let known = self.known(&id);
        prop_assert!(known.leases.iter().all(|earlier| earlier.attempt < lease.attempt));
        *known.attempts(lease.step) += 1;
        known.state = State::Running;
        if let crate::Step::Tile(_) = lease.step {
            known.turn = next;
        }
        known.leases.push(lease.clone());
        known.held.push(lease);
        Ok(())
    }

    fn done(&mut self, id: &str, which: usize) -> Result<(), TestCaseError> {
        let Some((lease, held)) = self.lease(id, which) else { return Ok(()) };
        let now = self.now;
        if let crate::Step::Tile(tile) = lease.step {
            let part = leave(self.store(), &lease);
            prop_assert_eq!(self.store().tile_done(&lease, 1).expect("no fault"), held);
            if held {
                let known = self.known(id);
                known.free(&lease);
                if let Some(tiles) = &mut known.tiles {
                    tiles[tile as usize].part = Some(part);
                }
            }
            return Ok(());
        }
        let made = write(self.store(), &lease, id.as_bytes());
        prop_assert_eq!(self.store().done(&lease, &made, now).expect("no fault"), held);
        if held {
            let known = self.known(id);
            known.is_over(State::Done, now);
            (known.bytes, known.result) = (id.len() as u64, Some(made.blob));
        }
        Ok(())
    }

    fn failed(&mut self, id: &str, which: usize) -> Result<(), TestCaseError> {
        let Some((lease, held)) = self.lease(id, which) else { return Ok(()) };
        let now = self.now;
        prop_assert_eq!(self.store().failed(&lease, &Failure::Crashed, now).expect("no fault"), held);
        if held {
            self.known(id).is_over(State::Failed, now);
        }
        Ok(())
    }

    fn retry(&mut self, id: &str, which: usize) -> Result<(), TestCaseError> {
        let Some((lease, held)) = self.lease(id, which) else { return Ok(()) };
        let now = self.now;
        let full = Failure::Storage { why: "no room".into(), full: true };
        let waits = self.store().retry(&lease, &full, now).expect("no fault");
        prop_assert_eq!(waits.is_some(), held);
        if held {
            let known = self.known(id);
            prop_assert_eq!(waits, Some(*known.attempts(lease.step) < ATTEMPTS));
            known.lapse(&[lease], now);
        }
        Ok(())
    }

    fn put_back(&mut self, id: &str, which: usize) -> Result<(), TestCaseError> {
        let Some((lease, held)) = self.lease(id, which) else { return Ok(()) };
        prop_assert_eq!(self.store().put_back(&lease).expect("no fault"), held);
        if held {
            let known = self.known(id);
            *known.attempts(lease.step) -= 1;
            known.free(&lease);
        }
        Ok(())
    }

    fn split(&mut self, id: &str, which: usize, tiles: usize) -> Result<(), TestCaseError> {
        let Some((lease, held)) = self.lease(id, which) else { return Ok(()) };
        if lease.step != crate::Step::Whole {
            return Ok(());
        }
        let plan = leave(self.store(), &lease);
        let used = self.store().used().expect("a sum");
        if held && used + PLAN + TILE * tiles as u64 > DISK {
            return Ok(());
        }
        prop_assert_eq!(self.store().split(&lease, &vec![1; tiles], PLAN).expect("no fault"), held);
        if held {
            let turn = self.next_turn();
            let known = self.known(id);
            (known.attempts, known.plan, known.turn) = (0, Some(plan), turn);
            known.tiles = Some(vec![Tile::default(); tiles]);
            known.bytes += PLAN + TILE * tiles as u64;
            known.held.clear();
        }
        Ok(())
    }

    fn unsplit(&mut self, id: &str, which: usize) -> Result<(), TestCaseError> {
        let Some((lease, held)) = self.lease(id, which) else { return Ok(()) };
        prop_assert_eq!(self.store().unsplit(&lease).expect("no fault"), held);
        if held {
            self.known(id).unsplit();
        }
        Ok(())
    }

    fn cancel(&mut self, id: &str) -> Result<(), TestCaseError> {
        let now = self.now;
        let cancelled = self.store().cancel(id, now).expect("no fault");
        prop_assert_eq!(cancelled, matches!(self.state(id), Some(State::Queued | State::Running)));
        if cancelled {
            self.known(id).is_over(State::Cancelled, now);
        }
        Ok(())
    }

    fn delete(&mut self, id: &str) -> Result<(), TestCaseError> {
        let over = self.state(id).is_some_and(State::is_final);
        prop_assert_eq!(self.store().delete(id).expect("no fault"), over);
        if over {
            self.model.remove(id);
        }
        Ok(())
    }

    fn expire(&mut self, age: Time) -> Result<(), TestCaseError> {
        let before = self.now - age;
        let expired = self.store().expire(before, 100).expect("no fault");
        let old = |known: &Model| known.state.is_final() && known.finished < before;
        prop_assert_eq!(expired.len(), self.model.values().filter(|known| old(known)).count());
        self.model.retain(|_, known| !old(known));
        Ok(())
    }

    fn reopen(&mut self) -> Result<(), TestCaseError> {
        std::fs::write(self.bench.path().join("files/x.in.part"), b"half").expect("a file");
        drop(self.store.take());
        let now = self.now;
        self.store = Some(open(&self.bench, now));
        self.lapse(Time::MAX);
        let mut promised: Vec<_> = self.model.iter().flat_map(|(id, known)| known.files(id)).collect();
        promised.sort();
        // Of a job in tiles, others may be left by steps that did not end.
        let is_left = |name: &String| {
            let known = name.split('.').next().and_then(|id| self.model.get(id));
            promised.contains(name)
                || !known.is_some_and(|known| known.tiles.is_some() && !known.state.is_final())
        };
        let files: Vec<_> = files(self.bench.path()).into_iter().filter(is_left).collect();
        prop_assert_eq!(files, promised);
        Ok(())
    }

    /// Whether the store is as the model has it.
    fn check(&self) -> Result<(), TestCaseError> {
        let store = self.store();
        let listed = store.list(None, 1000, None).expect("a list");
        prop_assert_eq!(listed.len(), self.model.len());
        listed.iter().try_for_each(|record| self.check_one(record))?;
        for (state, count) in store.counts().expect("counts") {
            prop_assert_eq!(count, self.model.values().filter(|known| known.state == state).count() as u64);
        }
        // What is told of an end are its two texts.
        let told = |record: &Record| {
            let result = record.result.as_ref().map_or(0, |result| result_text(result).len());
            result + record.failure.as_ref().map_or(0, |failure| failure_text(failure).len())
        };
        let told: usize = listed.iter().map(told).sum();
        let used = self.model.values().map(Model::used).sum::<u64>() + told as u64;
        prop_assert_eq!(store.used().expect("a sum"), used);
        prop_assert!(used <= DISK);
        Ok(())
    }

    fn check_one(&self, record: &Record) -> Result<(), TestCaseError> {
        let (store, known) = (self.store(), &self.model[&record.id]);
        prop_assert_eq!((record.state, record.attempts), (known.state, known.attempts));
        if !record.state.is_final() {
            let mut input = Vec::new();
            store.input(&record.id).expect("its cloud").read_to_end(&mut input).expect("bytes");
            prop_assert_eq!(input, bytes(&*known.job.input));
        }
        if record.state == State::Done {
            let told = record.result.as_ref().expect("a result");
            prop_assert_eq!(Some(&told.blob), known.result.as_ref());
            let bytes = result(store, &record.id).expect("a result");
            prop_assert_eq!(&bytes, record.id.as_bytes());
            prop_assert_eq!(told.bytes, bytes.len() as u64);
        } else {
            let (same, result) = store.result(&record.id).expect("no fault").expect("the job");
            prop_assert!(result.is_none() && same == *record);
        }
        Ok(())
    }
}

/// Leaves a file in the place of a lease.
fn leave(store: &Store, lease: &Lease) -> String {
    let place = store.place(lease);
    let mut blob = place.blobs.create(&place.own).expect("a file");
    blob.write_all(b"left").expect("room");
    blob.finish().expect("a file");
    place.own
}

over_each_engine!(a_store_is_what_happened_to_it);

/// Whatever happens: a job is where the model has it, its files are those that its state promises, it
/// is never done twice, and after a new start there is no other file.
fn a_store_is_what_happened_to_it(bench: Bench) {
    let cases = if bench.engine == Engine::Sqlite { 24 } else { 8 };
    let mut runner =
        TestRunner::new(ProptestConfig { cases, source_file: Some(file!()), ..ProptestConfig::default() });
    let happened = runner.run(&prop::collection::vec(step(), 0..40), |steps| {
        let mut world = World::new(Bench::of(bench.engine));
        steps.into_iter().try_for_each(|step| world.take(step))
    });
    happened.unwrap_or_else(|error| panic!("{error}"));
}
