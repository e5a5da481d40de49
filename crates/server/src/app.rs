//! What the handlers share, and the paths that they answer.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::State;
use axum::http::header;
use axum::middleware;
use axum::response::IntoResponse;
use metrics_exporter_prometheus::BuildError;
use tokio::sync::{Semaphore, watch};
use tokio::time::timeout;

use crate::admission::budget::Budget;
use crate::admission::client;
use crate::admission::parsing::Parsing;
use crate::config::{Config, Role};
use crate::connection::{compress, cors, head, prefix, record};
use crate::http::readiness::Readiness;
use crate::http::{openapi, upsample};
use crate::inference::statistics::Statistics;
use crate::metrics::Metrics;
use crate::problem::Problem;
use crate::route::{self, Route, delete, get, post};
use crate::{grpc, inference, jobs, page, points};
use densecloud_engine::Engine;
use densecloud_jobs::Jobs;

/// One server's state.
pub(super) struct App {
    pub(super) engine: Engine,
    pub(super) config: Config,
    pub(super) metrics: Metrics,
    /// Of requests of the Open Inference Protocol.
    pub(super) statistics: Statistics,
    pub(super) readiness: Readiness,
    pub(super) budget: Budget,
    /// The same of the folder for temporary files.
    pub(super) disk: Budget,
    /// None where the server has no folder for them.
    pub(super) jobs: Option<Arc<Jobs>>,
    // A semaphore: a question that nobody waits for any more keeps its turn until it is answered.
    pub(super) asking: Arc<Semaphore>,
    pub(super) parsing: Arc<Parsing>,
    /// For clouds of jobs that are written.
    pub(super) writing: Arc<Semaphore>,
    /// Requests whose response is not over, probes aside. A watch channel, so that a stopping server
    /// can wait for none.
    pub(super) in_flight: watch::Sender<usize>,
}

impl App {
    pub(super) fn new(engine: Engine, config: Config, jobs: Option<Arc<Jobs>>) -> Result<Self, BuildError> {
        Ok(Self {
            jobs,
            metrics: Metrics::new(&config.model)?,
            statistics: Statistics::default(),
            readiness: Readiness::new(),
            budget: Budget::new(config.limits.held_bytes),
            disk: Budget::new(config.limits.temp_bytes),
            asking: Arc::new(Semaphore::new(jobs::ASKING)),
            parsing: Arc::new(Parsing::new()),
            writing: Arc::new(Semaphore::new(jobs::WRITING)),
            in_flight: watch::Sender::new(0),
            engine,
            config,
        })
    }

    /// Checks points in, and the result's, against the limits.
    ///
    /// # Errors
    /// [`Problem::TooManyPointsIn`] or [`Problem::TooManyPointsOut`].
    pub(super) fn check_points(&self, points_in: u64, points_out: u64) -> Result<(), Problem> {
        let limits = &self.config.limits;
        if points_in > limits.points_in {
            return Err(Problem::TooManyPointsIn { points: points_in, limit: limits.points_in });
        }
        if points_out > limits.points_out {
            return Err(Problem::TooManyPointsOut { points: points_out, limit: limits.points_out });
        }
        Ok(())
    }

    pub(super) fn held_full(&self) -> Problem {
        Problem::HeldFull { used: self.budget.used(), limit: self.config.limits.held_bytes }
    }

    pub(super) fn disk_full(&self) -> Problem {
        Problem::TempFull { used: self.disk.used(), limit: self.config.limits.temp_bytes }
    }
}

/// What every program of a fleet tells of itself.
fn probes() -> Vec<Route> {
    vec![get("/healthz", healthz), get("/readyz", readyz), get("/metrics", metrics)]
}

/// All paths but those of gRPC.
pub(super) fn routes() -> Vec<Route> {
    let mut routes = vec![
        post("/upsample", upsample::upsample),
        get("/jobs", jobs::list),
        post("/jobs", jobs::submit),
        get("/jobs/{id}", jobs::get),
        delete("/jobs/{id}", jobs::delete),
        get("/jobs/{id}/result", jobs::result::result),
        get("/jobs/{id}/events", jobs::events::events),
        post("/points", points::of_body),
        get("/jobs/{id}/points", points::of_job),
        get("/", page::index),
        get("/page/{part}", page::part),
        get("/about", page::about),
        get("/estimate", page::estimate),
        get("/files/{number}", page::file),
        get("/openapi.json", openapi::openapi),
        get("/docs", openapi::docs),
    ];
    routes.extend(probes());
    routes.extend(inference::routes());
    routes
}

/// What answers every request.
pub(super) fn router(app: Arc<App>) -> Router {
    let routes = match app.config.role {
        Role::Server => route::router(routes()).merge(grpc::routes(&app)),
        Role::Worker => route::router(probes()),
    };
    let routes = routes
        .fallback(|| async { Problem::NotFound })
        .method_not_allowed_fallback(|| async { Problem::MethodNotAllowed })
        .layer(middleware::from_fn_with_state(Arc::clone(&app), client::identify))
        .layer(middleware::from_fn_with_state(Arc::clone(&app), compress::compress))
        .layer(middleware::from_fn_with_state(Arc::clone(&app), prefix::find))
        .layer(middleware::from_fn_with_state(Arc::clone(&app), cors::keep_out))
        .layer(middleware::from_fn(head::check));
    let routes = match cors::layer(&app.config.cors) {
        Some(cors) => routes.layer(cors),
        None => routes,
    };
    routes.layer(middleware::from_fn_with_state(Arc::clone(&app), record::record)).with_state(app)
}

/// How long `/metrics` waits for the jobs' figures.
const COUNTS: Duration = Duration::from_secs(1);

/// Alive, whatever it is doing.
async fn healthz() -> &'static str {
    "ok\n"
}

/// Whether to send requests here.
async fn readyz(State(app): State<Arc<App>>) -> Result<&'static str, Problem> {
    app.readiness.probe().map(|()| "ready\n")
}

async fn metrics(State(app): State<Arc<App>>) -> impl IntoResponse {
    // Where the store does not answer soon, the figures stay those of the last time; the log has the reason.
    let asked = jobs::ask(&app, |jobs| Ok((jobs.store().counts()?, jobs.store().waiting()?, jobs.now())));
    if let Ok(Ok((counts, waiting, now))) = timeout(COUNTS, asked).await {
        app.metrics.jobs(&counts, &waiting, now);
    }
    if let Some(jobs) = &app.jobs {
        app.metrics.fleet(jobs.beats_failed(), jobs.store().traffic());
    }
    let page = app.metrics.render(&app.engine, &app.config, app.budget.used());
    ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], page)
}
