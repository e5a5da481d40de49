//! Health, reflection, and methods that are not there.

use std::time::Duration;

use densecloud_engine::EngineConfig;
use densecloud_server::Config;
use densecloud_server::proto::{NumberType, UpsampleRequest};
use futures::stream;
use tonic::{Code, Request};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_types::StatusExt;

use super::*;
use crate::support::{Scripted, Server};

#[tokio::test(flavor = "multi_thread")]
async fn health_follows_readiness_from_warm_up_to_the_end() {
    let backend = Scripted::new();
    backend.shut();
    let mut config = Config::default();
    // So long that waiting for it would run into the test's own limit.
    config.timeouts.drain = Duration::from_secs(600);
    config.timeouts.head = Duration::from_secs(600);
    let mut server = Server::start_cold(&backend, EngineConfig::default(), config);
    let mut health = HealthClient::new(channel(&server));
    let of = |service: &str| HealthCheckRequest { service: service.into() };
    let mut watches = Vec::new();
    for service in ["", "densecloud.v1.Upsampler"] {
        let found = health.check(of(service)).await.expect("a status").into_inner();
        assert_eq!(found.status(), ServingStatus::NotServing, "{service}");
        let mut watch = health.watch(of(service)).await.expect("a watch").into_inner();
        assert_eq!(watch.message().await.unwrap().expect("a status").status(), ServingStatus::NotServing);
        watches.push(watch);
    }
    assert_eq!(health.check(of("other")).await.expect_err("unknown").code(), Code::NotFound);
    let mut unknown = health.watch(of("other")).await.expect("a watch").into_inner();
    assert_eq!(unknown.message().await.unwrap().expect("a status").status(), ServingStatus::ServiceUnknown);
    let request = || points(ratio(2.0), &plain(500), NumberType::Float32, 100);
    let status = asked(&server, request()).await.expect_err("warming up");
    assert_eq!(status.code(), Code::Unavailable);
    assert_eq!(status.get_error_details().error_info().expect("info").reason, "WARMING_UP");

    backend.open();
    for watch in &mut watches {
        assert_eq!(watch.message().await.unwrap().expect("a status").status(), ServingStatus::Serving);
    }
    assert_eq!(health.check(of("")).await.expect("a status").into_inner().status(), ServingStatus::Serving);

    // A call in flight, which keeps the server until it is over; a reflection that nobody ends, which does not.
    backend.shut();
    let mut reflection =
        tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient::new(channel(&server));
    let asked_once = reflection.server_reflection_info(stream::pending()).await.expect("a response");
    let mut last = client(&server);
    let last = tokio::spawn(async move { ask(&mut last, stream::iter(request())).await });
    server.wait_for_work();
    server.stop();
    for watch in &mut watches {
        assert_eq!(watch.message().await.unwrap().expect("a status").status(), ServingStatus::NotServing);
        assert!(watch.message().await.expect("a good end").is_none());
    }
    let status = asked(&server, points(ratio(2.0), &plain(500), NumberType::Float32, 100))
        .await
        .expect_err("stopping");
    assert_eq!(status.get_error_details().error_info().expect("info").reason, "DRAINING");
    backend.open();
    assert_eq!(last.await.unwrap().expect("an answer").header.points_out, 1000);
    assert!(asked_once.into_inner().message().await.expect("a good end").is_none());
    assert!(server.join().is_ok());
}

#[tokio::test(flavor = "multi_thread")]
async fn reflection_tells_what_there_is() {
    use tonic_reflection::pb::{v1, v1alpha};
    let expected = ["densecloud.v1.Upsampler", "grpc.health.v1.Health"];
    let server = Server::start(&Scripted::new(), Config::default());
    {
        use v1::server_reflection_request::MessageRequest;
        use v1::server_reflection_response::MessageResponse;
        let ask =
            |message| v1::ServerReflectionRequest { host: String::new(), message_request: Some(message) };
        let asked = [
            ask(MessageRequest::ListServices(String::new())),
            ask(MessageRequest::FileContainingSymbol("densecloud.v1.PointChunk".into())),
        ];
        let mut client = v1::server_reflection_client::ServerReflectionClient::new(channel(&server));
        let mut answer =
            client.server_reflection_info(stream::iter(asked)).await.expect("an answer").into_inner();
        let first = answer.message().await.unwrap().unwrap().message_response;
        let Some(MessageResponse::ListServicesResponse(list)) = first else { panic!("{first:?}") };
        let names: Vec<_> = list.service.iter().map(|service| service.name.as_str()).collect();
        assert!(expected.iter().all(|name| names.contains(name)), "{names:?}");
        let second = answer.message().await.unwrap().unwrap().message_response;
        assert!(matches!(second, Some(MessageResponse::FileDescriptorResponse(_))), "{second:?}");
    }
    {
        use v1alpha::server_reflection_request::MessageRequest;
        use v1alpha::server_reflection_response::MessageResponse;
        let message_request = Some(MessageRequest::ListServices(String::new()));
        let asked = [v1alpha::ServerReflectionRequest { host: String::new(), message_request }];
        let mut client = v1alpha::server_reflection_client::ServerReflectionClient::new(channel(&server));
        let mut answer =
            client.server_reflection_info(stream::iter(asked)).await.expect("an answer").into_inner();
        let first = answer.message().await.unwrap().unwrap().message_response;
        let Some(MessageResponse::ListServicesResponse(list)) = first else { panic!("{first:?}") };
        let names: Vec<_> = list.service.iter().map(|service| service.name.as_str()).collect();
        assert!(expected.iter().all(|name| names.contains(name)), "{names:?}");
    }
    assert_eq!(
        server.metric("densecloud_requests_total{interface=\"grpc\",outcome=\"ok\"}"),
        0.0,
        "not counted"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn other_methods_are_unimplemented_and_other_requests_find_nothing() {
    let server = Server::start(&Scripted::new(), Config::default());
    for path in ["/densecloud.v1.Upsampler/Downsample", "/densecloud.v2.Upsampler/Upsample", "/upsample"] {
        let mut client = tonic::client::Grpc::new(channel(&server));
        client.ready().await.expect("a connection");
        let codec = tonic_prost::ProstCodec::<UpsampleRequest, UpsampleRequest>::default();
        let call =
            client.unary(Request::new(UpsampleRequest { message: None }), path.parse().unwrap(), codec);
        let status = call.await.expect_err(path);
        let expected = if path == "/upsample" { Code::InvalidArgument } else { Code::Unimplemented };
        assert_eq!(status.code(), expected, "{path}: {status}");
    }
    let reply = server.post("/densecloud.v1.Upsampler/Upsample", b"{}");
    assert_eq!((reply.status, reply.problem_name().as_str()), (404, "not-found"));
    let mut old = server.connect();
    old.send(
        b"POST /densecloud.v1.Upsampler/Upsample HTTP/1.1\r\nhost: x\r\ncontent-type: application/grpc\r\n\
          content-length: 0\r\n\r\n",
    );
    let reply = old.reply();
    assert_eq!((reply.status, reply.problem_name().as_str()), (404, "not-found"), "HTTP/1.1 has no calls");
}
