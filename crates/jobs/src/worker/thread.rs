//! A thread that takes one step after another.

use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use super::Jobs;
use super::running::Running;
use crate::error::StoreError;
use crate::record::Record;
use crate::records::{Lease, Step};
use crate::work::{Task, Work};

/// Before a job that found no room is tried again.
pub(super) const PAUSE: Duration = Duration::from_millis(500);
/// Before a database that could not be written is.
const BROKEN: Duration = Duration::from_secs(2);

impl Jobs {
    pub(super) fn work(&self, worker: &str, work: &dyn Work) {
        while let Some((lease, task)) = self.next(worker) {
            let start = Instant::now();
            let (how, pause) = self.run(&lease, &task, work);
            work.ended(lease.step, how, start.elapsed());
            self.changes.send_replace(());
            if pause {
                drop(self.queued.wait_timeout(self.lock(), PAUSE));
            }
        }
    }

    /// Waits for the next job; none once the store stops.
    fn next(&self, worker: &str) -> Option<(Lease, Arc<Task>)> {
        loop {
            self.rest();
            let came = self.lock().waiting()?;
            let wait = match self.claim(worker) {
                Ok(Some(started)) => return Some(started),
                Ok(None) if self.lock().lost.is_empty() => self.look(),
                Ok(None) => BROKEN,
                Err(error) => {
                    tracing::error!(%error, "no job can be started");
                    BROKEN
                }
            };
            let idle = |running: &mut Running| !running.stopping && running.came == came;
            let woken = self.queued.wait_timeout_while(self.lock(), wait, idle);
            if woken.unwrap_or_else(PoisonError::into_inner).0.stopping {
                return None;
            }
        }
    }

    /// Leaves steps to others while there is no room here.
    fn rest(&self) {
        let running = self.lock();
        let rest = running.rest();
        drop(self.queued.wait_timeout_while(running, rest, |running| !running.stopping));
    }

    fn claim(&self, worker: &str) -> Result<Option<(Lease, Arc<Task>)>, StoreError> {
        self.put_lost_back();
        // One time for both, and this first: else, after the computer has slept, a thread would take over the jobs of
        // those beside it.
        let now = self.now();
        self.renew(now, now)?;
        let told = self.lock().told;
        let Some(lease) = self.store.claim(worker, now, now.saturating_add(self.lease()))? else {
            return Ok(None);
        };
        let Some(task) = self.begin(&lease, told) else { return Ok(None) };
        self.changes.send_replace(());
        let Record { id, request_id, attempts, .. } = &lease.record;
        match lease.step {
            Step::Whole => tracing::info!(job = id, request = request_id, attempt = attempts, "job started"),
            step => tracing::info!(job = id, request = request_id, ?step, "step of a job started"),
        }
        Ok(Some((lease, task)))
    }

    /// Notes a step that was claimed; puts it back where the threads are told to end meanwhile.
    fn begin(&self, lease: &Lease, told: u64) -> Option<Arc<Task>> {
        let mut running = self.lock();
        if running.stopping {
            drop(running);
            self.put_back(lease);
            return None;
        }
        let doubts = running.doubts;
        let task = running.begin(lease, told);
        if running.doubts != doubts {
            self.stopped.notify_all();
        }
        Some(task)
    }

    /// Puts steps back whose ends could not be written.
    fn put_lost_back(&self) {
        let mut lost = std::mem::take(&mut self.lock().lost);
        if !lost.is_empty() {
            lost.retain(|lease| self.store.put_back(lease).is_err());
            self.lock().lost.append(&mut lost);
            self.changes.send_replace(());
        }
    }
}
