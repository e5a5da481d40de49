//! `POST /upsample`: a cloud in, a dense cloud out, in the format of the input or one that `Accept` names.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Extension;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Uri, Version, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use tokio::task::spawn_blocking;

use crate::admission::budget::Held;
use crate::admission::guess;
use crate::admission::ticket::Ticket;
use crate::app::App;
use crate::connection::compress::AsIs;
use crate::connection::record::Points;
use crate::http::accepted::accepted;
use crate::http::asked::{Asked, Begun, begin, cost, unread};
use crate::http::download::{self, Dense, file_bytes, result_bytes};
use crate::http::filename;
use crate::http::form::Asking;
use crate::http::upload::Upload;
use crate::problem::Problem;
use crate::tiled::body::{Framing, Sent, TRAILERS};
use crate::tiled::{self, Tiled};
use densecloud::survey::Goal;
use densecloud::{Options, Prepared, Report};
use densecloud_cloud::Cloud;
use densecloud_engine::{Client, EngineError, Pending};
use densecloud_formats::Format;

/// The handler. A client that leaves drops this future at one of its waits, with it the job, and so
/// stops the work.
pub(crate) async fn upsample(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    version: Version,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let mut upload = Upload::new(&headers, body);
    let framing = Framing::of(version, &headers);
    let answer = match Ticket::new(&app, client, &headers) {
        Ok(ticket) => {
            let deadline = ticket.deadline.clone();
            deadline.run(answer(&app, ticket, (&uri, &headers, framing), &mut upload)).await
        }
        Err(problem) => Err(problem),
    };
    upload.give_up();
    answer
}

async fn answer(
    app: &Arc<App>,
    mut ticket: Ticket,
    (uri, headers, framing): (&Uri, &HeaderMap, Framing),
    upload: &mut Upload,
) -> Result<Response, Problem> {
    let wanted = accepted(headers)?;
    ticket.check()?;
    ticket.deadline.enter("of upload");
    let known = |cost| ticket.reserve(cost);
    let Asking { mut options, received, name } = Asking::receive(upload, uri, headers, app, known).await?;
    options.format = wanted;
    ticket.guess(cost(&options, &unread(guess::of_file(received.head(), received.length()))))?;
    let arrived = (received.length(), received.took);
    let read = move |app: &App| Asked::read(app, received, options);
    match begin(app, ticket, arrived, read, |_| {}).await? {
        Begun::Whole(done) => Ok(whole(*done, name)),
        Begun::Tiled(tiled) => in_tiles(app, tiled, framing, name).await,
    }
}

/// The answer of a result that is there.
fn whole(mut done: Done, name: Option<String>) -> Response {
    done.about.name = name;
    let points = done.points();
    let length = done.format.encoded_len(points.made, &done.dense.attributes, &done.dense.origin);
    let headers = done.headers();
    let about = done.about.clone();
    response(&about, headers, points, length, download::body(done.dense, done.format, done.held))
}

/// The answer of a cloud in tiles, which begins with the first part that is final.
async fn in_tiles(
    app: &Arc<App>,
    tiled: Tiled,
    framing: Framing,
    name: Option<String>,
) -> Result<Response, Problem> {
    let Sent { report, body, length, has_trailers } = tiled::body::sent(app, tiled, framing).await?;
    let about = About { name, ..About::of(&report) };
    let mut headers = HeaderMap::new();
    about.tell(&mut headers);
    if has_trailers {
        headers.insert(header::TRAILER, HeaderValue::from_static(TRAILERS));
    }
    let points = Points { read: report.points_in, made: report.points_out };
    Ok(response(&about, headers, points, length, body))
}

fn response(
    about: &About,
    mut headers: HeaderMap,
    points: Points,
    length: Option<u64>,
    body: Body,
) -> Response {
    headers.insert(header::CONTENT_DISPOSITION, about.disposition());
    if let Some(length) = length {
        headers.insert(header::CONTENT_LENGTH, length.into());
    }
    let mut response = (headers, Extension(points), body).into_response();
    if about.packed {
        response.extensions_mut().insert(AsIs);
    }
    response
}

/// A cloud, and what is wanted of it.
pub(crate) struct UpsampleRequest {
    pub(crate) cloud: Cloud,
    /// What it came in.
    pub(crate) input: Format,
    pub(crate) options: Options,
}

/// A finished result, and what its receiver is told beside it.
pub(crate) struct Done {
    pub(crate) dense: Dense,
    pub(crate) held: Held,
    pub(crate) format: Format,
    pub(crate) about: About,
    timing: Timing,
}

impl Done {
    /// The headers that every result has.
    pub(crate) fn headers(&self) -> HeaderMap {
        let mut headers = HeaderMap::new();
        self.about.tell(&mut headers);
        headers.insert("server-timing", visible(&timing(&self.timing.stages)));
        headers
    }

    /// How long a part of the work took.
    pub(crate) fn took(&self, stage: &str) -> Duration {
        self.timing.stages.iter().filter(|(name, _)| *name == stage).map(|(_, took)| *took).sum()
    }

    pub(crate) fn points(&self) -> Points {
        Points { read: self.about.points_in, made: self.about.points_out }
    }
}

/// Runs one request: parses the body with `read` on a blocking thread, queues it under `ticket`, and awaits the result.
/// What else `read` gives comes back with the result. `arrived` are the body's size and how long it took to
/// arrive.
pub(crate) async fn run<T: Send + 'static>(
    app: &Arc<App>,
    ticket: Ticket,
    arrived: (u64, Duration),
    read: impl FnOnce(&App) -> Result<(UpsampleRequest, T), Problem> + Send + 'static,
) -> Result<(Done, T), Problem> {
    let (ticket, (request, rest), timing) = parse(app, ticket, arrived, read).await?;
    Ok((work(app, ticket, request, timing, |_| {}).await?, rest))
}

/// Waits for a turn, and reads the body.
pub(crate) async fn parse<T: Send + 'static>(
    app: &Arc<App>,
    ticket: Ticket,
    (bytes, upload): (u64, Duration),
    read: impl FnOnce(&App) -> Result<T, Problem> + Send + 'static,
) -> Result<(Ticket, T, Timing), Problem> {
    let mut timing = Timing::default();
    timing.add(app, "upload", upload);
    let start = Instant::now();
    ticket.arrived();
    ticket.deadline.enter("of parsing");
    let turn = app.parsing.turn(ticket.client(), bytes).await;
    let shared = Arc::clone(app);
    let parsed = spawn_blocking(move || {
        let _turn = turn;
        read(&shared)
    });
    let parsed = parsed.await.map_err(|error| Problem::Internal(error.to_string()))??;
    timing.add(app, "parse", start.elapsed());
    Ok((ticket, parsed, timing))
}

/// Queues a request, and awaits its result; `begun` is shown the job when the engine has taken it.
pub(crate) async fn work(
    app: &Arc<App>,
    ticket: Ticket,
    request: UpsampleRequest,
    mut timing: Timing,
    begun: impl FnOnce(&Pending),
) -> Result<Done, Problem> {
    let (start, deadline, shared) = (Instant::now(), ticket.deadline.clone(), Arc::clone(app));
    let submitted = spawn_blocking(move || submit(&shared, ticket, request));
    let submitted = submitted.await.map_err(|error| Problem::Internal(error.to_string()))??;
    let Submitted { job, held, mut report } = submitted;
    begun(&job);
    let outcome = job.await.map_err(|error| match error {
        // It knows of the upload, too.
        EngineError::Deadline { .. } => deadline.over(),
        error => Problem::from_engine(error),
    })?;
    app.metrics.worked(outcome.estimate, outcome.took);
    report.complete(&outcome.made);
    timing.add(app, "queue", start.elapsed().saturating_sub(outcome.stages.total()));
    for (stage, took) in outcome.stages.iter() {
        timing.add(app, stage.name(), took);
    }
    app.metrics.points(report.points_in, report.points_out);
    let about = About::of(&report);
    let Report { format, origin, .. } = report;
    let dense = Dense { positions: outcome.made.positions, attributes: outcome.made.attributes, origin };
    Ok(Done { dense, held, format, about, timing })
}

/// What the headers of an answer tell of a result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct About {
    pub(crate) media_type: String,
    pub(crate) points_in: u64,
    pub(crate) points_out: u64,
    pub(crate) provenance: String,
    /// What its sender should know about how the cloud was read and made dense.
    pub(crate) warnings: Vec<String>,
    /// Whether its format is compressed in itself; false of jobs from before this was kept.
    #[serde(default)]
    pub(crate) packed: bool,
    /// What its file's name has of the upload's.
    #[serde(default)]
    pub(crate) name: Option<String>,
}

impl About {
    /// Of a result that is complete.
    pub(crate) fn of(report: &Report) -> Self {
        Self {
            media_type: report.format.media_type().to_owned(),
            points_in: report.points_in,
            points_out: report.points_out,
            provenance: report.provenance.clone(),
            warnings: report.warnings.clone(),
            packed: report.format.is_packed(),
            name: None,
        }
    }

    /// The header that says how to save it.
    pub(crate) fn disposition(&self) -> HeaderValue {
        filename::disposition(self.name.as_deref(), &self.media_type)
    }

    pub(crate) fn tell(&self, headers: &mut HeaderMap) {
        headers.insert(header::CONTENT_TYPE, visible(&self.media_type));
        headers.insert("densecloud-points-in", self.points_in.into());
        headers.insert("densecloud-points-out", self.points_out.into());
        headers.insert("densecloud-provenance", visible(&self.provenance));
        for warning in &self.warnings {
            headers.append("densecloud-warning", visible(warning));
        }
    }
}

/// A cloud that the engine has taken.
struct Submitted {
    job: Pending,
    /// Room for the result, taken beforehand: a finished result never lacks memory.
    held: Held,
    report: Report,
}

/// Blocking work: checks and queues the cloud.
fn submit(app: &App, ticket: Ticket, request: UpsampleRequest) -> Result<Submitted, Problem> {
    let (Prepared { request, report }, room) = prepare(app, request)?;
    let held = app.budget.hold(room.memory).ok_or_else(|| app.held_full())?;
    let job = ticket.submit(request)?;
    Ok(Submitted { job, held, report })
}

/// What a result takes.
pub(crate) struct Room {
    /// Bytes of memory until it is sent.
    pub(crate) memory: u64,
    /// Bytes as a file, about.
    pub(crate) file: u64,
}

/// Blocking work: checks everything that can be checked before the cascade.
///
/// # Errors
/// All that is wrong with the request, and nothing about the server's state.
pub(crate) fn prepare(app: &App, request: UpsampleRequest) -> Result<(Prepared, Room), Problem> {
    let UpsampleRequest { cloud, input, options } = request;
    let points_in = cloud.positions.len() as u64;
    app.check_points(points_in, options.points_out(points_in))?;
    let prepared =
        Prepared::new(cloud, input, options, &app.config.model.name).map_err(Problem::from_prepare)?;
    let points =
        Options { goal: Goal::Target(prepared.request.target), ..Options::default() }.points_out(points_in);
    app.check_points(points_in, points)?;
    let (format, tables) = (prepared.report.format, prepared.table_bytes());
    let a_point = prepared.attribute_bytes();
    let memory = result_bytes(points, a_point, format).saturating_add(tables);
    let file = file_bytes(points, a_point, format).saturating_add(tables);
    let limit = app.config.limits.held_bytes;
    if memory > limit {
        return Err(Problem::ResultTooLarge { points, bytes: memory, limit });
    }
    Ok((prepared, Room { memory, file }))
}

/// The longest value of a header of ours; names of properties are the client's to choose.
const LONGEST: usize = 1000;

/// Text as a header's value: visible ASCII, `?` for the rest, cut where it is too long.
pub(crate) fn visible(text: &str) -> HeaderValue {
    let plain: String =
        text.chars().take(LONGEST).map(|c| if c.is_ascii_graphic() || c == ' ' { c } else { '?' }).collect();
    HeaderValue::from_str(&plain).unwrap_or(HeaderValue::from_static("?"))
}

/// The value of `Server-Timing` for stages that took so long.
pub(crate) fn timing(stages: &[(&'static str, Duration)]) -> String {
    let one = |(stage, took): &(&str, Duration)| format!("{stage};dur={:.1}", took.as_secs_f64() * 1000.0);
    stages.iter().map(one).collect::<Vec<_>>().join(", ")
}

/// How long each part took, for `/metrics` and for the `Server-Timing` header, which browsers show.
#[derive(Default)]
pub(crate) struct Timing {
    stages: Vec<(&'static str, Duration)>,
}

impl Timing {
    fn add(&mut self, app: &App, stage: &'static str, took: Duration) {
        app.metrics.stage(stage, took);
        self.stages.push((stage, took));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_from_a_file_cannot_break_a_header() {
        assert_eq!(visible("rot\r\nSet-Cookie: grün"), "rot??Set-Cookie: gr?n");
        assert_eq!(visible(&"x".repeat(5000)).len(), LONGEST);
    }
}
