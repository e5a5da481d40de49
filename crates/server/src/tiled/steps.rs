//! The steps of one work in tiles, each a part that the engine takes; whoever drives them waits for each.

use std::sync::Arc;
use std::time::Duration;

use crate::admission::budget::Held;
use crate::admission::ticket::Ticket;
use crate::app::App;
use crate::http::asked::{cost, unread};
use crate::http::upload::reader_limits;
use crate::problem::Problem;
use crate::tiled::TiledRequest;
use densecloud::Options;
use densecloud_cascade::{CascadeError, LevelRunner, Observer, Stage};
use densecloud_engine::{Caller, Cost, Outcome, Part, Pending, Permit, Progress};
use densecloud_formats::Limits;
use densecloud_tiles::{Folder, Input, TILE_POINTS, TilesError, Tiling, Watch, Work, plan};

/// Points of the input that planning is counted as: it makes some places of the cloud dense, however large that is, and
/// holds as much of it.
const PLANNING: u64 = 100_000;
/// The ratio where only the points decide it.
const USUAL: f64 = 4.0;

/// A work in tiles on its way through the engine.
pub(crate) struct Steps {
    app: Arc<App>,
    caller: Caller,
    options: Options,
    /// Of what is still to do.
    left: Permit,
    tiling: Option<Arc<Tiling>>,
    next: u32,
    /// What each stage took.
    stages: Vec<(&'static str, Duration)>,
}

/// What a part comes to: what is wrong with the request is no failure of the engine's.
type Settled<T> = Result<T, Problem>;

/// Hears of a plan what the engine does of a request.
struct Heard<'a>(&'a dyn Observer);

impl Observer for Heard<'_> {
    fn plan(&self, sizes: &[usize]) {
        self.0.plan(sizes);
    }

    fn begin(&self, level: usize, stage: Stage) {
        self.0.begin(level, stage);
    }

    fn advance(&self, done: usize, total: usize) {
        self.0.advance(done, total);
    }

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

impl Watch for Heard<'_> {}

fn settled<T>(made: Result<T, TilesError>) -> Result<Settled<T>, CascadeError> {
    match made {
        Err(TilesError::Cascade(CascadeError::Cancelled)) => Err(CascadeError::Cancelled),
        made => Ok(made.map_err(Problem::from)),
    }
}

/// Points of a tile, which are told by whoever found that there is more than one.
fn tile_points(options: &Options) -> u64 {
    options.tile_points.unwrap_or(TILE_POINTS)
}

/// Plans the tiles of a cloud in a folder of their own.
fn planned(
    app: &App,
    limits: Limits,
    request: TiledRequest,
    runner: &dyn LevelRunner,
    watch: &dyn Watch,
) -> Result<Tiling, TilesError> {
    let TiledRequest { open, options, scratch, held: _held, .. } = request;
    let folder = Folder::temporary(&scratch.unwrap_or_else(|| app.config.temp_dir()))?;
    let reader = open(limits, &options.reading)?;
    let (model, tile_points) = (&app.config.model.name, tile_points(&options));
    let work = Work { options: &options, model, runner, tile_points, watch };
    match Input::read(reader, 0)? {
        Input::Large(large) => plan(*large, &work, &folder),
        Input::Small(..) => Err(densecloud_formats::FormatError::Empty("points").into()),
    }
}

/// What planning a request is counted as.
fn planning_cost(options: &Options, points: u64) -> Cost {
    let ratio = match options.points_out(points) as f64 / points.max(1) as f64 {
        ratio if ratio > 1.0 => ratio,
        _ => USUAL,
    };
    Cost::new(PLANNING, (PLANNING as f64 * ratio.min(64.0)) as u64).times(options.effort())
}

/// Has a request planned.
pub(crate) fn submit_plan(
    app: &Arc<App>,
    caller: &Caller,
    permit: Permit,
    request: TiledRequest,
) -> Pending<Settled<Tiling>> {
    let part = Part { cost: planning_cost(&request.options, request.points), is_typical: false };
    let (limits, shared) = (reader_limits(app), Arc::clone(app));
    let work = move |runner: &dyn LevelRunner, observer: &dyn Observer| {
        settled(planned(&shared, limits, request, runner, &Heard(observer)))
    };
    app.engine.submit_part(caller, permit, part, work)
}

/// What is reserved for a tile.
pub(crate) fn cost_of(tiling: &Tiling, tile: u32, options: &Options) -> Cost {
    let [own, _, size] = tiling.points(tile);
    Cost::new(own, size).times(options.effort())
}

/// Has a tile worked on.
pub(crate) fn submit_tile(
    app: &Arc<App>,
    caller: &Caller,
    permit: Permit,
    (tiling, tile): (Arc<Tiling>, u32),
    options: &Options,
) -> Pending<Settled<u64>> {
    let [own, around, size] = tiling.points(tile);
    let all = size as f64 * (own + around) as f64 / own.max(1) as f64;
    let cost = Cost::new(own + around, all as u64).times(options.effort());
    let work =
        move |runner: &dyn LevelRunner, observer: &dyn Observer| settled(tiling.run(tile, runner, observer));
    app.engine.submit_part(caller, permit, Part { cost, is_typical: true }, work)
}

impl Steps {
    /// Of a cloud of about so many points.
    ///
    /// # Errors
    /// As [`Ticket::reserve`].
    pub(crate) fn new(
        app: &Arc<App>,
        ticket: Ticket,
        points: u64,
        options: &Options,
    ) -> Result<Self, Problem> {
        let (caller, deadline, left) = ticket.into_parts(cost(options, &unread(points)))?;
        deadline.enter("of planning and work");
        let (app, options, stages) = (Arc::clone(app), options.clone(), Vec::new());
        Ok(Self { app, caller, options, left, tiling: None, next: 0, stages })
    }

    /// The first step.
    pub(crate) fn plan(&mut self, request: TiledRequest) -> Pending<Settled<Tiling>> {
        let permit = self.left.part(Cost::new(0, 0));
        submit_plan(&self.app, &self.caller, permit, request)
    }

    /// Takes the plan, which tells how large the work is, and its share of the disk.
    ///
    /// # Errors
    /// It is above a limit, or there is no room for so much.
    pub(crate) fn planned(&mut self, tiling: Tiling) -> Result<(Arc<Tiling>, Held), Problem> {
        let (points_in, points_out) = (tiling.report().points_in, tiling.report().points_out);
        self.app.check_points(points_in, points_out)?;
        let exact = Cost::new(points_in, points_out).in_parts(tile_points(&self.options));
        let exact = exact.times(self.options.effort());
        self.app.engine.resize(&self.caller, &mut self.left, exact).map_err(Problem::Refused)?;
        let on_disk = self.app.disk.hold(tiling.disk_bytes()).ok_or_else(|| self.app.disk_full())?;
        let tiling = Arc::new(tiling);
        self.tiling = Some(Arc::clone(&tiling));
        Ok((tiling, on_disk))
    }

    /// The next tile, if there is one.
    pub(crate) fn next(&mut self) -> Option<Pending<Settled<u64>>> {
        let tiling = Arc::clone(self.tiling.as_ref().filter(|tiling| self.next < tiling.len())?);
        let tile = self.next;
        self.next += 1;
        let permit = self.left.part(cost_of(&tiling, tile, &self.options));
        Some(submit_tile(&self.app, &self.caller, permit, (tiling, tile), &self.options))
    }

    /// Takes note of a tile that is done, and gives its points.
    ///
    /// # Errors
    /// What went wrong with it.
    pub(crate) fn took(&mut self, outcome: Outcome<Settled<u64>>) -> Result<u64, Problem> {
        let Outcome { made, stages, estimate, took } = outcome;
        let points = made?;
        self.app.metrics.worked(estimate, took);
        for (stage, took) in stages.iter() {
            match self.stages.iter_mut().find(|(name, _)| *name == stage.name()) {
                Some((_, sum)) => *sum += took,
                None => self.stages.push((stage.name(), took)),
            }
        }
        Ok(points)
    }

    /// The work is over, `done` or not.
    pub(crate) fn over(&self, done: bool) {
        let Some(tiling) = self.tiling.as_ref().filter(|_| done) else { return };
        for (stage, took) in &self.stages {
            self.app.metrics.stage(stage, *took);
        }
        self.app.metrics.points(tiling.report().points_in, tiling.report().points_out);
    }

    /// What each stage took so far.
    pub(crate) fn stages(&self) -> Vec<(&'static str, Duration)> {
        self.stages.clone()
    }
}

/// How the progress of the next tile is that of the whole, of which so many tiles are done, and gave so many points.
pub(crate) fn overall(tiling: &Tiling, done: u32, points: u64) -> impl Fn(Progress) -> Progress + use<> {
    let size = if done < tiling.len() { tiling.points(done)[2] } else { 0 };
    let all = tiling.report().points_out.max(1) as f64;
    move |now| {
        let made = points as f64 + now.fraction.min(1.0) * size as f64;
        Progress { fraction: (made / all).min(1.0), ..now }
    }
}
