//! What is answered, and what is refused.

use densecloud_cloud::Origin;
use densecloud_formats::{Format, PlyEncoding, Scalar};
use densecloud_server::Config;
use densecloud_server::proto::options::{Goal, Result as Wanted};
use densecloud_server::proto::upsample_request::Message as In;
use densecloud_server::proto::upsample_response::Message as Out;
use densecloud_server::proto::{Layout, NumberType, Options, Start, UpsampleRequest};
use futures::stream;
use tonic::codec::CompressionEncoding;
use tonic::{Code, Request};
use tonic_types::StatusExt;

use super::*;
use crate::support::{PLY, Scripted, Server, cloud, encode, wait_until};

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
            densecloud_formats::encode(Vec::new(), format, &cloud(2000), &[], &Origin::default()).unwrap();
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
        let reason = &details.error_info().expect("info").reason;
        assert_ne!(reason, "INTERRUPTED_BODY", "{part}");
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
