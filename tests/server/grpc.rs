//! The gRPC interface, with the client that is generated from the same contract.

use std::time::Duration;

use axum::body::{Body, Bytes};
use densecloud::cloud::{Attribute, Cloud, Origin, Values};
use densecloud::engine::EngineConfig;
use densecloud::formats::{CloudReader, Format, Limits, PlyEncoding, Scalar};
use densecloud::proto::options::{Goal, Result as Wanted};
use densecloud::proto::upsample_request::Message as In;
use densecloud::proto::upsample_response::Message as Out;
use densecloud::proto::upsampler_client::UpsamplerClient;
use densecloud::proto::{
    Field, Layout, NumberType, Options, PointChunk, Progress, ResultHeader, Start, UpsampleRequest,
};
use densecloud::server::Config;
use futures::stream::{self, Stream, StreamExt};
use http_body_util::BodyExt;
use tonic::codec::CompressionEncoding;
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Request, Status};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;
use tonic_types::StatusExt;

use crate::support::{PATIENCE, PLY, Scripted, Server, cloud, encode, wait_until};

const CANCELLED: &str = "densecloud_requests_total{interface=\"grpc\",outcome=\"cancelled\"}";

fn channel(server: &Server) -> Channel {
    Endpoint::from_shared(format!("http://{}", server.address)).unwrap().connect_lazy()
}

fn client(server: &Server) -> UpsamplerClient<Channel> {
    UpsamplerClient::new(channel(server))
}

fn message(message: In) -> UpsampleRequest {
    UpsampleRequest { message: Some(message) }
}

fn ratio(ratio: f64) -> Options {
    Options { goal: Some(Goal::Ratio(ratio)), ..Options::default() }
}

/// A file in pieces of `size` bytes.
fn file(options: Options, bytes: &[u8], size: usize) -> Vec<UpsampleRequest> {
    let start = Start { options: Some(options), layout: None };
    let chunks = bytes.chunks(size).map(|piece| message(In::FileChunk(piece.to_vec().into())));
    std::iter::once(message(In::Start(start))).chain(chunks).collect()
}

fn kind(values: &Values) -> NumberType {
    match values {
        Values::U8(_) => NumberType::Uint8,
        Values::I32(_) => NumberType::Int32,
        Values::U32(_) => NumberType::Uint32,
        Values::F32(_) => NumberType::Float32,
        other => panic!("no test has {other:?}"),
    }
}

fn layout(cloud: &Cloud, position_type: NumberType) -> Layout {
    let field = |a: &Attribute| Field { name: a.name.clone(), r#type: kind(&a.values).into() };
    Layout {
        points: cloud.positions.len() as u64,
        position_type: position_type.into(),
        fields: cloud.attributes.iter().map(field).collect(),
    }
}

/// A column's bytes.
fn column(values: &Values) -> Vec<u8> {
    match values {
        Values::U8(column) => column.clone(),
        Values::I32(column) => column.iter().flat_map(|n| n.to_le_bytes()).collect(),
        Values::U32(column) => column.iter().flat_map(|n| n.to_le_bytes()).collect(),
        Values::F32(column) => column.iter().flat_map(|n| n.to_le_bytes()).collect(),
        other => panic!("no test has {other:?}"),
    }
}

fn coordinates(cloud: &Cloud, position_type: NumberType) -> Vec<u8> {
    let numbers = cloud.positions.as_flattened().iter();
    match position_type {
        NumberType::Float32 => numbers.flat_map(|n| (*n as f32).to_le_bytes()).collect(),
        _ => numbers.flat_map(|n| n.to_le_bytes()).collect(),
    }
}

/// A cloud as columns, in chunks of `size` points.
fn points(options: Options, cloud: &Cloud, position_type: NumberType, size: usize) -> Vec<UpsampleRequest> {
    let layout = layout(cloud, position_type);
    let width = if position_type == NumberType::Float32 { 12 } else { 24 };
    let positions = coordinates(cloud, position_type);
    let columns: Vec<(Vec<u8>, usize)> =
        cloud.attributes.iter().map(|a| (column(&a.values), a.values.kind().size())).collect();
    let mut messages = vec![message(In::Start(Start { options: Some(options), layout: Some(layout) }))];
    for first in (0..cloud.positions.len()).step_by(size) {
        let end = cloud.positions.len().min(first + size);
        messages.push(message(In::Points(PointChunk {
            positions: positions[first * width..end * width].to_vec().into(),
            fields: columns.iter().map(|(c, size)| c[first * size..end * size].to_vec().into()).collect(),
        })));
    }
    messages
}

/// All that an answer has, put together.
#[derive(Debug, Default)]
struct Answer {
    progress: Vec<Progress>,
    header: ResultHeader,
    file: Vec<u8>,
    positions: Vec<u8>,
    fields: Vec<Vec<u8>>,
    chunks: usize,
}

async fn ask(
    client: &mut UpsamplerClient<Channel>,
    request: impl Stream<Item = UpsampleRequest> + Send + 'static,
) -> Result<Answer, Status> {
    let mut stream = client.upsample(request).await?.into_inner();
    let mut answer = Answer::default();
    let mut headers = 0;
    while let Some(message) = stream.message().await? {
        match message.message.expect("a message") {
            Out::Progress(progress) => {
                assert_eq!(headers, 0, "progress comes before the result");
                answer.progress.push(progress);
            }
            Out::Header(header) => {
                headers += 1;
                answer.fields = vec![Vec::new(); header.layout.as_ref().map_or(0, |l| l.fields.len())];
                answer.header = header;
            }
            Out::FileChunk(bytes) => {
                assert!(bytes.len() <= 1 << 20 && answer.header.layout.is_none());
                answer.chunks += 1;
                answer.file.extend(bytes);
            }
            Out::Points(chunk) => {
                answer.chunks += 1;
                answer.positions.extend(chunk.positions);
                for (all, more) in answer.fields.iter_mut().zip(chunk.fields) {
                    all.extend(more);
                }
            }
        }
    }
    assert_eq!(headers, 1, "one header");
    Ok(answer)
}

async fn asked(server: &Server, messages: Vec<UpsampleRequest>) -> Result<Answer, Status> {
    ask(&mut client(server), stream::iter(messages)).await
}

/// A client that sends these messages and then keeps its side open.
fn open(messages: Vec<UpsampleRequest>) -> impl Stream<Item = UpsampleRequest> + Send + 'static {
    stream::iter(messages).chain(stream::pending())
}

fn plain(points: usize) -> Cloud {
    cloud(points).into()
}

fn with_attributes(points: usize) -> Cloud {
    let mut cloud = plain(points);
    let numbers = 0..points as u32;
    let attribute = |name: &str, values| Attribute { name: name.into(), values };
    cloud.attributes = vec![
        attribute("red", Values::U8(numbers.clone().map(|i| i as u8).collect())),
        attribute("label", Values::I32(numbers.clone().map(|i| 7 - i as i32).collect())),
        attribute("warmth", Values::F32(numbers.map(|i| i as f32 * 0.1).collect())),
    ];
    cloud
}

fn npy(cloud: &Cloud, scalar: Scalar) -> Vec<u8> {
    let format = Format::Npy { scalar, fields: true };
    densecloud::formats::encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &Origin::default())
        .unwrap()
}

fn read(bytes: &[u8]) -> Cloud {
    CloudReader::open(bytes, Limits::default()).unwrap().read().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn columns_of_numbers_become_the_points_that_http_answers() {
    let server = Server::start(&Scripted::new(), Config::default());
    for (cloud, scalar, position_type) in [
        (plain(2000), Scalar::F32, NumberType::Float32),
        (plain(2000), Scalar::F64, NumberType::Float64),
        (with_attributes(2000), Scalar::F32, NumberType::Float32),
    ] {
        let http = server.post("/upsample?ratio=16&seed=7&source_fields=true", &npy(&cloud, scalar));
        assert_eq!(http.status, 200, "{}", http.text());
        let options = Options { seed: 7, source_fields: true, ..ratio(16.0) };
        let answer = asked(&server, points(options, &cloud, position_type, 333)).await.expect("an answer");
        assert!(answer.chunks > 1, "in chunks");
        assert_eq!((answer.header.points_in, answer.header.points_out), (2000, 32_000));
        assert_eq!(http.header("densecloud-provenance"), Some(answer.header.provenance.as_str()));
        assert_eq!(answer.header.media_type, "");
        let expected = read(&http.body);
        assert!(answer.positions == coordinates(&expected, position_type), "the same bytes");
        let found = answer.header.layout.expect("a layout");
        assert_eq!((found.points, found.position_type()), (32_000, position_type));
        let names: Vec<&str> = found.fields.iter().map(|field| field.name.as_str()).collect();
        let last = &names[names.len() - 2..];
        assert_eq!(last, ["source_index", "is_generated"]);
        if !cloud.attributes.is_empty() {
            // Named and typed in a file, too.
            assert_eq!(found, layout(&expected, position_type));
            for (attribute, bytes) in expected.attributes.iter().zip(&answer.fields) {
                assert!(column(&attribute.values) == *bytes, "{}", attribute.name);
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_in_pieces_becomes_the_file_that_http_answers() {
    let server = Server::start(&Scripted::new(), Config::default());
    let ascii = Format::Ply { encoding: PlyEncoding::Ascii, scalar: Scalar::F64 };
    for format in [PLY, ascii, Format::TEXT, Format::Las { compressed: true }] {
        let bytes =
            densecloud::formats::encode(Vec::new(), format, &cloud(2000), &[], &Origin::default()).unwrap();
        let http = server.post("/upsample?points=9000", &bytes);
        let options = Options { goal: Some(Goal::Points(9000)), ..Options::default() };
        let answer = asked(&server, file(options, &bytes, 777)).await.expect("an answer");
        assert!(answer.file == http.body, "{format:?}");
        assert_eq!(Some(answer.header.media_type.as_str()), http.header("content-type"));
        assert_eq!(answer.header.layout, None);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_comes_as_a_file_may_go_as_columns_and_the_other_way() {
    let server = Server::start(&Scripted::new(), Config::default());
    let bytes = encode(&cloud(500), PLY);
    let expected = read(&server.post("/upsample?ratio=2", &bytes).body);
    let options = Options { result: Some(Wanted::AsPoints(true)), ..ratio(2.0) };
    let answer = asked(&server, file(options, &bytes, 4096)).await.expect("an answer");
    assert_eq!(answer.header.layout.expect("a layout").position_type(), NumberType::Float32);
    assert!(answer.positions == coordinates(&expected, NumberType::Float32));

    let options = Options { result: Some(Wanted::MediaType("text/csv".into())), ..ratio(2.0) };
    let answer =
        asked(&server, points(options, &plain(500), NumberType::Float32, 100)).await.expect("an answer");
    assert_eq!(answer.header.media_type, "text/csv; charset=utf-8");
    assert_eq!(String::from_utf8(answer.file).unwrap().lines().count(), 1000);
}

#[tokio::test(flavor = "multi_thread")]
async fn coordinates_that_32_bits_are_too_coarse_for_come_back_in_64() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut cloud = plain(500);
    for position in &mut cloud.positions {
        *position =
            [position[0] + 465_123.25, position[1] + 5_204_987.5, position[2]].map(|c| f64::from(c as f32));
    }
    let answer =
        asked(&server, points(ratio(2.0), &cloud, NumberType::Float32, 100)).await.expect("an answer");
    assert_eq!(answer.header.layout.expect("a layout").position_type(), NumberType::Float64);
    assert_eq!(answer.positions.len(), 1000 * 24);
}

#[tokio::test(flavor = "multi_thread")]
async fn too_many_points_are_refused_before_they_arrive() {
    let mut config = Config::default();
    config.limits.points_in = 1000;
    config.limits.points_out = 3000;
    let server = Server::start(&Scripted::new(), config);
    let start = |points, options| {
        let layout = Layout { points, position_type: NumberType::Float32.into(), fields: Vec::new() };
        vec![message(In::Start(Start { options: Some(options), layout: Some(layout) }))]
    };
    let ply = b"ply\nformat binary_little_endian 1.0\nelement vertex 4294967295\nproperty float x\nproperty float y\n\
                property float z\nend_header\n";
    for (messages, reason, setting) in [
        (start(1001, ratio(2.0)), "TOO_MANY_POINTS_IN", "--max-points-in"),
        (start(u64::MAX, ratio(2.0)), "TOO_MANY_POINTS_IN", "--max-points-in"),
        (start(1000, ratio(4.0)), "TOO_MANY_POINTS_OUT", "--max-points-out"),
        (file(ratio(2.0), ply, 50), "TOO_MANY_POINTS_IN", "--max-points-in"),
    ] {
        let status = ask(&mut client(&server), open(messages)).await.expect_err(reason);
        assert_eq!(status.code(), Code::ResourceExhausted, "{status}");
        assert!(status.message().contains(setting), "{status}");
        let details = status.get_error_details();
        let info = details.error_info().expect("info");
        assert_eq!((info.reason.as_str(), info.domain.as_str()), (reason, "densecloud"));
        assert_eq!(info.metadata["setting"], setting);
        assert!(details.retry_info().is_none(), "it would be refused again");
    }
    wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
    let counted = "densecloud_requests_total{interface=\"grpc\",outcome=\"too-many-points-in\"}";
    wait_until("they are counted", || server.metric(counted) == 3.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_is_named() {
    let mut config = Config::default();
    config.limits.body_bytes = 100_000;
    let server = Server::start(&Scripted::new(), config);
    let bytes = encode(&cloud(100), PLY);
    let fine = |options| file(options, &bytes, 1000);
    let columns = || points(ratio(2.0), &plain(100), NumberType::Float32, 50);
    let chunk = || message(In::FileChunk(bytes.clone().into()));
    let without = |mut messages: Vec<_>, index| {
        messages.remove(index);
        messages
    };
    let with = |mut messages: Vec<_>, more| {
        messages.push(more);
        messages
    };
    let wanted =
        |media_type: &str| Options { result: Some(Wanted::MediaType(media_type.into())), ..ratio(2.0) };
    let invalid = Code::InvalidArgument;
    for (messages, code, part) in [
        (fine(Options::default()), invalid, "ratio"),
        (fine(ratio(65.0)), invalid, "from 1 to 64"),
        (fine(Options { attributes: "x".into(), ..ratio(2.0) }), invalid, "NAME:mean"),
        (fine(Options { attributes: "red:drop".into(), ..ratio(2.0) }), invalid, "no attribute"),
        (fine(wanted("image/png")), invalid, "image/png"),
        (fine(wanted("a\nb")), invalid, "a\\nb"),
        (vec![], invalid, "first message"),
        (vec![chunk()], invalid, "first message"),
        (vec![UpsampleRequest { message: None }], invalid, "first message"),
        (with(fine(ratio(2.0)), fine(ratio(2.0)).remove(0)), invalid, "second `start`"),
        (with(fine(ratio(2.0)), columns().remove(1)), invalid, "no layout"),
        (with(columns(), chunk()), invalid, "has a layout"),
        (with(columns(), columns().remove(1)), invalid, "150 points"),
        (without(columns(), 2), invalid, "50 points together"),
        (without(fine(ratio(2.0)), 1), invalid, "PLY"),
        (fine(ratio(2.0)).into_iter().take(2).collect(), invalid, "73 are there"),
        (fine(ratio(2.0)).into_iter().take(1).collect(), invalid, "no points"),
        (file(ratio(2.0), b"PK\x03\x04 and more", 1000), invalid, "ZIP"),
        (points(ratio(2.0), &plain(5), NumberType::Float32, 50), invalid, "5"),
        (file(ratio(2.0), &vec![b' '; 100_001], 50_000), Code::ResourceExhausted, "--max-body-bytes"),
        (
            points(ratio(2.0), &plain(10_000), NumberType::Float32, 50),
            Code::ResourceExhausted,
            "--max-body-bytes",
        ),
        (file(ratio(2.0), &vec![b' '; 5 << 20], 5 << 20), invalid, "smaller chunks"),
    ] {
        let status = asked(&server, messages).await.expect_err(part);
        assert_eq!(status.code(), code, "{part}: {status}");
        assert!(status.message().contains(part), "{part}: {status}");
        let details = status.get_error_details();
        let id = &details.request_info().expect("info").request_id;
        assert!(!id.is_empty(), "{part}");
    }
    assert_eq!(server.engine.queued_points(), 0);
    wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_id_comes_back() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut request = Request::new(stream::iter(file(ratio(99.0), b"", 1)));
    request.metadata_mut().insert("x-request-id", "mine-7".parse().unwrap());
    let response = client(&server).upsample(request).await.expect("a response");
    assert_eq!(response.metadata().get("x-request-id").expect("an id"), "mine-7");
    let status = response.into_inner().message().await.expect_err("a bad ratio");
    assert_eq!(status.get_error_details().request_info().expect("info").request_id, "mine-7");
    assert_eq!(status.get_error_details().bad_request().expect("why").field_violations[0].field, "ratio");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_compressed_request_is_read_and_its_size_is_that_of_what_comes_out() {
    let server = Server::start(&Scripted::new(), Config::default());
    let mut client = client(&server).send_compressed(CompressionEncoding::Gzip);
    let answer =
        ask(&mut client, stream::iter(points(ratio(2.0), &plain(500), NumberType::Float64, 100))).await;
    assert_eq!(answer.expect("an answer").positions.len(), 1000 * 24);
    let bomb = file(ratio(2.0), &vec![b' '; 64 << 20], 64 << 20);
    let status = ask(&mut client, stream::iter(bomb)).await.expect_err("64 MiB out of 64 KiB");
    assert_eq!(status.code(), Code::InvalidArgument, "{status}");
}

#[tokio::test(flavor = "multi_thread")]
async fn progress_is_told_while_the_work_goes_on() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    backend.shut();
    let mut client = client(&server);
    let request = stream::iter(points(ratio(4.0), &plain(500), NumberType::Float32, 100));
    let mut answer = client.upsample(request).await.expect("a response").into_inner();
    let Some(Out::Progress(first)) = answer.message().await.unwrap().unwrap().message else {
        panic!("no progress")
    };
    assert!((0.0..1.0).contains(&first.fraction), "{first:?}");
    backend.open();
    let mut last = None;
    while let Some(message) = answer.message().await.expect("it goes on") {
        last = message.message;
    }
    assert!(matches!(last, Some(Out::Points(_))), "{last:?}");
}

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
    assert_eq!(old.reply().header("grpc-status"), Some("12"), "unimplemented");
}
