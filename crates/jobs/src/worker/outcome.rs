//! A step that is done, and what becomes of it.

use std::io;
use std::panic::AssertUnwindSafe;
use std::time::Instant;

use super::Jobs;
use crate::error::StoreError;
use crate::record::{Failure, Record, ResultFile};
use crate::records::{Lease, Step};
use crate::work::{Begun, Checked, How, Parts, Stopped, Task, Work, passes};

/// What became of a step.
enum Ended {
    Result(ResultFile),
    Split { sizes: Vec<u64>, bytes: u64 },
    Tile(u64),
}

impl Jobs {
    /// Does a step and keeps what came of it; says how it ended, and whether the thread should wait before it tries the next.
    pub(super) fn run(&self, lease: &Lease, task: &Task, work: &dyn Work) -> (How, bool) {
        // A panic is a bug in one job; it must not take the thread, and all other jobs, with it.
        let ended = std::panic::catch_unwind(AssertUnwindSafe(|| self.attempt(lease, task, work)));
        let ended = ended.unwrap_or(Err(Stopped::Crashed));
        if ended.is_err() {
            // What is left goes with the job.
            let _ = self.store.discard(lease);
        }
        let cancelled = {
            self.lock().is_over(lease);
            task.cancelled()
        };
        let kept = match ended {
            Err(_) if cancelled => Ok(How::Lost),
            Err(stopped) => self.stop_at(lease, stopped),
            Ok(ended) => self.keep(lease, &ended),
        };
        let mut running = self.lock();
        running.remove(lease);
        match kept {
            Ok(how) => (how, how == How::Later),
            Err(error) => {
                // It is put back as soon as the database can be written, or at the next start.
                tracing::error!(job = lease.record.id, %error, "a job's state cannot be kept");
                running.lost.push(lease.clone());
                (How::Lost, true)
            }
        }
    }

    /// Does a step.
    fn attempt(&self, lease: &Lease, task: &Task, work: &dyn Work) -> Result<Ended, Stopped> {
        let (job, place) = (&lease.record, self.store.place(lease));
        if let Step::Tile(tile) = lease.step {
            return work.tile(job, tile, &place, task).map(Ended::Tile);
        }
        let input = self.store.input(&job.id)?;
        let mut sink = self.store.result_writer(lease)?;
        let mut checked = Checked { sink: &mut sink, task };
        let about = match lease.step {
            Step::Join => {
                let names = self.store.parts(&job.id).map_err(io::Error::other)?;
                let parts = Parts { input, names: names.into_iter().map(|(_, name)| name).collect() };
                work.join(job, parts, &place, task, &mut checked)?
            }
            _ => match work.begin(job, input, &place, task, &mut checked)? {
                Begun::Done(about) => about,
                Begun::Split { sizes, bytes } => return Ok(Ended::Split { sizes, bytes }),
            },
        };
        Ok(Ended::Result(sink.finish(about)?))
    }

    /// Keeps what came of a step.
    fn keep(&self, lease: &Lease, ended: &Ended) -> Result<How, StoreError> {
        let Record { id, request_id, .. } = &lease.record;
        let kept = match ended {
            Ended::Result(result) => self.store.done(lease, result, self.now())?,
            Ended::Split { sizes, bytes } => self.store.split(lease, sizes, *bytes)?,
            Ended::Tile(points) => self.store.tile_done(lease, *points)?,
        };
        if !kept {
            return Ok(How::Lost);
        }
        match ended {
            Ended::Result(result) => {
                tracing::info!(job = id, request = request_id, bytes = result.bytes, "job done");
            }
            Ended::Split { sizes, .. } => {
                tracing::info!(job = id, request = request_id, tiles = sizes.len(), "job planned");
                self.wake_all();
            }
            Ended::Tile(points) => {
                tracing::info!(job = id, request = request_id, step = ?lease.step, points, "tile done");
                self.wake_one();
            }
        }
        Ok(How::Done)
    }

    /// Whether this process may not use what others may: that says nothing of the job.
    fn is_barred(&self, error: &io::Error) -> bool {
        self.settings.folder().is_none() && error.kind() == io::ErrorKind::PermissionDenied
    }

    /// A step has no result: its job fails of that, or it waits again.
    fn stop_at(&self, lease: &Lease, stopped: Stopped) -> Result<How, StoreError> {
        let id = &lease.record.id;
        match stopped {
            Stopped::Later | Stopped::Cancelled => self.store.defer(lease).map(|_| How::Later),
            Stopped::Storage(error) if passes(&error) || self.is_barred(&error) => {
                tracing::warn!(job = id, %error, "a job is tried again later");
                self.store.defer(lease).map(|_| How::Later)
            }
            Stopped::Differs => {
                tracing::warn!(job = id, "the tiles of a job are planned anew: they are another version's");
                self.store.unsplit(lease).map(|_| How::Later)
            }
            Stopped::Refused(why) => self.fail(lease, &Failure::Refused(why)),
            Stopped::Crashed => self.fail(lease, &Failure::Crashed),
            Stopped::Storage(error) => {
                tracing::error!(job = id, %error, "a job's file cannot be read or written");
                let full = StoreError::from(io::Error::from(error.kind())).is_full();
                let failure = Failure::Storage { why: error.to_string(), full };
                // Other machines may have room.
                let others = full && self.settings.folder().is_none();
                if others { self.retry(lease, &failure) } else { self.fail(lease, &failure) }
            }
        }
    }

    fn fail(&self, lease: &Lease, failure: &Failure) -> Result<How, StoreError> {
        if !self.store.failed(lease, failure, self.now())? {
            return Ok(How::Lost);
        }
        Ok(self.has_failed(lease, failure))
    }

    /// A step found no room on this machine: it is left to others for a while.
    fn retry(&self, lease: &Lease, failure: &Failure) -> Result<How, StoreError> {
        Ok(match self.store.retry(lease, failure, self.now())? {
            None => How::Lost,
            Some(false) => self.has_failed(lease, failure),
            Some(true) => {
                tracing::warn!(job = lease.record.id, step = ?lease.step, "left to another, which may have room");
                self.lock().rest = Some(Instant::now() + self.settings.lease);
                How::Later
            }
        })
    }

    fn has_failed(&self, lease: &Lease, failure: &Failure) -> How {
        let Record { id, request_id, .. } = &lease.record;
        self.cancel(id);
        tracing::info!(job = id, request = request_id, ?failure, "job failed");
        How::Failed
    }
}
