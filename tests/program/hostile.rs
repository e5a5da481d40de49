//! Clients at fault: requests made to exhaust the server or to forge its log; and the threat model's list of tests.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use densecloud_cloud::Origin;
use densecloud_formats::Format;
use serde_json::{Value, json};

use crate::support::{PATIENCE, Serving, agent, densecloud, request, signal, wide_sphere};

#[test]
fn what_a_client_sends_makes_no_line_of_the_log() {
    let mut child = densecloud()
        .args(["serve", "--port", "0", "--log-format", "text", "--log", "debug,ort=warn", "--threads", "1"])
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut log = BufReader::new(child.stderr.take().expect("piped"));
    let mut line = String::new();
    while !line.contains("listening") {
        line.clear();
        assert!(log.read_line(&mut line).expect("text") > 0, "it ended");
    }
    let (_, address) = line.split_once("address=").expect("an address");
    let url = format!("http://{}", address.split_whitespace().next().expect("an address"));
    while agent().get(format!("{url}/readyz")).call().expect("an answer").status().as_u16() != 200 {
        std::thread::sleep(Duration::from_millis(20));
    }
    let forged = "%0A2026-01-01T00:00:00Z%20%20INFO%20forged%1B%5B31m%0D%0Aforged";
    let address = url.trim_start_matches("http://");
    let send = |bytes: &[u8]| {
        let mut stream = TcpStream::connect(address).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        stream.write_all(bytes).expect("sent");
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        assert!(answer.starts_with(b"HTTP/1.1 4"), "{:?}", String::from_utf8_lossy(&answer));
    };
    for target in [
        format!("/upsample?ratio=2&{forged}=1"),
        format!("/upsample?ratio={forged}"),
        format!("/upsample?ratio=2&attributes={forged}:mean"),
        format!("/jobs/{forged}"),
        format!("/v2/models/{forged}"),
        format!("/{forged}"),
    ] {
        let body = b"ply\nformat ascii 1.0\ncomment a\x1b[31m\nforged \x1b[31m\nend_header\n";
        send(&request(&target, "x-request-id: a b\r\n", body));
    }
    let cloud = b"ply\nformat ascii 1.0\nelement forged\x1b[31m 4\nproperty float x\nend_header\n";
    send(&request("/upsample?ratio=2", "accept: forged\x1b[31m\r\n", cloud));
    send(&request("/upsample?ratio=2", "content-encoding: forged, \u{e4}\r\n", cloud));
    send(b"GET /\x1b[31mforged HTTP/1.1\r\nhost: x\r\n\r\n");
    signal(&child.id().to_string(), "TERM");
    let mut rest = String::new();
    log.read_to_string(&mut rest).expect("text");
    assert!(child.wait().expect("an end").success());
    assert!(rest.contains("forged"), "{rest}");
    for line in rest.lines().filter(|line| !line.contains("onnxruntime")) {
        assert!(line.starts_with("20") && line.as_bytes()[10] == b'T', "not the log's own line: {line:?}");
        assert!(!line.starts_with("2026-01-01T00:00:00Z  INFO forged"), "{line:?}");
        assert!(!line.contains(|c: char| c.is_control()), "{line:?}");
    }
}

/// What is sent, and the statuses of which one must come back.
type Bomb = (&'static str, Vec<u8>, &'static [u16]);

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

/// A small cloud in a binary format, some of whose bytes are then other ones.
fn forged(format: Format, changes: &[(usize, &[u8])]) -> Vec<u8> {
    let positions: Vec<_> = (0..50).map(|i| [f64::from(i), f64::from(i * i % 17), 1.0]).collect();
    let mut bytes =
        densecloud_formats::encode(Vec::new(), format, &positions, &[], &Origin::default()).expect("memory");
    for (at, new) in changes {
        bytes[*at..at + new.len()].copy_from_slice(new);
    }
    bytes
}

fn bombs() -> Vec<Bomb> {
    const UP: &str = "/upsample?ratio=2";
    const INFER: &str = "/v2/models/densecloud/infer";
    let good = wide_sphere(500, 0);
    let up = |body: &[u8]| request(UP, "", body);
    let infer = |json: &Value| request(INFER, "", json.to_string().as_bytes());
    let tensor = |shape: Value, data: Value| {
        json!({ "inputs": [{ "name": "points", "datatype": "FP32", "shape": shape, "data": data }],
                "parameters": { "ratio": 2 } })
    };
    let nothing = vec![b'\n'; 64 << 20];
    let ply = |lines: &str| format!("ply\nformat binary_little_endian 1.0\n{lines}end_header\n").into_bytes();
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let npy = |shape: &str| {
        let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape}, 3), }}");
        let header = format!("{header:<117}\n");
        [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), &[0; 6000]]
            .concat()
    };
    let pcd = |count: &str, points: &str, data: &str| {
        let header = format!(
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {count}\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\n\
             DATA {data}\n"
        );
        [header.as_bytes(), &[255; 6000]].concat()
    };
    let chunked = |chunks: &[u8]| {
        let head = format!(
            "POST {UP} HTTP/1.1\r\nhost: x\r\nconnection: close\r\ntransfer-encoding: chunked\r\n\r\n"
        );
        [head.as_bytes(), chunks].concat()
    };
    let announced = |length: &str| {
        format!("POST {UP} HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {length}\r\n\r\n")
            .into_bytes()
    };
    let deep = format!("{{\"inputs\": {}", "[".repeat(100_000));
    let get = |target: &str, headers: &str| {
        format!("GET {target} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{headers}\r\n").into_bytes()
    };
    const LAS: Format = Format::Las { compressed: false };
    const LAZ: Format = Format::Las { compressed: true };
    const MOST: &[u8] = &[255; 4];
    vec![
        // What a body becomes.
        ("gzip", request(UP, "content-encoding: gzip\r\n", &gzip(&nothing)), &[413]),
        (
            "gzip in parts",
            request(UP, "content-encoding: gzip\r\n", &gzip(b"\n").repeat(20_000)),
            &[413, 422],
        ),
        ("deflate", request(UP, "content-encoding: deflate\r\n", &zlib(&nothing)), &[413]),
        ("gzip twice", request(UP, "content-encoding: gzip, gzip\r\n", &gzip(&gzip(&nothing))), &[415]),
        ("gzip of JSON", request(INFER, "content-encoding: gzip\r\n", &gzip(&nothing)), &[413]),
        // What a header claims.
        ("PLY points", up(&ply(&format!("element vertex 4294967295\n{xyz}"))), &[413]),
        ("PLY points past 64 bits", up(&ply(&format!("element vertex 99999999999999999999\n{xyz}"))), &[400]),
        (
            "PLY other elements",
            up(&ply(&format!("element face 4294967295\nproperty list uint int a\nelement vertex 9\n{xyz}"))),
            &[400, 413],
        ),
        (
            "PLY empty elements",
            up(&ply(&format!("element none 18446744073709551615\nelement vertex 9\n{xyz}"))),
            &[400],
        ),
        (
            "PLY lists",
            up(&[ply(&format!("element vertex 9\nproperty list uint int a\n{xyz}")), vec![255; 900]]
                .concat()),
            &[400],
        ),
        (
            "PLY properties",
            up(&ply(&format!("element vertex 9\n{}", "property double a\n".repeat(50_000)))),
            &[400],
        ),
        ("LAS points", up(&forged(LAS, &[(107, MOST), (247, &[255; 8])])), &[400, 413]),
        ("LAS records", up(&forged(LAS, &[(100, MOST)])), &[400]),
        ("LAS offset of points", up(&forged(LAS, &[(96, MOST)])), &[400]),
        ("LAZ points", up(&forged(LAZ, &[(107, MOST), (247, &[255; 8])])), &[400, 413]),
        ("PCD points", up(&pcd("1 1 1", "4294967295", "binary")), &[413]),
        ("PCD numbers a field", up(&pcd("1 1 4294967295", "9", "binary")), &[400]),
        ("PCD compressed", up(&pcd("1 1 1", "9", "binary_compressed")), &[400]),
        ("NumPy points", up(&npy("4294967295")), &[413]),
        ("NumPy points past 64 bits", up(&npy("99999999999999999999")), &[400, 413]),
        ("OFF points", up(b"OFF\n4294967295 4294967295 0\n0 0 0\n"), &[413]),
        ("a line", up(&vec![b'1'; 900_000]), &[400, 413, 415, 422]),
        // What tensors claim.
        ("tensor", infer(&tensor(json!([4_294_967_295_u32, 3]), json!([]))), &[400, 413]),
        ("tensor past 64 bits", infer(&tensor(json!([i64::MAX, 3]), json!([]))), &[400, 413]),
        ("tensor in JSON", infer(&tensor(json!([2000, 3]), json!(vec![0.5; 6000]))), &[413]),
        ("tensor longer than it says", infer(&tensor(json!([2, 3]), json!(vec![0.5; 6000]))), &[400]),
        ("deep JSON", request(INFER, "", deep.as_bytes()), &[400]),
        (
            "a long header of tensors",
            request(INFER, "inference-header-content-length: 18446744073709551615\r\n", b"{}"),
            &[400],
        ),
        // What a result would be.
        ("ratio", request("/upsample?ratio=64", "", &good), &[413]),
        ("endless ratio", request("/upsample?ratio=1e308", "", &good), &[400]),
        ("no ratio", request("/upsample?ratio=nan", "", &good), &[400]),
        ("points", request("/upsample?points=18446744073709551615", "", &good), &[413, 422]),
        ("spacing", request("/upsample?spacing=1e-300", "", &good), &[413, 422]),
        ("density", request("/upsample?density=1e300", "", &good), &[413, 422]),
        // HTTP itself.
        ("body", request(UP, "", &vec![b' '; 2 << 20]), &[413]),
        ("announced body", announced("9223372036854775807"), &[413]),
        ("announced body at the end of 64 bits", announced("18446744073709551615"), &[413, 431]),
        ("chunk", chunked(b"FFFFFFFFFFFFFFFF0\r\n"), &[400]),
        ("chunk extension", chunked(format!("1;{}", "a".repeat(100_000)).as_bytes()), &[400]),
        ("headers", get("/healthz", &"a: b\r\n".repeat(5000)), &[431]),
        ("a header", get("/healthz", &format!("a: {}\r\n", "b".repeat(200_000))), &[431]),
        ("a path", get(&format!("/{}", "a".repeat(200_000)), ""), &[414, 431]),
        ("a query", request(&format!("/upsample?ratio=2{}", "&a=b".repeat(10_000)), "", &good), &[400]),
        (
            "attributes",
            request(&format!("/upsample?ratio=2&attributes={}", "a:mean,".repeat(5000)), "", &good),
            &[400],
        ),
        (
            "ranges of accepted types",
            request(UP, &format!("accept: {}\r\n", "a/b;q=1,".repeat(5000)), &good),
            &[406],
        ),
    ]
}

#[test]
fn what_is_made_to_exhaust_the_server_is_refused_and_takes_no_memory() {
    let serving = Serving::start(&[
        "--max-body-bytes",
        "1000000",
        "--max-points-in",
        "1000",
        "--max-points-out",
        "4000",
        "--stall-timeout",
        "60",
    ]);
    // Threads and buffers that the first requests make are not the bombs'.
    for _ in 0..3 {
        let answer = serving.post("/upsample?ratio=4", &wide_sphere(1000, 0));
        assert_eq!(answer.status().as_u16(), 200);
    }
    let before = serving.kilobytes("VmHWM:") << 10;
    let mut wrong = Vec::new();
    for (what, bytes, statuses) in bombs() {
        let start = Instant::now();
        let mut stream = TcpStream::connect(&serving.address).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        // It may be refused, and the connection closed, before all of it is sent.
        let _ = stream.write_all(&bytes);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let answer = String::from_utf8_lossy(&answer);
        let status = answer.split(' ').nth(1).and_then(|status| status.parse().ok());
        if !status.is_some_and(|status| statuses.contains(&status)) || start.elapsed() > PATIENCE {
            wrong.push(format!("{what}, {} bytes, {statuses:?}: {answer}", bytes.len()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let after = serving.kilobytes("VmHWM:") << 10;
    // Each body may be held once as it came and once as points; what the bombs claim is from 64 MB to 16 EB.
    println!("{} KiB more than before", (after - before) >> 10);
    assert!(after - before < 48 << 20, "{before} bytes before, {after} after");
    let answer = serving.post("/upsample?ratio=4", &wide_sphere(1000, 0));
    assert_eq!(answer.status().as_u16(), 200);
    // The last answer has arrived; what it held is given back a moment later.
    for line in ["densecloud_held_bytes 0", "densecloud_queue_points 0", "densecloud_requests_in_flight 0"] {
        serving.wait_for_metric(line);
    }
}

/// All of the repository's sources in a folder.
fn sources(folder: &Path, into: &mut String) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs" || e == "py") {
            into.push_str(&std::fs::read_to_string(&path).expect("text"));
        }
    }
}

#[test]
fn every_test_that_the_threat_model_names_is_there() {
    let root = &Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut all = String::new();
    for folder in ["crates", "tests"] {
        sources(&root.join(folder), &mut all);
    }
    let model = std::fs::read_to_string(root.join("SECURITY.md")).expect("the threat model");
    let mut named = 0;
    for row in model.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| threat")) {
        let tests = row.trim_end_matches(" |").rsplit(" | ").next().expect("a column");
        let names: Vec<_> = tests.split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty(), "no test: {row}");
        for name in names {
            // A test, a fuzz target, or a check of the supply chain.
            let there = all.contains(&format!("fn {name}("))
                || all.contains(&format!("def {name}("))
                || root.join(name).exists();
            assert!(there, "{name} is not there: {row}");
            named += 1;
        }
    }
    assert!(named > 30, "{named}");
}
