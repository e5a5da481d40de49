//! The worker threads: two pools over one runner.

use std::sync::Arc;

use super::StartError;
use densecloud_cascade::LevelRunner;

/// Which pool a request runs on: large ones must not keep small ones waiting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Lane {
    /// Small requests, seconds of work at most.
    Express,
    /// All others.
    Bulk,
}

impl Lane {
    /// The most points out of a small request.
    pub(super) const EXPRESS: u64 = 100_000;

    /// By the number of points out.
    pub(super) fn of(points_out: u64) -> Self {
        if points_out <= Self::EXPRESS { Self::Express } else { Self::Bulk }
    }
}

/// Threads over one runner.
///
/// Each lane has a pool of `threads` threads, on which geometry runs too, so that a program started
/// with `--threads 4` uses four. While both lanes have work, they share what the runner has: its sessions in
/// [turn](super::turns), or a device.
pub(super) struct Workers {
    bulk: rayon::ThreadPool,
    express: rayon::ThreadPool,
    threads: usize,
    runner: Arc<dyn LevelRunner>,
}

impl Workers {
    /// Starts `threads` threads a lane.
    ///
    /// # Errors
    /// [`StartError::Threads`].
    pub(super) fn new(runner: Arc<dyn LevelRunner>, threads: usize) -> Result<Self, StartError> {
        let pool = |name: &'static str| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .thread_name(move |i| format!("{name}-{i}"))
                .build()
                .map_err(|e| StartError::Threads { count: threads, why: e.to_string() })
        };
        Ok(Self { bulk: pool("densecloud")?, express: pool("densecloud-x")?, threads, runner })
    }

    /// Runs `work` on the pool of `lane`, where rayon's parallel iterators use its threads.
    pub(super) fn install<R: Send>(&self, lane: Lane, work: impl FnOnce() -> R + Send) -> R {
        match lane {
            Lane::Bulk => self.bulk.install(work),
            Lane::Express => self.express.install(work),
        }
    }

    /// Threads of each lane.
    pub(super) fn threads(&self) -> usize {
        self.threads
    }

    /// What runs the units.
    pub(super) fn runner(&self) -> &dyn LevelRunner {
        &*self.runner
    }
}
