//! `grpc.health.v1`: whether calls are taken, asked once or watched.

use std::sync::Arc;

use futures::stream::{self, BoxStream, StreamExt};
use tonic::server::NamedService;
use tonic::{Request, Response, Status};
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_server;
use tonic_health::pb::{HealthCheckRequest, HealthCheckResponse};

use super::upsample::Calls;
use crate::app::App;
use crate::connection::record::Early;
use crate::problem::Problem;
use crate::proto::upsampler_server::UpsamplerServer;

/// As `/readyz`, for the whole server (the empty name) and for its one service.
pub(super) struct Health {
    app: Arc<App>,
}

const SERVICE: &str = <UpsamplerServer<Calls> as NamedService>::NAME;

impl Health {
    pub(super) fn new(app: Arc<App>) -> Self {
        Self { app }
    }
}

fn status(app: &App, service: &str) -> ServingStatus {
    match service {
        "" | SERVICE if app.readiness.probe().is_ok() => ServingStatus::Serving,
        "" | SERVICE => ServingStatus::NotServing,
        _ => ServingStatus::ServiceUnknown,
    }
}

fn reply(status: ServingStatus) -> HealthCheckResponse {
    HealthCheckResponse { status: status.into() }
}

#[tonic::async_trait]
impl health_server::Health for Health {
    async fn check(
        &self,
        request: Request<HealthCheckRequest>,
    ) -> Result<Response<HealthCheckResponse>, Status> {
        match status(&self.app, &request.get_ref().service) {
            ServingStatus::ServiceUnknown => {
                Err(Status::not_found(format!("there are \"\", the whole server, and {SERVICE:?}")))
            }
            known => Ok(Response::new(reply(known))),
        }
    }

    type WatchStream = BoxStream<'static, Result<HealthCheckResponse, Status>>;

    /// Tells the status now and when it changes; ends when the server stops.
    async fn watch(
        &self,
        request: Request<HealthCheckRequest>,
    ) -> Result<Response<Self::WatchStream>, Status> {
        let service = request.into_inner().service;
        let (app, changes) = (Arc::clone(&self.app), self.app.readiness.changes());
        let statuses = stream::unfold((app, changes, None), move |(app, mut changes, told)| {
            let service = service.clone();
            async move {
                loop {
                    // Before the question, so that no change between is missed.
                    changes.mark_unchanged();
                    let now = status(&app, &service);
                    if told != Some(now) {
                        return Some((Ok(reply(now)), (app, changes, Some(now))));
                    }
                    if app.readiness.check() == Err(Problem::Draining) {
                        return None;
                    }
                    // Cannot fail: `app` holds the sender.
                    let _ = changes.changed().await;
                }
            }
        });
        let mut response = Response::new(statuses.boxed());
        response.extensions_mut().insert(Early);
        Ok(response)
    }
}
