//! The Open Inference Protocol, version 2, over HTTP, with Triton's extension for binary tensors: a cloud
//! as a tensor in, the dense cloud as a tensor out.
//!
//! | file | holds |
//! |---|---|
//! | `request`, `bounded` | the JSON of a request, and what of it there may be only little of |
//! | `reply` | the answer |
//! | `describe`, `repository` | the server, and its one model |
//! | `statistics` | how many requests there were, and how long they took |
//!
//! The work is that of [`crate::http::upsample`]; only what stands around the points differs. Errors under
//! `/v2` are the same [`Problem`]s, with the body that this protocol has (see [`crate::connection::record`]).

mod bounded;
mod describe;
mod reply;
mod repository;
mod request;
pub(crate) mod statistics;

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};

use crate::admission::guess;
use crate::admission::ticket::Ticket;
use crate::app::App;
use crate::http::upload::Upload;
use crate::http::upsample::{self, UpsampleRequest};
use crate::problem::Problem;
use crate::route::{Route, get, post};
use bounded::Parameters;
use densecloud::{Options, PARAMETERS, Parameter, Topic};
use densecloud_cloud::Cloud;
use densecloud_engine::{Client, Cost};
use densecloud_formats::{Format, Scalar};
#[cfg(test)]
pub(crate) use request::HINTS;
use request::{Request, read, split, without_literals};
use statistics::{Attempt, Times};

/// The model's name in paths, whatever its card says.
const MODEL: &str = "densecloud";
/// Its one version.
const VERSION: &str = "1";
/// The tensor in, and the one out.
const TENSOR: &str = "points";

/// Bytes of JSON at the beginning of a body, where binary tensors follow.
const HEADER_LENGTH: HeaderName = HeaderName::from_static("inference-header-content-length");
/// The longest such JSON that is judged before the rest has arrived; there is no data in it, so it is short.
const JUDGED: usize = 64 << 10;

/// All paths of the protocol.
pub(super) fn routes() -> Vec<Route> {
    vec![
        get("/v2", describe::server),
        get("/v2/health/live", || async { Json(serde_json::json!({ "live": true })) }),
        get("/v2/health/ready", ready),
        get("/v2/models", describe::models),
        get("/v2/models/stats", statistics::all),
        get("/v2/models/{model}", describe::model),
        get("/v2/models/{model}/stats", statistics::of_model),
        get("/v2/models/{model}/config", describe::config),
        get("/v2/models/{model}/ready", model_ready),
        post("/v2/models/{model}/infer", infer),
        get("/v2/models/{model}/versions/{version}", describe::model),
        get("/v2/models/{model}/versions/{version}/stats", statistics::of_model),
        get("/v2/models/{model}/versions/{version}/config", describe::config),
        get("/v2/models/{model}/versions/{version}/ready", model_ready),
        post("/v2/models/{model}/versions/{version}/infer", infer),
        post("/v2/repository/index", repository::index),
        post("/v2/repository/models/{model}/load", repository::fixed),
        post("/v2/repository/models/{model}/unload", repository::fixed),
    ]
}

/// Whether a path is this protocol's, and so errors there have its form.
pub(super) fn is_path(path: &str) -> bool {
    path.strip_prefix("/v2").is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// Whether a path is asked again and again, to see whether the server is well.
pub(super) fn is_probe(path: &str) -> bool {
    is_path(path) && (path.ends_with("/ready") || path.ends_with("/live"))
}

/// What a path names: a model and perhaps a version.
type Named = Path<Vec<(String, String)>>;

/// Refuses what is not the one model.
fn check_model(Path(named): &Named) -> Result<(), Problem> {
    for (what, name) in named {
        let known = if what == "model" { MODEL } else { VERSION };
        if name != known {
            return Err(Problem::UnknownModel(format!("the {what} {name:?}")));
        }
    }
    Ok(())
}

async fn ready(State(app): State<Arc<App>>) -> Result<impl IntoResponse, Problem> {
    app.readiness.probe()?;
    Ok(Json(serde_json::json!({ "ready": true })))
}

async fn model_ready(State(app): State<Arc<App>>, named: Named) -> Result<impl IntoResponse, Problem> {
    check_model(&named)?;
    app.readiness.probe()?;
    Ok(Json(serde_json::json!({ "name": MODEL, "ready": true })))
}

/// As [`upsample::upsample`], of which it is the other door.
async fn infer(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    named: Named,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let mut upload = Upload::new(&headers, body);
    let answer = async {
        check_model(&named)?;
        if uri.query().is_some_and(|query| !query.is_empty()) {
            let why = "not read here; put them among the request's \"parameters\"".to_owned();
            return Err(Problem::parameter("query", why));
        }
        let attempt = app.statistics.begin();
        let ticket = Ticket::new(&app, client, &headers)?;
        let deadline = ticket.deadline.clone();
        deadline.run(answer(&app, ticket, attempt, &headers, &mut upload)).await
    }
    .await;
    upload.give_up();
    answer
}

async fn answer(
    app: &Arc<App>,
    mut ticket: Ticket,
    attempt: Attempt<'_>,
    headers: &HeaderMap,
    upload: &mut Upload,
) -> Result<Response, Problem> {
    ticket.check()?;
    ticket.deadline.enter("of upload");
    let header = header_length(headers)?;
    let length = upload.length(headers);
    let mut expected = None;
    let judge = |bytes: &[u8], _new| match header {
        Some(header) if header <= bytes.len().min(JUDGED) => {
            let total = match expected {
                Some(total) => total,
                None => judge(&mut ticket, &bytes[..header])?,
            };
            expected = Some(total);
            check_length(total, length.unwrap_or(total.max(bytes.len() as u64)))
        }
        _ => Ok(()),
    };
    let received = upload.receive_judged(headers, app, judge).await?;
    if expected.is_none() {
        // All of it is JSON, and what is wanted is in there, too: no fewer points than come.
        let guess = guess::of_json(received.head());
        ticket.guess(Cost::new(guess, guess))?;
    }
    let arrived = (received.length(), received.took);
    let read = move |app: &App| {
        let (json, binary) = split(received.head(), header)?;
        let (plain, _held);
        let request = match read(json) {
            Err(problem @ Problem::MalformedRequest(_)) => {
                // Room for the other text beside this one.
                _held = app.budget.hold(json.len() as u64).ok_or_else(|| app.held_full())?;
                plain = without_literals(json).ok_or(problem)?;
                read(&plain)?
            }
            request => request?,
        };
        check_points(app, &request)?;
        let mut cloud = Cloud::from(request.positions(binary)?);
        cloud.origin.sha256 = Some(request.hash(&cloud.positions));
        let Request { options, reply, .. } = request;
        let input = Format::Npy { scalar: reply.datatype.scalar(), fields: false };
        // To the rest, a tensor is a NumPy array.
        Ok((UpsampleRequest { cloud, input, options }, reply))
    };
    let (mut done, reply) = upsample::run(app, ticket, arrived, read).await?;
    if done.format != (Format::Npy { scalar: reply.datatype.scalar(), fields: false }) {
        let why = "FP32 is too coarse for these coordinates and this many points; send FP64";
        done.about.warnings.push(why.into());
    }
    let (mut headers, points, times) = (done.headers(), done.points(), Times::of(&done));
    // That of the answer itself.
    headers.remove(header::CONTENT_TYPE);
    let response = reply.response(done)?;
    attempt.succeeded(&times);
    Ok((headers, Extension(points), response).into_response())
}

/// The value of [`HEADER_LENGTH`].
fn header_length(headers: &HeaderMap) -> Result<Option<usize>, Problem> {
    let Some(value) = headers.get(HEADER_LENGTH) else { return Ok(None) };
    let length = value.to_str().ok().and_then(|value| value.trim().parse().ok());
    let wrong = || {
        Problem::MalformedRequest(format!(
            "Inference-Header-Content-Length: {value:?} is not a number of bytes"
        ))
    };
    length.map(Some).ok_or_else(wrong)
}

/// Refuses from the JSON alone what could only be refused later; gives the bytes that the whole body has.
fn judge(ticket: &mut Ticket, json: &[u8]) -> Result<u64, Problem> {
    let request = read(json)?;
    ticket.reserve(Cost::new(request.points, request.options.points_out(request.points)))?;
    Ok(json.len() as u64 + request.binary_bytes())
}

fn check_points(app: &App, request: &Request<'_>) -> Result<(), Problem> {
    app.check_points(request.points, request.options.points_out(request.points))
}

fn check_length(expected: u64, found: u64) -> Result<(), Problem> {
    if found == expected {
        return Ok(());
    }
    let why =
        format!("the body has {found} bytes, but its JSON and the tensor that it describes have {expected}");
    Err(Problem::MalformedRequest(why))
}

/// The two types of number that a tensor may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Datatype {
    F32,
    F64,
}

impl Datatype {
    fn of(name: &str) -> Option<Self> {
        [Self::F32, Self::F64].into_iter().find(|datatype| datatype.name() == name)
    }

    fn name(self) -> &'static str {
        match self {
            Self::F32 => "FP32",
            Self::F64 => "FP64",
        }
    }

    /// Bytes of one number.
    fn width(self) -> usize {
        match self {
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn scalar(self) -> Scalar {
        match self {
            Self::F32 => Scalar::F32,
            Self::F64 => Scalar::F64,
        }
    }
}

/// The parameters that a request may have: a tensor has no attributes, and is no file.
pub(super) fn parameters() -> impl Iterator<Item = &'static Parameter> {
    let about_files = [Topic::Attributes, Topic::Reading, Topic::Tiles];
    PARAMETERS.iter().filter(move |parameter| !about_files.contains(&parameter.topic))
}

/// Reads the parameters of a request, which are those of `/upsample` that tell of points alone. Most clients of this
/// protocol send none: without one that says how dense the result shall be, it has four times the points.
fn options(given: &Parameters) -> Result<Options, Problem> {
    let names: Vec<&str> = parameters().map(|parameter| parameter.name).collect();
    if let Some(unknown) = given.names().find(|name| !names.contains(name)) {
        return Err(Problem::parameter(unknown, format!("unknown; there are {}", names.join(", "))));
    }
    if let Some(nested) = given.nested.first() {
        let why = "invalid type: a list or an object; it may be a number, a string, true or false";
        return Err(Problem::parameter(nested, why.into()));
    }
    Ok(Options::parse(&given.pairs)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_paths_of_the_protocol_are_its_own() {
        for (path, its_own, probe) in [
            ("/v2", true, false),
            ("/v2/", true, false),
            ("/v2/health/ready", true, true),
            ("/v2/models/densecloud/versions/1/ready", true, true),
            ("/v2/models/densecloud/infer", true, false),
            ("/v20", false, false),
            ("/upsample", false, false),
            ("/ready", false, false),
        ] {
            assert_eq!((is_path(path), is_probe(path)), (its_own, probe), "{path}");
        }
    }
}
