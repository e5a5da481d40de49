//! What is refused, with which status, and how early.

use std::io::Write;
use std::time::Duration;

use densecloud_engine::EngineConfig;
use densecloud_server::{Config, Limits};

use crate::support::{PLY, Scripted, Server, cloud, encode, wait_until};

fn limits() -> Limits {
    Limits { body_bytes: 20_000, points_in: 1000, points_out: 4000, held_bytes: 200_000, ..Limits::default() }
}

#[test]
fn each_kind_of_bad_request_has_its_status_and_its_name() {
    let server = Server::start(&Scripted::new(), Config { limits: limits(), ..Config::default() });
    let good = encode(&cloud(100), PLY);
    let truncated = &good[..good.len() - 1];
    let few = encode(&cloud(5), PLY);
    let equal = encode(&[[1.0; 3]; 50], PLY);
    let many = encode(&cloud(1001), PLY);
    let text = "1 2 3\n".repeat(1001);
    for (target, body, status, name) in [
        ("/upsample", &good[..], 400, "invalid-parameter"),
        ("/upsample?ratio=65", &good, 400, "invalid-parameter"),
        ("/upsample?ratio=4&ratio=4", &good, 400, "invalid-parameter"),
        ("/upsample?ratio=4&colour=red", &good, 400, "invalid-parameter"),
        ("/upsample?ratio=4", b"ply\nformat ascii 1.0\nend_header\n", 400, "malformed-cloud"),
        ("/upsample?ratio=4", b"1 2\nx y z\n", 400, "malformed-cloud"),
        ("/upsample?ratio=4", truncated, 400, "malformed-cloud"),
        ("/upsample?ratio=4", &[0_u8; 20_001], 413, "body-too-large"),
        ("/upsample?ratio=2", &many, 413, "too-many-points-in"),
        ("/upsample?ratio=2", text.as_bytes(), 413, "too-many-points-in"),
        ("/upsample?ratio=41", &good, 413, "too-many-points-out"),
        ("/upsample?points=4001", &good, 413, "too-many-points-out"),
        ("/upsample?ratio=4", b"PK\x03\x04whatever", 415, "unsupported-format"),
        ("/upsample?ratio=4", &[1; 5000], 415, "unsupported-format"),
        ("/upsample?ratio=4", b"", 422, "impossible-cloud"),
        ("/upsample?ratio=4", &few, 422, "impossible-cloud"),
        ("/upsample?ratio=4", &equal, 422, "impossible-cloud"),
        ("/upsample?points=50", &good, 422, "impossible-cloud"),
        ("/nowhere", &good, 404, "not-found"),
        ("/healthz", &good, 405, "method-not-allowed"),
    ] {
        let reply = server.post(target, body);
        assert_eq!(reply.problem_name(), name, "{target}: {}", reply.text());
        assert_eq!(reply.status, status, "{target}: {}", reply.text());
        assert_eq!(reply.problem()["title"].as_str().map(str::is_empty), Some(false));
    }
    assert_eq!(server.engine.queued_points(), 0);
    let fine = server.post("/upsample?ratio=40", &good);
    assert_eq!(fine.status, 200, "at the limits: {}", fine.text());
}

#[test]
fn a_refusal_names_what_is_wrong_and_what_lifts_the_limit() {
    let server = Server::start(&Scripted::new(), Config { limits: limits(), ..Config::default() });
    let problem = server.post("/upsample?ratio=4&colour=red", b"").problem();
    assert_eq!(problem["parameter"], "colour");
    let problem = server.post("/upsample?ratio=4", &encode(&cloud(1001), PLY)).problem();
    assert_eq!(problem["limit"], 1000);
    assert_eq!(problem["setting"], "--max-points-in");
    assert!(problem["detail"].as_str().is_some_and(|d| d.contains("1001") && d.contains("--max-points-in")));
}

#[test]
fn a_type_of_grpc_makes_no_call_of_a_plain_request() {
    let server = Server::start(&Scripted::new(), Config::default());
    let reply = server.ask("POST", "/upsample?ratio=999", "content-type: application/grpc\r\n", b"");
    assert_eq!((reply.status, reply.problem_name().as_str()), (400, "invalid-parameter"));
}

#[test]
fn methods_and_compression_that_are_not_taken_say_what_is() {
    let server = Server::start(&Scripted::new(), Config::default());
    let reply = server.get("/upsample?ratio=4");
    assert_eq!((reply.status, reply.problem_name().as_str()), (405, "method-not-allowed"));
    assert_eq!(reply.header("allow"), Some("POST"));
    let mut client = server.connect();
    client.send(b"POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\nconnection: close\r\n");
    client.send(b"content-encoding: br\r\ncontent-length: 3\r\n\r\nabc");
    let reply = client.reply();
    assert_eq!((reply.status, reply.problem_name().as_str()), (415, "unsupported-encoding"));
    assert_eq!(reply.header("accept-encoding"), Some("gzip, deflate, zstd, identity"));
    let mut client = server.connect();
    client.send(b"HEAD /nowhere HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n");
    let head = String::from_utf8(client.rest()).expect("text");
    assert!(head.starts_with("HTTP/1.1 404") && head.ends_with("\r\n\r\n"), "{head}");
}

#[test]
fn a_header_is_judged_before_the_rest_has_arrived() {
    let server = Server::start(&Scripted::new(), Config { limits: limits(), ..Config::default() });
    let header = |format: &str, points: u64| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {points}\nproperty float x\nproperty float y\n\
             property float z\nend_header\n"
        )
    };
    for (query, start, name) in [
        ("ratio=2", header("ascii", 4_294_967_295), "too-many-points-in"),
        ("ratio=2", header("binary_little_endian", 1001), "too-many-points-in"),
        ("ratio=5", header("binary_little_endian", 1000), "too-many-points-out"),
        ("ratio=2", header("binary_little_endian", u64::MAX), "too-many-points-in"),
        ("ratio=2", "\u{7f}ELF\u{2}\u{1}\u{1}\0".to_owned() + &"\0".repeat(5000), "unsupported-format"),
    ] {
        let mut client = server.connect();
        client.send(format!("POST /upsample?{query} HTTP/1.1\r\nhost: x\r\n").as_bytes());
        client.send(b"connection: close\r\ncontent-length: 19999\r\n\r\n");
        client.send(start.as_bytes());
        // The client goes no further, so whatever answers has not waited for the rest.
        let reply = client.reply();
        assert_eq!(reply.problem_name(), name, "{start:?}");
    }
}

#[test]
fn a_body_that_is_too_large_is_refused_while_it_comes_or_before() {
    let server = Server::start(&Scripted::new(), Config { limits: limits(), ..Config::default() });
    // Announced: refused before a byte of it, and without asking for it.
    let mut client = server.connect();
    client.send(b"POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\nconnection: close\r\n");
    client.send(b"expect: 100-continue\r\ncontent-length: 20001\r\n\r\n");
    let reply = client.reply();
    assert_eq!((reply.status, reply.problem_name().as_str()), (413, "body-too-large"));
    // Not announced: refused at the limit.
    let mut client = server.connect();
    client.send(b"POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\nconnection: close\r\n");
    client.send(b"transfer-encoding: chunked\r\n\r\n");
    let line = "1 2 3\n".repeat(1000);
    for _ in 0..4 {
        client.try_send(format!("{:x}\r\n{line}\r\n", line.len()).as_bytes());
    }
    let reply = client.reply();
    assert_eq!((reply.status, reply.problem_name().as_str()), (413, "body-too-large"));
}

#[test]
fn a_client_that_sends_on_still_finds_the_refusal() {
    let server = Server::start(&Scripted::new(), Config { limits: limits(), ..Config::default() });
    let body = vec![b'1'; 4 << 20];
    let reply = server.post("/upsample?ratio=2", &body);
    assert_eq!((reply.status, reply.problem_name().as_str()), (413, "body-too-large"));
}

#[test]
fn a_full_queue_says_when_to_come_back_and_takes_work_again() {
    let backend = Scripted::new();
    let sizes = EngineConfig { threads: 2, queue_points: 500, client_points: 500, ..Default::default() };
    let server = Server::start_cold(&backend, sizes, Config::default());
    server.wait_for_ready();
    backend.shut();
    let body = encode(&cloud(100), PLY);
    let mut first = server.connect();
    first.send_post("/upsample?ratio=4", &body);
    server.wait_for_work();
    let refused = server.post("/upsample?ratio=4", &body);
    assert_eq!((refused.status, refused.problem_name().as_str()), (503, "queue-full"));
    assert!(refused.header("retry-after").is_some_and(|s| s.parse::<u64>().is_ok_and(|s| s >= 1)));
    assert_eq!(refused.problem()["setting"], "--queue-points");
    assert_eq!(server.metric("densecloud_queue_points"), 400.0);
    backend.open();
    assert_eq!(first.reply().status, 200);
    assert_eq!(server.post("/upsample?ratio=4", &body).status, 200);
}

#[test]
fn results_have_their_memory_before_the_work_begins() {
    let backend = Scripted::new();
    // Room for one result of 4000 points (96 kB), not for two.
    let limits = Limits { held_bytes: 100_000, ..limits() };
    let server = Server::start(&backend, Config { limits, ..Config::default() });
    backend.shut();
    let body = encode(&cloud(100), PLY);
    let mut first = server.connect();
    first.send_post("/upsample?ratio=40", &body);
    // Its points are reserved by its header, its result's memory when all of it has come.
    wait_until("it has its memory", || server.metric("densecloud_held_bytes") >= 96_000.0);
    let refused = server.post("/upsample?ratio=40", &body);
    assert_eq!((refused.status, refused.problem_name().as_str()), (503, "memory-full"));
    assert_eq!(refused.problem()["setting"], "--max-held-bytes");
    backend.open();
    assert_eq!(first.reply().status, 200);
    wait_until("it is given back", || server.metric("densecloud_held_bytes") == 0.0);
}

#[test]
fn work_that_takes_too_long_is_given_up_with_504() {
    let backend = Scripted::new();
    let mut config = Config::default();
    config.timeouts.request = Duration::from_millis(300);
    let server = Server::start(&backend, config);
    backend.shut();
    let reply = server.post("/upsample?ratio=4", &encode(&cloud(100), PLY));
    assert_eq!((reply.status, reply.problem_name().as_str()), (504, "deadline"));
    assert_eq!(reply.problem()["setting"], "--request-timeout");
    backend.open();
    server.wait_for_no_work();
}

#[test]
fn a_failing_model_is_the_servers_fault_and_its_words_stay_in_the_log() {
    let backend = Scripted::new();
    let server = Server::start(&backend, Config::default());
    backend.fail();
    let reply = server.post("/upsample?ratio=4", &encode(&cloud(100), PLY));
    assert_eq!((reply.status, reply.problem_name().as_str()), (500, "internal"));
    assert!(!reply.text().contains("secret"), "{}", reply.text());
    assert_eq!(server.get("/healthz").status, 200);
}

#[test]
fn a_compressed_body_is_read_and_a_bomb_is_refused_while_it_comes() {
    // Room for zstd's window beside what the others get.
    let limits = Limits { held_bytes: 16 << 20, ..limits() };
    let server = Server::start(&Scripted::new(), Config { limits, ..Config::default() });
    let ask = |coding: &str, body: &[u8], rest: usize| {
        let mut client = server.connect();
        let head = format!(
            "POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-encoding: {coding}\r\n\
             content-length: {}\r\n\r\n",
            body.len() + rest
        );
        client.send(head.as_bytes());
        client.send(body);
        client.reply()
    };
    let plain = server.post("/upsample?ratio=2", &encode(&cloud(500), PLY));
    for (coding, compress) in [("gzip", gzip as fn(&[u8]) -> Vec<u8>), ("deflate", deflate), ("zstd", zstd)] {
        let reply = ask(coding, &compress(&encode(&cloud(500), PLY)), 0);
        assert_eq!(reply.status, 200, "{coding}: {}", String::from_utf8_lossy(&reply.body));
        // All but the stages' times.
        assert!(reply.body == plain.body, "{coding}");
        // The end of the bomb never comes, so whatever answers has not waited for it.
        let bomb = compress(&vec![b'\n'; 1 << 20]);
        let bomb = ask(coding, &bomb[..bomb.len().min(900)], 9);
        assert_eq!((bomb.status, bomb.problem_name().as_str()), (413, "body-too-large"), "{coding}");
        // Nothing, again and again.
        let nothing = compress(b"").repeat(if coding == "gzip" { 2000 } else { 1 });
        if nothing.len() > 20_000 {
            let mut client = server.connect();
            client.send(
                format!("POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\ncontent-encoding: {coding}\r\ntransfer-encoding: chunked\r\n\r\n")
                    .as_bytes(),
            );
            client.try_send(format!("{:x}\r\n", nothing.len()).as_bytes());
            client.try_send(&nothing);
            client.try_send(b"\r\n");
            let reply = client.reply();
            assert_eq!((reply.status, reply.problem_name().as_str()), (413, "body-too-large"), "{coding}");
        }
        let many = ask(coding, &compress(&encode(&cloud(1001), PLY)), 9);
        assert_eq!((many.status, many.problem_name().as_str()), (413, "too-many-points-in"), "{coding}");
        let broken = ask(coding, b"1 2 3\n", 0);
        assert_eq!((broken.status, broken.problem_name().as_str()), (400, "interrupted-body"), "{coding}");
    }
    wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn deflate(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    zstd::encode_all(bytes, 3).unwrap()
}
