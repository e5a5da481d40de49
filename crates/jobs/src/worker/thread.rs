//! A thread that takes one step after another.

use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use super::Jobs;
use super::running::{Run, Running};
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
        let mut running = self.lock();
        while !running.stopping {
            let wait = match self.claim(&mut running, worker) {
                Ok(Some(started)) => return Some(started),
                Ok(None) if running.lost.is_empty() => self.look(),
                Ok(None) => BROKEN,
                Err(error) => {
                    tracing::error!(%error, "no job can be started");
                    BROKEN
                }
            };
            running = self.queued.wait_timeout(running, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
        None
    }

    fn claim(&self, running: &mut Running, worker: &str) -> Result<Option<(Lease, Arc<Task>)>, StoreError> {
        if !running.lost.is_empty() {
            running.lost.retain(|lease| self.store.put_back(lease).is_err());
            self.changes.send_replace(());
        }
        // One time for both, and this first: else, after the computer has slept, a thread would take over the jobs of
        // those beside it.
        let now = self.now();
        self.renew(running, now)?;
        let until = now.saturating_add(self.lease());
        let Some(lease) = self.store.claim(worker, now, until)? else { return Ok(None) };
        let task = Arc::new(Task::default());
        let run = Run { lease: lease.clone(), task: Arc::clone(&task) };
        running.tasks.insert((lease.record.id.clone(), lease.step), run);
        self.changes.send_replace(());
        let Record { id, request_id, attempts, .. } = &lease.record;
        match lease.step {
            Step::Whole => tracing::info!(job = id, request = request_id, attempt = attempts, "job started"),
            step => tracing::info!(job = id, request = request_id, ?step, "step of a job started"),
        }
        Ok(Some((lease, task)))
    }
}
