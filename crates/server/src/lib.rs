//! The HTTP and gRPC interfaces: `POST /upsample` over the [`engine`](densecloud_engine), `/jobs` over
//! [`jobs`](densecloud_jobs), and what operators need around it (`/healthz`, `/readyz`, `/metrics`).
//!
//! | room | holds |
//! |---|---|
//! | `connection` | what stands around every request: sockets, log, encodings, other sites |
//! | `admission` | who asks, and what was promised: points, memory, turns, deadlines |
//! | `http` | `POST /upsample`, and the description of the interface |
//! | `inference` | the same work as tensors in JSON or binary: the Open Inference Protocol |
//! | `grpc` | the same work in messages, on the same port; health and reflection |
//! | `jobs` | jobs: taking, telling, sending, watching, running |
//! | `tiled` | clouds of more points than a tile: their steps, and what is sent while these go on |
//! | `points` | clouds packed to be shown, or in another format |
//! | `page` | the page at `/`, and what it alone asks |
//! | `problem` | every failure, its status and its words: the one table |
//! | `app`, `route`, `config`, `metrics` | what handlers share; the table of paths; settings; numbers for operators |
//! | `manager` | what a service manager is told |
//!
//! Invariants: nothing blocks the async threads; no wait is without a deadline; memory grows with
//! what arrives and is counted, not with what is claimed; work belongs to the request's future, so a
//! client that leaves stops it.

mod admission;
mod app;
mod config;
mod connection;
mod grpc;
mod http;
mod inference;
mod jobs;
mod manager;
mod metrics;
mod page;
mod points;
mod problem;
pub mod proto;
mod route;
#[cfg(test)]
mod testing;
mod tiled;

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{Instant, interval, sleep, timeout_at};

pub use admission::client::Access;
pub use admission::keys::{Keys, KeysError};
pub use config::{Config, ConfigError, Limits, LinesLost, ModelInfo, Role, Timeouts};
pub use connection::cors::CorsOrigin;
pub use connection::prefix::BasePath;

use app::App;
use densecloud_engine::{Engine, EngineError};
use densecloud_jobs::{Jobs, StoreError};
use densecloud_tiles::Folder;

/// Why a server did not start, or ended by itself.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The settings cannot work.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The model did not run.
    #[error("the model failed its warm-up: {0}")]
    WarmUp(EngineError),
    /// Where the jobs are kept cannot be used.
    #[error("{place}: {why}")]
    Jobs {
        /// The setting, and what it says where that is no secret.
        place: String,
        /// What is wrong with it.
        why: StoreError,
    },
    /// A part of the server broke; a bug.
    #[error("internal error: {0}")]
    Internal(String),
}

/// How often recorded durations are folded into their buckets.
const FOLD: Duration = Duration::from_secs(5);

/// Serves until `shutdown` resolves and what is in flight then is done, or has had
/// [`Timeouts::drain`].
///
/// Connections are taken at once; `/readyz` tells when the model has warmed up. After `shutdown`,
/// `/readyz` says so first; after [`Timeouts::lead`], new work is refused with 503, and probes are
/// still answered until the last request is over. What is not over by the deadline is cancelled.
/// A service manager that waits to be told (systemd's `Type=notify`) is told of both ends.
///
/// # Errors
/// See [`ServeError`].
pub async fn run(
    listener: TcpListener,
    engine: Engine,
    config: Config,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ServeError> {
    config.validate()?;
    let internal = |error: &dyn std::fmt::Display| ServeError::Internal(error.to_string());
    let mut shutdown = pin!(shutdown);
    let jobs = tokio::select! {
        opened = open_when_there(&config) => opened?,
        () = shutdown.as_mut() => {
            tracing::info!("stopped");
            return Ok(());
        }
    };
    let app = Arc::new(App::new(engine.clone(), config.clone(), jobs).map_err(|e| internal(&e))?);
    let warm_up = async {
        let start = Instant::now();
        match spawn_blocking(move || engine.warm_up()).await {
            Ok(Ok(())) => {
                tracing::info!(seconds = start.elapsed().as_secs_f64(), "ready");
                app.readiness.ready();
                manager::ready();
                if let Err(error) = jobs::work::start(&app) {
                    return internal(&error);
                }
                // The server goes on; only a failure ends it from here.
                std::future::pending().await
            }
            Ok(Err(error)) => ServeError::WarmUp(error),
            Err(error) => internal(&error),
        }
    };
    let fold = async {
        let mut ticks = interval(FOLD);
        loop {
            ticks.tick().await;
            app.metrics.fold();
        }
    };
    let (close, closing) = watch::channel(false);
    let serve = async {
        let router = app::router(Arc::clone(&app));
        tokio::join!(
            connection::accept::accept(listener, router, &config, closing),
            drain(&app, shutdown, &close)
        )
    };
    tokio::select! {
        (connections, deadline) = serve => {
            end(connections, deadline).await;
            join_jobs(&app, deadline).await;
            clear(&app).await;
        }
        error = warm_up => return Err(error),
        () = fold => {}
    }
    tracing::info!("stopped");
    Ok(())
}

/// Removes the tiles that threads still had as the last connection ended.
async fn clear(app: &App) {
    let folders = [app.config.temp_dir(), jobs::tiles::scratch(app)];
    // Only a panic could come back, and that is in the log.
    let _ = spawn_blocking(move || folders.iter().for_each(|folder| Folder::remove_own(folder))).await;
}

/// How long a database that does not answer is waited for at the start: it may start beside, or anew.
const START: Duration = Duration::from_secs(60);
/// Before it is asked again.
const AGAIN: Duration = Duration::from_secs(1);

/// Opens the store, as soon as its database answers.
async fn open_when_there(config: &Config) -> Result<Option<Arc<Jobs>>, ServeError> {
    let start = Instant::now();
    loop {
        let config = config.clone();
        let opened = spawn_blocking(move || open_jobs(&config)).await;
        match opened.map_err(|error| ServeError::Internal(error.to_string()))? {
            Err(ServeError::Jobs { why, place }) if why.is_away() && start.elapsed() < START => {
                tracing::warn!(%why, "{place} does not answer; it is asked again");
                sleep(AGAIN).await;
            }
            opened => return opened,
        }
    }
}

/// Opens the store; blocks for moments, before anything is served.
fn open_jobs(config: &Config) -> Result<Option<Arc<Jobs>>, ServeError> {
    let Some(settings) = &config.jobs else { return Ok(None) };
    match Jobs::open(settings.clone()) {
        Ok(jobs) => Ok(Some(Arc::new(jobs))),
        Err(why) => {
            let place = match (settings.folder(), &why) {
                (Some(folder), _) => format!("--data-dir {}", folder.display()),
                (None, StoreError::Io(_)) => "--store".to_owned(),
                (None, _) => "--database".to_owned(),
            };
            Err(ServeError::Jobs { place, why })
        }
    }
}

/// Puts running jobs back, so that the next start finds them queued. Those that a slow disk keeps it from are
/// found running, and queued then.
async fn stop_jobs(app: &App, deadline: Instant) {
    if let Some(jobs) = app.jobs.clone() {
        // Only a panic could come back, and that is in the log.
        let _ = timeout_at(deadline, spawn_blocking(move || jobs.stop())).await;
    }
}

/// Lets the threads of jobs see that nobody waits for them.
async fn join_jobs(app: &App, deadline: Instant) {
    if let Some(jobs) = app.jobs.clone() {
        let _ = timeout_at(deadline, spawn_blocking(move || jobs.join())).await;
    }
}

/// Waits for `shutdown`, then for the requests in flight, then closes; gives the deadline of all
/// that.
async fn drain(app: &App, shutdown: impl Future<Output = ()>, close: &watch::Sender<bool>) -> Instant {
    shutdown.await;
    manager::stopping();
    let lead = app.config.timeouts.lead;
    // Who was never told that it is ready sends nothing yet.
    if app.readiness.leave() && !lead.is_zero() {
        tracing::info!(seconds = lead.as_secs_f64(), "leaving: not ready any more, still serving");
        sleep(lead).await;
    }
    app.readiness.drain();
    let deadline = Instant::now() + app.config.timeouts.drain;
    stop_jobs(app, deadline).await;
    let mut in_flight = app.in_flight.subscribe();
    tracing::info!(in_flight = *in_flight.borrow(), "draining");
    if timeout_at(deadline, in_flight.wait_for(|count| *count == 0)).await.is_err() {
        tracing::warn!(in_flight = *app.in_flight.borrow(), "cancelling what is not done by the deadline");
    }
    close.send_replace(true);
    deadline
}

/// Lets connections send what they still buffer, and drops those that take longer.
async fn end(mut connections: JoinSet<()>, deadline: Instant) {
    let all = async { while connections.join_next().await.is_some() {} };
    if timeout_at(deadline, all).await.is_err() {
        connections.shutdown().await;
    }
}
