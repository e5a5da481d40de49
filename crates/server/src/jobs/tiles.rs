//! The steps of a job in tiles: planning, one tile, joining. Each is by itself, with what the others left among the job's
//! blobs, so that any worker can take it.

use std::fs::File;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use super::work::{caller, ended, stopped, unwritten};
use crate::admission::budget::Held;
use crate::app::App;
use crate::http::upload::reader_limits;
use crate::http::upsample::About;
use crate::problem::Problem;
use crate::tiled::{Open, TiledRequest, cost_of, submit_plan, submit_tile};
use densecloud::Options;
use densecloud_cascade::Silent;
use densecloud_engine::{Cost, Outcome, Progress};
use densecloud_formats::CloudReader;
use densecloud_jobs::{Begun, BlobReader, Parts, Place, Record, Settings, Stopped, Task};
use densecloud_tiles::{Folder, Input, Shelf, TilesError, Tiling};

/// Where the folders lie that steps work in: beside their blobs, where these are files, so that those can be moved there.
pub(crate) fn scratch(app: &App) -> PathBuf {
    let folder = app.config.jobs.as_ref().and_then(Settings::folder);
    folder.map_or_else(|| app.config.temp_dir(), |folder| folder.join("tiles"))
}

/// Removes what steps of earlier programs left.
pub(super) fn clean(app: &App) {
    let parent = scratch(app);
    let cleaned = Folder::keep_only(&parent, std::iter::empty()).and_then(|()| Folder::temporary(&parent));
    if let Err(error) = cleaned {
        tracing::warn!(%error, "tiles of jobs that are over are left");
    }
}

fn folder(app: &App, job: &Record) -> Result<Folder, Stopped> {
    Folder::temporary(&scratch(app)).map_err(|error| failed(error, job))
}

/// What a failure is to a job.
fn failed(error: TilesError, job: &Record) -> Stopped {
    match error {
        TilesError::Differs { .. } => Stopped::Differs,
        TilesError::Format(error) => unwritten(error, job),
        TilesError::File { why, .. } => Stopped::Storage(why),
        error => stopped(&error.into(), job),
    }
}

/// A share of the disk, while a step needs it.
fn on_disk(app: &App, bytes: u64, job: &Record) -> Result<Held, Stopped> {
    app.disk.hold(bytes).ok_or_else(|| stopped(&app.disk_full(), job))
}

/// Plans the tiles of a cloud.
pub(super) fn plan(
    app: &Arc<App>,
    job: &Record,
    options: Options,
    place: &Place,
    task: &Task,
) -> Result<Begun, Stopped> {
    // A file at hand, so that a store that does not answer is no fault of the cloud's.
    let folder = folder(app, job)?;
    let file = folder.path().join("cloud");
    place.blobs.fetch(&place.input, &file)?;
    let input = File::open(&file)?;
    let caller = caller(job);
    let permit =
        app.engine.reserve(&caller, Cost::new(0, 0)).map_err(|refusal| ended(refusal.into(), job))?;
    let open: Box<Open> = Box::new(move |limits, reading| CloudReader::open_as(input, limits, reading));
    let scratch = Some(scratch(app));
    let request = TiledRequest { open, held: None, points: job.points_in, options, scratch };
    // Little beside the work itself.
    task.part(|progress| Progress { fraction: 0.0, ..progress });
    let planned = task.wait(submit_plan(app, &caller, permit, request)).map_err(|error| ended(error, job))?;
    let tiling = planned.made.map_err(|problem| stopped(&problem, job))?;
    let report = tiling.report();
    app.check_points(report.points_in, report.points_out).map_err(|problem| stopped(&problem, job))?;
    let sizes: Vec<u64> = (0..tiling.len()).map(|tile| tiling.points(tile)[2]).collect();
    let bytes = tiling.disk_bytes();
    let _on_disk = on_disk(app, bytes, job)?;
    Shelf::new(Arc::clone(&place.blobs), &place.own).put_plan(tiling).map_err(|error| failed(error, job))?;
    Ok(Begun::Split { sizes, bytes })
}

/// The plan that a job is worked by.
fn shelf(place: &Place, job: &Record) -> Result<Shelf, Stopped> {
    let plan = place.plan.as_deref().ok_or_else(|| stopped(&Problem::Internal("no plan".into()), job))?;
    Ok(Shelf::new(Arc::clone(&place.blobs), plan))
}

/// Works on one tile, and gives the points of its part.
pub(super) fn run(
    app: &Arc<App>,
    job: &Record,
    (tile, options): (u32, Options),
    place: &Place,
    task: &Task,
) -> Result<u64, Stopped> {
    let (caller, folder, shelf) = (caller(job), folder(app, job)?, shelf(place, job)?);
    let wrong = |error| failed(error, job);
    shelf.get_plan(&folder).and_then(|()| shelf.get_tile(tile, &folder)).map_err(wrong)?;
    let tiling = Arc::new(Tiling::load(&folder).map_err(wrong)?);
    tiling.check(&app.config.model.name).map_err(wrong)?;
    let _on_disk = on_disk(app, tiling.disk_bytes() / u64::from(tiling.len()), job)?;
    let permit = app.engine.reserve(&caller, cost_of(&tiling, tile, &options));
    let permit = permit.map_err(|refusal| ended(refusal.into(), job))?;
    let share = tiling.points(tile)[2] as f64 / tiling.report().points_out.max(1) as f64;
    task.part(move |now| Progress { fraction: now.fraction.min(1.0) * share, ..now });
    let outcome = task.wait(submit_tile(app, &caller, permit, (tiling, tile), &options));
    let Outcome { made, stages, estimate, took } = outcome.map_err(|error| ended(error, job))?;
    let points = made.map_err(|problem| stopped(&problem, job))?;
    app.metrics.worked(estimate, took);
    for (stage, took) in stages.iter() {
        app.metrics.stage(stage.name(), took);
    }
    shelf.put_part(&place.own, tile, &folder).map_err(wrong)?;
    Ok(points)
}

/// Writes the parts of all tiles into one file.
pub(super) fn join(
    app: &Arc<App>,
    job: &Record,
    (parts, options): (Parts, Options),
    place: &Place,
    sink: &mut dyn Write,
) -> Result<About, Stopped> {
    let (folder, shelf) = (folder(app, job)?, shelf(place, job)?);
    let wrong = |error| failed(error, job);
    let mut tiling = shelf.with_parts(parts.names, &folder).map_err(wrong)?;
    if tiling.lacks_origin() {
        tiling = with_input(app, tiling, parts.input, &options).map_err(wrong)?;
    }
    let report = tiling.join().and_then(|join| join.write(sink)).map_err(wrong)?;
    app.metrics.points(report.points_in, report.points_out);
    Ok(About::of(&report))
}

/// Takes from a job's cloud what only that knows.
fn with_input(
    app: &App,
    tiling: Tiling,
    input: Box<dyn BlobReader>,
    options: &Options,
) -> Result<Tiling, TilesError> {
    let reader = CloudReader::open_as(input, reader_limits(app), &options.reading)?;
    match Input::read(reader, 0)? {
        Input::Large(large) => tiling.with_input(*large, &Silent),
        Input::Small(..) => Ok(tiling),
    }
}
