//! What is told of a job, as JSON.

use std::sync::Arc;
use std::time::{Duration, UNIX_EPOCH};

use humantime::format_rfc3339_millis;
use serde::Serialize;
use serde_json::Value;

use crate::app::App;
use crate::connection::prefix::Prefix;
use crate::http::upsample::About;
use crate::jobs::{ask, seen};
use crate::problem::Problem;
use densecloud_engine::Client;
use densecloud_jobs::{AtWork, Failure, Jobs, Record, ResultFile, State, Time};

/// One job.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Document {
    pub(crate) id: String,
    pub(crate) state: &'static str,
    #[serde(skip)]
    pub(crate) over: bool,
    points_in: u64,
    points_out: u64,
    pub(crate) progress: Progress,
    /// The share of the result that is made by tiles that are done.
    #[serde(skip)]
    made: f64,
    /// Queued jobs before it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) position: Option<u64>,
    pub(crate) attempts: u32,
    created: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    started: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    finished: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    expires: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    expected_start: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    expected_end: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    result: Option<ResultDocument>,
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<Value>,
    request_id: String,
}

/// How far it is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct Progress {
    stage: Option<&'static str>,
    level: usize,
    levels: usize,
    fraction: f64,
}

/// Its result.
#[derive(Debug, Clone, Serialize)]
struct ResultDocument {
    url: String,
    media_type: String,
    bytes: u64,
    sha256: String,
    provenance: String,
    warnings: Vec<String>,
}

impl Document {
    /// A job by its name.
    pub(crate) async fn ask(app: &Arc<App>, client: &Client, id: String) -> Result<Self, Problem> {
        let (shared, client) = (Arc::clone(app), client.clone());
        ask(app, move |jobs| Self::of(&shared, jobs, &seen(&shared, jobs, &client, &id)?)).await
    }

    /// Blocks for moments.
    pub(crate) fn of(app: &App, jobs: &Jobs, record: &Record) -> Result<Self, Problem> {
        Self::with(app, jobs, record, &jobs.at_work(&record.id))
    }

    /// As [`Document::of`], with what is known in memory of the job's steps that run here.
    pub(crate) fn with(app: &App, jobs: &Jobs, record: &Record, at_work: &AtWork) -> Result<Self, Problem> {
        let result = record.result.as_ref();
        let made = result.map(about).transpose()?.map(|about| about.points_out);
        let mut document = Self {
            id: record.id.clone(),
            state: record.state.name(),
            over: record.state.is_final(),
            points_in: record.points_in,
            // What is left out for its confidence is known at the end.
            points_out: made.unwrap_or(record.points_out),
            position: None,
            attempts: record.attempts,
            created: rfc3339(record.created),
            started: record.started.map(rfc3339),
            finished: record.finished.map(rfc3339),
            expires: record.finished.map(|end| {
                let kept = jobs.settings().expiry.as_millis().try_into().unwrap_or(Time::MAX);
                rfc3339(end.saturating_add(kept))
            }),
            expected_start: None,
            expected_end: None,
            result: result.map(|result| ResultDocument::of(&record.id, result)).transpose()?,
            problem: record.failure.as_ref().map(|failure| failed_as(failure, &record.request_id)),
            request_id: record.request_id.clone(),
            made: share_made(record),
            progress: Progress { stage: None, level: 0, levels: 0, fraction: share_made(record) },
        };
        if record.state == State::Running {
            document.tell_progress(at_work);
        }
        match record.state {
            State::Queued => {
                let (count, points) = jobs.store().ahead(record)?;
                document.position = Some(count);
                let start = time(app, points.saturating_add(jobs.points_running(&record.id)))
                    .map(|wait| jobs.now() + wait);
                document.expected_start = start.map(rfc3339);
                document.expected_end =
                    start.zip(time(app, record.points_out)).map(|(start, work)| rfc3339(start + work));
            }
            State::Running => document.expect_end(app, jobs),
            _ => {}
        }
        Ok(document)
    }

    /// The same with links that begin with this.
    pub(crate) fn under(mut self, prefix: &Prefix) -> Self {
        if let Some(result) = &mut self.result {
            result.url = prefix.link(&result.url);
        }
        self
    }

    /// One with all that a job can tell of itself.
    #[cfg(test)]
    pub(crate) fn with_everything() -> Self {
        let text = |text: &str| text.to_owned();
        Self {
            id: text("ab12"),
            state: State::Running.name(),
            over: false,
            points_in: 1,
            points_out: 2,
            progress: Progress { stage: Some("units"), level: 1, levels: 2, fraction: 0.5 },
            made: 0.0,
            position: Some(0),
            attempts: 1,
            created: rfc3339(0),
            started: Some(rfc3339(0)),
            finished: Some(rfc3339(0)),
            expires: Some(rfc3339(Time::MAX)),
            expected_start: Some(rfc3339(0)),
            expected_end: Some(rfc3339(0)),
            result: Some(ResultDocument {
                url: text("/jobs/ab12/result"),
                media_type: text("text/plain"),
                bytes: 1,
                sha256: text("12"),
                provenance: text("densecloud"),
                warnings: vec![text("none")],
            }),
            problem: Some(Problem::JobsOff.value("id-1")),
            request_id: text("id-1"),
        }
    }

    /// Takes a running job's progress from memory.
    pub(crate) fn advance(&mut self, app: &App, jobs: &Jobs, at_work: &AtWork) {
        if self.tell_progress(at_work) {
            self.expect_end(app, jobs);
        }
    }

    /// The same; false where nothing is known there.
    fn tell_progress(&mut self, at_work: &AtWork) -> bool {
        let Some(now) = at_work.progress() else { return false };
        let fraction = (self.made + now.fraction).min(1.0);
        self.progress = densecloud_engine::Progress { fraction, ..now }.into();
        true
    }

    fn expect_end(&mut self, app: &App, jobs: &Jobs) {
        let left = self.points_out as f64 * (1.0 - self.progress.fraction);
        self.expected_end = time(app, left as u64).map(|work| rfc3339(jobs.now() + work));
    }
}

/// Milliseconds for so many points.
fn time(app: &App, points: u64) -> Option<Time> {
    Some((points as f64 / app.engine.rate()? * 1000.0).min(1e15) as Time)
}

/// The share of the result that is made, by the record.
fn share_made(record: &Record) -> f64 {
    match (&record.tiles, record.state) {
        (_, State::Done) => 1.0,
        (Some(tiles), State::Running) => (tiles.points as f64 / record.points_out.max(1) as f64).min(1.0),
        _ => 0.0,
    }
}

impl From<densecloud_engine::Progress> for Progress {
    fn from(progress: densecloud_engine::Progress) -> Self {
        Self {
            stage: progress.stage.map(densecloud_cascade::Stage::name),
            level: progress.level,
            levels: progress.levels,
            fraction: progress.fraction,
        }
    }
}

impl ResultDocument {
    fn of(id: &str, result: &ResultFile) -> Result<Self, Problem> {
        let about = about(result)?;
        Ok(Self {
            url: format!("/jobs/{id}/result"),
            media_type: about.media_type,
            bytes: result.bytes,
            sha256: result.sha256.clone(),
            provenance: about.provenance,
            warnings: about.warnings,
        })
    }
}

/// What the work left beside a result.
pub(crate) fn about(result: &ResultFile) -> Result<About, Problem> {
    serde_json::from_str(&result.about).map_err(|error| Problem::Internal(error.to_string()))
}

/// A failure as the problem that `POST /upsample` would have answered with, or one of jobs alone.
fn failed_as(failure: &Failure, request_id: &str) -> Value {
    let problem = match failure {
        Failure::Refused(problem) => match serde_json::from_str(problem) {
            Ok(problem) => return problem,
            Err(error) => Problem::Internal(error.to_string()),
        },
        Failure::Storage { why, full: true } => Problem::DiskFull(why.clone()),
        Failure::Storage { why, full: false } => Problem::Internal(why.clone()),
        Failure::GaveUp { attempts, tile } => Problem::GaveUp { attempts: *attempts, tile: *tile },
        Failure::Crashed => Problem::Internal("a worker panicked".to_owned()),
        other => Problem::Internal(format!("{other:?}")),
    };
    problem.value(request_id)
}

/// The last millisecond that RFC 3339 has a text for, in the year 9999.
const LAST: Time = 253_402_300_799_999;

/// A time as RFC 3339 has it, in UTC; what is out of its years is at their end.
fn rfc3339(time: Time) -> String {
    let since = Duration::from_millis(time.clamp(0, LAST).unsigned_abs());
    format_rfc3339_millis(UNIX_EPOCH + since).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_calendar() {
        for (time, text) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400_000, "2000-02-29T00:00:00.000Z"),
            (1_709_251_199_999, "2024-02-29T23:59:59.999Z"),
            (4_107_542_400_000, "2100-03-01T00:00:00.000Z"),
            (1_795_392_000_123, "2026-11-23T00:00:00.123Z"),
            (LAST, "9999-12-31T23:59:59.999Z"),
            (Time::MAX, "9999-12-31T23:59:59.999Z"),
        ] {
            assert_eq!(rfc3339(time), text);
        }
    }
}
