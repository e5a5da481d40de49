//! Queue, workers, progress and cancellation: runs cascades for many callers at once.
//!
//! The [`Engine`] admits requests while the points they will give fit its budget, runs a few at a
//! time on one set of worker threads, and hands each caller a [`Pending`] to wait on. Dropping that
//! stops the work. Clients take turns, each has a share of the budget, and deadlines count the time
//! in the queue. It knows nothing of files or HTTP.

mod client;
mod clock;
mod coming;
mod cost;
mod fair;
mod pending;
mod progress;
mod queue;
mod refusal;
mod turns;
mod workers;

use std::sync::Arc;
use std::time::Duration;

pub use client::{Caller, Client};
pub use clock::{Clock, SystemClock};
pub use cost::Cost;
pub use fair::Fair;
pub use pending::{Outcome, Pending, ProgressHandle};
pub use progress::{Progress, StageTimes};
pub use queue::Permit;
pub use refusal::Refusal;

use cost::Pace;
use densecloud::Request;
use densecloud_cascade::{Backend, BackendError, LevelRunner, Patchwise};
use densecloud_cascade::{CascadeError, CascadeOptions, Observer, Silent, Target};
use densecloud_cloud::Position;
use queue::{Bounds, Queue};
use turns::Turns;
use workers::{Lane, Workers};

/// Sizes of the engine. The defaults refuse nobody: a service sets its own limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EngineConfig {
    /// Worker threads; each has its own session. 0 means one a processor.
    pub threads: usize,
    /// Requests computed at the same time, on the same workers, and as many more small ones (of up to 100,000 points
    /// out). 0 means as many as threads, so that one request's single-threaded stages leave no processor idle.
    pub concurrency: usize,
    /// Points out of all requests that are queued or running; beyond it requests are refused. One
    /// request alone is always admitted.
    pub queue_points: u64,
    /// The same of one client's requests. 0 means a quarter of all.
    pub client_points: u64,
    /// The longest that the work waiting in a lane may take, by the machine alone: above it the lane takes no more
    /// requests. A client's work may take the same part of it as of the points. What is [reserved](Engine::reserve) counts
    /// as waiting from then on, unless its cloud is on its way for longer than this, or a thread is idle that will take it;
    /// for others' requests, up to its client's part. Work that runs does not count, nor does the size of a new request:
    /// only those after it would wait for it. None is no limit.
    pub queue_time: Option<Duration>,
    /// Bytes that requests at work may take together, as [`Cost::memory`] estimates them: others wait until
    /// there is room, and a request above it is refused.
    pub memory: u64,
}

impl Default for EngineConfig {
    fn default() -> Self {
        Self {
            threads: 0,
            concurrency: 0,
            queue_points: u64::MAX,
            client_points: 0,
            queue_time: None,
            memory: u64::MAX,
        }
    }
}

impl EngineConfig {
    /// Threads of each lane.
    fn threads(&self) -> usize {
        or(self.threads, std::thread::available_parallelism().map_or(1, usize::from))
    }
}

/// A setting, or its default where it is 0.
fn or<T: Default + PartialEq>(value: T, default: T) -> T {
    if value == T::default() { default } else { value }
}

/// What one part of a larger work takes while it is at work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// As of a request of so many points, those around the part included.
    pub cost: Cost,
    /// Whether it is the work of such a request, and what it takes tells of what others will.
    pub is_typical: bool,
}

/// Why an engine does not start.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// The backend opens no session.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// The system starts no more threads.
    #[error("cannot start {count} threads: {why}")]
    Threads {
        /// How many were wanted.
        count: usize,
        /// The system's own words.
        why: String,
    },
}

/// Why a request has no result.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
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
    clock: Arc<dyn Clock>,
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.queue.close();
    }
}

impl Engine {
    /// Starts the workers over a backend that takes a patch at a time, with a session for each of its threads.
    ///
    /// # Errors
    /// What [`Backend::open`] gives, and [`StartError::Threads`].
    pub fn with_backend(backend: Arc<dyn Backend>, config: EngineConfig) -> Result<Self, StartError> {
        let sessions = Turns::open(&*backend, config.threads())?;
        Self::new(Arc::new(Patchwise::with_sessions(backend, sessions)), config)
    }

    /// Starts the workers over any runner.
    ///
    /// # Errors
    /// [`StartError::Threads`].
    pub fn new(runner: Arc<dyn LevelRunner>, config: EngineConfig) -> Result<Self, StartError> {
        Self::with_clock(runner, config, Arc::new(SystemClock))
    }

    /// Starts the workers over any runner, by any clock.
    ///
    /// # Errors
    /// [`StartError::Threads`].
    pub fn with_clock(
        runner: Arc<dyn LevelRunner>,
        config: EngineConfig,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, StartError> {
        let threads = config.threads();
        let concurrency = or(config.concurrency, threads);
        let bounds = Bounds {
            points: config.queue_points,
            client_points: or(config.client_points, config.queue_points / 4),
            time: config.queue_time,
            memory: config.memory,
            threads: concurrency,
        };
        let queue = Arc::new(Queue::new(bounds, runner.demand(), Arc::clone(&clock)));
        let workers = Arc::new(Workers::new(runner, threads)?);
        // Dropped where a thread fails to start, which ends those before it.
        let inner = Arc::new(Inner { queue, workers, clock });
        for i in 0..2 * concurrency {
            // The second half takes small requests alone: they never wait for a large one to end.
            let lane = (i >= concurrency).then_some(Lane::Express);
            let (queue, workers) = (Arc::clone(&inner.queue), Arc::clone(&inner.workers));
            std::thread::Builder::new()
                .name(format!("densecloud-job-{i}"))
                .spawn(move || pending::work(&queue, &workers, lane))
                .map_err(|e| StartError::Threads { count: 2 * concurrency, why: e.to_string() })?;
        }
        Ok(Self { inner })
    }

    /// Runs every unit once, so that the first request is not slower than the others, and then two
    /// sizes, which tell how fast this machine is.
    ///
    /// # Errors
    /// [`EngineError::Cascade`] when the model does not run.
    pub fn warm_up(&self) -> Result<(), EngineError> {
        let runner = self.inner.workers.runner();
        let patch = runner.shape().patch_size;
        let all = f64::from(1_u32 << runner.units().min(6));
        self.timed(patch, all)?;
        let small = self.timed(patch, 2.0)?;
        let large = self.timed(4 * patch, 8.0)?;
        self.inner.queue.calibrate(Pace::measured(small, large));
        Ok(())
    }

    /// Upsamples a cloud of `points` points by `ratio`, beside the queue; says what it cost.
    fn timed(&self, points: usize, ratio: f64) -> Result<(Cost, Duration), EngineError> {
        // A spiral on the sphere: even, and without a file.
        let positions: Vec<Position> = (0..points)
            .map(|i| {
                let z = 1.0 - (2 * i + 1) as f64 / points as f64;
                let (r, angle) = ((1.0 - z * z).sqrt(), i as f64 * 2.399_963);
                [r * angle.cos(), r * angle.sin(), z]
            })
            .collect();
        let (target, options) = (Target::Ratio(ratio), CascadeOptions::default());
        let Inner { workers, clock, .. } = &*self.inner;
        let cost = Cost::new(points as u64, target.points_out(points as u64)?);
        let start = clock.now();
        workers.install(cost.lane(), || {
            densecloud_cascade::upsample(&positions, target, &options, workers.runner(), &Silent)
        })?;
        Ok((cost, clock.now() - start))
    }

    /// What a request takes. O(points in).
    ///
    /// # Errors
    /// [`EngineError::Cascade`] when the target is impossible for this many points.
    pub fn cost(request: &Request) -> Result<Cost, EngineError> {
        let finite =
            request.cloud.positions.iter().filter(|p| p.iter().all(|c| c.is_finite())).count() as u64;
        Ok(Cost::new(finite, request.target.points_out(finite)?).times(request.effort()))
    }

    /// Queues a request of the only client there is, without a deadline. Returns at once; cost O(points in).
    ///
    /// # Errors
    /// As [`Engine::submit_for`].
    pub fn submit(&self, request: Request) -> Result<Pending, EngineError> {
        self.submit_for(&Caller::default(), request, None)
    }

    /// Takes the points of a request from the budget before the request is there: as soon as its size is
    /// known, or guessed from below. From then on the request counts as waiting. Dropping the permit gives the points back.
    ///
    /// # Errors
    /// Any [`Refusal`].
    pub fn reserve(&self, caller: &Caller, cost: Cost) -> Result<Permit, Refusal> {
        self.inner.queue.admit(caller, cost)
    }

    /// Would [`Engine::reserve`] accept the smallest request possible? Reserves nothing. `cost` is the least that is known
    /// of it; a refusal's time is that of a request as large as those before it.
    ///
    /// # Errors
    /// As [`Engine::reserve`].
    pub fn would_admit(&self, caller: &Caller, cost: Cost) -> Result<(), Refusal> {
        self.inner.queue.would_admit(caller, cost)
    }

    /// Checks that a request of this size fits into the memory that all together may take.
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
        let cost = Self::cost(&request)?;
        let permit = match reserved {
            Some(mut permit) => {
                permit.resize(caller, cost)?;
                permit
            }
            None => self.reserve(caller, cost)?,
        };
        let cost = permit.cost();
        let work = move |runner: &dyn LevelRunner, observer: &dyn Observer| request.run(runner, observer);
        Ok(Pending::queue(&self.inner, caller, permit, (cost, true), work))
    }

    /// Changes what is reserved, now that more is known: to less always, to more where there is room.
    ///
    /// # Errors
    /// As [`Engine::reserve`]; it is as before then.
    pub fn resize(&self, caller: &Caller, permit: &mut Permit, cost: Cost) -> Result<(), Refusal> {
        permit.resize(caller, cost)
    }

    /// Queues one part of a larger work, with the points that were reserved for [that part](Permit::part). Parts of one
    /// work take turns with others' requests as if each came alone.
    pub fn submit_part<T: Send + 'static>(
        &self,
        caller: &Caller,
        permit: Permit,
        part: Part,
        work: impl FnOnce(&dyn LevelRunner, &dyn Observer) -> Result<T, CascadeError> + Send + 'static,
    ) -> Pending<T> {
        let Part { cost, is_typical } = part;
        Pending::queue(&self.inner, caller, permit, (cost, is_typical), work)
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

    /// How long the work that is admitted and not done will take.
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
        let cost = Cost::new(Lane::EXPRESS, 4 * Lane::EXPRESS);
        Some(cost.points_out as f64 / self.estimate(cost)?.as_secs_f64())
    }

    /// Where the model runs: `cpu`, for example.
    #[must_use]
    pub fn provider(&self) -> &str {
        self.inner.workers.runner().provider()
    }

    /// Worker threads.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.inner.workers.threads()
    }
}

#[cfg(test)]
mod tests;
