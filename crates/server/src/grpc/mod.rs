//! The gRPC interface, on the port of the HTTP one: a cloud in messages in, the dense cloud in messages
//! out, as `proto/densecloud/v1/densecloud.proto` describes it; health and reflection beside it.
//!
//! | file | holds |
//! |---|---|
//! | `upsample` | the method: one task a call, its deadline, its end |
//! | `start` | the first message: what is wanted, and how the cloud comes |
//! | `incoming`, `outgoing` | the cloud's messages in, and the result's out |
//! | `health` | `grpc.health.v1`, over the server's readiness |
//!
//! The work is that of [`crate::http::upsample`], of which this is another door: columns of numbers are a
//! NumPy file to it, so that limits, errors and results are the same.

mod health;
mod incoming;
mod outgoing;
mod start;
mod tiles;
mod upsample;

use std::convert::Infallible;
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{Version, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use tonic::codec::CompressionEncoding;
use tonic::server::NamedService;
use tonic_health::pb::health_server::HealthServer;
use tonic_reflection::server::Builder;
use tower::Service;

use crate::app::App;
use crate::connection::record::Early;
use crate::problem::Problem;
use crate::proto;
use crate::proto::upsampler_server::UpsamplerServer;

/// The largest message taken, the default of most gRPC libraries; one that is cut off in the middle takes
/// that much memory.
const MESSAGE: usize = 4 << 20;
/// Bytes of a chunk of a result.
const CHUNK: usize = 256 << 10;
/// No chunk is larger.
const LARGEST_CHUNK: usize = 1 << 20;

/// All services.
pub(super) fn routes(app: &Arc<App>) -> Router<Arc<App>> {
    let upsampler = UpsamplerServer::new(upsample::Calls::new(Arc::clone(app)))
        .max_decoding_message_size(MESSAGE)
        .accept_compressed(CompressionEncoding::Gzip);
    let mut router = add(Router::new(), upsampler);
    router = add(router, HealthServer::new(health::Health::new(Arc::clone(app))));
    let mut reflection = Router::new();
    // Fails for a broken descriptor alone, and a test lists the services.
    if let Ok(service) = described().build_v1() {
        reflection = add(reflection, service);
    }
    if let Ok(service) = described().build_v1alpha() {
        reflection = add(reflection, service);
    }
    reflection = reflection.route_layer(middleware::from_fn_with_state(Arc::clone(app), until_draining));
    router.merge(reflection).route_layer(middleware::from_fn(calls_alone))
}

/// Adds all methods of a service.
fn add<S>(router: Router<Arc<App>>, service: S) -> Router<Arc<App>>
where
    S: NamedService + Service<Request, Error = Infallible> + Clone + Send + Sync + 'static,
    S::Response: IntoResponse,
    S::Future: Send + 'static,
{
    router.route_service(&format!("/{}/{{method}}", S::NAME), service)
}

fn described() -> Builder<'static> {
    Builder::configure()
        .register_encoded_file_descriptor_set(proto::DESCRIPTOR)
        .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
}

/// Whether a request is a call: what its errors look like follows from it.
/// HTTP/1.1 has no place for a status that comes last.
pub(super) fn is_call(request: &Request) -> bool {
    let kind = request.headers().get(header::CONTENT_TYPE).map(|value| value.as_bytes());
    request.version() == Version::HTTP_2 && kind.is_some_and(|kind| kind.starts_with(b"application/grpc"))
}

/// Whether a path is asked again and again, to see whether the server is well, or what it offers.
pub(super) fn is_probe(path: &str) -> bool {
    path.starts_with("/grpc.health.") || path.starts_with("/grpc.reflection.")
}

/// A problem as the whole answer to a call.
pub(super) fn refusal(problem: &Problem, request_id: &str) -> Response {
    problem.grpc(request_id).into_http()
}

/// Hides these paths from everything that is no call.
async fn calls_alone(request: Request, next: Next) -> Response {
    if is_call(&request) { next.run(request).await } else { Problem::NotFound.into_response() }
}

/// Ends the client's side of a call, and so the call, when the server stops.
async fn until_draining(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let request = request.map(|body| {
        let draining = async move { app.readiness.draining().await };
        Body::from_stream(body.into_data_stream().take_until(Box::pin(draining)))
    });
    let mut response = next.run(request).await;
    response.extensions_mut().insert(Early);
    response
}
