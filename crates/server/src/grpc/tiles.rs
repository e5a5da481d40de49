//! The messages of a result in tiles: chunks leave as the parts become final.

use std::sync::Arc;

use axum::body::Body;
use futures::stream::{self, BoxStream, StreamExt, TryStreamExt};
use http_body_util::BodyExt;
use hyper::body::Frame;
use tokio::task::spawn_blocking;

use super::outgoing::{self, Messages, Points, header, message, pieces, scalar};
use super::start::Columns;
use crate::admission::budget::Held;
use crate::app::App;
use crate::connection::record;
use crate::http::download::Dense;
use crate::http::upsample::About;
use crate::problem::Problem;
use crate::proto::upsample_response::Message;
use crate::proto::{Ending, UpsampleResponse};
use crate::tiled::body::{Framing, block_bytes, sent};
use crate::tiled::{Plan, Tiled};
use densecloud::Report;
use densecloud_cloud::{Attribute, Origin};

/// Waits for the first part, and gives the messages from there on.
///
/// # Errors
/// What ended the work before that.
pub(super) async fn messages(
    app: &Arc<App>,
    tiled: Tiled,
    as_points: bool,
) -> Result<(record::Points, Messages), Problem> {
    let (report, first, rest) = if as_points { points(app, tiled).await? } else { file(app, tiled).await? };
    let points = record::Points { read: report.points_in, made: report.points_out };
    Ok((points, stream::once(async { Ok(first) }).chain(rest).boxed()))
}

type Begun = (Report, UpsampleResponse, BoxStream<'static, Result<UpsampleResponse, Problem>>);

/// As a file: the body of an answer in HTTP.
async fn file(app: &Arc<App>, tiled: Tiled) -> Result<Begun, Problem> {
    let sent = sent(app, tiled, Framing::Trailers).await?;
    let first = header(About::of(&sent.report), None);
    Ok((sent.report, first, chunks(sent.body)))
}

fn chunks(body: Body) -> Messages {
    let frames = stream::try_unfold(body, |mut body| async {
        let frame = body.frame().await.transpose().map_err(problem)?;
        Ok::<_, Problem>(frame.map(|frame| (frame, body)))
    });
    let messages = |frame: Frame<axum::body::Bytes>| match frame.into_data() {
        Ok(block) => stream::iter(pieces(block).map(Ok)).boxed(),
        Err(trailers) => {
            let fields = trailers.into_trailers().unwrap_or_default();
            let warnings = fields.get_all("densecloud-warning").iter();
            let warnings =
                warnings.map(|warning| String::from_utf8_lossy(warning.as_bytes()).into_owned()).collect();
            stream::once(async { Ok(ending(warnings)) }).boxed()
        }
    };
    frames.map_ok(messages).try_flatten().boxed()
}

/// Why a body broke off: mostly a problem of ours in two wrappings.
fn problem(error: axum::Error) -> Problem {
    let told = Problem::Internal(error.to_string());
    let inner = error.into_inner().downcast::<std::io::Error>().ok().and_then(|error| error.into_inner());
    inner.and_then(|error| error.downcast::<Problem>().ok()).map_or(told, |problem| *problem)
}

fn ending(warnings: Vec<String>) -> UpsampleResponse {
    message(Message::Ending(Ending { warnings }))
}

/// As columns of numbers.
async fn points(app: &Arc<App>, mut tiled: Tiled) -> Result<Begun, Problem> {
    let plan = tiled.begun().await?;
    let held = app.budget.hold(block_bytes(&plan)).ok_or_else(|| app.held_full())?;
    let (report, attributes) = blocking(&plan, |plan| {
        let tiling = plan.tiling();
        let report = match tiling.flows() {
            true => tiling.flow(std::io::sink())?.report(),
            false => tiling.join()?.report().clone(),
        };
        Ok((report, tiling.attributes()?))
    })
    .await?;
    let columns = Columns::of(report.points_out, scalar(report.format), &attributes);
    let first = header(About::of(&report), Some(&columns));
    let told = report.warnings.clone();
    let parts = Parts { tiled, plan, attributes, columns, tile: 0, told, _held: held };
    let messages = stream::try_unfold(Some(parts), |parts| async {
        let Some(parts) = parts else { return Ok(None) };
        parts.next().await.map(Some)
    });
    Ok((report, first, messages.try_flatten().boxed()))
}

async fn blocking<T: Send + 'static>(
    plan: &Plan,
    work: impl FnOnce(&Plan) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let plan = plan.clone();
    spawn_blocking(move || work(&plan)).await.map_err(|error| Problem::Internal(error.to_string()))?
}

/// The parts of a result that are still to be sent.
struct Parts {
    tiled: Tiled,
    plan: Plan,
    attributes: Vec<Attribute>,
    columns: Columns,
    tile: u32,
    /// Warnings that the header has.
    told: Vec<String>,
    _held: Held,
}

impl Parts {
    /// The messages of the next part, or, after the last, the ending.
    async fn next(mut self) -> Result<(Messages, Option<Self>), Problem> {
        if self.tile == self.plan.tiling().len() {
            self.tiled.whole().await?;
            let report = blocking(&self.plan, |plan| Ok(plan.tiling().join()?.report().clone())).await?;
            let late = report.warnings.into_iter().filter(|warning| !self.told.contains(warning)).collect();
            return Ok((stream::once(async { Ok(ending(late)) }).boxed(), None));
        }
        self.tiled.tiles(self.tile + 1).await?;
        let tile = self.tile;
        self.tile += 1;
        Ok((self.part(tile).await?, Some(self)))
    }

    /// The chunks of one part, of which one block is in memory at a time.
    async fn part(&self, tile: u32) -> Result<Messages, Problem> {
        let (attributes, columns) = (self.attributes.clone(), self.columns.clone());
        let part = blocking(&self.plan, move |plan| Ok(plan.tiling().part(tile)?)).await?;
        let blocks = stream::try_unfold((part, attributes), |(mut part, attributes)| async move {
            let read = spawn_blocking(move || part.next(&attributes).map(|block| (block, part, attributes)));
            let (block, part, attributes) = read.await.map_err(|e| Problem::Internal(e.to_string()))??;
            Ok::<_, Problem>(block.map(|block| (block, (part, attributes))))
        });
        let chunks = move |(attributes, positions)| {
            let dense = Dense { positions, attributes, origin: Origin::default() };
            let points = Points { dense, columns: columns.clone(), next: 0 };
            stream::try_unfold(points, |mut points| async move {
                let step = spawn_blocking(move || points.chunk().map(|chunk| (chunk, points)));
                let (chunk, points) = step.await.map_err(|e| Problem::Internal(e.to_string()))??;
                Ok(chunk.map(|chunk| (outgoing::message(Message::Points(chunk)), points)))
            })
        };
        Ok(blocks.map_ok(chunks).try_flatten().boxed())
    }
}
