//! `/jobs`: clouds that are made dense while nobody waits.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::body::Body;
use axum::extract::{Extension, Path, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

use super::accepted::accepted;
use super::app::App;
use super::budget::Held;
use super::deadline::Deadline;
use super::form::Asking;
use super::jobs_document::Document;
use super::jobs_work::Asked;
use super::problem::{Problem, SOON};
use super::query::{self, Parameters};
use super::request_id::RequestId;
use super::upload::{Received, Upload};
use super::upsample::{Order, prepare};
use crate::engine::{Client, Cost};
use crate::formats::Format;
use crate::jobs::{Deleted, Jobs, Load, NewJob, Record, StoreError, Submitted};

impl App {
    pub(super) fn jobs(&self) -> Result<&Arc<Jobs>, Problem> {
        self.jobs.as_ref().ok_or(Problem::JobsOff)
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::OverBudget { used, wanted, limit } => Self::JobDisk { used, wanted, limit },
            StoreError::OtherRequest => Self::KeyReused,
            StoreError::Full { queued, limit } => Self::JobsFull { queued, limit, retry_after: SOON },
            StoreError::ClientFull { queued, limit } => Self::ClientJobs { queued, limit, retry_after: SOON },
            error if error.is_full() => Self::DiskFull(error.to_string()),
            error if error.is_busy() => Self::JobsBusy,
            error => Self::Internal(error.to_string()),
        }
    }
}

/// Questions to the store at a time: should the database be locked, those that wait for it must leave threads for
/// the requests that need none of it.
pub(super) const ASKING: usize = 4;
/// How long a question waits for its turn.
const TURN: Duration = Duration::from_secs(5);

/// Asks the store, on a thread that may wait for the disk.
///
/// # Errors
/// [`Problem::JobsOff`], [`Problem::JobsBusy`], or the question's own.
pub(super) async fn ask<T: Send + 'static>(
    app: &Arc<App>,
    question: impl FnOnce(&Arc<Jobs>) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let jobs = Arc::clone(app.jobs()?);
    let turn = timeout(TURN, Arc::clone(&app.asking).acquire_owned()).await.map_err(|_| Problem::JobsBusy)?;
    let asked = spawn_blocking(move || {
        // Until the answer is there, also where nobody waits for it any more.
        let _turn = turn;
        question(&jobs)
    });
    asked.await.map_err(|error| Problem::Internal(error.to_string()))?
}

/// `POST /jobs`: as `POST /upsample` until the cloud is read, then 202 instead of the result. What
/// `--request-timeout` limits is the upload.
pub(super) async fn submit(
    State(app): State<Arc<App>>,
    Extension(id): Extension<RequestId>,
    Extension(client): Extension<Client>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let mut upload = Upload::new(&headers, body);
    let answer = match Deadline::of(&headers, app.config.timeouts.request) {
        Ok(deadline) => {
            deadline.enter("of upload");
            deadline.run(take(&app, &id, &client, &uri, &headers, &mut upload)).await
        }
        Err(problem) => Err(problem),
    };
    upload.give_up();
    if let Err(problem @ (Problem::JobsFull { .. } | Problem::ClientJobs { .. } | Problem::JobDisk { .. })) =
        &answer
    {
        app.metrics.refused(problem.outcome());
    }
    answer
}

/// Tells a client whose job is refused when to come back: when as many of the jobs that wait are done as were one
/// too many, its own by turns with the others'.
fn refused(app: &App, jobs: &Jobs, client: &Client, error: StoreError) -> Problem {
    let wait = |clients: u64, load: Load| {
        let points = load.points as f64 / load.jobs.max(1) as f64 * clients.max(1) as f64;
        let seconds = points / app.engine.rate()? / jobs.settings().running.max(1) as f64;
        Duration::try_from_secs_f64(seconds).ok()
    };
    let load = jobs.store().load(client.name()).unwrap_or_default();
    match error {
        StoreError::Full { queued, limit } => {
            Problem::JobsFull { queued, limit, retry_after: wait(1, load).unwrap_or(SOON) }
        }
        StoreError::ClientFull { queued, limit } => {
            Problem::ClientJobs { queued, limit, retry_after: wait(load.clients, load).unwrap_or(SOON) }
        }
        error => error.into(),
    }
}

async fn take(
    app: &Arc<App>,
    id: &RequestId,
    client: &Client,
    uri: &Uri,
    headers: &HeaderMap,
    upload: &mut Upload,
) -> Result<Response, Problem> {
    app.jobs()?;
    app.readiness.check()?;
    let wanted = accepted(headers)?;
    let key = idempotency_key(headers)?;
    if key.is_none() {
        // With a key it may be one that is there already.
        let (shared, client) = (Arc::clone(app), client.clone());
        let room = move |jobs: &Arc<Jobs>| {
            jobs.store().has_room(client.name()).map_err(|error| refused(&shared, jobs, &client, error))
        };
        ask(app, room).await?;
    }
    let known = |points_in, points_out| {
        app.check_points(points_in, points_out)?;
        app.engine.check_memory(Cost { points_in, points_out }).map_err(Problem::Refused)
    };
    let Asking { parameters, query, received } = Asking::receive(upload, uri, headers, app, known).await?;
    let asked = Asked::of(query, headers);
    let (shared, client, id) = (Arc::clone(app), client.clone(), id.as_str().to_owned());
    let (submitted, document) = ask(app, move |jobs| {
        let (job, _held) = new_job(&shared, received, &parameters, wanted, &asked)?;
        let owner = shared.config.access.owner(&client).unwrap_or_default();
        let job = NewJob { key, owner, client: client.name().to_owned(), request_id: id, ..job };
        let submitted = jobs.submit(&job).map_err(|error| refused(&shared, jobs, &client, error))?;
        let (Submitted::New(record) | Submitted::Known(record)) = &submitted;
        let document = Document::of(&shared, jobs, record)?;
        Ok((submitted, document))
    })
    .await?;
    let (status, record) = match submitted {
        Submitted::New(record) => (StatusCode::ACCEPTED, record),
        Submitted::Known(record) => (StatusCode::OK, record),
    };
    let location = HeaderValue::from_str(&format!("/jobs/{}", record.id))
        .map_err(|error| Problem::Internal(error.to_string()))?;
    Ok((status, [(header::LOCATION, location)], Json(document)).into_response())
}

/// Blocking work: reads the cloud, only to know that it can be read, and makes a job of its file.
fn new_job(
    app: &App,
    received: Received,
    parameters: &Parameters,
    wanted: Option<Format>,
    asked: &Asked,
) -> Result<(NewJob, Held), Problem> {
    let prepared = prepare(app, Order::read(app, &received, parameters.clone(), wanted)?)?;
    let finite = prepared.request.cloud.positions.iter().filter(|p| p.iter().all(|c| c.is_finite())).count();
    let points_out = prepared.request.target.points_out(finite as u64)?;
    let cost = Cost { points_in: finite as u64, points_out };
    app.engine.check_memory(cost).map_err(Problem::Refused)?;
    let (input, held) = received.into_parts();
    let job = NewJob {
        request: asked.text(),
        key: None,
        owner: String::new(),
        client: String::new(),
        request_id: String::new(),
        points_in: prepared.about.points_in,
        points_out,
        result_bytes: prepared.file,
        input,
    };
    Ok((job, held))
}

/// The longest key that is taken.
const LONGEST: usize = 255;

fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let Some(key) = headers.get("idempotency-key") else { return Ok(None) };
    match key.to_str() {
        Ok(text) if (1..=LONGEST).contains(&text.len()) => Ok(Some(text.to_owned())),
        _ => {
            let why = format!("not 1 to {LONGEST} visible ASCII characters");
            Err(Problem::parameter("Idempotency-Key", why))
        }
    }
}

/// `GET /jobs/{id}`.
pub(super) async fn get(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
) -> Result<Json<Document>, Problem> {
    Ok(Json(Document::ask(&app, &client, id).await?))
}

/// The record of a job that a client may see.
///
/// # Errors
/// [`Problem::NoJob`], for another's as for none.
pub(super) fn seen(app: &App, jobs: &Jobs, client: &Client, id: &str) -> Result<Record, Problem> {
    let owner = app.config.access.owner(client);
    let found = jobs.store().get(id)?.filter(|job| owner.is_none_or(|owner| owner == job.owner));
    found.ok_or_else(|| Problem::NoJob(id.to_owned()))
}

/// `DELETE /jobs/{id}`: cancels a job that is not over (200, and the job), forgets one that is (204).
pub(super) async fn delete(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let (shared, name, of) = (Arc::clone(&app), id.clone(), client.clone());
    let deleted = ask(&app, move |jobs| {
        seen(&shared, jobs, &of, &name)?;
        Ok(jobs.delete(&name)?)
    });
    match deleted.await? {
        Some(Deleted::Cancelled) => Ok(Json(Document::ask(&app, &client, id).await?).into_response()),
        Some(Deleted::Forgotten) => Ok(StatusCode::NO_CONTENT.into_response()),
        None => Err(Problem::NoJob(id)),
    }
}

/// A page of `GET /jobs`.
#[derive(Debug, Serialize)]
pub(super) struct Page {
    jobs: Vec<Document>,
    /// The next page, where there is one.
    next: Option<String>,
}

/// Jobs on a page where the request does not say.
const PAGE: u32 = 20;
/// And at most.
const LONGEST_PAGE: u32 = 100;

/// `GET /jobs`: the newest first.
pub(super) async fn list(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    uri: Uri,
) -> Result<Json<Page>, Problem> {
    let (before, limit) = page_of(&uri)?;
    let owner = app.config.access.owner(&client);
    let shared = Arc::clone(&app);
    let page = ask(&app, move |jobs| {
        // One more than asked for tells whether there is another page.
        let mut records = jobs.store().list(before, limit + 1, owner.as_deref())?;
        let more = records.len() > limit as usize;
        records.truncate(limit as usize);
        let last = records.last().map(|record| record.number).filter(|_| more);
        let next = last.map(|number| format!("/jobs?limit={limit}&before={number}"));
        let jobs = records.iter().map(|record| Document::of(&shared, jobs, record));
        Ok(Page { jobs: jobs.collect::<Result<_, _>>()?, next })
    });
    Ok(Json(page.await?))
}

fn page_of(uri: &Uri) -> Result<(Option<i64>, u32), Problem> {
    let (mut before, mut limit) = (None, PAGE);
    let pairs = query::pairs(uri)?;
    for (i, (name, value)) in pairs.iter().enumerate() {
        if pairs[..i].iter().any(|(earlier, _)| earlier == name) {
            return Err(Problem::parameter(name, "given twice".into()));
        }
        let wrong = |what: String| Problem::parameter(name, format!("{value:?} is not {what}"));
        match name.as_str() {
            "before" => match value.parse() {
                Ok(number) if number > 0 => before = Some(number),
                _ => return Err(wrong("a number of a job".into())),
            },
            "limit" => match value.parse() {
                Ok(number) if (1..=LONGEST_PAGE).contains(&number) => limit = number,
                _ => return Err(wrong(format!("a number from 1 to {LONGEST_PAGE}"))),
            },
            _ => return Err(Problem::parameter(name, "unknown; there are before and limit".into())),
        }
    }
    Ok((before, limit))
}
