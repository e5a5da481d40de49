//! From a cloud that has arrived to a job that can be kept.

use std::io;
use std::sync::Arc;

use crate::app::App;
use crate::http::asked::{cost, tile_points, unread};
use crate::http::download::file_bytes;
use crate::http::upload::Received;
use crate::http::upsample::{UpsampleRequest, prepare};
use crate::jobs::work;
use crate::problem::Problem;
use densecloud::Options;
use densecloud_engine::Cost;
use densecloud_formats::Format;
use densecloud_jobs::{CloudFile, NewJob};
use densecloud_tiles::{Found, Input};

/// Blocking work: reads the cloud, only to know that it can be read, and makes a job of its file.
pub(crate) fn new_job(
    app: &App,
    received: Received,
    options: Options,
    stem: Option<String>,
) -> Result<NewJob, Problem> {
    // Before the cloud is read.
    work::text(&options, stem.clone())?;
    let (Sizes { points_in, points_out, result_bytes }, options) = sizes(app, &received, options)?;
    Ok(NewJob {
        request: work::text(&options, stem)?,
        key: None,
        owner: String::new(),
        client: String::new(),
        request_id: String::new(),
        points_in,
        points_out,
        result_bytes,
        input: Arc::new(received),
    })
}

/// How large a job is.
struct Sizes {
    points_in: u64,
    points_out: u64,
    /// Of the result's file, about.
    result_bytes: u64,
}

/// Those of a cloud, and the options with the points of a tile, where it is larger than one.
fn sizes(app: &App, received: &Received, options: Options) -> Result<(Sizes, Options), Problem> {
    let reader = received.open(app, &options.reading)?;
    let (most, input) = (tile_points(&options, reader.header()), reader.header().format.written());
    let read = match reader.header().points {
        Some(points) if points > most => Input::read(reader, 0)?,
        _ => Input::read(reader, most)?,
    };
    match read {
        Input::Small(cloud, _) => {
            let request = UpsampleRequest { cloud: *cloud, input, options: options.clone() };
            Ok((whole(app, request)?, options))
        }
        Input::Large(large) => {
            let found = large.check(&options, most)?;
            let options = Options { tile_points: Some(most), ..options };
            Ok((tiled(app, &options, input, found)?, options))
        }
    }
}

fn tiled(app: &App, options: &Options, input: Format, found: Found) -> Result<Sizes, Problem> {
    let Found { points, finite, attribute_bytes } = found;
    let points_out = options.points_out(finite);
    app.check_points(points, points_out)?;
    app.engine.check_memory(cost(options, &unread(finite))).map_err(Problem::Refused)?;
    let format = Format::of_result(options.format, input, true);
    Ok(Sizes { points_in: points, points_out, result_bytes: file_bytes(points_out, attribute_bytes, format) })
}

fn whole(app: &App, request: UpsampleRequest) -> Result<Sizes, Problem> {
    let (prepared, room) = prepare(app, request)?;
    let finite = prepared.request.cloud.positions.iter().filter(|p| p.iter().all(|c| c.is_finite())).count();
    let points_out = prepared.request.target.points_out(finite as u64)?;
    app.engine.check_memory(Cost::new(finite as u64, points_out)).map_err(Problem::Refused)?;
    Ok(Sizes { points_in: prepared.report.points_in, points_out, result_bytes: room.file })
}

impl CloudFile for Received {
    fn length(&self) -> u64 {
        Self::length(self)
    }

    fn copy_to(&self, sink: &mut dyn io::Write) -> io::Result<()> {
        self.content().copy_to(sink)
    }
}
