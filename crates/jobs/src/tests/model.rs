//! The store under random use and random ends, beside a model of it.

use std::collections::BTreeMap;
use std::path::Path;

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
    Claim,
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
        4 => Just(Step::Claim),
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
        self.bytes + Draft::new(self.job.clone()).row_bytes
    }

    /// Whether a lease gives a say.
    fn is_held(&self, lease: &Lease) -> bool {
        self.state == State::Running && self.leases.last() == Some(lease)
    }
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
                let mut input = Vec::new();
                store.input(&record.id).expect("its cloud").read_to_end(&mut input).expect("bytes");
                prop_assert_eq!(&input, &known.job.input);
            }
            State::Done => {
                let told = record.result.as_ref().expect("a result");
                prop_assert_eq!(Some(&told.blob), known.result.as_ref());
                let bytes = std::fs::read(folder.join("files").join(&told.blob)).expect("a file");
                prop_assert_eq!(&bytes, record.id.as_bytes());
                prop_assert_eq!(told.bytes, bytes.len() as u64);
                prop_assert_eq!(result(store, &record.id), Some(bytes));
            }
            State::Failed | State::Cancelled => {}
        }
        if record.state != State::Done {
            let (same, result) = store.result(&record.id).expect("no fault").expect("the job");
            prop_assert!(result.is_none() && same == *record);
        }
    }
    for (state, count) in store.counts().expect("counts") {
        prop_assert_eq!(count, model.values().filter(|known| known.state == state).count() as u64);
    }
    // What is told of an end are its two texts.
    let told = |record: &Record| {
        let result = record.result.as_ref().map_or(0, |result| result_text(result).len());
        result + record.failure.as_ref().map_or(0, |failure| failure_text(failure).len())
    };
    let told: usize = listed.iter().map(told).sum();
    let used = model.values().map(Model::used).sum::<u64>() + told as u64;
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
            // One of those that a job ever had, and whether it is still its own.
            let lease = |model: &BTreeMap<String, Model>, id: &String, which: usize| {
                let known = model.get(id)?;
                let lease = known.leases.iter().rev().cycle().nth(which)?;
                Some((lease.clone(), known.is_held(lease)))
            };
            match step {
                Step::Submit { key, request, size } => {
                    let key = key.map(|key| format!("key {key}"));
                    let new = job(&format!("request {request}"), key.as_deref(), &vec![7; size]);
                    let holder = model.iter().find(|(_, known)| key.is_some() && known.job.key == key);
                    let used = open_store.used().expect("a sum");
                    match (try_submit(open_store, &new, now), holder) {
                        (Ok(Submitted::Known(record)), Some((id, known))) => {
                            prop_assert_eq!(&record.id, id);
                            prop_assert_eq!(&known.job, &new);
                        }
                        (Err(StoreError::OtherRequest), Some((_, known))) => prop_assert_ne!(&known.job, &new),
                        (Err(StoreError::OverBudget { .. }), None) => {
                            prop_assert!(used + Draft::new(new).bytes() > DISK);
                        }
                        (Ok(Submitted::New(record)), None) => {
                            order.push(record.id.clone());
                            let bytes = size as u64 + RESULT;
                            let known = Model {
                                state: State::Queued,
                                attempts: 0,
                                finished: 0,
                                job: new,
                                bytes,
                                leases: Vec::new(),
                                result: None,
                            };
                            model.insert(record.id, known);
                        }
                        other => prop_assert!(false, "{other:?}"),
                    }
                }
                Step::Claim => {
                    let first = order.iter().find(|id| state(&model, id) == Some(State::Queued)).cloned();
                    let claimed = claim(open_store, now);
                    let id = claimed.as_ref().map(|lease| lease.record.id.clone());
                    prop_assert_eq!(&id, &first, "in the order in which they came");
                    if let Some((known, lease)) = first.and_then(|id| model.get_mut(&id)).zip(claimed) {
                        prop_assert!(known.leases.iter().all(|earlier| earlier.attempt < lease.attempt));
                        known.state = State::Running;
                        known.attempts += 1;
                        known.leases.push(lease);
                    }
                }
                Step::Written(i) => {
                    if let Some((lease, _)) = lease(&model, &pick(i), 0).filter(|(_, held)| *held) {
                        write(open_store, &lease, b"not the one");
                    }
                }
                Step::Done(i, which) => {
                    let id = pick(i);
                    if let Some((lease, held)) = lease(&model, &id, which) {
                        let made = write(open_store, &lease, id.as_bytes());
                        prop_assert_eq!(open_store.done(&lease, &made, now).expect("no fault"), held);
                        if let Some(known) = model.get_mut(&id).filter(|_| held) {
                            (known.state, known.finished, known.bytes) = (State::Done, now, id.len() as u64);
                            known.result = Some(made.blob);
                        }
                    }
                }
                Step::Failed(i, which) => {
                    let id = pick(i);
                    if let Some((lease, held)) = lease(&model, &id, which) {
                        let failed = open_store.failed(&lease, &Failure::Crashed, now);
                        prop_assert_eq!(failed.expect("no fault"), held);
                        if let Some(known) = model.get_mut(&id).filter(|_| held) {
                            (known.state, known.finished, known.bytes) = (State::Failed, now, 0);
                        }
                    }
                }
                Step::PutBack(i, which) => {
                    let id = pick(i);
                    if let Some((lease, held)) = lease(&model, &id, which) {
                        prop_assert_eq!(open_store.put_back(&lease).expect("no fault"), held);
                        if let Some(known) = model.get_mut(&id).filter(|_| held) {
                            known.state = State::Queued;
                            known.attempts -= 1;
                        }
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
                    let expired = open_store.expire(now - age, 100).expect("no fault");
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
                            State::Done => known.result.clone(),
                            State::Failed | State::Cancelled => None,
                        })
                        .collect();
                    promised.sort();
                    prop_assert_eq!(files(folder), promised);
                }
            }
            check(store.as_ref().expect("open"), folder, &model)?;
        }
    }
}
