//! `POST /upsample`: a cloud in, a dense cloud out, in the format of the input or one that `Accept` names.

use std::fmt::Write;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Extension;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use tokio::task::spawn_blocking;

use crate::admission::budget::Held;
use crate::admission::ticket::Ticket;
use crate::app::App;
use crate::connection::compress::AsIs;
use crate::connection::record::Points;
use crate::http::accepted::accepted;
use crate::http::download::{self, Dense, file_bytes, result_bytes};
use crate::http::form::Asking;
use crate::http::query::{self, Parameters};
use crate::http::upload::{Received, Upload};
use crate::problem::Problem;
use densecloud::Request;
use densecloud::provenance;
use densecloud::survey::{self, Survey};
use densecloud_cascade::CascadeOptions;
use densecloud_cloud::{Cloud, Origin, Table};
use densecloud_engine::{Client, EngineError, Outcome, Pending};
use densecloud_formats::Format;

/// The handler. A client that leaves drops this future at one of its waits, with it the job, and so
/// stops the work.
pub(crate) async fn upsample(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let mut upload = Upload::new(&headers, body);
    let answer = match Ticket::new(&app, client, &headers) {
        Ok(ticket) => {
            let deadline = ticket.deadline.clone();
            deadline.run(answer(&app, ticket, &uri, &headers, &mut upload)).await
        }
        Err(problem) => Err(problem),
    };
    upload.give_up();
    answer
}

async fn answer(
    app: &Arc<App>,
    mut ticket: Ticket,
    uri: &Uri,
    headers: &HeaderMap,
    upload: &mut Upload,
) -> Result<Response, Problem> {
    let wanted = accepted(headers)?;
    ticket.check()?;
    ticket.deadline.enter("of upload");
    let known = |points_in, points_out| ticket.reserve(points_in, points_out);
    let Asking { parameters, received, .. } = Asking::receive(upload, uri, headers, app, known).await?;
    let arrived = (received.bytes().len(), received.took);
    let read = move |app: &App| Ok((Order::read(app, &received, parameters, wanted)?, ()));
    let (done, ()) = run(app, ticket, arrived, read, |_| {}).await?;
    let points = done.points();
    let length = done.format.encoded_len(points.made, &done.dense.attributes, &done.dense.origin);
    let mut headers = done.headers();
    if let Some(length) = length {
        headers.insert(header::CONTENT_LENGTH, length.into());
    }
    let packed = done.about.packed;
    let body = download::body(done.dense, done.format, done.held);
    let mut response = (headers, Extension(points), body).into_response();
    if packed {
        response.extensions_mut().insert(AsIs);
    }
    Ok(response)
}

/// A cloud, and what is wanted of it.
pub(crate) struct Order {
    pub(crate) cloud: Cloud,
    pub(crate) parameters: Parameters,
    /// What it came in.
    pub(crate) input: Format,
    /// What the result shall be in; `None` is as it came.
    pub(crate) wanted: Option<Format>,
}

impl Order {
    /// Blocking work: parses the body.
    pub(crate) fn read(
        app: &App,
        received: &Received,
        parameters: Parameters,
        wanted: Option<Format>,
    ) -> Result<Self, Problem> {
        let (cloud, input) = received.parse(app)?;
        Ok(Self { cloud, parameters, input, wanted })
    }
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
        headers.insert("server-timing", visible(&self.timing.0));
        headers
    }

    pub(crate) fn points(&self) -> Points {
        Points { read: self.about.points_in, made: self.about.points_out }
    }
}

/// Upsamples what `read` makes of a body of so many `bytes` that took `upload` to arrive, for the holder of a ticket; `read` runs on a
/// blocking thread, and what else it gives comes back with the result. `begun` is shown the job when the engine has taken it.
pub(crate) async fn run<T: Send + 'static>(
    app: &Arc<App>,
    ticket: Ticket,
    (bytes, upload): (usize, Duration),
    read: impl FnOnce(&App) -> Result<(Order, T), Problem> + Send + 'static,
    begun: impl FnOnce(&Pending),
) -> Result<(Done, T), Problem> {
    let mut timing = Timing::default();
    timing.add(app, "upload", upload);
    let start = Instant::now();
    let deadline = ticket.deadline.clone();
    deadline.enter("of parsing");
    let turn = app.parsing.turn(ticket.client(), bytes as u64).await;
    let submit = {
        let app = Arc::clone(app);
        spawn_blocking(move || {
            let (order, rest) = read(&app)?;
            drop(turn);
            Ok::<_, Problem>((submit(&app, ticket, order)?, rest))
        })
    };
    let (submitted, rest) = submit.await.map_err(|error| Problem::Internal(error.to_string()))??;
    timing.add(app, "parse", start.elapsed());
    let start = Instant::now();
    let Submitted { job, held, format, origin, mut about } = submitted;
    begun(&job);
    let outcome = job.await.map_err(|error| match error {
        // It knows of the upload, too.
        EngineError::Deadline { .. } => deadline.over(),
        error => Problem::from_engine(error),
    })?;
    app.metrics.worked(outcome.estimate, outcome.took);
    about.complete(&outcome, format, &origin);
    timing.add(app, "queue", start.elapsed().saturating_sub(outcome.stages.total()));
    for (stage, took) in outcome.stages.iter() {
        timing.add(app, stage.name(), took);
    }
    app.metrics.points(about.points_in, about.points_out);
    let dense = Dense { positions: outcome.positions, attributes: outcome.attributes, origin };
    Ok((Done { dense, held, format, about, timing }, rest))
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
}

impl About {
    /// Adds what is known once the result is there.
    pub(crate) fn complete(&mut self, outcome: &Outcome, format: Format, origin: &Origin) {
        self.points_out = outcome.positions.len() as u64;
        self.warnings.extend(outcome.warnings());
        let lost = format.cannot_hold(&outcome.attributes, origin);
        if !lost.is_empty() {
            self.warnings.push(format!("the result's format has no place for {}", lost.join(", ")));
        }
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
    format: Format,
    origin: Origin,
    about: About,
}

/// A cloud that the engine can take.
pub(crate) struct Prepared {
    pub(crate) request: Request,
    /// Memory that the result will take.
    pub(crate) room: u64,
    /// Bytes that it will take as a file, about.
    pub(crate) file: u64,
    pub(crate) format: Format,
    pub(crate) origin: Origin,
    pub(crate) about: About,
}

/// Blocking work: checks and queues the cloud.
fn submit(app: &App, ticket: Ticket, order: Order) -> Result<Submitted, Problem> {
    let Prepared { request, room, format, origin, about, .. } = prepare(app, order)?;
    let held = app.budget.hold(room).ok_or_else(|| app.held_full())?;
    let job = ticket.submit(request)?;
    Ok(Submitted { job, held, format, origin, about })
}

/// Blocking work: checks everything that can be checked before the cascade.
///
/// # Errors
/// All that is wrong with the request, and nothing about the server's state.
pub(crate) fn prepare(app: &App, order: Order) -> Result<Prepared, Problem> {
    let Order { cloud, parameters, input, wanted } = order;
    let points_in = cloud.positions.len() as u64;
    app.check_points(points_in, parameters.points_out(points_in))?;
    let target = parameters.goal.target(&cloud.positions).map_err(Problem::from_goal)?;
    let points = query::points_out(target, points_in);
    app.check_points(points_in, points)?;
    let mut warnings = cloud.warnings();
    let mut format = Format::of_result(wanted, input, !cloud.attributes.is_empty());
    if let Ok(survey) = Survey::of(&cloud.positions, survey::GLANCE) {
        warnings.extend(survey.warnings());
        format = format.fine_enough(survey.bounds, survey.result_spacing(points));
    }
    let finish = parameters.finish;
    let (mut origin, lost) = finish.origin(&cloud);
    warnings.extend(lost);
    let tables: u64 = origin.tables.iter().map(Table::bytes).sum();
    let a_point = finish.bytes_a_point(&cloud.attributes);
    let room = result_bytes(points, a_point, format).saturating_add(tables);
    let file = file_bytes(points, a_point, format).saturating_add(tables);
    let limit = app.config.limits.held_bytes;
    if room > limit {
        return Err(Problem::ResultTooLarge { points, bytes: room, limit });
    }
    let mut settings = CascadeOptions::default();
    if let Some(seed) = parameters.seed {
        settings.seed = seed;
    }
    let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    if let Some(unknown) = finish.rules.unknown(&names).next() {
        let there = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
        let why = format!("the cloud has no attribute {unknown:?}; it has {there}");
        return Err(Problem::parameter("attributes", why));
    }
    let request = Request { cloud, target, settings, finish };
    let provenance = provenance::line(&app.config.model.name, &request);
    origin.comments.push(provenance.clone());
    let media_type = format.media_type().to_owned();
    let packed = format.is_packed();
    let about = About { media_type, points_in, points_out: points, provenance, warnings, packed };
    Ok(Prepared { request, room, file, format, origin, about })
}

/// The longest value of a header of ours; names of properties are the client's to choose.
const LONGEST: usize = 1000;

/// Text as a header's value: visible ASCII, `?` for the rest, cut where it is too long.
fn visible(text: &str) -> HeaderValue {
    let plain: String =
        text.chars().take(LONGEST).map(|c| if c.is_ascii_graphic() || c == ' ' { c } else { '?' }).collect();
    HeaderValue::from_str(&plain).unwrap_or(HeaderValue::from_static("?"))
}

/// How long each part took, for `/metrics` and for the `Server-Timing` header, which browsers show.
#[derive(Default)]
struct Timing(String);

impl Timing {
    fn add(&mut self, app: &App, stage: &'static str, took: Duration) {
        app.metrics.stage(stage, took);
        let comma = if self.0.is_empty() { "" } else { ", " };
        // Writing into a string cannot fail.
        let _ = write!(self.0, "{comma}{stage};dur={:.1}", took.as_secs_f64() * 1000.0);
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
