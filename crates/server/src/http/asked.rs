//! A request whose cloud may be of any size: worked on as a whole, or, beyond one tile, in tiles.

use std::sync::Arc;
use std::time::Duration;

use crate::admission::guess;
use crate::admission::ticket::Ticket;
use crate::app::App;
use crate::http::upload::Received;
use crate::http::upsample::{Done, UpsampleRequest, parse, work};
use crate::problem::Problem;
use crate::tiled::{Tiled, TiledProgress, TiledRequest};
use densecloud::Options;
use densecloud_engine::{Cost, Progress, ProgressHandle};
use densecloud_formats::{Format, Header};
use densecloud_tiles::{Input, TILE_POINTS, TileSize};

/// What a request for a cloud with this header takes, as far as that tells.
pub(crate) fn cost(options: &Options, header: &Header) -> Cost {
    let points_in = header.points.unwrap_or_default();
    Cost::new(points_in, options.points_out(points_in)).in_parts(tile_points(options, header))
}

/// The header of a file of which nothing is known but how many points it has, about.
pub(crate) fn unread(points: u64) -> Header {
    Header {
        format: Format::TEXT,
        points: Some(points),
        attributes: Vec::new(),
        dropped_properties: Vec::new(),
    }
}

/// The most points of a tile of a cloud with this header.
pub(crate) fn tile_points(options: &Options, header: &Header) -> u64 {
    // Fails only where memory is what decides.
    TileSize::of(options).points(options.goal, header).unwrap_or(TILE_POINTS)
}

/// A cloud that has been read, or is too large for that, and what is wanted of it.
pub(crate) enum Asked {
    Whole(Box<UpsampleRequest>),
    Tiled(Box<TiledRequest>),
}

impl Asked {
    /// Blocking work: reads the body, as far as one tile may hold it.
    ///
    /// # Errors
    /// What [`CloudReader`](densecloud_formats::CloudReader) gives, as problems.
    pub(crate) fn read(app: &App, received: Received, options: Options) -> Result<Self, Problem> {
        let reader = received.open(app, &options.reading)?;
        let (most, told) = (tile_points(&options, reader.header()), reader.header().points);
        if told.is_none_or(|points| points <= most)
            && let Input::Small(cloud, header) = Input::read(reader, most)?
        {
            let (cloud, input) = (*cloud, header.format.written());
            return Ok(Self::Whole(Box::new(UpsampleRequest { cloud, input, options })));
        }
        let points = told.unwrap_or_else(|| guess::of_file(received.head(), received.length())).max(most + 1);
        let (open, held) = received.into_opener();
        let options = Options { tile_points: Some(most), ..options };
        Ok(Self::Tiled(Box::new(TiledRequest { open, held: Some(held), points, options, scratch: None })))
    }
}

/// A request whose cloud has been read: its result, or, of a large one, the work at it.
pub(crate) enum Begun {
    Whole(Box<Done>),
    Tiled(Tiled),
}

/// What tells how far a request is.
pub(crate) enum Following {
    Whole(ProgressHandle),
    Tiled(TiledProgress),
}

impl Following {
    pub(crate) fn progress(&self) -> Progress {
        match self {
            Self::Whole(handle) => handle.progress(),
            Self::Tiled(progress) => progress.progress(),
        }
    }
}

/// Runs one request: as [`run`], but for a cloud that is too large for that, at which the work begins.
pub(crate) async fn begin(
    app: &Arc<App>,
    ticket: Ticket,
    arrived: (u64, Duration),
    read: impl FnOnce(&App) -> Result<Asked, Problem> + Send + 'static,
    begun: impl FnOnce(Following),
) -> Result<Begun, Problem> {
    let (ticket, asked, timing) = parse(app, ticket, arrived, read).await?;
    match asked {
        Asked::Whole(request) => {
            let done = work(app, ticket, *request, timing, |job| {
                begun(Following::Whole(job.progress_handle()));
            });
            Ok(Begun::Whole(Box::new(done.await?)))
        }
        Asked::Tiled(request) => {
            let tiled = Tiled::begin(app, ticket, *request)?;
            begun(Following::Tiled(tiled.progress()));
            Ok(Begun::Tiled(tiled))
        }
    }
}
