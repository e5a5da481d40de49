//! Queue, workers, progress and cancellation: runs cascades for many callers at once.
//!
//! The [`Engine`] admits requests while the points they will give fit its budget, runs a few at a
//! time on one set of worker threads, and hands each caller a [`Pending`] to wait on. Dropping that
//! stops the work. Clients take turns, each has a share of the budget, and deadlines count the time
//! in the queue. It knows nothing of files or HTTP.

mod client;
mod cost;
mod fair;
mod pending;
mod progress;
mod queue;
mod refusal;

use std::sync::Arc;
use std::time::{Duration, Instant};

pub use client::{Caller, Client};
pub use cost::Cost;
pub use fair::Fair;
pub use pending::{Outcome, Pending, ProgressHandle};
pub use progress::{Progress, StageTimes};
pub use queue::Permit;
pub use refusal::Refusal;

use cost::Pace;
use densecloud::Request;
use densecloud_cascade::{Backend, BackendError, Lane, Workers};
use densecloud_cascade::{CascadeError, CascadeOptions, Silent, Target};
use densecloud_cloud::Position;
use queue::{Bounds, Queue};

/// Sizes of the engine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EngineConfig {
    /// Worker threads; each has its own session. 0 means one a processor.
    pub threads: usize,
    /// Requests computed at the same time, on the same workers, and as many more small ones
    /// ([`Lane::Express`]). 0 means as many as threads, so that one request's single-threaded stages
    /// leave no processor idle.
    pub concurrency: usize,
    /// Points out of all requests that are queued or running; beyond it requests are refused. One
    /// request alone is always admitted.
    pub queue_points: u64,
    /// The same of one client's requests. 0 means a quarter of all.
    pub client_points: u64,
    /// Work that waits in a lane above which the lane takes no more requests, by the time that it takes on
    /// the machine alone; of one client's the same part as of the points. What is at work does not count, nor does
    /// the size of the request: only those after it would wait for it.
    pub queue_time: Duration,
    /// Bytes that requests at work may take together, as [`Cost::memory`] estimates them; more wait until
    /// others are done, and a request above it is refused.
    pub memory: u64,
}

impl Default for EngineConfig {
    fn default() -> Self {
        Self {
            threads: 0,
            concurrency: 0,
            queue_points: 50_000_000,
            client_points: 0,
            queue_time: Duration::from_secs(15),
            memory: u64::MAX,
        }
    }
}

/// Why a request has no result.
#[derive(Debug, Clone, thiserror::Error)]
pub enum EngineError {
    /// It was not admitted.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The deadline came before the result.
    #[error(
        "the deadline came after {:.1} s in the queue and {:.1} s of work",
        waited.as_secs_f64(), worked.as_secs_f64()
    )]
    Deadline {
        /// In the queue.
        waited: Duration,
        /// At work; nothing where it was never begun.
        worked: Duration,
    },
    /// The [`Pending`] was dropped, or the engine shut down.
    #[error("cancelled")]
    Cancelled,
    /// The cascade refused the cloud, or failed.
    #[error("{0}")]
    Cascade(CascadeError),
    /// The worker died of a bug; other requests are not affected.
    #[error("internal error: {0}")]
    Internal(String),
}

impl From<CascadeError> for EngineError {
    fn from(error: CascadeError) -> Self {
        match error {
            CascadeError::Cancelled => Self::Cancelled,
            other => Self::Cascade(other),
        }
    }
}

/// Runs cascades; clones share one queue and one set of workers. When the last clone is dropped,
/// queued requests are cancelled and the threads end.
#[derive(Clone)]
pub struct Engine {
    inner: Arc<Inner>,
}

struct Inner {
    queue: Arc<Queue>,
    workers: Arc<Workers>,
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.queue.close();
    }
}

impl Engine {
    /// Starts the workers over any backend.
    ///
    /// # Errors
    /// What [`Backend::open`] gives.
    pub fn with_backend(backend: Arc<dyn Backend>, config: EngineConfig) -> Result<Self, BackendError> {
        let or = |value: usize, default: usize| if value == 0 { default } else { value };
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = or(config.threads, processors);
        let workers = Arc::new(Workers::new(backend, threads)?);
        let client_points = match config.client_points {
            0 => config.queue_points / 4,
            points => points,
        };
        let bounds = Bounds {
            points: config.queue_points,
            client_points,
            time: config.queue_time,
            memory: config.memory,
        };
        let queue = Arc::new(Queue::new(bounds));
        let concurrency = or(config.concurrency, threads);
        for i in 0..2 * concurrency {
            // The second half takes small requests alone: they never wait for a large one to end.
            let lane = (i >= concurrency).then_some(Lane::Express);
            let (queue, workers) = (Arc::clone(&queue), Arc::clone(&workers));
            std::thread::Builder::new()
                .name(format!("densecloud-job-{i}"))
                .spawn(move || pending::work(&queue, &workers, lane))
                .map_err(|e| BackendError::Library { why: format!("cannot start a thread: {e}") })?;
        }
        Ok(Self { inner: Arc::new(Inner { queue, workers }) })
    }

    /// Runs every unit once, so that the first request is not slower than the others, and then two
    /// sizes, which tell how fast this machine is.
    ///
    /// # Errors
    /// [`EngineError::Cascade`] when the model does not run.
    pub fn warm_up(&self) -> Result<(), EngineError> {
        let workers = &self.inner.workers;
        let patch = workers.shape().patch_size;
        let all = f64::from(1_u32 << workers.backend().units().min(6));
        self.timed(patch, all)?;
        let small = self.timed(patch, 2.0)?;
        let large = self.timed(4 * patch, 8.0)?;
        self.inner.queue.calibrate(Pace::measured(small, large));
        Ok(())
    }

    /// Upsamples so many points by `ratio`, beside the queue; says what it cost.
    fn timed(&self, points: usize, ratio: f64) -> Result<(Cost, Duration), EngineError> {
        // A spiral on the sphere: even, and without a file.
        let positions: Vec<Position> = (0..points)
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f64 / points as f64;
                let (r, angle) = ((1.0 - z * z).sqrt(), i as f64 * 2.399_963);
                [r * angle.cos(), r * angle.sin(), z]
            })
            .collect();
        let (target, settings) = (Target::Ratio(ratio), CascadeOptions::default());
        let start = Instant::now();
        let dense =
            densecloud_cascade::upsample(&positions, target, &settings, &self.inner.workers, &Silent)?;
        let cost = Cost { points_in: points as u64, points_out: dense.positions.len() as u64 };
        Ok((cost, start.elapsed()))
    }

    /// Queues a request of the only client there is, without a deadline. Returns at once; cost O(points in).
    ///
    /// # Errors
    /// As [`Engine::submit_for`].
    pub fn submit(&self, request: Request) -> Result<Pending, EngineError> {
        self.submit_for(&Caller::default(), request, None)
    }

    /// Takes the points of a request from the budget before the request is there: as soon as its size is
    /// known, or guessed from below. They are given back when the permit is dropped.
    ///
    /// # Errors
    /// Any [`Refusal`].
    pub fn reserve(&self, caller: &Caller, cost: Cost) -> Result<Permit, Refusal> {
        self.inner.queue.admit(caller, cost)
    }

    /// Whether [`Engine::reserve`] would do so for a request of which no more is known; takes nothing. A refusal's time
    /// is that of one as large as those before it.
    ///
    /// # Errors
    /// The same.
    pub fn would_admit(&self, caller: &Caller, cost: Cost) -> Result<(), Refusal> {
        self.inner.queue.would_admit(caller, cost)
    }

    /// Whether a request of this size fits into the memory that all together may take.
    ///
    /// # Errors
    /// [`Refusal::TooBig`].
    pub fn check_memory(&self, cost: Cost) -> Result<(), Refusal> {
        self.inner.queue.check_memory(cost)
    }

    /// Queues a request, with the points that were reserved for it, if any were. Returns at once; cost
    /// O(points in).
    ///
    /// # Errors
    /// [`EngineError::Cascade`] when the target is impossible for this many points; what
    /// [`Engine::reserve`] gives, where nothing was reserved or too little.
    pub fn submit_for(
        &self,
        caller: &Caller,
        request: Request,
        reserved: Option<Permit>,
    ) -> Result<Pending, EngineError> {
        let finite =
            request.cloud.positions.iter().filter(|p| p.iter().all(|c| c.is_finite())).count() as u64;
        let cost = Cost { points_in: finite, points_out: request.target.points_out(finite)? };
        let permit = match reserved {
            Some(mut permit) => {
                permit.resize(caller, cost)?;
                permit
            }
            None => self.reserve(caller, cost)?,
        };
        Ok(Pending::queue(&self.inner.queue, request, caller, permit))
    }

    /// Points out of all requests that are reserved, queued or running.
    #[must_use]
    pub fn queued_points(&self) -> u64 {
        self.inner.queue.points()
    }

    /// Points out that one client may have among them.
    #[must_use]
    pub fn client_points(&self) -> u64 {
        self.inner.queue.bounds().client_points
    }

    /// Bytes that the requests at work take, as estimated.
    #[must_use]
    pub fn memory(&self) -> u64 {
        self.inner.queue.memory()
    }

    /// Bytes that they may take.
    #[must_use]
    pub fn max_memory(&self) -> u64 {
        self.inner.queue.bounds().memory
    }

    /// How long all that is admitted and not done will take.
    #[must_use]
    pub fn backlog(&self) -> Duration {
        self.inner.queue.backlog()
    }

    /// How long a request takes alone on the machine; none before the first measurement.
    #[must_use]
    pub fn estimate(&self, cost: Cost) -> Option<Duration> {
        self.inner.queue.estimate(cost)
    }

    /// Points out a second, of a large cloud at a ratio of four; none before the first measurement.
    #[must_use]
    pub fn rate(&self) -> Option<f64> {
        let cost = Cost { points_in: Lane::EXPRESS, points_out: 4 * Lane::EXPRESS };
        Some(cost.points_out as f64 / self.estimate(cost)?.as_secs_f64())
    }

    /// Where the model runs: `cpu`, for example.
    #[must_use]
    pub fn provider(&self) -> &str {
        self.inner.workers.backend().provider()
    }

    /// Worker threads.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.inner.workers.threads()
    }
}

#[cfg(test)]
mod tests;
