//! What a job is about: the work of `POST /upsample`, with a file for an answer.

use std::io::{self, Write};
use std::sync::Arc;

use axum::http::{HeaderMap, HeaderValue, header};
use serde::{Deserialize, Serialize};

use crate::app::App;
use crate::http::accepted::accepted;
use crate::http::query::Parameters;
use crate::http::upload::Received;
use crate::http::upsample::{Order, Prepared, prepare};
use crate::problem::Problem;
use densecloud_engine::{Caller, Client, EngineError};
use densecloud_formats::{Format, FormatError, encode};
use densecloud_jobs::{Record, Stopped, Task, Work};

/// What a request for a job says beside its cloud, as it is kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Asked {
    query: String,
    /// The media type of the format that it wants, or nothing for any.
    accept: String,
}

/// Bytes of parameters at most: they are kept as long as the job is.
const LONGEST: usize = 16 << 10;

impl Asked {
    /// Of parameters that have been read, as a query, and the header `Accept`.
    ///
    /// # Errors
    /// [`Problem::Parameter`] where the query is too long to be kept.
    pub(crate) fn of(query: String, wanted: Option<Format>) -> Result<Self, Problem> {
        Self::check(&query)?;
        Ok(Self { query, accept: wanted.map_or("", Format::media_type).to_owned() })
    }

    /// Whether a query can be kept.
    ///
    /// # Errors
    /// [`Problem::Parameter`] where it is too long.
    pub(crate) fn check(query: &str) -> Result<(), Problem> {
        if query.len() > LONGEST {
            let why = format!("{} bytes of parameters; a job may have {LONGEST}", query.len());
            return Err(Problem::parameter("query", why));
        }
        Ok(())
    }

    pub(crate) fn text(&self) -> String {
        // Two strings: there is nothing that JSON could not hold.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// What it means; as when the request came, unless another version of the program took it.
    fn read(text: &str) -> Result<(Parameters, Option<Format>), Problem> {
        let internal = |error: &dyn std::fmt::Display| Problem::Internal(error.to_string());
        let asked: Self = serde_json::from_str(text).map_err(|e| internal(&e))?;
        let pairs: Vec<_> = form_urlencoded::parse(asked.query.as_bytes()).into_owned().collect();
        let mut headers = HeaderMap::new();
        let accept = HeaderValue::from_str(&asked.accept).map_err(|e| internal(&e))?;
        headers.insert(header::ACCEPT, accept);
        Ok((Parameters::from_pairs(&pairs)?, accepted(&headers)?))
    }
}

/// Starts the threads that run jobs, where there are any to keep.
pub(crate) fn start(app: &Arc<App>) -> io::Result<()> {
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
        // It came under another limit. What is above this one might never find room.
        let limit = app.config.limits.body_bytes;
        if input.len() as u64 > limit {
            return Err(refused(Problem::BodyTooLarge { limit }));
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_formats::Separator;

    #[test]
    fn what_is_kept_of_a_request_means_the_same_and_is_short() {
        let comma = Format::Xyz { names: false, separator: Separator::Comma };
        let formats = Format::MEDIA_TYPES.map(Format::from_media_type);
        for wanted in formats.into_iter().chain([None, Some(comma)]) {
            let asked = Asked::of("ratio=4&attributes=a%26b:drop".to_owned(), wanted);
            let asked = asked.unwrap_or_else(|problem| panic!("{problem}"));
            let read = Asked::read(&asked.text());
            assert_eq!(read.as_ref().map(|(_, format)| *format), Ok(wanted), "{read:?}");
        }
        let long = format!("ratio=4&sensor={}", "1".repeat(LONGEST));
        let Err(Problem::Parameter { why, .. }) = Asked::of(long, None) else { panic!("too long") };
        assert!(why.contains("16384"), "{why}");
    }

    #[test]
    fn what_was_kept_before_is_read_however_long() {
        // More than a URI holds.
        let query = format!("ratio=4&seed=7&sensor={}1,2,3", "0".repeat(100_000));
        let asked = Asked { query, accept: "image/png, text/csv;q=0.5".to_owned() };
        let (parameters, wanted) = Asked::read(&asked.text()).expect("parameters");
        assert_eq!((parameters.seed, parameters.finish.sensor), (Some(7), Some([1.0, 2.0, 3.0])));
        assert_eq!(wanted, Some(Format::Xyz { names: false, separator: Separator::Comma }));
    }
}
