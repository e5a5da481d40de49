//! How far a request is, and how long its stages took.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::clock::Clock;
use densecloud_cascade::{Observer, Stage};

/// A moment in a request's life.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// The stage that runs; none while the request waits in the queue, and when it is done.
    pub stage: Option<Stage>,
    /// The level that runs, from 1; 0 while the request waits.
    pub level: usize,
    /// How many levels there are; 0 while the request waits.
    pub levels: usize,
    /// Share of the whole work that is done, 0 to 1, estimated.
    pub fraction: f64,
}

/// Wall-clock time of each stage, summed over the levels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StageTimes([Duration; Stage::ALL.len()]);

impl StageTimes {
    /// Stages in their order, with their times.
    pub fn iter(&self) -> impl Iterator<Item = (Stage, Duration)> {
        Stage::ALL.into_iter().zip(self.0)
    }

    /// All stages together.
    #[must_use]
    pub fn total(&self) -> Duration {
        self.0.iter().sum()
    }
}

/// Rough shares of a level's time, for [`Progress::fraction`] alone.
const SHARES: [f64; Stage::ALL.len()] = [0.01, 0.06, 0.53, 0.40, 0.0];

/// Watches one cascade: the engine's [`Observer`].
pub(super) struct Watch {
    clock: Arc<dyn Clock>,
    state: Mutex<State>,
    // Read before every batch and written at every batch's end, so not behind the mutex.
    cancelled: AtomicBool,
    deadline: Option<Instant>,
    done: AtomicU64,
    total: AtomicU64,
}

#[derive(Default)]
struct State {
    /// Share of the whole work that each level is.
    weights: Vec<f64>,
    current: Option<(usize, Stage, Instant)>,
    finished: bool,
    times: StageTimes,
}

impl State {
    fn end_stage(&mut self, now: Instant) {
        if let Some((_, stage, start)) = self.current.take() {
            self.times.0[stage as usize] += now - start;
        }
    }
}

impl Watch {
    /// Of work that is cancelled by itself at the deadline.
    pub(super) fn new(clock: Arc<dyn Clock>, deadline: Option<Instant>) -> Self {
        Self {
            clock,
            state: Mutex::default(),
            cancelled: AtomicBool::new(false),
            deadline,
            done: AtomicU64::new(0),
            total: AtomicU64::new(0),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Ends the last stage and gives the times.
    pub(super) fn finish(&self) -> StageTimes {
        let now = self.clock.now();
        let mut state = self.lock();
        state.end_stage(now);
        state.finished = true;
        state.times
    }

    pub(super) fn progress(&self) -> Progress {
        let state = self.lock();
        let levels = state.weights.len();
        let Some((level, stage, _)) = state.current else {
            let (level, fraction) = if state.finished { (levels, 1.0) } else { (0, 0.0) };
            return Progress { stage: None, level, levels, fraction };
        };
        let (done, total) = (self.done.load(Ordering::Relaxed), self.total.load(Ordering::Relaxed));
        let within = if total == 0 { 0.0 } else { done as f64 / total as f64 };
        let before: f64 = state.weights[..level].iter().sum();
        let stages: f64 = SHARES[..stage as usize].iter().sum();
        let of_level = stages + SHARES[stage as usize] * within;
        Progress {
            stage: Some(stage),
            level: level + 1,
            levels,
            fraction: before + state.weights[level] * of_level,
        }
    }
}

impl Observer for Watch {
    fn plan(&self, sizes: &[usize]) {
        // A level's cost goes with its input, half of what it would make in full.
        let costs: Vec<f64> = (0..sizes.len()).map(|level| (level as f64).exp2()).collect();
        let all: f64 = costs.iter().sum();
        self.lock().weights = costs.iter().map(|cost| cost / all).collect();
    }

    fn begin(&self, level: usize, stage: Stage) {
        let now = self.clock.now();
        let mut state = self.lock();
        state.end_stage(now);
        self.done.store(0, Ordering::Relaxed);
        self.total.store(0, Ordering::Relaxed);
        state.current = Some((level, stage, now));
    }

    fn advance(&self, done: usize, total: usize) {
        self.total.store(total as u64, Ordering::Relaxed);
        // Threads may report out of order; progress never goes back.
        self.done.fetch_max(done as u64, Ordering::Relaxed);
    }

    fn cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
            || self.deadline.is_some_and(|deadline| self.clock.now() >= deadline)
    }
}
