//! One request on its way through the engine.

use std::future::Future;
use std::panic::AssertUnwindSafe;
use std::pin::Pin;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::client::{Caller, Client};
use super::clock::Clock;
use super::cost::Cost;
use super::progress::{Progress, StageTimes, Watch};
use super::queue::{Permit, Queue, Turn};
use super::workers::{Lane, Workers};
use super::{EngineError, Inner};
use densecloud::Made;
use densecloud_cascade::{CascadeError, LevelRunner, Observer};

/// Work that was admitted: a request, or any other. Await it, or [`Pending::wait`] for it; drop it to stop the work within
/// one batch of patches.
#[must_use = "dropping it cancels the request"]
pub struct Pending<T = Made> {
    queue: Arc<Queue>,
    task: Arc<Task>,
    // Tokio's channel because it can be awaited and waited for; it needs no runtime.
    result: oneshot::Receiver<Result<Outcome<T>, EngineError>>,
}

/// Finished work.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome<T = Made> {
    /// What came of it: of a request the dense cloud, and what was done to the input.
    pub made: T,
    /// How long each stage took, over all levels.
    pub stages: StageTimes,
    /// How long the engine expected it to take alone on the machine, when it was admitted.
    pub estimate: Duration,
    /// How long it took, less the time that others had.
    pub took: Duration,
}

/// What the queue, its threads and the caller share.
pub(super) struct Task {
    pub(super) client: Client,
    pub(super) cost: Cost,
    /// Bytes that it will take at its height.
    pub(super) memory: u64,
    /// How long it will take, alone on the machine.
    pub(super) estimate: Duration,
    clock: Arc<dyn Clock>,
    watch: Watch,
    deadline: Option<Instant>,
    submitted: Instant,
    started: OnceLock<Instant>,
    // Taken by the thread that runs it; dropped with the task when nobody does.
    work: Mutex<Option<Work>>,
}

struct Work {
    job: Box<dyn Job>,
    // Lives here, not with the caller: a caller who leaves must not free points that are still
    // being computed.
    permit: Permit,
}

/// Work of some kind, with whoever waits for it.
trait Job: Send {
    /// Does it, and gives turn and permit back before its result.
    fn run(self: Box<Self>, workers: &Workers, task: &Task, permit: Permit, turn: Turn<'_>);

    /// Will never do it.
    fn fail(self: Box<Self>, error: EngineError);
}

struct Waited<T, F> {
    work: F,
    /// Whether what it takes tells of what others will.
    is_typical: bool,
    result: oneshot::Sender<Result<Outcome<T>, EngineError>>,
}

impl Task {
    pub(super) fn cancel(&self) {
        self.watch.cancel();
        self.take();
    }

    fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| self.clock.now() >= deadline)
    }

    /// Its end where its deadline has passed.
    fn late(&self) -> EngineError {
        let worked = self.started.get().map_or(Duration::ZERO, |begun| self.clock.now() - *begun);
        EngineError::Deadline { waited: self.waited(), worked }
    }

    /// How long it waited in the queue; so far, where it still does.
    fn waited(&self) -> Duration {
        self.started.get().copied().unwrap_or_else(|| self.clock.now()) - self.submitted
    }

    fn take(&self) -> Option<Work> {
        self.work.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

impl<T: Send + 'static> Pending<T> {
    /// Queues work that takes `cost` while it runs, and gives back `permit` when it is over.
    pub(super) fn queue(
        engine: &Inner,
        caller: &Caller,
        permit: Permit,
        (cost, is_typical): (Cost, bool),
        work: impl FnOnce(&dyn LevelRunner, &dyn Observer) -> Result<T, CascadeError> + Send + 'static,
    ) -> Self {
        let Inner { queue, clock, .. } = engine;
        let (sender, result) = oneshot::channel();
        let number = permit.number();
        let job = Waited { work, is_typical, result: sender };
        let task = Arc::new(Task {
            client: caller.client.clone(),
            cost,
            memory: queue.memory_of(cost),
            estimate: queue.time_of(cost),
            clock: Arc::clone(clock),
            watch: Watch::new(Arc::clone(clock), caller.deadline),
            deadline: caller.deadline,
            submitted: clock.now(),
            started: OnceLock::new(),
            work: Mutex::new(Some(Work { job: Box::new(job), permit })),
        });
        queue.push(Arc::clone(&task), number);
        Self { queue: Arc::clone(queue), task, result }
    }
}

impl<T> Pending<T> {
    /// How far it is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        self.task.watch.progress()
    }

    /// Tells how far it is while the request itself is being waited for.
    #[must_use]
    pub fn progress_handle(&self) -> ProgressHandle {
        ProgressHandle(Arc::clone(&self.task))
    }

    /// Blocks until it is done. Not for async code: await it there.
    ///
    /// # Errors
    /// As awaiting it.
    pub fn wait(mut self) -> Result<Outcome<T>, EngineError> {
        let result = std::mem::replace(&mut self.result, oneshot::channel().1);
        result.blocking_recv().unwrap_or(Err(EngineError::Cancelled))
    }
}

/// Tells how far a request is, and can cancel it; keeps nothing running.
#[derive(Clone)]
pub struct ProgressHandle(Arc<Task>);

impl ProgressHandle {
    /// How far it is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        self.0.watch.progress()
    }

    /// How long it waited in the queue; so far, where it still does.
    #[must_use]
    pub fn waited(&self) -> Duration {
        self.0.waited()
    }

    /// Stops the work within one batch of patches; whoever waits for it gets
    /// [`EngineError::Cancelled`].
    pub fn cancel(&self) {
        self.0.cancel();
    }
}

impl<T> Future for Pending<T> {
    type Output = Result<Outcome<T>, EngineError>;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        // A sender that is gone without a word was cancelled with its task.
        Pin::new(&mut self.result).poll(context).map(|r| r.unwrap_or(Err(EngineError::Cancelled)))
    }
}

impl<T> Drop for Pending<T> {
    fn drop(&mut self) {
        self.task.watch.cancel();
        self.queue.remove(&self.task);
    }
}

/// A queue thread's life: one task after another until the queue closes.
pub(super) fn work(queue: &Queue, workers: &Workers, lane: Option<Lane>) {
    while let Some((task, turn)) = queue.next(lane) {
        let Some(Work { job, permit }) = task.take() else { continue };
        if task.is_late() {
            drop((turn, permit));
            job.fail(task.late());
            continue;
        }
        job.run(workers, &task, permit, turn);
    }
}

impl<T, F> Job for Waited<T, F>
where
    T: Send,
    F: FnOnce(&dyn LevelRunner, &dyn Observer) -> Result<T, CascadeError> + Send,
{
    fn run(self: Box<Self>, workers: &Workers, task: &Task, permit: Permit, turn: Turn<'_>) {
        let Self { work, is_typical, result } = *self;
        // Only this thread sets it, once.
        let _ = task.started.set(task.clock.now());
        // A panic is a bug in one request; it must not take the thread, and the service, with it.
        let done = std::panic::catch_unwind(AssertUnwindSafe(|| {
            workers.install(task.cost.lane(), || work(workers.runner(), &task.watch))
        }));
        let outcome = match done {
            Ok(Ok(made)) => {
                let took = turn.took();
                if is_typical {
                    turn.learn(task.cost, took);
                }
                Ok(Outcome { made, stages: task.watch.finish(), estimate: task.estimate, took })
            }
            Ok(Err(CascadeError::Cancelled)) if task.is_late() => Err(task.late()),
            Ok(Err(error)) => Err(EngineError::from(error)),
            Err(panic) => Err(EngineError::Internal(message(&*panic))),
        };
        // Before the answer, so that a caller who has it finds its points free.
        drop((turn, permit));
        // A caller who left needs no answer.
        let _ = result.send(outcome);
    }

    fn fail(self: Box<Self>, error: EngineError) {
        let _ = self.result.send(Err(error));
    }
}

fn message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a worker panicked".into())
}
