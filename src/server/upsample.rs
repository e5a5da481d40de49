//! `POST /upsample`: a cloud in, a dense cloud out, in the format of the input or one that `Accept` names.

use std::fmt::Write;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Extension;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, Uri, header};
use axum::response::{IntoResponse, Response};
use tokio::task::spawn_blocking;
use tokio::time::timeout;

use super::accepted::accepted;
use super::app::App;
use super::budget::Held;
use super::download::{self, Dense, result_bytes};
use super::problem::Problem;
use super::query::{self, Parameters};
use super::record::Points;
use super::upload::Upload;
use crate::cascade::Settings;
use crate::cloud::{Cloud, Origin, Table, bytes_a_point};
use crate::engine::{Job, Request};
use crate::formats::Format;
use crate::provenance;
use crate::survey::{self, Survey};

/// The handler. A client that leaves drops this future at one of its waits, with it the job, and so
/// stops the work.
pub(super) async fn upsample(
    State(app): State<Arc<App>>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let mut upload = Upload::new(&headers, body);
    let limit = app.config.timeouts.request;
    let answer = timeout(limit, answer(&app, &uri, &headers, &mut upload)).await;
    let answer = answer.unwrap_or(Err(Problem::Deadline { limit }));
    upload.give_up();
    answer
}

async fn answer(
    app: &Arc<App>,
    uri: &Uri,
    headers: &HeaderMap,
    upload: &mut Upload,
) -> Result<Response, Problem> {
    app.readiness.check()?;
    let parameters = Parameters::parse(uri)?;
    let wanted = accepted(headers)?;
    let received = upload.receive(headers, app, &parameters).await?;
    let took = received.took;
    let read = move |app: &App| {
        let (cloud, input) = received.parse(app)?;
        Ok((Order { cloud, parameters, input, wanted }, ()))
    };
    let (done, ()) = run(app, took, read).await?;
    let length = done.format.encoded_len(done.points.made, &done.dense.attributes, &done.dense.origin);
    let mut headers = done.headers();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(done.format.media_type()));
    if let Some(length) = length {
        headers.insert(header::CONTENT_LENGTH, length.into());
    }
    let body = download::body(done.dense, done.format, done.held);
    Ok((headers, Extension(done.points), body).into_response())
}

/// A cloud, and what is wanted of it.
pub(super) struct Order {
    pub(super) cloud: Cloud,
    pub(super) parameters: Parameters,
    /// What it came in.
    pub(super) input: Format,
    /// What the result shall be in; `None` is as it came.
    pub(super) wanted: Option<Format>,
}

/// A finished result, and what its receiver is told beside it.
pub(super) struct Done {
    pub(super) dense: Dense,
    pub(super) held: Held,
    pub(super) format: Format,
    pub(super) points: Points,
    pub(super) provenance: String,
    pub(super) warnings: Vec<String>,
    timing: Timing,
}

impl Done {
    /// The headers that every result has.
    pub(super) fn headers(&self) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert("densecloud-points-in", self.points.read.into());
        headers.insert("densecloud-points-out", self.points.made.into());
        headers.insert("densecloud-provenance", visible(&self.provenance));
        headers.insert("server-timing", visible(&self.timing.0));
        for warning in &self.warnings {
            headers.append("densecloud-warning", visible(warning));
        }
        headers
    }
}

/// Upsamples what `read` makes of a body that took `upload` to arrive; `read` runs on a blocking thread,
/// and what else it gives comes back with the result.
pub(super) async fn run<T: Send + 'static>(
    app: &Arc<App>,
    upload: Duration,
    read: impl FnOnce(&App) -> Result<(Order, T), Problem> + Send + 'static,
) -> Result<(Done, T), Problem> {
    let mut timing = Timing::default();
    timing.add(app, "upload", upload);
    let start = Instant::now();
    let submit = {
        let app = Arc::clone(app);
        spawn_blocking(move || {
            let (order, rest) = read(&app)?;
            Ok::<_, Problem>((submit(&app, order)?, rest))
        })
    };
    let (submitted, rest) = submit.await.map_err(|error| Problem::Internal(error.to_string()))??;
    timing.add(app, "parse", start.elapsed());
    let start = Instant::now();
    let Submitted { job, held, format, origin, provenance, points_in, mut warnings } = submitted;
    let outcome = job.await.map_err(|error| Problem::from_engine(error, app.engine.retry_after()))?;
    warnings.extend(outcome.warnings());
    timing.add(app, "queue", start.elapsed().saturating_sub(outcome.stages.total()));
    for (stage, took) in outcome.stages.iter() {
        timing.add(app, stage.name(), took);
    }
    let points = Points { read: points_in, made: outcome.positions.len() as u64 };
    app.metrics.points(points.read, points.made);
    let lost = format.cannot_hold(&outcome.attributes, &origin);
    if !lost.is_empty() {
        warnings.push(format!("the result's format has no place for {}", lost.join(", ")));
    }
    let dense = Dense { positions: outcome.positions, attributes: outcome.attributes, origin };
    Ok((Done { dense, held, format, points, provenance, warnings, timing }, rest))
}

/// A cloud that the engine has taken.
struct Submitted {
    job: Job,
    /// Room for the result, taken beforehand: a finished result never lacks memory.
    held: Held,
    format: Format,
    origin: Origin,
    provenance: String,
    points_in: u64,
    /// What its sender should know about how it was read.
    warnings: Vec<String>,
}

/// Blocking work: checks and queues the cloud.
fn submit(app: &App, order: Order) -> Result<Submitted, Problem> {
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
    let tables = origin.tables.iter().map(Table::bytes).sum();
    let a_point = bytes_a_point(&cloud.attributes) + finish.bytes_a_point();
    let room = result_bytes(points, a_point, format).saturating_add(tables);
    let limit = app.config.limits.held_bytes;
    if room > limit {
        return Err(Problem::ResultTooLarge { points, bytes: room, limit });
    }
    let held = app.budget.hold(room).ok_or_else(|| app.held_full())?;
    let mut settings = Settings::default();
    if let Some(seed) = parameters.seed {
        settings.seed = seed;
    }
    let names: Vec<&str> = cloud.attributes.iter().map(|a| a.name.as_str()).collect();
    if let Some(unknown) = finish.rules.unknown(&names).next() {
        let why = format!("the cloud has no attribute {unknown:?}; it has {}", names.join(", "));
        return Err(Problem::parameter("attributes", why));
    }
    let request = Request { cloud, target, settings, finish };
    let provenance = provenance::line(&app.config.model.name, &request);
    origin.comments.push(provenance.clone());
    let job =
        app.engine.submit(request).map_err(|error| Problem::from_engine(error, app.engine.retry_after()))?;
    Ok(Submitted { job, held, format, origin, provenance, points_in, warnings })
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
