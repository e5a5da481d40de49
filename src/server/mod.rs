//! The HTTP and gRPC interfaces: `POST /upsample` over the [`engine`](crate::engine), `/jobs` over
//! [`jobs`](crate::jobs), and what operators need around it (`/healthz`, `/readyz`, `/metrics`).
//!
//! | file | holds |
//! |---|---|
//! | `accept` | the loop that accepts connections, and each connection's life |
//! | `activity` | when a connection, or an answer on one, counts as dead |
//! | `app` | what handlers share; the table of paths |
//! | `record` | around each request: id, log, metrics |
//! | `upsample` | the handler, from body to body |
//! | `inference` | the same work as tensors in JSON or binary: the Open Inference Protocol |
//! | `grpc` | the same work in messages, on the same port; health and reflection |
//! | `jobs`, `jobs_document`, `jobs_result`, `jobs_events` | jobs: taking, telling, sending, watching |
//! | `jobs_work` | what a job is about, for the threads that run it |
//! | `compress` | around answers: gzip or zstd, where the client asks for it |
//! | `query`, `form`, `upload`, `decode`, `download` | its parts: parameters, forms, the body in, what compresses it, the body out |
//! | `problem` | every failure, its status and its words: the one table |
//! | `openapi` | the interface described, for programs and for people |
//! | `client`, `keys` | who asks |
//! | `parsing` | turns at parsing, fair among clients |
//! | `ticket`, `deadline` | what a request has been promised: points, and until when |
//! | `cors` | pages from other sites |
//! | `config`, `budget`, `readiness`, `metrics`, `request_id` | one noun each |
//!
//! Invariants: nothing blocks the async threads; no wait is without a deadline; memory grows with
//! what arrives and is counted, not with what is claimed; work belongs to the request's future, so a
//! client that leaves stops it.

mod accept;
mod accepted;
mod activity;
mod app;
mod budget;
mod client;
mod compress;
mod config;
mod cors;
mod deadline;
mod decode;
mod download;
mod form;
mod grpc;
mod inference;
mod jobs;
mod jobs_document;
mod jobs_events;
mod jobs_result;
mod jobs_work;
mod keys;
mod metrics;
mod openapi;
mod parsing;
mod problem;
mod query;
mod readiness;
mod record;
mod request_id;
mod ticket;
mod upload;
mod upsample;

use std::sync::Arc;
use std::time::Duration;

use sd_notify::NotifyState;
use tokio::net::TcpListener;
use tokio::sync::watch;
use tokio::task::{JoinSet, spawn_blocking};
use tokio::time::{Instant, interval, sleep, timeout_at};

pub use client::Access;
pub use config::{Config, ConfigError, Limits, ModelInfo, Timeouts};
pub use cors::CorsOrigin;
pub use keys::{Keys, KeysError};

use crate::engine::{Engine, EngineError};
use crate::jobs::{Jobs, StoreError};
use app::App;

/// Why a server did not start, or ended by itself.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The settings cannot work.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The model did not run.
    #[error("the model failed its warm-up: {0}")]
    WarmUp(EngineError),
    /// The folder of the jobs cannot be used.
    #[error("--data-dir {folder}: {why}")]
    Jobs {
        /// The folder.
        folder: String,
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
    let jobs = open_jobs(&config)?;
    let app = Arc::new(App::new(engine.clone(), config.clone(), jobs).map_err(|e| internal(&e))?);
    let warm_up = async {
        let start = Instant::now();
        match spawn_blocking(move || engine.warm_up()).await {
            Ok(Ok(())) => {
                tracing::info!(seconds = start.elapsed().as_secs_f64(), "ready");
                app.readiness.ready();
                tell_manager(NotifyState::Ready);
                if let Err(error) = jobs_work::start(&app) {
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
        tokio::join!(accept::accept(listener, router, &config, closing), drain(&app, shutdown, &close))
    };
    tokio::select! {
        (connections, deadline) = serve => {
            end(connections, deadline).await;
            join_jobs(&app, deadline).await;
        }
        error = warm_up => return Err(error),
        () = fold => {}
    }
    tracing::info!("stopped");
    Ok(())
}

/// Opens the store; blocks for moments, before anything is served.
fn open_jobs(config: &Config) -> Result<Option<Arc<Jobs>>, ServeError> {
    let Some(settings) = &config.jobs else { return Ok(None) };
    match Jobs::open(settings.clone()) {
        Ok(jobs) => Ok(Some(Arc::new(jobs))),
        Err(why) => Err(ServeError::Jobs { folder: settings.folder.display().to_string(), why }),
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
    tell_manager(NotifyState::Stopping);
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

/// Without effect where no manager waits.
fn tell_manager(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::warn!(%error, "the service manager cannot be told");
    }
}

/// Lets connections send what they still buffer, and drops those that take longer.
async fn end(mut connections: JoinSet<()>, deadline: Instant) {
    let all = async { while connections.join_next().await.is_some() {} };
    if timeout_at(deadline, all).await.is_err() {
        connections.shutdown().await;
    }
}
