//! `POST /points` and `GET /jobs/{id}/points`: the points of a cloud, packed to be shown, or in another format.
//!
//! | file | holds |
//! |---|---|
//! | `asked` | what a request asks for |
//! | `sample` | which points are sent, and in which order |
//! | `packed` | the packed form |
//! | `converted` | another format |

mod asked;
mod converted;
mod packed;
mod sample;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use axum::Extension;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, Uri};
use axum::response::Response;
use tokio::task::spawn_blocking;

pub(crate) use self::asked::MOST;
use self::asked::{As, Asked};
use crate::admission::deadline::Deadline;
use crate::app::App;
use crate::http::upload::Upload;
use crate::jobs::{JobId, finished};
use crate::problem::Problem;
use densecloud_engine::Client;
use densecloud_formats::{CloudReader, Header, Limits};

/// `POST /points`: of a cloud in the body.
pub(crate) async fn of_body(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    uri: Uri,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Problem> {
    let mut upload = Upload::new(&headers, body);
    let answer = match Deadline::of(&headers, app.config.timeouts.request) {
        Ok(deadline) => {
            deadline.enter("of upload");
            deadline.run(received(&app, &client, &deadline, (&uri, &headers), &mut upload)).await
        }
        Err(problem) => Err(problem),
    };
    upload.give_up();
    answer
}

async fn received(
    app: &Arc<App>,
    client: &Client,
    deadline: &Deadline,
    (uri, headers): (&Uri, &HeaderMap),
    upload: &mut Upload,
) -> Result<Response, Problem> {
    let asked = Asked::of(uri, headers)?;
    app.readiness.check()?;
    let known = |header: &Header| app.check_points(header.points.unwrap_or_default(), 0);
    let received = upload.receive_file(headers, app, &asked.reading, known).await?;
    deadline.enter("of parsing");
    let length = received.length();
    let open = move |app: &App, asked: &Asked| Ok((received.open(app, &asked.reading)?, received));
    answer(app, client, length, asked, open).await
}

/// `GET /jobs/{id}/points`: of a job's result.
pub(crate) async fn of_job(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    JobId(id): JobId,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let asked = Asked::of(&uri, &headers)?;
    let (result, file) = finished(&app, &client, id).await?;
    // Some formats are copied there to be sought in.
    let copy = app.disk.hold(result.bytes).ok_or_else(|| app.disk_full())?;
    let deadline = Deadline::of(&headers, app.config.timeouts.request)?;
    deadline.enter("of parsing");
    let open = move |app: &App, asked: &Asked| {
        let limits = Limits { max_points: Some(app.config.limits.points_out), max_bytes: None };
        Ok((CloudReader::open_as(file, limits, &asked.reading)?, copy))
    };
    deadline.run(answer(&app, &client, result.bytes, asked, open)).await
}

/// Reads a cloud when it is its turn, and answers with its points. What comes beside the reader is kept until all is read.
async fn answer<T>(
    app: &Arc<App>,
    client: &Client,
    bytes: u64,
    asked: Asked,
    open: impl FnOnce(&App, &Asked) -> Result<(CloudReader<'static>, T), Problem> + Send + 'static,
) -> Result<Response, Problem> {
    let turn = app.parsing.turn(client, bytes).await;
    let waiting = Waiting::default();
    let (shared, left) = (Arc::clone(app), Arc::clone(&waiting.0));
    let read = spawn_blocking(move || {
        let _turn = turn;
        let (reader, _kept) = open(&shared, &asked)?;
        match asked.shape {
            As::Packed => packed::answer(&shared, reader, &asked, &left),
            As::File(format) => converted::answer(&shared, reader, format),
        }
    });
    read.await.map_err(|error| Problem::Internal(error.to_string()))?
}

/// Tells a thread that nobody waits for it any more.
#[derive(Default)]
struct Waiting(Arc<AtomicBool>);

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
