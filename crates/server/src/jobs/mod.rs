//! `/jobs`: clouds that are made dense while nobody waits.

pub(crate) mod document;
pub(crate) mod events;
mod intake;
pub(crate) mod result;
pub(crate) mod tiles;
pub(crate) mod work;

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::body::Body;
use axum::extract::{Extension, FromRequestParts, Path, State};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use tokio::task::spawn_blocking;
use tokio::time::timeout;

use crate::admission::deadline::Deadline;
use crate::app::App;
use crate::connection::prefix::Prefix;
use crate::connection::request_id::RequestId;
use crate::http::accepted::accepted;
use crate::http::form::Asking;
use crate::http::query;
use crate::http::upload::Upload;
use crate::jobs::document::Document;
use crate::jobs::intake::new_job;
use crate::problem::{Problem, SOON};
use densecloud_engine::{Client, Cost};
use densecloud_jobs::{
    Admitted, BlobReader, Deleted, Draft, Jobs, Load, NewJob, Record, ResultFile, StoreError, Submitted,
};

impl App {
    pub(crate) fn jobs(&self) -> Result<&Arc<Jobs>, Problem> {
        self.jobs.as_ref().ok_or(Problem::JobsOff)
    }
}

/// Questions to the store at a time. Where another program locks the database, the questions that wait leave threads
/// for requests that do not need it.
pub(crate) const ASKING: usize = 4;
/// How long a question waits for its turn.
const TURN: Duration = Duration::from_secs(5);

/// Asks the store, on a thread that may wait for the disk.
///
/// # Errors
/// [`Problem::JobsOff`], [`Problem::JobsBusy`], or the question's own.
pub(crate) async fn ask<T: Send + 'static>(
    app: &Arc<App>,
    question: impl FnOnce(&Arc<Jobs>) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let jobs = Arc::clone(app.jobs()?);
    let turn = timeout(TURN, Arc::clone(&app.asking).acquire_owned()).await;
    let turn = turn.map_err(|_| {
        Problem::JobsBusy("the jobs' database is busy with other requests; nothing was changed")
    })?;
    let asked = spawn_blocking(move || {
        // Held until the answer is there, even if nobody waits for it any more.
        let _turn = turn;
        question(&jobs)
    });
    asked.await.map_err(|error| Problem::Internal(error.to_string()))?
}

/// Clouds of jobs that are written at a time: each takes a thread, and a while.
pub(crate) const WRITING: usize = 4;

/// Runs `work` on a blocking thread and holds `turn` meanwhile. The work takes a while and does not ask the store, so
/// requests that wait for a turn keep nobody from asking it.
async fn blocking<T: Send + 'static>(
    app: &Arc<App>,
    turn: impl Send + 'static,
    work: impl FnOnce(&App) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let app = Arc::clone(app);
    let done = spawn_blocking(move || {
        let _turn = turn;
        work(&app)
    });
    done.await.map_err(|error| Problem::Internal(error.to_string()))?
}

/// A job's result, for whoever may see the job.
///
/// # Errors
/// [`Problem::NoJob`], [`Problem::JobNotDone`], or that of [`ask`].
pub(crate) async fn finished(
    app: &Arc<App>,
    client: &Client,
    id: String,
) -> Result<(ResultFile, Box<dyn BlobReader>), Problem> {
    let (shared, client) = (Arc::clone(app), client.clone());
    let found = move |jobs: &Arc<Jobs>| {
        let found = jobs.store().result(&id)?.filter(|(job, _)| is_seen(&shared, &client, job));
        let (job, result) = found.ok_or(Problem::NoJob(id))?;
        result.ok_or(Problem::JobNotDone { state: job.state.name() })
    };
    ask(app, found).await
}

/// `POST /jobs`: as `POST /upsample` until the cloud is read, then 202 instead of the result. What
/// `--request-timeout` limits is the upload.
pub(crate) async fn submit(
    State(app): State<Arc<App>>,
    Extension(id): Extension<RequestId>,
    Extension(client): Extension<Client>,
    Extension(prefix): Extension<Prefix>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let mut upload = Upload::new(&headers, body);
    let answer = match Deadline::of(&headers, app.config.timeouts.request) {
        Ok(deadline) => {
            deadline.enter("of upload");
            let taken = deadline.run(take(&app, &id, &client, &uri, &headers, &mut upload)).await;
            taken.and_then(|(status, document)| answer(status, document, &prefix))
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

/// The problem of a client whose job is refused. Its `Retry-After` is the time until enough waiting jobs are done to
/// make room; the client's own jobs take turns with other clients'.
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
) -> Result<(StatusCode, Document), Problem> {
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
    let known = |cost: Cost| {
        app.check_points(cost.points_in, cost.points_out)?;
        app.engine.check_memory(cost).map_err(Problem::Refused)
    };
    work::check_length(uri.query().unwrap_or_default())?;
    let Asking { mut options, received, name: stem } =
        Asking::receive(upload, uri, headers, app, known).await?;
    options.format = wanted;
    let owner = app.config.access.owner(client).unwrap_or_default();
    let (name, id) = (client.name().to_owned(), id.as_str().to_owned());
    let turn = app.parsing.turn(client, received.length()).await;
    let draft = blocking(app, turn, move |app| {
        let job = new_job(app, received, options, stem)?;
        let job = NewJob { key, owner, client: name, request_id: id, ..job };
        let draft = Draft::new(job).map_err(|error| Problem::Internal(error.to_string()))?;
        Ok(Arc::new(draft))
    })
    .await?;
    let (shared, new, of) = (Arc::clone(app), Arc::clone(&draft), client.clone());
    let admit =
        move |jobs: &Arc<Jobs>| jobs.store().admit(&new).map_err(|error| refused(&shared, jobs, &of, error));
    let (submitted, document) = match ask(app, admit).await? {
        Admitted::Known(record) => {
            let (shared, known) = (Arc::clone(app), record.clone());
            let document = ask(app, move |jobs| Document::of(&shared, jobs, &known)).await?;
            (Submitted::Known(*record), document)
        }
        Admitted::New(id) => {
            let (jobs, new) = (Arc::clone(app.jobs()?), Arc::clone(&draft));
            let turn = Arc::clone(&app.writing).acquire_owned().await;
            let turn = turn.map_err(|error| Problem::Internal(error.to_string()))?;
            let input = blocking(app, turn, move |_| {
                jobs.store().write_input(&id, &new).map_err(|error| StoreError::from(error).into())
            });
            let input = input.await?;
            let (shared, of) = (Arc::clone(app), client.clone());
            ask(app, move |jobs| {
                let submitted =
                    jobs.insert(&draft, input).map_err(|error| refused(&shared, jobs, &of, error))?;
                let (Submitted::New(record) | Submitted::Known(record)) = &submitted;
                let document = Document::of(&shared, jobs, record)?;
                Ok((submitted, document))
            })
            .await?
        }
    };
    let status = match submitted {
        Submitted::New(_) => StatusCode::ACCEPTED,
        Submitted::Known(_) => StatusCode::OK,
    };
    Ok((status, document))
}

/// What tells of a job that was taken.
fn answer(status: StatusCode, document: Document, prefix: &Prefix) -> Result<Response, Problem> {
    let location = HeaderValue::from_str(&prefix.link(&format!("/jobs/{}", document.id)))
        .map_err(|error| Problem::Internal(error.to_string()))?;
    Ok((status, [(header::LOCATION, location)], Json(document.under(prefix))).into_response())
}

/// The longest key that is taken.
const LONGEST: usize = 255;

/// The key that a request gives itself.
pub(crate) fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let Some(key) = headers.get("idempotency-key") else { return Ok(None) };
    match key.to_str() {
        Ok(text) if (1..=LONGEST).contains(&text.len()) => Ok(Some(text.to_owned())),
        _ => {
            let why = format!("not 1 to {LONGEST} visible ASCII characters");
            Err(Problem::parameter("Idempotency-Key", why))
        }
    }
}

/// A job's name in a path; what is no text names none.
pub(crate) struct JobId(pub(crate) String);

impl<S: Send + Sync> FromRequestParts<S> for JobId {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        match Path::from_request_parts(parts, state).await {
            Ok(Path(name)) => Ok(Self(name)),
            Err(_) => Err(Problem::NoJob("of this name".to_owned())),
        }
    }
}

/// `GET /jobs/{id}`.
pub(crate) async fn get(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    Extension(prefix): Extension<Prefix>,
    JobId(id): JobId,
) -> Result<Json<Document>, Problem> {
    Ok(Json(Document::ask(&app, &client, id).await?.under(&prefix)))
}

/// Whether a client may see a job.
pub(crate) fn is_seen(app: &App, client: &Client, job: &Record) -> bool {
    app.config.access.owner(client).is_none_or(|owner| owner == job.owner)
}

/// The record of a job that a client may see.
///
/// # Errors
/// [`Problem::NoJob`], for another's as for none.
pub(crate) fn seen(app: &App, jobs: &Jobs, client: &Client, id: &str) -> Result<Record, Problem> {
    let found = jobs.store().get(id)?.filter(|job| is_seen(app, client, job));
    found.ok_or_else(|| Problem::NoJob(id.to_owned()))
}

/// `DELETE /jobs/{id}`: cancels a job that is not over (200, and the job), forgets one that is (204).
pub(crate) async fn delete(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    Extension(prefix): Extension<Prefix>,
    JobId(id): JobId,
) -> Result<Response, Problem> {
    let (shared, name, of) = (Arc::clone(&app), id.clone(), client.clone());
    let deleted = ask(&app, move |jobs| {
        seen(&shared, jobs, &of, &name)?;
        Ok(jobs.delete(&name)?)
    });
    match deleted.await? {
        Some(Deleted::Cancelled) => {
            Ok(Json(Document::ask(&app, &client, id).await?.under(&prefix)).into_response())
        }
        Some(Deleted::Forgotten) => Ok(StatusCode::NO_CONTENT.into_response()),
        None => Err(Problem::NoJob(id)),
    }
}

/// A page of `GET /jobs`.
#[derive(Debug, Serialize)]
pub(crate) struct Page {
    jobs: Vec<Document>,
    /// The next page, where there is one.
    next: Option<String>,
}

/// Jobs on a page where the request does not say.
const PAGE: u32 = 20;
/// And at most.
const LONGEST_PAGE: u32 = 100;

/// `GET /jobs`: the newest first.
pub(crate) async fn list(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    Extension(prefix): Extension<Prefix>,
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
        let next = last.map(|number| prefix.link(&format!("/jobs?limit={limit}&before={number}")));
        let jobs =
            records.iter().map(|record| Document::of(&shared, jobs, record).map(|job| job.under(&prefix)));
        Ok(Page { jobs: jobs.collect::<Result<_, _>>()?, next })
    });
    Ok(Json(page.await?))
}

/// What a request for a page says: from which number downwards, and how many.
pub(crate) fn page_of(uri: &Uri) -> Result<(Option<i64>, u32), Problem> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[tokio::test(start_paused = true)]
    async fn clouds_that_are_written_and_questions_to_the_store_do_not_wait_for_each_other() {
        let (app, _folder) = testing::app();
        let writing = app.writing.acquire_many(WRITING as u32).await.expect("turns");
        assert!(ask(&app, |jobs| Ok(jobs.store().used()?)).await.is_ok());
        drop(writing);
        let asking = app.asking.acquire_many(ASKING as u32).await.expect("turns");
        let post = async |body: &'static str| {
            let mut headers = HeaderMap::new();
            headers.insert("idempotency-key", HeaderValue::from_static("k-1"));
            let (app, uri) = (State(Arc::clone(&app)), Uri::from_static("/jobs?ratio=1"));
            let id = Extension(RequestId::of(&headers));
            let (client, prefix) = (Extension(Client::new("a")), Extension(Prefix::default()));
            let answer = submit(app, id, client, prefix, uri, headers, body.into()).await;
            answer.expect_err("no turn")
        };
        let problem = post("no cloud").await;
        assert_eq!(problem.outcome(), "unsupported-format", "{problem}");
        let problem = post("0 0 0\n1 0 0\n0 1 0\n0 0 1\n").await;
        assert_eq!(problem.outcome(), "jobs-busy");
        assert!(!problem.to_string().contains("another program"), "{problem}");
        drop(asking);
    }
}
