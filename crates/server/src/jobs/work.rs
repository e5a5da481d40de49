//! What a job is about: the work of `POST /upsample`, with a file for an answer.

use std::io::{self, Read as _, Write};
use std::sync::Arc;
use std::time::Duration;

use axum::http::{HeaderMap, HeaderValue, header};
use serde::{Deserialize, Serialize};

use crate::app::App;
use crate::http::accepted::accepted;
use crate::http::query;
use crate::http::upload::reader_limits;
use crate::http::upsample::{About, UpsampleRequest, prepare};
use crate::jobs::tiles;
use crate::problem::Problem;
use densecloud::{Options, Prepared};
use densecloud_engine::{Caller, Client, EngineError};
use densecloud_formats::{CloudReader, FormatError, encode};
use densecloud_jobs::{Begun, BlobReader, How, Parts, Place, Record, Step, Stopped, Task, Work};

/// Bytes of options at most: they are kept as long as the job is.
const LONGEST: usize = 16 << 10;

/// Whether options of this length, as they came, can be kept.
///
/// # Errors
/// [`Problem::Parameter`] where they are too long.
pub(crate) fn check_length(text: &str) -> Result<(), Problem> {
    if text.len() > LONGEST {
        let why = format!("{} bytes of parameters; a job may have {LONGEST}", text.len());
        return Err(Problem::parameter("query", why));
    }
    Ok(())
}

/// What a job keeps of a request beside its cloud: the options in JSON, and where the cloud's file had a name what
/// the result's has of that.
///
/// # Errors
/// [`Problem::Parameter`] where they are too long to be kept.
pub(crate) fn text(options: &Options, name: Option<String>) -> Result<String, Problem> {
    let text = match name {
        None => serde_json::to_string(options),
        Some(name) => serde_json::to_string(&Kept { options: options.clone(), name }),
    };
    let text = text.map_err(|error| Problem::Internal(error.to_string()))?;
    check_length(&text)?;
    Ok(text)
}

#[derive(Serialize, Deserialize)]
struct Kept {
    options: Options,
    name: String,
}

/// What version 0.1.0 kept: a query, and a header `Accept`.
#[derive(Deserialize)]
struct Before {
    query: String,
    accept: String,
}

/// The options and the name that a job keeps; as when the request came, unless another version of the program took it.
fn kept(text: &str) -> Result<(Options, Option<String>), Problem> {
    let internal = |error: serde_json::Error| Problem::Internal(error.to_string());
    if let Ok(Before { query, accept }) = serde_json::from_str(text) {
        return Ok((before(&query, &accept)?, None));
    }
    if let Ok(Kept { options, name }) = serde_json::from_str(text) {
        return Ok((options, Some(name)));
    }
    Ok((serde_json::from_str(text).map_err(internal)?, None))
}

fn before(query: &str, accept: &str) -> Result<Options, Problem> {
    let pairs: Vec<_> = form_urlencoded::parse(query.as_bytes()).into_owned().collect();
    let accept = HeaderValue::from_str(accept).map_err(|error| Problem::Internal(error.to_string()))?;
    let format = accepted(&HeaderMap::from_iter([(header::ACCEPT, accept)]))?;
    Ok(Options { format, ..query::options_of(&pairs)? })
}

/// Starts the threads that run jobs, where there are any to keep.
pub(crate) fn start(app: &Arc<App>) -> io::Result<()> {
    let Some(jobs) = &app.jobs else { return Ok(()) };
    tiles::clean(app);
    let work: Arc<dyn Work> = Arc::new(Upsampling(Arc::clone(app)));
    jobs.start(&work)
}

struct Upsampling(Arc<App>);

impl Work for Upsampling {
    fn begin(
        &self,
        job: &Record,
        input: Box<dyn BlobReader>,
        place: &Place,
        task: &Task,
        sink: &mut dyn Write,
    ) -> Result<Begun, Stopped> {
        let app = &self.0;
        let (options, name) = asked(job)?;
        // It came under another limit. What is above this one might never find room.
        let limit = app.config.limits.body_bytes;
        let length = input.length()?;
        if length > limit {
            return Err(stopped(&Problem::BodyTooLarge { limit }, job));
        }
        if options.tile_points.is_some_and(|most| job.points_in > most) {
            return tiles::plan(app, job, options, place, task);
        }
        let about = whole(app, job, (input, length, options), task, sink)?;
        Ok(Begun::Done(told(About { name, ..about }, job)?))
    }

    fn tile(&self, job: &Record, tile: u32, place: &Place, task: &Task) -> Result<u64, Stopped> {
        tiles::run(&self.0, job, (tile, asked(job)?.0), place, task)
    }

    fn join(
        &self,
        job: &Record,
        parts: Parts,
        place: &Place,
        _task: &Task,
        sink: &mut dyn Write,
    ) -> Result<String, Stopped> {
        let (options, name) = asked(job)?;
        let about = tiles::join(&self.0, job, (parts, options), place, sink)?;
        told(About { name, ..about }, job)
    }

    fn ended(&self, step: Step, how: How, took: Duration) {
        self.0.metrics.step(step, how, took);
    }
}

/// The options and the name that a job keeps.
fn asked(job: &Record) -> Result<(Options, Option<String>), Stopped> {
    kept(&job.request).map_err(|problem| stopped(&problem, job))
}

/// What is told of a result, as text.
fn told(about: About, job: &Record) -> Result<String, Stopped> {
    serde_json::to_string(&about).map_err(|error| stopped(&Problem::Internal(error.to_string()), job))
}

/// Beside the same client's live requests: one that waits for these would hold up other clients' jobs.
pub(super) fn caller(job: &Record) -> Caller {
    Caller { client: Client::new(&format!("jobs of {}", job.client)), deadline: None }
}

/// A cloud that is worked on as a whole.
fn whole(
    app: &App,
    job: &Record,
    (mut input, length, options): (Box<dyn BlobReader>, u64, Options),
    task: &Task,
    sink: &mut dyn Write,
) -> Result<About, Stopped> {
    let failed = |problem: Problem| stopped(&problem, job);
    let held = app.budget.hold(length).ok_or(Stopped::Later)?;
    let mut bytes = Vec::with_capacity(length as usize);
    input.read_to_end(&mut bytes)?;
    drop(input);
    let reader = CloudReader::open_as(&bytes[..], reader_limits(app), &options.reading);
    let reader = reader.map_err(|error| failed(error.into()))?;
    let input = reader.header().format.written();
    let cloud = reader.read().map_err(|error| failed(error.into()))?;
    drop((bytes, held));
    let (prepared, room) = prepare(app, UpsampleRequest { cloud, input, options }).map_err(failed)?;
    let Prepared { request, mut report } = prepared;
    let _held = app.budget.hold(room.memory).ok_or(Stopped::Later)?;
    let submitted = app.engine.submit_for(&caller(job), request, None);
    let outcome = submitted.and_then(|job| task.wait(job)).map_err(|error| ended(error, job))?;
    app.metrics.worked(outcome.estimate, outcome.took);
    report.complete(&outcome.made);
    encode(sink, report.format, &outcome.made.positions, &outcome.made.attributes, &report.origin)
        .map_err(|error| unwritten(error, job))?;
    for (stage, took) in outcome.stages.iter() {
        app.metrics.stage(stage.name(), took);
    }
    app.metrics.points(report.points_in, report.points_out);
    Ok(About::of(&report))
}

/// Why the engine has no result.
pub(super) fn ended(error: EngineError, job: &Record) -> Stopped {
    match error {
        EngineError::Cancelled => Stopped::Cancelled,
        error => stopped(&Problem::from_engine(error), job),
    }
}

pub(super) fn unwritten(error: FormatError, job: &Record) -> Stopped {
    match error {
        FormatError::Io(error) => Stopped::Storage(error),
        error => stopped(&Problem::Internal(error.to_string()), job),
    }
}

/// What a problem is to a job: for what live requests and other jobs have, it can wait.
pub(super) fn stopped(problem: &Problem, job: &Record) -> Stopped {
    match problem {
        Problem::Refused(refusal) if refusal.retry_after().is_some() => Stopped::Later,
        Problem::TempFull { .. } => Stopped::Later,
        problem => refused(problem, &job.request_id),
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
    use densecloud_formats::{Format, Separator};

    #[test]
    fn what_is_kept_of_a_request_means_the_same_and_is_short() {
        let comma = Format::text(Separator::Comma);
        let formats = Format::MEDIA_TYPES.map(Format::from_media_type);
        for format in formats.into_iter().chain([None, Some(comma)]) {
            let asked = Options::parse(&[("ratio", "4"), ("attributes", "a&b:drop")]).expect("options");
            let asked = Options { format, ..asked };
            for name in [None, Some("scan \"1\"".to_owned())] {
                let text = text(&asked, name.clone()).unwrap_or_else(|problem| panic!("{problem}"));
                assert_eq!(kept(&text), Ok((asked.clone(), name)), "{text}");
            }
        }
        let long =
            Options::parse(&[("attributes", format!("{}:drop", "x".repeat(LONGEST)))]).expect("options");
        let Err(Problem::Parameter { why, .. }) = text(&long, None) else { panic!("too long") };
        assert!(why.contains("16384"), "{why}");
    }

    #[test]
    fn what_was_kept_before_is_read_however_long() {
        // More than a URI holds.
        let query = format!("ratio=4&seed=7&sensor={}1,2,3", "0".repeat(100_000));
        let text = serde_json::json!({ "query": query, "accept": "image/png, text/csv;q=0.5" }).to_string();
        let (options, name) = kept(&text).expect("options");
        assert_eq!(name, None);
        assert_eq!((options.cascade.seed, options.finish.sensor), (7, Some([1.0, 2.0, 3.0])));
        assert_eq!(options.format, Some(Format::text(Separator::Comma)));
    }
}
