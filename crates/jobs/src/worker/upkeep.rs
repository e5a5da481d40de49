//! What has to be done now and then: leases that are to be extended, jobs that expire, leftovers.

use std::sync::PoisonError;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime};

use super::Jobs;
use super::running::Running;
use super::thread::PAUSE;
use crate::error::StoreError;
use crate::record::Time;
use crate::records::Lease;
use crate::settings::Keeping;

/// How often leases, and expired jobs, are looked at, at least.
const LOOK: Duration = Duration::from_secs(30);
/// How often blobs are looked for that nobody needs, where several programs share them, and how old those are: older than
/// what is written before the record that promises it.
const COLLECT: Duration = Duration::from_secs(3600);
/// Expired jobs that are forgotten at once: one wait for the disk each time, between which others have the
/// database.
const BATCH: u32 = 200;

impl Jobs {
    /// How long a lease is, in milliseconds. It is extended when half of it is over, so a worker that ended is missed after
    /// this time at most, and one that is slow for half of it loses nothing.
    pub(super) fn lease(&self) -> Time {
        self.settings.lease.as_millis().try_into().unwrap_or(Time::MAX)
    }

    /// How often leases, and what waits, are looked at, whoever tells of changes.
    pub(super) fn look(&self) -> Duration {
        LOOK.min(self.settings.lease / 4)
    }

    /// Extends the leases that are over by a time. Work at a job whose lease is another's is stopped.
    pub(super) fn renew(&self, by: Time, now: Time) -> Result<(), StoreError> {
        let until = now.saturating_add(self.lease());
        let due: Vec<Lease> = {
            let running = self.lock();
            running.at_work().map(|run| &run.lease).filter(|lease| lease.until <= by).cloned().collect()
        };
        due.iter().try_for_each(|lease| {
            if self.store.beat(lease, until)? {
                self.lock().extend(lease, until);
            } else if self.lock().give_up(lease) {
                tracing::warn!(job = lease.record.id, "the lease of a job is another's");
            }
            Ok(())
        })
    }

    /// Extends leases, on a thread of its own, since all others may be at work for long.
    pub(super) fn keep_leases(&self) {
        let mut running = self.lock();
        while !running.stopping {
            let doubts = running.doubts;
            drop(running);
            let now = self.now();
            if let Err(error) = self.renew(now.saturating_add(self.lease() / 2), now) {
                self.beats_failed.fetch_add(1, Ordering::Relaxed);
                tracing::error!(%error, "leases of jobs cannot be extended");
            }
            let sure = |running: &mut Running| !running.stopping && running.doubts == doubts;
            let woken = self.stopped.wait_timeout_while(self.lock(), self.look(), sure);
            running = woken.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Forgets jobs when their time has come, on a thread of its own, since it may take long.
    pub(super) fn keep_up(&self) {
        let mut collected = Instant::now();
        let mut running = self.lock();
        while !running.stopping {
            drop(running);
            let more = self.expire();
            if let Keeping::Shared { process, .. } = &self.settings.keeping {
                // Whoever only takes jobs keeps no other from doing them.
                if self.settings.running > 0 {
                    self.attend(process);
                }
                if collected.elapsed() > COLLECT {
                    collected = Instant::now();
                    self.collect();
                }
            }
            let wait = if more { Duration::ZERO } else { self.look().min(self.settings.expiry.max(PAUSE)) };
            let going = |running: &mut Running| !running.stopping;
            let woken = self.stopped.wait_timeout_while(self.lock(), wait, going);
            running = woken.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Says that this process is there.
    fn attend(&self, process: &str) {
        match self.store.attend(process, self.now()) {
            Ok(taken) => taken.iter().for_each(|id| {
                tracing::warn!(job = id, "a job of a version or model that nobody runs any more begins anew");
            }),
            Err(error) => tracing::error!(%error, "nobody can be told that this process is there"),
        }
    }

    fn collect(&self) {
        let collected =
            SystemTime::now().checked_sub(COLLECT).map_or(Ok(()), |time| self.store.collect(time));
        if let Err(error) = collected {
            tracing::error!(%error, "leftovers of jobs cannot be removed");
        }
    }

    /// Forgets some of the jobs whose time has come; says whether there may be more.
    fn expire(&self) -> bool {
        let age = self.settings.expiry.as_millis().try_into().unwrap_or(Time::MAX);
        match self.store.expire(self.now().saturating_sub(age), BATCH) {
            Ok(ids) => {
                ids.iter().for_each(|id| tracing::info!(job = id, "job expired"));
                if !ids.is_empty() {
                    self.changes.send_replace(());
                }
                ids.len() == BATCH as usize
            }
            Err(error) => {
                tracing::error!(%error, "expired jobs cannot be removed");
                false
            }
        }
    }
}
