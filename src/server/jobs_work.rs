//! What a job is about: the work of `POST /upsample`, with a file for an answer.

use std::io::{self, Write};
use std::sync::Arc;

use axum::http::{HeaderMap, HeaderValue, Uri, header};
use serde::{Deserialize, Serialize};

use super::accepted::accepted;
use super::app::App;
use super::problem::Problem;
use super::query::Parameters;
use super::upload::Received;
use super::upsample::{Order, Prepared, prepare};
use crate::engine::{Caller, Client, EngineError};
use crate::formats::{Format, FormatError, encode};
use crate::jobs::{Record, Stopped, Task, Work};

/// What a request for a job says beside its cloud, as it is kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Asked {
    query: String,
    accept: String,
}

impl Asked {
    pub(super) fn of(query: String, headers: &HeaderMap) -> Self {
        let accept = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
        Self { query, accept: accept.collect::<Vec<_>>().join(",") }
    }

    pub(super) fn text(&self) -> String {
        // Two strings: there is nothing that JSON could not hold.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// What it means; as when the request came, unless another version of the program took it.
    fn read(text: &str) -> Result<(Parameters, Option<Format>), Problem> {
        let internal = |error: &dyn std::fmt::Display| Problem::Internal(error.to_string());
        let asked: Self = serde_json::from_str(text).map_err(|e| internal(&e))?;
        let uri: Uri = format!("/?{}", asked.query).parse().map_err(|e| internal(&e))?;
        let mut headers = HeaderMap::new();
        let accept = HeaderValue::from_str(&asked.accept).map_err(|e| internal(&e))?;
        headers.insert(header::ACCEPT, accept);
        Ok((Parameters::parse(&uri)?, accepted(&headers)?))
    }
}

/// Starts the threads that run jobs, where there are any to keep.
pub(super) fn start(app: &Arc<App>) -> io::Result<()> {
    let work: Arc<dyn Work> = Arc::new(Upsampling(Arc::clone(app)));
    app.jobs.as_ref().map_or(Ok(()), |jobs| jobs.start(&work))
}

struct Upsampling(Arc<App>);

impl Work for Upsampling {
    fn run(
        &self,
        job: &Record,
        input: Vec<u8>,
        task: &Task,
        sink: &mut dyn Write,
    ) -> Result<String, Stopped> {
        let app = &self.0;
        let refused = |problem: Problem| refused(&problem, &job.request_id);
        let (parameters, wanted) = Asked::read(&job.request).map_err(refused)?;
        let held = app.budget.hold(input.len() as u64).ok_or(Stopped::Later)?;
        let received = Received::kept(input, held);
        let order = Order::read(app, &received, parameters, wanted);
        let prepared = order.and_then(|order| prepare(app, order)).map_err(refused)?;
        drop(received);
        let Prepared { request, room, format, origin, mut about, .. } = prepared;
        let _held = app.budget.hold(room).ok_or(Stopped::Later)?;
        // Beside the same client's live requests: one that waits for these would hold up other clients' jobs.
        let caller = Caller { client: Client::new(&format!("jobs of {}", job.client)), deadline: None };
        let outcome = app.engine.submit_for(&caller, request, None).and_then(|job| task.wait(job)).map_err(
            |error| match error {
                // Live requests have the points; a job can wait.
                EngineError::Refused(refusal) if refusal.retry_after().is_some() => Stopped::Later,
                EngineError::Cancelled => Stopped::Cancelled,
                error => refused(Problem::from_engine(error)),
            },
        )?;
        app.metrics.worked(outcome.estimate, outcome.took);
        about.complete(&outcome, format, &origin);
        encode(sink, format, &outcome.positions, &outcome.attributes, &origin).map_err(
            |error| match error {
                FormatError::Io(error) => Stopped::Storage(error),
                error => refused(Problem::Internal(error.to_string())),
            },
        )?;
        for (stage, took) in outcome.stages.iter() {
            app.metrics.stage(stage.name(), took);
        }
        app.metrics.points(about.points_in, about.points_out);
        serde_json::to_string(&about).map_err(|error| refused(Problem::Internal(error.to_string())))
    }
}

fn refused(problem: &Problem, request_id: &str) -> Stopped {
    if let Problem::Internal(why) = problem {
        tracing::error!(request = request_id, why, "internal failure");
    }
    Stopped::Refused(problem.value(request_id).to_string())
}
