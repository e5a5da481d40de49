//! `GET /jobs/{id}/events`: a job's way to its end, as server-sent events.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::{Extension, Path, State};
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use futures::stream;
use tokio::sync::watch;
use tokio::time::{Instant, sleep};

use super::app::App;
use super::jobs_document::{Document, Progress};
use super::problem::Problem;
use crate::engine::Client;

/// How often progress is looked at; a change of state is told at once.
const TICK: Duration = Duration::from_millis(250);
/// Without news, proxies and our own watch over slow readers want a sign of life.
const ALIVE: Duration = Duration::from_secs(10);

/// The handler. An event has the name of its kind, `progress` or a final state, and the job as `GET
/// /jobs/{id}` tells it. The stream ends with the job, and when the server stops.
pub(super) async fn events(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let changes = app.jobs()?.changes();
    let first = Document::ask(&app, &client, id.clone()).await?;
    let alive = ALIVE.min(app.config.timeouts.stall / 3);
    let state = Events { app, client, id, changes, alive, first: Some(first), told: None, over: false };
    let body = Body::from_stream(stream::unfold(state, |mut events| async move {
        let text = events.next().await?;
        Some((Ok::<_, std::convert::Infallible>(Bytes::from(text)), events))
    }));
    let mut response = body.into_response();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    Ok(response)
}

struct Events {
    app: Arc<App>,
    client: Client,
    id: String,
    changes: watch::Receiver<()>,
    alive: Duration,
    first: Option<Document>,
    told: Option<News>,
    over: bool,
}

/// What makes an event of a document; expected times alone, which always change, do not.
type News = (&'static str, u32, Option<u64>, Progress);

impl Events {
    /// The next event's text; nothing after the last.
    async fn next(&mut self) -> Option<String> {
        let start = Instant::now();
        loop {
            if self.over || self.app.readiness.check() == Err(Problem::Draining) {
                return None;
            }
            // Before the question, so that no change between is missed.
            self.changes.mark_unchanged();
            let document = match self.first.take() {
                Some(first) => Ok(first),
                None => Document::ask(&self.app, &self.client, self.id.clone()).await,
            };
            let document = match document {
                Ok(document) => document,
                Err(Problem::NoJob(_)) => {
                    // Deleted or expired while it was watched.
                    self.over = true;
                    return Some(format!("event: deleted\ndata: {{\"id\":\"{}\"}}\n\n", self.id));
                }
                // The job is there all the same; its watcher waits, too.
                Err(error) => {
                    tracing::debug!(job = self.id, %error, "a watched job cannot be looked at");
                    sleep(TICK).await;
                    return Some(": alive\n\n".to_owned());
                }
            };
            let news = (document.state, document.attempts, document.position, document.progress.clone());
            if self.told.as_ref() != Some(&news) {
                self.told = Some(news);
                self.over = document.over;
                let kind = if document.over { document.state } else { "progress" };
                let data = serde_json::to_string(&document).unwrap_or_default();
                return Some(format!("event: {kind}\ndata: {data}\n\n"));
            }
            if start.elapsed() >= self.alive {
                return Some(": alive\n\n".to_owned());
            }
            tokio::select! {
                _ = self.changes.changed() => {}
                () = sleep(TICK) => {}
            }
        }
    }
}
