//! The queue: first come, first served in each lane, bounded in points out.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::EngineError;
use super::job::Task;
use crate::backend::Lane;

/// Tasks that wait, and the account of points admitted.
pub(super) struct Queue {
    limit: u64,
    state: Mutex<State>,
    // Wakes job threads; a channel would not let a caller take its task back out.
    changed: Condvar,
}

#[derive(Default)]
struct State {
    tasks: VecDeque<Arc<Task>>,
    points: u64,
    /// Points a second, smoothed; 0 before the first measurement.
    rate: f64,
    closed: bool,
}

/// A share of the queue's points; given back when dropped, wherever the task ends.
pub(super) struct Permit {
    queue: Arc<Queue>,
    points: u64,
}

impl Drop for Permit {
    fn drop(&mut self) {
        self.queue.lock().points -= self.points;
    }
}

impl Queue {
    pub(super) fn new(limit: u64) -> Self {
        Self { limit, state: Mutex::default(), changed: Condvar::new() }
    }

    /// Nothing panics while it is held, so a poisoned lock is still sound.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes `points` from the budget.
    pub(super) fn admit(self: &Arc<Self>, points: u64) -> Result<Permit, EngineError> {
        let mut state = self.lock();
        if state.closed {
            return Err(EngineError::Cancelled);
        }
        // A request above the whole limit would never fit; it may run when it is alone.
        if state.points > 0 && state.points.saturating_add(points) > self.limit {
            return Err(EngineError::Full { wanted: points, queued: state.points, limit: self.limit });
        }
        state.points += points;
        Ok(Permit { queue: Arc::clone(self), points })
    }

    pub(super) fn push(&self, task: Arc<Task>) {
        self.lock().tasks.push_back(task);
        // All: the one that would be woken may serve the other lane.
        self.changed.notify_all();
    }

    /// The next task, of one lane if it is given; none once the queue is closed.
    pub(super) fn next(&self, lane: Option<Lane>) -> Option<Arc<Task>> {
        let find =
            |state: &State| state.tasks.iter().position(|task| lane.is_none_or(|lane| task.lane == lane));
        let state = self.lock();
        let mut state = self
            .changed
            .wait_while(state, |state| find(state).is_none() && !state.closed)
            .unwrap_or_else(PoisonError::into_inner);
        let place = find(&state)?;
        state.tasks.remove(place)
    }

    /// Takes a task back out, if it still waits.
    pub(super) fn remove(&self, task: &Arc<Task>) {
        let mut state = self.lock();
        let found = state.tasks.iter().position(|t| Arc::ptr_eq(t, task));
        let removed = found.and_then(|i| state.tasks.remove(i));
        // Dropping it may give back its permit, which takes the lock.
        drop(state);
        drop(removed);
    }

    /// Lets the job threads end and drops what waits.
    pub(super) fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        let tasks = std::mem::take(&mut state.tasks);
        drop(state);
        self.changed.notify_all();
        for task in tasks {
            task.cancel();
        }
    }

    pub(super) fn points(&self) -> u64 {
        self.lock().points
    }

    /// Learns from `points` that took `time`.
    pub(super) fn measured(&self, points: u64, time: Duration) {
        let rate = points as f64 / time.as_secs_f64().max(1e-6);
        let mut state = self.lock();
        state.rate = if state.rate == 0.0 { rate } else { 0.8 * state.rate + 0.2 * rate };
    }

    /// Points a second, smoothed.
    pub(super) fn rate(&self) -> Option<f64> {
        Some(self.lock().rate).filter(|&rate| rate > 0.0)
    }

    /// Time for what is admitted at the measured rate.
    pub(super) fn backlog(&self) -> Duration {
        let state = self.lock();
        let seconds = if state.rate > 0.0 { state.points as f64 / state.rate } else { 0.0 };
        Duration::from_secs_f64(seconds.min(1e6))
    }
}
