//! What HTTP asks of a head (RFC 9112), over raw sockets.

use std::io::Write;

use densecloud_server::Config;

use crate::support::{PLY, Reply, Scripted, Server, cloud, encode};

/// The answer to these bytes, and nothing after it.
fn answer(server: &Server, request: &[u8]) -> Reply {
    let mut client = server.connect();
    client.send(request);
    let bytes = client.rest();
    Reply::parse(&bytes).unwrap_or_else(|| panic!("no answer: {:?}", String::from_utf8_lossy(&bytes)))
}

#[test]
fn a_head_of_http_1_1_has_one_host() {
    let server = Server::start(&Scripted::new(), Config::default());
    let get = |version: &str, lines: &str| {
        answer(&server, format!("GET /healthz HTTP/{version}\r\nconnection: close\r\n{lines}\r\n").as_bytes())
    };
    for (version, lines, status) in [
        ("1.1", "host: x\r\n", 200),
        ("1.1", "Host: [::1]:8080\r\n", 200),
        ("1.1", "host:\r\n", 200),
        ("1.0", "", 200),
        ("1.1", "", 400),
        ("1.1", "host: x\r\nHost: x\r\n", 400),
        ("1.1", "host: x\r\nhost: y\r\n", 400),
        ("1.0", "host: x\r\nhost: y\r\n", 400),
        ("1.1", "host: x y\r\n", 400),
        ("1.1", "host: http://x/\r\n", 400),
    ] {
        let reply = get(version, lines);
        assert_eq!(reply.status, status, "{version} {lines:?}");
        if status == 400 {
            assert_eq!(reply.problem_name(), "malformed-request");
            assert!(reply.text().contains("Host"), "{}", reply.text());
        }
    }
    // Errors there have the protocol's form.
    let reply = answer(&server, b"GET /v2 HTTP/1.1\r\nconnection: close\r\n\r\n");
    assert!(reply.status == 400 && reply.text().starts_with("{\"error\":"), "{}", reply.text());
}

#[test]
fn a_transfer_coding_that_is_not_known_is_501() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(100), PLY);
    let chunked = [format!("{:x}\r\n", body.len()).as_bytes(), &body, b"\r\n0\r\n\r\n"].concat();
    let post = |lines: &str, body: &[u8]| {
        let head = format!("POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{lines}\r\n");
        answer(&server, &[head.as_bytes(), body].concat())
    };
    for coding in ["gzip", "identity", "gzip, chunked", "chunked, gzip", "\"chunked\"", "x"] {
        let reply = post(&format!("transfer-encoding: {coding}\r\n"), &chunked);
        assert_eq!(
            (reply.status, reply.problem_name().as_str()),
            (501, "unknown-transfer-coding"),
            "{coding}"
        );
        assert_eq!(reply.header("connection"), Some("close"), "{coding}");
    }
    let reply = post("Transfer-Encoding: gzip\r\nTransfer-Encoding: chunked\r\n", &chunked);
    assert_eq!(reply.problem_name(), "unknown-transfer-coding");
    for coding in ["chunked", "Chunked", " chunked "] {
        assert_eq!(post(&format!("transfer-encoding: {coding}\r\n"), &chunked).status, 200, "{coding}");
    }
    let reply = post("transfer-encoding: chunked, chunked\r\n", &chunked);
    assert_eq!((reply.status, reply.problem_name().as_str()), (400, "malformed-request"));
    // The HTTP library's own words for what is malformed in another way stay.
    let mut client = server.connect();
    client.send(b"POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\ncontent-length: x\r\n\r\n");
    assert!(client.rest().starts_with(b"HTTP/1.1 400 Bad Request\r\n"));
    // A connection that was used before is judged like a new one.
    let mut client = server.connect();
    client.send(b"GET /healthz HTTP/1.1\r\nhost: x\r\n\r\n");
    assert!(client.some().starts_with(b"HTTP/1.1 200 "));
    client.send(b"POST /upsample?ratio=2 HTTP/1.1\r\nhost: x\r\ntransfer-encoding: gzip\r\n\r\nabc");
    assert!(client.rest().starts_with(b"HTTP/1.1 501 Not Implemented\r\n"));
}

#[test]
fn a_post_of_http_1_0_needs_a_length() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(100), PLY);
    let post = |lines: &str| {
        let head = format!("POST /upsample?ratio=2 HTTP/1.0\r\n{lines}\r\n");
        answer(&server, &[head.as_bytes(), &body].concat())
    };
    let reply = post("");
    assert_eq!((reply.status, reply.problem_name().as_str()), (411, "length-required"));
    assert_eq!(post(&format!("content-length: {}\r\n", body.len())).status, 200);
}

#[test]
fn what_curls_d_makes_of_a_file_is_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let jobs = Some(densecloud_jobs::Settings::new(folder.path().to_owned()));
    let server = Server::start(&Scripted::new(), Config { jobs, ..Config::default() });
    let curl = "content-type: application/x-www-form-urlencoded\r\n";
    let text = encode(&cloud(100), densecloud_formats::Format::TEXT);
    let las = densecloud_formats::Format::Las { compressed: false };
    let las = densecloud_formats::encode(Vec::new(), las, &cloud(100), &[], &Default::default()).unwrap();
    let npy = densecloud_formats::Format::Npy { scalar: densecloud_formats::Scalar::F64, fields: false };
    for file in [text, encode(&cloud(100), PLY), las, encode(&cloud(100), npy)] {
        // As it takes them out.
        let stripped: Vec<u8> = file.iter().copied().filter(|byte| !b"\r\n\0".contains(byte)).collect();
        for target in ["/upsample?ratio=2", "/jobs?ratio=2"] {
            let reply = server.ask("POST", target, curl, &stripped);
            assert_eq!((reply.status, reply.problem_name().as_str()), (400, "stripped-body"), "{target}");
            assert!(reply.text().contains("--data-binary @FILE"), "{}", reply.text());
            // With --data-binary it says the same type.
            let whole = server.ask("POST", target, curl, &file);
            assert!(matches!(whole.status, 200 | 202), "{target}: {}", whole.text());
        }
    }
    // A name without its @, and what is said to be a cloud.
    assert_eq!(server.ask("POST", "/upsample?ratio=2", curl, b"in.ply").problem_name(), "stripped-body");
    assert_eq!(server.post("/upsample?ratio=2", b"in.ply").problem_name(), "unsupported-format");
    assert_eq!(server.ask("POST", "/upsample?ratio=2", curl, b"").problem_name(), "impossible-cloud");
    let other = server.ask("POST", "/upsample?ratio=2", curl, &[0xff, 0xd8, 0, 1, 2, b'\n', 7, 7]);
    assert_eq!(other.problem_name(), "unsupported-format");
    // Compressed, a small file may have none of these bytes.
    let deflated = |i| {
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
        for k in 1..10 {
            writeln!(encoder, "{} {} {}", 7 * i + k, k * k, 3 * i * k).unwrap();
        }
        encoder.finish().unwrap()
    };
    let small = (0..1000).map(deflated).find(|body| !body.iter().any(|byte| b"\r\n\0".contains(byte)));
    let headers = format!("{curl}content-encoding: deflate\r\n");
    let reply = server.ask("POST", "/upsample?ratio=2", &headers, &small.expect("one of a thousand"));
    assert_eq!(reply.status, 200, "{}", String::from_utf8_lossy(&reply.body));
}
