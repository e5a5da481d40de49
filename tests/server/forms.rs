//! Forms: the cloud and the options as `curl -F` and browsers send them.

use densecloud_server::{Config, Limits, Timeouts};
use std::time::Duration;

use crate::support::{PLY, Reply, Scripted, Server, cloud, encode, wait_until};

enum Part<'a> {
    Option(&'a str, &'a str),
    File(&'a str, &'a [u8]),
}
use Part::{File, Option};

fn form(parts: &[Part<'_>]) -> Vec<u8> {
    let mut body = Vec::new();
    for part in parts {
        body.extend(b"--frontier\r\n");
        match part {
            Option(name, value) => body.extend(
                format!("Content-Disposition: form-data; name=\"{name}\"\r\n\r\n{value}\r\n").into_bytes(),
            ),
            File(name, bytes) => {
                let head = format!(
                    "Content-Disposition: form-data; name=\"{name}\"; filename=\"scan.ply\"\r\n\
                     Content-Type: application/octet-stream\r\n\r\n"
                );
                body.extend(head.into_bytes());
                body.extend(*bytes);
                body.extend(b"\r\n");
            }
        }
    }
    body.extend(b"--frontier--\r\n");
    body
}

const KIND: &str = "content-type: multipart/form-data; boundary=frontier\r\n";

fn send(server: &Server, target: &str, parts: &[Part<'_>]) -> Reply {
    server.ask("POST", target, KIND, &form(parts))
}

fn small() -> Limits {
    Limits { body_bytes: 100_000, points_in: 1000, points_out: 20_000, ..Limits::default() }
}

#[test]
fn a_form_is_a_query_and_a_body_in_any_order() {
    let server = Server::start(&Scripted::new(), Config { limits: small(), ..Config::default() });
    let cloud = encode(&cloud(500), PLY);
    let plain = server.post("/upsample?ratio=4&seed=7&source_fields=true", &cloud);
    let (ratio, seed, fields) = (Option("ratio", "4"), Option("seed", "7"), Option("source_fields", "true"));
    let file = || File("cloud", &cloud);
    for (target, parts) in [
        ("/upsample", [file(), ratio, seed, fields]),
        ("/upsample", [Option("ratio", "4"), Option("seed", "7"), Option("source_fields", "true"), file()]),
        (
            "/upsample?ratio=4",
            [Option("seed", "7"), File("scan", &cloud), Option("source_fields", "1"), Option("points", "")],
        ),
    ] {
        let reply = send(&server, target, &parts);
        assert_eq!(reply.status, 200, "{target}: {}", String::from_utf8_lossy(&reply.body));
        assert!(reply.body == plain.body, "{target}");
    }
    // However it is cut into pieces, and with its file compressed.
    let mut body = form(&[Option("seed", "7"), file(), Option("source_fields", "true")]);
    let mut client = server.connect();
    let head = format!(
        "POST /upsample?ratio=4 HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{KIND}content-length: {}\r\n\r\n",
        body.len()
    );
    client.send(head.as_bytes());
    for piece in body.chunks(97) {
        client.send(piece);
    }
    assert!(client.reply().body == plain.body);
    let packed = zstd::encode_all(&cloud[..], 3).expect("memory");
    body = b"--frontier\r\nContent-Disposition: form-data; name=\"cloud\"\r\nContent-Encoding: zstd\r\n\r\n"
        .to_vec();
    body.extend(packed);
    body.extend(b"\r\n--frontier--\r\n");
    let reply = server.ask("POST", "/upsample?ratio=4&seed=7&source_fields=true", KIND, &body);
    assert!(reply.status == 200 && reply.body == plain.body);
    wait_until("all memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
}

#[test]
fn how_a_file_is_read_may_be_said_after_it() {
    let server = Server::start(&Scripted::new(), Config { limits: small(), ..Config::default() });
    let rows: String = (0..400).map(|i| format!("{i};{},5;{};{}\n", i % 20, i / 20, i % 7)).collect();
    let told = "/upsample?ratio=2&axes=2,3,4&separator=semicolon";
    let plain = server.post(told, rows.as_bytes());
    assert_eq!(plain.status, 200, "{}", plain.text());
    let parts = [File("cloud", rows.as_bytes()), Option("axes", "2,3,4"), Option("separator", ";")];
    let reply = send(&server, "/upsample?ratio=2", &parts);
    assert!(reply.status == 200 && reply.body == plain.body, "{}", reply.text());
    // Nothing tells of these bytes what they are, and nothing says it.
    let parts = [File("cloud", &[1; 8192]), Option("format", "text")];
    assert_eq!(send(&server, "/upsample?ratio=2", &parts).problem_name(), "unsupported-format");
}

#[test]
fn a_job_is_submitted_with_a_form_and_again_under_its_key() {
    let folder = tempfile::tempdir().expect("a folder");
    let config =
        Config { jobs: Some(densecloud_jobs::Settings::new(folder.path().to_owned())), ..Config::default() };
    let server = Server::start(&Scripted::new(), config);
    let cloud = encode(&cloud(300), PLY);
    let parts = [File("cloud", &cloud), Option("ratio", "3"), Option("attributes", "a:mean")];
    let refused = send(&server, "/jobs", &parts);
    assert_eq!((refused.status, refused.problem()["parameter"].as_str()), (400, Some("attributes")));
    let parts = [File("cloud", &cloud), Option("ratio", "3"), Option("seed", "5")];
    let headers = format!("{KIND}idempotency-key: k-1\r\n");
    let ask = || server.ask("POST", "/jobs", &headers, &form(&parts));
    let (first, again) = (ask(), ask());
    assert_eq!((first.status, again.status), (202, 200), "{}", first.text());
    assert_eq!(first.header("location"), again.header("location"));
    let result = format!("{}/result", first.header("location").expect("a location"));
    wait_until("the job is done", || server.get(&result).status == 200);
    assert!(server.get(&result).body == server.post("/upsample?ratio=3&seed=5", &cloud).body);
    let other = [File("cloud", &cloud), Option("ratio", "4")];
    let other = server.ask("POST", "/jobs", &headers, &form(&other));
    assert_eq!(other.problem_name(), "idempotency-key-reused");
}

#[test]
fn a_form_that_is_wrong_says_what_is() {
    let server = Server::start(&Scripted::new(), Config { limits: small(), ..Config::default() });
    let file = encode(&cloud(100), PLY);
    for (parts, parameter) in [
        (vec![Option("ratio", "4")], "cloud"),
        (vec![File("cloud", &file)], "ratio"),
        (vec![File("cloud", &file), Option("ratio", "")], "ratio"),
        (vec![File("cloud", &file), Option("ratio", "4"), Option("sede", "")], "sede"),
        (vec![File("cloud", &file), Option("ratio", "4"), Option("ratio", "4")], "ratio"),
        (vec![File("cloud", &file), Option("ratio", "65")], "ratio"),
        (vec![File("cloud", &file), Option("ratio", "4"), Option("points", "400")], "points"),
        (vec![File("a", &file), File("b", &file), Option("ratio", "4")], "b"),
    ] {
        let reply = send(&server, "/upsample", &parts);
        assert_eq!((reply.status, reply.problem()["parameter"].as_str()), (400, Some(parameter)));
    }
    let twice = send(&server, "/upsample?ratio=4", &[Option("ratio", "4"), File("cloud", &file)]);
    assert_eq!(twice.problem()["parameter"], "ratio");
    let whole = form(&[Option("ratio", "4"), File("cloud", &file)]);
    for (headers, body, status, name) in [
        ("content-type: multipart/form-data\r\n", &whole[..], 400, "malformed-request"),
        (KIND, &whole[..whole.len() - 20], 400, "interrupted-body"),
        (KIND, &b"no form"[..], 400, "interrupted-body"),
        (
            "content-type: multipart/form-data; boundary=frontier\r\ncontent-encoding: gzip\r\n",
            &whole[..],
            400,
            "malformed-request",
        ),
    ] {
        let reply = server.ask("POST", "/upsample", headers, body);
        assert_eq!((reply.status, reply.problem_name().as_str()), (status, name), "{headers}");
    }
    wait_until("all memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
}

#[test]
fn limits_hold_for_forms_while_they_come() {
    let timeouts = Timeouts { stall: Duration::from_millis(300), ..Timeouts::default() };
    let server = Server::start(&Scripted::new(), Config { limits: small(), timeouts, ..Config::default() });
    // None of these forms ends: what answers has not waited for the end.
    let ask = |mut body: Vec<u8>| {
        body.truncate(body.len() - "\r\n--frontier--\r\n".len());
        let mut client = server.connect();
        let head = format!(
            "POST /upsample HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{KIND}content-length: {}\r\n\r\n",
            body.len() + 20
        );
        client.send(head.as_bytes());
        let _ = client.try_send(&body);
        client.reply()
    };
    let many = encode(&cloud(1001), PLY);
    let some = encode(&cloud(400), PLY);
    let long = vec![b'1'; 150_000];
    let bomb = zstd::encode_all(&vec![b' '; 200_000][..], 3).expect("memory");
    for (parts, name) in [
        (vec![File("cloud", &many), Option("ratio", "4")], "too-many-points-in"),
        (vec![Option("ratio", "64"), File("cloud", &some)], "too-many-points-out"),
        (vec![File("cloud", &long)], "body-too-large"),
        (vec![Option("ratio", "4"), File("cloud", &some)], "upload-stalled"),
    ] {
        assert_eq!(ask(form(&parts)).problem_name(), name);
    }
    let mut body =
        b"--frontier\r\nContent-Disposition: form-data; name=\"cloud\"\r\nContent-Encoding: zstd\r\n\r\n"
            .to_vec();
    body.extend(&bomb);
    body.extend(b"\r\n--frontier--\r\n");
    assert_eq!(ask(body).problem_name(), "body-too-large");
    // A head of a part, or a value, that never ends.
    for endless in
        ["--frontier\r\nX: ", "--frontier\r\nContent-Disposition: form-data; name=\"seed\"\r\n\r\n"]
    {
        let mut client = server.connect();
        client.send(
            format!("POST /upsample HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{KIND}transfer-encoding: chunked\r\n\r\n")
                .as_bytes(),
        );
        let mut chunk = endless.as_bytes().to_vec();
        while chunk.len() < 0x8000 {
            chunk.push(b'1');
        }
        for _ in 0..40 {
            if !(client.try_send(b"8000\r\n") && client.try_send(&chunk) && client.try_send(b"\r\n")) {
                break;
            }
            chunk.fill(b'1');
        }
        assert_eq!(client.reply().problem_name(), "malformed-request");
    }
    wait_until("all memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
}
