//! What Triton calls the model repository: here it is the one model, which comes and goes with the server.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use serde_json::{Value, json};

use super::bounded::Parameters;
use super::request::switch;
use super::{MODEL, Named, VERSION, check_model};
use crate::admission::deadline::Deadline;
use crate::app::App;
use crate::http::upload::Upload;
use crate::problem::Problem;

/// Bytes of a question for the index: it is parsed on a thread that serves connections, too.
const LONGEST: usize = 64 << 10;

/// `POST /v2/repository/index`.
pub(super) async fn index(
    State(app): State<Arc<App>>,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<Value>, Problem> {
    let mut upload = Upload::new(&headers, body);
    let deadline = Deadline::new(None, app.config.timeouts.request);
    let received = deadline.run(upload.receive_judged(&headers, &app, |bytes, _| check_length(bytes))).await;
    upload.give_up();
    let only = asks_for_ready(received?.head())?;
    let (state, reason) = match app.readiness.probe() {
        Ok(()) => ("READY", String::new()),
        Err(problem @ Problem::WarmingUp) => ("LOADING", problem.to_string()),
        Err(problem) => ("UNAVAILABLE", problem.to_string()),
    };
    let model = json!({ "name": MODEL, "version": VERSION, "state": state, "reason": reason });
    let models = if only && state != "READY" { Vec::new() } else { vec![model] };
    Ok(Json(models.into()))
}

fn check_length(body: &[u8]) -> Result<(), Problem> {
    if body.len() <= LONGEST {
        return Ok(());
    }
    Err(Problem::MalformedRequest(format!("the body has more than {LONGEST} bytes")))
}

/// Whether only models that are ready shall be named; no body asks for all.
fn asks_for_ready(body: &[u8]) -> Result<bool, Problem> {
    if body.trim_ascii().is_empty() {
        return Ok(false);
    }
    let asked: Option<Parameters> = serde_json::from_slice(body)
        .map_err(|error| Problem::MalformedRequest(format!("the request's JSON: {error}")))?;
    asked.unwrap_or_default().find("ready")?.map_or(Ok(false), |value| switch("ready", value))
}

/// `POST /v2/repository/models/densecloud/load` and `.../unload`: an error, as of a Triton that does not let clients
/// control its models.
pub(super) async fn fixed(named: Named) -> Result<(), Problem> {
    check_model(&named)?;
    Err(Problem::FixedModel)
}
