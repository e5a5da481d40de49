//! A backend that a test holds and lets go, and whose work takes time by a clock of the test's own: nothing here waits for
//! the system's.

use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use densecloud_cascade::{
    Backend, BackendError, Batch, Fake, LevelRunner, Output, Patchwise, Session, UnitShape,
};

use super::*;

/// A clock that goes when it is told to.
#[derive(Debug)]
pub(super) struct ManualClock(Mutex<Instant>);

impl ManualClock {
    pub(super) fn advance(&self, by: Duration) {
        *self.0.lock().unwrap() += by;
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Instant {
        *self.0.lock().unwrap()
    }
}

/// A fake backend, its clock, and a gate before each batch.
#[derive(Clone)]
pub(super) struct Machine {
    fake: Fake,
    pub(super) clock: Arc<ManualClock>,
    /// What each batch takes.
    batch: Duration,
    gate: Arc<(Mutex<Gate>, Condvar)>,
}

#[derive(Default)]
struct Gate {
    closed: bool,
    /// Batches that have come to it since it was closed.
    arrived: usize,
}

impl Machine {
    /// Batches take so many milliseconds, by the clock.
    pub(super) fn new(batch_ms: u64) -> Self {
        Self::over(Fake::new(), batch_ms)
    }

    pub(super) fn over(fake: Fake, batch_ms: u64) -> Self {
        let clock = Arc::new(ManualClock(Mutex::new(Instant::now())));
        Self { fake, clock, batch: Duration::from_millis(batch_ms), gate: Arc::default() }
    }

    /// An engine over it.
    pub(super) fn engine(&self, config: EngineConfig) -> Engine {
        Engine::with_clock(self.runner(config.threads()), config, self.clock.clone()).unwrap()
    }

    fn runner(&self, threads: usize) -> Arc<dyn LevelRunner> {
        let backend: Arc<dyn Backend> = Arc::new(self.clone());
        let sessions = Turns::open(&*backend, threads).unwrap();
        Arc::new(Patchwise::with_sessions(backend, sessions))
    }

    /// From now on batches wait.
    pub(super) fn close(&self) {
        *self.gate.0.lock().unwrap() = Gate { closed: true, arrived: 0 };
    }

    pub(super) fn open_gate(&self) {
        self.gate.0.lock().unwrap().closed = false;
        self.gate.1.notify_all();
    }

    /// Until a batch has come to the gate.
    pub(super) fn wait_for_a_batch(&self) {
        let gate = self.gate.0.lock().unwrap();
        let (gate, waited) = self.gate.1.wait_timeout_while(gate, LONG, |gate| gate.arrived == 0).unwrap();
        drop(gate);
        assert!(!waited.timed_out(), "no batch has come to the gate");
    }

    /// Batches run so far.
    pub(super) fn batches(&self) -> usize {
        self.fake.batches()
    }
}

impl Backend for Machine {
    fn shape(&self) -> UnitShape {
        self.fake.shape
    }

    fn units(&self) -> usize {
        self.fake.units()
    }

    fn provider(&self) -> &str {
        "machine"
    }

    fn open(&self) -> Result<Box<dyn Session>, BackendError> {
        Ok(Box::new(self.clone()))
    }
}

impl Session for Machine {
    fn run(&mut self, unit: usize, batch: &Batch<'_>, output: &mut Output) -> Result<(), BackendError> {
        let (gate, changed) = &*self.gate;
        let mut state = gate.lock().unwrap();
        state.arrived += 1;
        changed.notify_all();
        drop(changed.wait_while(state, |gate| gate.closed).unwrap());
        self.clock.advance(self.batch);
        self.fake.run(unit, batch, output)
    }
}
