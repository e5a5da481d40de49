//! `GET /jobs/{id}/events`: a job's way to its end, as server-sent events.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Extension, State as Shared};
use axum::http::{HeaderName, header};
use axum::response::sse::{Event, Sse};
use axum::response::{IntoResponse, Response};
use futures::stream;
use serde::Serialize;
use tokio::sync::watch;
use tokio::time::{Instant, sleep};

use crate::app::App;
use crate::connection::accept::Connection;
use crate::connection::activity::Activity;
use crate::connection::prefix::Prefix;
use crate::jobs::document::{Document, Progress};
use crate::jobs::{JobId, ask, seen};
use crate::problem::Problem;
use densecloud_engine::Client;
use densecloud_jobs::{AtWork, Jobs, State};

/// How often a running job's progress is looked at, in memory. The database is asked only when a job has changed: a
/// thousand watchers cost nothing while none has.
const TICK: Duration = Duration::from_millis(250);
/// Without news, proxies want a sign of life.
const ALIVE: Duration = Duration::from_secs(10);
/// A client that closed its sending side may be gone: what is sent to it shows that.
const HALF_CLOSED: Duration = Duration::from_secs(1);
/// Says to nginx, and to others that have taken it over, that an answer is to be passed on as it comes.
const ACCEL_BUFFERING: HeaderName = HeaderName::from_static("x-accel-buffering");

/// The handler. An event has the name of its kind, `progress` or a final state, and the job as `GET
/// /jobs/{id}` tells it. The stream ends with the job, and when the server stops.
pub(crate) async fn events(
    Shared(app): Shared<Arc<App>>,
    Extension(client): Extension<Client>,
    Extension(prefix): Extension<Prefix>,
    connection: Option<Extension<Connection>>,
    JobId(id): JobId,
) -> Result<Response, Problem> {
    let jobs = Arc::clone(app.jobs()?);
    let changes = jobs.changes();
    let activity = connection.map(|Extension(connection)| connection.activity).unwrap_or_default();
    let (seen, told, over) = (None, None, false);
    let mut state = Events { app, jobs, client, id, prefix, activity, changes, seen, told, over };
    state.look().await?;
    let events = stream::unfold(state, |mut events| async move {
        let event = events.next().await?;
        Some((Ok::<_, Infallible>(event), events))
    });
    // Not to be kept, either, where axum says only that a cache must ask.
    let headers = [(header::CACHE_CONTROL, "no-store"), (ACCEL_BUFFERING, "no")];
    Ok((headers, Sse::new(events)).into_response())
}

struct Events {
    app: Arc<App>,
    jobs: Arc<Jobs>,
    client: Client,
    id: String,
    prefix: Prefix,
    activity: Activity,
    changes: watch::Receiver<()>,
    /// The job as it was last looked up, and while it runs what is known of it in memory.
    seen: Option<(Document, AtWork)>,
    told: Option<News>,
    over: bool,
}

/// What makes an event of a document; expected times alone, which always change, do not.
type News = (&'static str, u32, Option<u64>, Progress);

impl Events {
    /// Looks the job up.
    async fn look(&mut self) -> Result<(), Problem> {
        // Before the question, so that no change between is missed.
        self.changes.mark_unchanged();
        let (shared, client, id) = (Arc::clone(&self.app), self.client.clone(), self.id.clone());
        let prefix = self.prefix.clone();
        let seen = ask(&self.app, move |jobs| {
            // Before the record: a job that is at work by then runs, or is over.
            let at_work = jobs.at_work(&id);
            let record = seen(&shared, jobs, &client, &id)?;
            let document = Document::with(&shared, jobs, &record, &at_work)?.under(&prefix);
            let runs = record.state == State::Running;
            Ok((document, if runs { at_work } else { AtWork::default() }))
        });
        self.seen = Some(seen.await?);
        Ok(())
    }

    /// The next event; nothing after the last.
    async fn next(&mut self) -> Option<Event> {
        let start = Instant::now();
        loop {
            if self.over || self.app.readiness.check() == Err(Problem::Draining) {
                return None;
            }
            if self.changes.has_changed().unwrap_or(false) {
                match self.look().await {
                    Ok(()) => {}
                    Err(Problem::NoJob(_)) => {
                        // Deleted or expired while it was watched.
                        self.over = true;
                        return Some(event("deleted", &serde_json::json!({ "id": self.id })));
                    }
                    // The job is there all the same; its watcher waits, too.
                    Err(error) => {
                        tracing::debug!(job = self.id, %error, "a watched job cannot be looked at");
                        self.changes.mark_changed();
                        sleep(TICK).await;
                        return Some(sign_of_life());
                    }
                }
            }
            let (document, at_work) = self.seen.as_mut()?;
            document.advance(&self.app, &self.jobs, at_work);
            let news = (document.state, document.attempts, document.position, document.progress.clone());
            if self.told.as_ref() != Some(&news) {
                self.told = Some(news);
                self.over = document.over;
                let kind = if document.over { document.state } else { "progress" };
                return Some(event(kind, document));
            }
            let alive = if self.activity.is_half_closed() { HALF_CLOSED } else { ALIVE };
            if start.elapsed() >= alive {
                return Some(sign_of_life());
            }
            tokio::select! {
                _ = self.changes.changed() => self.changes.mark_changed(),
                () = sleep(TICK) => {}
            }
        }
    }
}

/// An event of a kind, with a document. Strings and numbers only: there is nothing that JSON could not hold.
fn event(kind: &str, document: &impl Serialize) -> Event {
    Event::default().event(kind).data(serde_json::to_string(document).unwrap_or_default())
}

/// A comment, which readers skip.
fn sign_of_life() -> Event {
    Event::default().comment("alive")
}

#[cfg(test)]
mod tests {
    use densecloud_jobs::{Admitted, Draft, NewJob};
    use http_body_util::BodyExt;

    use super::*;
    use crate::testing;

    #[tokio::test]
    async fn events_are_framed_as_browsers_read_them() {
        let events = [event("deleted", &serde_json::json!({ "id": "ab12" })), sign_of_life()];
        let stream = stream::iter(events.map(Ok::<_, Infallible>));
        let body = Sse::new(stream).into_response().into_body();
        let text = axum::body::to_bytes(body, 1000).await.expect("a body");
        assert_eq!(text, "event: deleted\ndata: {\"id\":\"ab12\"}\n\n: alive\n\n");
    }

    #[tokio::test(start_paused = true)]
    async fn watching_asks_the_database_only_when_a_job_has_changed() {
        let (app, folder) = testing::app();
        let jobs = Arc::clone(app.jobs().expect("jobs"));
        let job = NewJob {
            request: String::new(),
            key: None,
            owner: String::new(),
            client: String::new(),
            request_id: "id-1".into(),
            points_in: 1,
            points_out: 4,
            result_bytes: 1,
            input: Arc::new(b"1 2 3\n".to_vec()),
        };
        let draft = Draft::new(job).expect("a draft");
        let Admitted::New(id) = jobs.store().admit(&draft).expect("room") else { panic!("no key") };
        let input = jobs.store().write_input(&id, &draft).expect("room");
        jobs.insert(&draft, input).expect("room");
        let (client, prefix) = (Extension(Client::new("")), Extension(Prefix::default()));
        let answer = events(Shared(Arc::clone(&app)), client, prefix, None, JobId(id.clone())).await;
        let mut body = answer.expect("its events").into_body();
        let mut next = async || {
            let frame = body.frame().await.expect("an event").expect("no fault");
            String::from_utf8(frame.into_data().expect("bytes").to_vec()).expect("text")
        };
        let first = next().await;
        assert!(first.starts_with("event: progress\n") && first.contains("\"attempts\":0"), "{first}");
        // What only the database knows, behind the server's back.
        let database = rusqlite::Connection::open(folder.path().join("jobs.sqlite")).expect("a database");
        database.execute("UPDATE jobs SET attempts = 7", []).expect("no lock");
        for _ in 0..3 {
            assert_eq!(next().await, ": alive\n\n");
        }
        jobs.delete(&id).expect("no fault");
        let last = next().await;
        assert!(last.starts_with("event: cancelled\n") && last.contains("\"attempts\":7"), "{last}");
    }
}
