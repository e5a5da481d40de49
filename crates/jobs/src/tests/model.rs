//! The store under random use and random ends, beside a model of it.

use std::collections::BTreeMap;

use proptest::prelude::*;

use super::*;
use crate::sqlite::rows::{failure_text, result_text};

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
    PutBack(usize, usize),
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
        1 => of_lease.prop_map(|(i, lease)| Step::PutBack(i, lease)),
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
    /// Of its files.
    bytes: u64,
    /// All that it ever had; the last may still be its own.
    leases: Vec<Lease>,
    /// The file of its result.
    result: Option<String>,
}

impl Model {
    /// With its row, without what is told of its end.
    fn used(&self) -> u64 {
        self.bytes + Draft::new(self.job.clone()).expect("a draft").row_bytes
    }

    /// Whether a lease gives a say.
    fn is_held(&self, lease: &Lease) -> bool {
        self.state == State::Running && self.leases.last() == Some(lease)
    }

    fn is_over(&mut self, state: State, now: Time) {
        (self.state, self.finished, self.bytes) = (state, now, 0);
    }

    /// Its worker is gone.
    fn lapse(&mut self, now: Time) {
        if self.attempts < ATTEMPTS {
            self.state = State::Queued;
        } else {
            self.is_over(State::Failed, now);
        }
    }

    /// The one file that is promised.
    fn file(&self, id: &str) -> Option<String> {
        match self.state {
            State::Queued | State::Running => Some(format!("{id}.in")),
            State::Done => self.result.clone(),
            State::Failed | State::Cancelled => None,
        }
    }
}

/// A store and what should be in it.
struct World {
    folder: tempfile::TempDir,
    // None only while it is opened anew.
    store: Option<Store>,
    model: BTreeMap<String, Model>,
    /// Names of all jobs that ever came, the first one first.
    order: Vec<String>,
    now: Time,
}

impl World {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Some(open(folder.path(), 0));
        Self { folder, store, model: BTreeMap::new(), order: Vec::new(), now: 0 }
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
            Step::PutBack(i, which) => self.put_back(&self.pick(i), which)?,
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
                    finished: 0,
                    job: new,
                    bytes: size as u64 + RESULT,
                    leases: Vec::new(),
                    result: None,
                };
                self.model.insert(record.id, known);
            }
            other => prop_assert!(false, "{other:?}"),
        }
        Ok(())
    }

    fn claim(&mut self, time: Time) -> Result<(), TestCaseError> {
        let now = self.now;
        let until = |known: &Model| known.leases.last().map_or(Time::MAX, |lease| lease.until);
        let running = self.model.values_mut().filter(|known| known.state == State::Running);
        running.filter(|known| until(known) <= now).for_each(|known| known.lapse(now));
        let first = self.order.iter().find(|id| self.state(id) == Some(State::Queued)).cloned();
        let claimed = self.store().claim("worker", now, now + time).expect("no fault");
        let id = claimed.as_ref().map(|lease| lease.record.id.clone());
        prop_assert_eq!(&id, &first, "in the order in which they came");
        if let Some(lease) = claimed {
            let known = self.known(&lease.record.id);
            prop_assert!(known.leases.iter().all(|earlier| earlier.attempt < lease.attempt));
            known.state = State::Running;
            known.attempts += 1;
            known.leases.push(lease);
        }
        Ok(())
    }

    fn done(&mut self, id: &str, which: usize) -> Result<(), TestCaseError> {
        let Some((lease, held)) = self.lease(id, which) else { return Ok(()) };
        let made = write(self.store(), &lease, id.as_bytes());
        let now = self.now;
        prop_assert_eq!(self.store().done(&lease, &made, now).expect("no fault"), held);
        if held {
            let known = self.known(id);
            (known.state, known.finished, known.bytes) = (State::Done, now, id.len() as u64);
            known.result = Some(made.blob);
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

    fn put_back(&mut self, id: &str, which: usize) -> Result<(), TestCaseError> {
        let Some((lease, held)) = self.lease(id, which) else { return Ok(()) };
        prop_assert_eq!(self.store().put_back(&lease).expect("no fault"), held);
        if held {
            let known = self.known(id);
            known.state = State::Queued;
            known.attempts -= 1;
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
        std::fs::write(self.folder.path().join("files/x.in.part"), b"half").expect("a file");
        drop(self.store.take());
        let now = self.now;
        self.store = Some(open(self.folder.path(), now));
        let running = self.model.values_mut().filter(|known| known.state == State::Running);
        running.for_each(|known| known.lapse(now));
        let mut promised: Vec<_> = self.model.iter().filter_map(|(id, known)| known.file(id)).collect();
        promised.sort();
        prop_assert_eq!(files(self.folder.path()), promised);
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

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// Whatever happens: a job is where the model has it, its files are those that its state promises, it
    /// is never done twice, and after a new start there is no other file.
    #[test]
    fn a_store_is_what_happened_to_it(steps in prop::collection::vec(step(), 0..40)) {
        let mut world = World::new();
        steps.into_iter().try_for_each(|step| world.take(step))?;
    }
}
