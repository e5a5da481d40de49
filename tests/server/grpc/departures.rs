//! Clients that leave, that stall, that have no time; a server that is full or fails.

use std::time::Duration;

use axum::body::{Body, Bytes};
use densecloud_engine::EngineConfig;
use densecloud_server::Config;
use densecloud_server::proto::upsampler_client::UpsamplerClient;
use densecloud_server::proto::{NumberType, UpsampleRequest};
use futures::stream::{self, Stream, StreamExt};
use http_body_util::BodyExt;
use tonic::Code;
use tonic::transport::Endpoint;
use tonic_types::StatusExt;

use super::*;
use crate::support::{PATIENCE, Scripted, Server, wait_until};

const CANCELLED: &str = "densecloud_requests_total{interface=\"grpc\",outcome=\"cancelled\"}";

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_leaves_stops_its_work() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    let before = backend.batches();
    backend.shut();
    let request = stream::iter(points(ratio(64.0), &plain(2000), NumberType::Float32, 500));
    let answer = client(&server).upsample(request).await.expect("a response");
    server.wait_for_work();
    drop(answer);
    wait_until("it is counted", || server.metric(CANCELLED) == 1.0);
    backend.open();
    server.wait_for_no_work();
    assert!(backend.batches() - before <= 4, "{} batches", backend.batches() - before);
    wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
    assert_eq!(server.metric("densecloud_requests_in_flight"), 0.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_leaves_while_it_sends_gives_everything_back() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut messages = points(ratio(2.0), &plain(2000), NumberType::Float32, 500);
    messages.pop();
    // A runtime of its own, which takes the connection with it when it ends.
    let elsewhere =
        tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let address = format!("http://{}", server.address);
    elsewhere.spawn(async move {
        let mut client = UpsamplerClient::new(Endpoint::from_shared(address).unwrap().connect_lazy());
        ask(&mut client, open(messages)).await
    });
    // Beside what a half message may take.
    wait_until("some has arrived", || {
        server.metric("densecloud_held_bytes") >= 18_000.0 + f64::from(4 << 20)
    });
    elsewhere.shutdown_background();
    wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
    wait_until("it is counted", || server.metric(CANCELLED) == 1.0);
}

/// A server whose patience is short.
fn impatient() -> Config {
    let mut config = Config::default();
    config.timeouts.stall = Duration::from_millis(200);
    config
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_stops_sending_is_told_so() {
    let server = Server::start(&Scripted::new(), impatient());
    let mut messages = points(ratio(2.0), &plain(2000), NumberType::Float32, 500);
    messages.pop();
    for messages in [messages, Vec::new()] {
        let status = ask(&mut client(&server), open(messages)).await.expect_err("stalled");
        assert_eq!(status.code(), Code::DeadlineExceeded, "{status}");
        assert!(status.message().contains("--stall-timeout"), "{status}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn work_may_take_longer_than_a_client_may_stall() {
    let backend = Scripted::new();
    let server = Server::start(&backend, impatient());
    backend.shut();
    let request = points(ratio(2.0), &plain(500), NumberType::Float32, 100);
    let mut client = client(&server);
    let answer = tokio::spawn(async move { ask(&mut client, stream::iter(request)).await });
    server.wait_for_work();
    tokio::time::sleep(5 * impatient().timeouts.stall).await;
    backend.open();
    assert_eq!(answer.await.unwrap().expect("an answer").header.points_out, 1000);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_reader_that_stops_reading_is_cut_off_and_does_not_find_its_result_whole() {
    let server = Server::start(&Scripted::new(), impatient());
    let request = stream::iter(points(ratio(64.0), &plain(1000), NumberType::Float64, 1000));
    let channel = Endpoint::from_shared(format!("http://{}", server.address)).unwrap();
    let channel = channel.initial_stream_window_size(65_535).connect_lazy();
    let mut answer = UpsamplerClient::new(channel).upsample(request).await.expect("a response").into_inner();
    wait_until("the result is there", || server.metric("densecloud_points_out_total") == 64_000.0);
    wait_until("its memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
    wait_until("it is counted", || server.metric(CANCELLED) == 1.0);
    let ended = loop {
        match answer.message().await {
            Ok(Some(_)) => {}
            other => break other,
        }
    };
    assert!(ended.is_err(), "{ended:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_servers_deadline_counts_everything() {
    let backend = Scripted::new();
    let mut config = Config::default();
    config.timeouts.request = Duration::from_millis(300);
    let server = Server::start(&backend, config);
    backend.shut();
    let status =
        asked(&server, points(ratio(2.0), &plain(500), NumberType::Float32, 100)).await.expect_err("late");
    assert_eq!(status.code(), Code::DeadlineExceeded, "{status}");
    assert!(status.message().contains("--request-timeout"), "{status}");
    backend.open();
    server.wait_for_no_work();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_calls_own_deadline_holds_where_it_is_sooner() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    backend.shut();
    // The generated client would give up by itself; this one only says that it will.
    let messages = points(ratio(2.0), &plain(500), NumberType::Float32, 500);
    let response = raw(&server, &[("grpc-timeout", "300m")], stream::iter(messages)).await;
    let body =
        tokio::time::timeout(PATIENCE, response.into_body().collect()).await.expect("in time").unwrap();
    assert_eq!(
        body.trailers().expect("trailers")["grpc-status"],
        (Code::DeadlineExceeded as i32).to_string()
    );
    backend.open();
    server.wait_for_no_work();
}

/// A message as it is sent.
fn framed(message: &UpsampleRequest) -> Bytes {
    use prost::Message;
    let bytes = message.encode_to_vec();
    [&[0][..], &(bytes.len() as u32).to_be_bytes(), &bytes].concat().into()
}

/// A call by hand, whose response has begun.
async fn raw(
    server: &Server,
    headers: &[(&str, &str)],
    messages: impl Stream<Item = UpsampleRequest> + Send + 'static,
) -> axum::http::Response<hyper::body::Incoming> {
    let uri = format!("http://{}/densecloud.v1.Upsampler/Upsample", server.address);
    let mut request = axum::http::Request::post(uri).header("content-type", "application/grpc");
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let body = Body::from_stream(messages.map(|message| Ok::<_, std::io::Error>(framed(&message))));
    let stream = tokio::net::TcpStream::connect(server.address).await.unwrap();
    let (executor, io) = (hyper_util::rt::TokioExecutor::new(), hyper_util::rt::TokioIo::new(stream));
    let (mut sender, connection) = hyper::client::conn::http2::handshake(executor, io).await.unwrap();
    tokio::spawn(connection);
    let response = sender.send_request(request.body(body).unwrap());
    tokio::time::timeout(PATIENCE, response).await.expect("in time").expect("a response")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_server_says_when_to_come_back() {
    let backend = Scripted::new();
    let sizes =
        EngineConfig { threads: 1, queue_points: 1000, client_points: 1000, ..EngineConfig::default() };
    let server = Server::start_cold(&backend, sizes, Config::default());
    server.wait_for_ready();
    backend.shut();
    let request = || points(ratio(4.0), &plain(200), NumberType::Float32, 100);
    let first = client(&server).upsample(stream::iter(request())).await.expect("a response");
    server.wait_for_work();
    let status = asked(&server, request()).await.expect_err("full");
    assert_eq!(status.code(), Code::Unavailable, "{status}");
    let details = status.get_error_details();
    assert_eq!(details.error_info().expect("info").reason, "QUEUE_FULL");
    let wait = details.retry_info().expect("when").retry_delay.expect("a delay");
    assert!(wait >= Duration::from_secs(1), "{wait:?}");
    backend.open();
    drop(first);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_fails_inside_stays_inside() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    backend.fail();
    let status =
        asked(&server, points(ratio(2.0), &plain(500), NumberType::Float32, 100)).await.expect_err("broken");
    assert_eq!(status.code(), Code::Internal);
    assert!(!format!("{status:?}").contains("secret"), "{status:?}");
    let counted = "densecloud_requests_total{interface=\"grpc\",outcome=\"internal\"}";
    wait_until("it is counted", || server.metric(counted) == 1.0);
}
