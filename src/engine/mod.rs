//! Queue, workers, progress and cancellation: runs cascades for many callers at once.
//!
//! The [`Engine`] admits requests while the points they will give fit its budget, runs a few at a
//! time on one set of worker threads, and hands each caller a [`Job`] to wait on. Dropping the job
//! stops the work. It knows nothing of files or HTTP.

mod job;
mod progress;
mod queue;

use std::sync::Arc;
use std::time::Duration;

pub use job::{Job, Outcome, ProgressHandle};
pub use progress::{Progress, StageTimes};

use crate::attributes::Finish;
use crate::backend::{Backend, BackendError, Lane, Model, OnnxBackend, Workers};
use crate::cascade::{self, CascadeError, Settings, Silent, Target};
use crate::cloud::{Cloud, Position};
use queue::Queue;

/// What a caller wants done.
#[derive(Debug, Clone)]
pub struct Request {
    /// The cloud, in its own coordinates.
    pub cloud: Cloud,
    /// How many points are wanted.
    pub target: Target,
    /// How to run the cascade.
    pub settings: Settings,
    /// What is done with the cascade's points.
    pub finish: Finish,
}

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
}

impl Default for EngineConfig {
    fn default() -> Self {
        Self { threads: 0, concurrency: 0, queue_points: 50_000_000 }
    }
}

/// Why a request has no result.
#[derive(Debug, Clone, thiserror::Error)]
pub enum EngineError {
    /// The queue is full.
    #[error(
        "busy: {queued} points are queued or running and this request would add {wanted}, above the \
         limit of {limit} (--queue-points)"
    )]
    Full {
        /// Points out that this request would give.
        wanted: u64,
        /// Points out already admitted.
        queued: u64,
        /// The limit.
        limit: u64,
    },
    /// The job was dropped, or the engine shut down.
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
    /// Loads a model into ONNX Runtime and starts the workers.
    ///
    /// # Errors
    /// [`BackendError`] when the runtime or the model cannot be loaded.
    pub fn new(model: Arc<Model>, config: EngineConfig) -> Result<Self, BackendError> {
        Self::with_backend(Arc::new(OnnxBackend::new(model)?), config)
    }

    /// Starts the workers over any backend.
    ///
    /// # Errors
    /// What [`Backend::open`] gives.
    pub fn with_backend(backend: Arc<dyn Backend>, config: EngineConfig) -> Result<Self, BackendError> {
        let or = |value: usize, default: usize| if value == 0 { default } else { value };
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = or(config.threads, processors);
        let workers = Arc::new(Workers::new(backend, threads)?);
        let queue = Arc::new(Queue::new(config.queue_points));
        let concurrency = or(config.concurrency, threads);
        for i in 0..2 * concurrency {
            // The second half takes small requests alone: they never wait for a large one to end.
            let lane = (i >= concurrency).then_some(Lane::Express);
            let (queue, workers) = (Arc::clone(&queue), Arc::clone(&workers));
            std::thread::Builder::new()
                .name(format!("densecloud-job-{i}"))
                .spawn(move || job::work(&queue, &workers, lane))
                .map_err(|e| BackendError::Library { why: format!("cannot start a thread: {e}") })?;
        }
        Ok(Self { inner: Arc::new(Inner { queue, workers }) })
    }

    /// Runs every unit once, so that the first request is not slower than the others, and learns
    /// how fast this machine is.
    ///
    /// # Errors
    /// [`EngineError::Cascade`] when the model does not run.
    pub fn warm_up(&self) -> Result<(), EngineError> {
        let workers = &self.inner.workers;
        let ratio = f64::from(1_u32 << workers.backend().units().min(6));
        // A spiral on the sphere: even, and without a file.
        let points = workers.shape().patch_size;
        let positions: Vec<Position> = (0..points)
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f64 / points as f64;
                let (r, angle) = ((1.0 - z * z).sqrt(), i as f64 * 2.399_963);
                [r * angle.cos(), r * angle.sin(), z]
            })
            .collect();
        let start = std::time::Instant::now();
        let dense =
            cascade::upsample(&positions, Target::Ratio(ratio), &Settings::default(), workers, &Silent)?;
        self.inner.queue.measured(dense.positions.len() as u64, start.elapsed());
        Ok(())
    }

    /// Queues a request. Returns at once; cost O(points in).
    ///
    /// # Errors
    /// [`EngineError::Full`] when the queue's budget of points is used up;
    /// [`EngineError::Cascade`] when the target is impossible for this many points.
    pub fn submit(&self, request: Request) -> Result<Job, EngineError> {
        let finite = request.cloud.positions.iter().filter(|p| p.iter().all(|c| c.is_finite())).count();
        let points_out = request.target.points_out(finite as u64)?;
        Job::queue(&self.inner.queue, request, points_out)
    }

    /// Points out of all requests that are queued or running.
    #[must_use]
    pub fn queued_points(&self) -> u64 {
        self.inner.queue.points()
    }

    /// How long the backlog will take at the rate measured so far; at least a second.
    #[must_use]
    pub fn retry_after(&self) -> Duration {
        self.inner.queue.backlog().max(Duration::from_secs(1))
    }

    /// Points out a second, as measured so far; none before the first measurement.
    #[must_use]
    pub fn rate(&self) -> Option<f64> {
        self.inner.queue.rate()
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
