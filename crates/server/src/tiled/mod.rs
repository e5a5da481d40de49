//! Clouds of more points than a tile: planned, run tile by tile on the engine, and sent as their parts are final.
//!
//! A task drives each of them, so that the work goes on while the client reads, and ends with whoever waits for it. Parts
//! lie on the disk until they are sent: a client that is slow holds up no work, and takes no memory.

pub(crate) mod body;
mod steps;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio::task::JoinSet;

use steps::Steps;
pub(crate) use steps::{cost_of, submit_plan, submit_tile};

use crate::admission::budget::Held;
use crate::admission::ticket::Ticket;
use crate::app::App;
use crate::problem::Problem;
use densecloud::Options;
use densecloud_engine::{EngineError, Progress, ProgressHandle};
use densecloud_formats::{CloudReader, FormatError, Limits, Reading};
use densecloud_tiles::Tiling;

/// A large cloud that has arrived, and what is wanted of it.
pub(crate) struct TiledRequest {
    pub(crate) open: Box<Open>,
    /// Its shares of memory and disk, until it has been read.
    pub(crate) held: Option<[Held; 2]>,
    /// Points in, as the file's header tells them or as they are guessed.
    pub(crate) points: u64,
    pub(crate) options: Options,
    /// Where the folder of its tiles lies, if not among the other temporary ones.
    pub(crate) scratch: Option<PathBuf>,
}

/// Opens a cloud.
pub(crate) type Open = dyn FnOnce(Limits, &Reading) -> Result<CloudReader<'static>, FormatError> + Send;

/// A plan that is shared. Its folder, which goes with the last who has it, is removed on a thread that may wait for the
/// disk.
#[derive(Clone)]
pub(crate) struct Plan(Option<Arc<Tiling>>);

impl Plan {
    pub(crate) fn tiling(&self) -> &Arc<Tiling> {
        // Taken as it is dropped alone.
        self.0.as_ref().expect("a plan")
    }
}

impl Drop for Plan {
    fn drop(&mut self) {
        discard(self.0.take());
    }
}

/// Drops it where that may block.
fn discard<T: Send + 'static>(what: T) {
    if let Ok(runtime) = Handle::try_current() {
        runtime.spawn_blocking(move || drop(what));
    }
}

/// How far a work is.
#[derive(Default)]
struct State {
    plan: Option<Plan>,
    /// The plan's share of the disk.
    on_disk: Option<Held>,
    /// What the engine works on.
    handle: Option<ProgressHandle>,
    /// Tiles that are done, and the points that they gave.
    done: u32,
    points: u64,
    /// What each stage took, over all tiles.
    stages: Vec<(&'static str, Duration)>,
    /// How it ended.
    end: Option<Result<(), Problem>>,
}

/// A work that goes on, until dropped.
pub(crate) struct Tiled {
    state: watch::Receiver<State>,
    _task: JoinSet<()>,
}

/// Tells how far a work is, and keeps nothing running.
#[derive(Clone)]
pub(crate) struct TiledProgress(watch::Receiver<State>);

impl Tiled {
    /// Begins with a cloud.
    ///
    /// # Errors
    /// As [`Ticket::reserve`].
    pub(crate) fn begin(app: &Arc<App>, ticket: Ticket, request: TiledRequest) -> Result<Self, Problem> {
        let deadline = ticket.deadline.clone();
        let mut steps = Steps::new(app, ticket, request.points, &request.options)?;
        let (sender, state) = watch::channel(State::default());
        let mut task = JoinSet::new();
        task.spawn(async move {
            let ended = drive(&mut steps, request, &sender).await.map_err(|failure| match failure {
                // It knows of the upload, too.
                Failure::Engine(EngineError::Deadline { .. }) => deadline.over(),
                Failure::Engine(error) => Problem::from_engine(error),
                Failure::Problem(problem) => problem,
            });
            steps.over(ended.is_ok());
            sender.send_modify(|state| {
                (state.end, state.handle, state.stages) = (Some(ended), None, steps.stages());
            });
        });
        Ok(Self { state, _task: task })
    }

    pub(crate) fn progress(&self) -> TiledProgress {
        TiledProgress(self.state.clone())
    }

    /// Waits until so many tiles are done.
    ///
    /// # Errors
    /// The work ended before that.
    pub(crate) async fn tiles(&mut self, count: u32) -> Result<Plan, Problem> {
        let is_there = |state: &State| state.end.is_some() || state.done >= count;
        self.wait(is_there).await
    }

    /// Waits until a file can begin: the first tile is done, or, where it needs to know all points, the last.
    ///
    /// # Errors
    /// The work ended before that.
    pub(crate) async fn begun(&mut self) -> Result<Plan, Problem> {
        let flows = |plan: &Plan| plan.tiling().flows();
        let first = |state: &State| state.done > 0 && state.plan.as_ref().is_some_and(flows);
        self.wait(|state| state.end.is_some() || first(state)).await
    }

    /// Waits until all tiles are done.
    ///
    /// # Errors
    /// The work ended before that.
    pub(crate) async fn whole(&mut self) -> Result<Plan, Problem> {
        self.wait(|state| state.end.is_some()).await
    }

    async fn wait(&mut self, is_there: impl FnMut(&State) -> bool) -> Result<Plan, Problem> {
        let ended = || Problem::Internal("the work ended early".into());
        // Fails where the task has panicked.
        let state = self.state.wait_for(is_there).await.map_err(|_| ended())?;
        match &state.end {
            Some(Err(problem)) => Err(problem.clone()),
            _ => state.plan.clone().ok_or_else(ended),
        }
    }

    /// What each stage took, once all tiles are done.
    pub(crate) fn stages(&self) -> Vec<(&'static str, Duration)> {
        self.state.borrow().stages.clone()
    }
}

impl TiledProgress {
    /// How far it is: stage and level are those of the tile at work, the fraction is by the points of all.
    pub(crate) fn progress(&self) -> Progress {
        let state = self.0.borrow();
        let waiting = Progress { stage: None, level: 0, levels: 0, fraction: 0.0 };
        let now = state.handle.as_ref().map_or(waiting, ProgressHandle::progress);
        let Some(plan) = &state.plan else { return Progress { fraction: 0.0, ..now } };
        steps::overall(plan.tiling(), state.done, state.points)(now)
    }
}

enum Failure {
    Engine(EngineError),
    Problem(Problem),
}

impl From<EngineError> for Failure {
    fn from(error: EngineError) -> Self {
        Self::Engine(error)
    }
}

impl From<Problem> for Failure {
    fn from(problem: Problem) -> Self {
        Self::Problem(problem)
    }
}

async fn drive(
    steps: &mut Steps,
    request: TiledRequest,
    state: &watch::Sender<State>,
) -> Result<(), Failure> {
    let planning = steps.plan(request);
    state.send_modify(|state| state.handle = Some(planning.progress_handle()));
    let tiling = planning.await?.made?;
    let (tiling, on_disk) = steps.planned(tiling)?;
    state.send_modify(|state| (state.plan, state.on_disk) = (Some(Plan(Some(tiling))), Some(on_disk)));
    while let Some(tile) = steps.next() {
        state.send_modify(|state| state.handle = Some(tile.progress_handle()));
        let points = steps.took(tile.await?)?;
        state.send_modify(|state| (state.done, state.points) = (state.done + 1, state.points + points));
    }
    Ok(())
}
