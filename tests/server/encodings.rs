//! Answers in gzip and zstd: the same bytes inside, for those who ask, of what becomes smaller.

use std::io::Read;

use densecloud_formats::{Format, PcdEncoding, Scalar};
use densecloud_server::Config;

use crate::support::{PLY, Reply, Scripted, Server, cloud, encode, wait_until};

fn decoded(reply: &Reply) -> Vec<u8> {
    match reply.header("content-encoding") {
        None => reply.body.clone(),
        Some("gzip") => {
            let mut bytes = Vec::new();
            flate2::read::GzDecoder::new(&reply.body[..]).read_to_end(&mut bytes).expect("gzip");
            bytes
        }
        Some("zstd") => zstd::decode_all(&reply.body[..]).expect("zstd"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_answer_is_compressed_for_those_who_ask() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(500), PLY);
    let plain = server.post("/upsample?ratio=16", &body);
    assert_eq!(plain.header("vary"), Some("accept-encoding"));
    assert!(plain.header("content-encoding").is_none() && plain.header("content-length").is_some());
    for (asked, expected) in [
        ("gzip", Some("gzip")),
        ("zstd", Some("zstd")),
        ("gzip, deflate, br, zstd", Some("zstd")),
        ("gzip;q=1.0, zstd;q=0.1", Some("gzip")),
        ("br", None),
        ("gzip;q=0", None),
    ] {
        let headers = format!("accept-encoding: {asked}\r\n");
        let reply = server.ask("POST", "/upsample?ratio=16", &headers, &body);
        assert_eq!((reply.status, reply.header("content-encoding")), (200, expected), "{asked}");
        assert_eq!(reply.header("vary"), Some("accept-encoding"));
        assert_eq!(reply.header("densecloud-points-out"), Some("8000"));
        assert_eq!(reply.header("content-length").is_none(), expected.is_some());
        assert!(decoded(&reply) == plain.body, "{asked}");
        assert!(expected.is_none() || reply.body.len() < plain.body.len(), "{asked}");
    }
    wait_until("all memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
    assert_eq!(server.metric("densecloud_requests_total{interface=\"http\",outcome=\"ok\"}"), 7.0);
}

#[test]
fn what_would_not_become_smaller_is_sent_as_it_is() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(500), PLY);
    let ask = |accept: &str| {
        let headers = format!("accept-encoding: gzip, zstd\r\naccept: {accept}\r\n");
        server.ask("POST", "/upsample?ratio=4", &headers, &body)
    };
    for (accept, compressed) in [
        ("application/vnd.laszip", false),
        ("model/e57", false),
        ("application/vnd.las", true),
        ("application/x-npy", true),
        ("application/x-pcd", true),
        ("text/plain", true),
    ] {
        assert_eq!(ask(accept).header("content-encoding").is_some(), compressed, "{accept}");
    }
    // A grid of whole numbers: of other clouds, LZF makes nothing smaller.
    let grid: Vec<_> = (0..900).map(|i| [f64::from(i % 30), f64::from(i / 30), 0.0]).collect();
    let format = Format::Pcd { encoding: PcdEncoding::Compressed, scalar: Scalar::F32 };
    let grid = densecloud_formats::encode(Vec::new(), format, &grid, &[], &Default::default());
    let grid = grid.expect("memory");
    assert!(String::from_utf8_lossy(&grid).contains("DATA binary_compressed"));
    let packed = server.ask("POST", "/upsample?ratio=4", "accept-encoding: gzip\r\n", &grid);
    assert_eq!((packed.status, packed.header("content-encoding")), (200, None));
    let get = |path: &str| server.ask("GET", path, "accept-encoding: gzip\r\n", b"");
    assert_eq!(get("/openapi.json").header("content-encoding"), Some("gzip"));
    assert_eq!(get("/docs").header("content-encoding"), Some("gzip"));
    // Too short, and an error.
    assert_eq!(get("/healthz").header("content-encoding"), None);
    assert_eq!(get("/nowhere").problem_name(), "not-found");
}

#[test]
fn a_jobs_result_has_a_tag_for_each_of_its_forms_and_parts_are_of_the_plain_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let config =
        Config { jobs: Some(densecloud_jobs::Settings::new(folder.path().to_owned())), ..Config::default() };
    let server = Server::start(&Scripted::new(), config);
    let job = server.post("/jobs?ratio=16", &encode(&cloud(500), PLY));
    let path = job.header("location").expect("a location").to_owned();
    let target = format!("{path}/result");
    wait_until("the job is done", || server.get(&target).status == 200);
    let ask = |method: &str, headers: &str| {
        let mut client = server.connect();
        client.send(
            format!("{method} {target} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{headers}\r\n").as_bytes(),
        );
        let bytes = client.rest();
        if method == "HEAD" {
            let text = String::from_utf8(bytes).expect("a head alone");
            assert!(text.ends_with("\r\n\r\n"), "{text}");
            // Without a length, which would be that of a body that is not there.
            let headers = text.lines().filter_map(|l| l.split_once(": ")).map(|(n, v)| (n.into(), v.into()));
            let status = text.split(' ').nth(1).expect("a status").parse().expect("a number");
            return Reply { status, headers: headers.collect(), body: Vec::new() };
        }
        Reply::parse(&bytes).expect("a whole response")
    };
    let plain = ask("GET", "");
    let tag = plain.header("etag").expect("a tag").to_owned();
    let gzip = ask("GET", "accept-encoding: gzip\r\n");
    assert!(decoded(&gzip) == plain.body && gzip.body.len() < plain.body.len());
    let other = gzip.header("etag").expect("a tag").to_owned();
    assert_eq!(other, format!("{}-gzip\"", tag.trim_end_matches('"')));
    assert_eq!((plain.header("accept-ranges"), gzip.header("accept-ranges")), (Some("bytes"), None));
    // Each is known again by its own tag, weak or not, and by no other.
    for (accept, known, unknown) in [("", &tag, &other), ("accept-encoding: gzip\r\n", &other, &tag)] {
        for tag in [known.clone(), format!("W/{known}"), "*".to_owned()] {
            let same = ask("GET", &format!("{accept}if-none-match: {tag}\r\n"));
            assert_eq!((same.status, same.header("etag")), (304, Some(known.as_str())), "{tag}");
            assert!(same.body.is_empty());
        }
        assert_eq!(ask("GET", &format!("{accept}if-none-match: {unknown}\r\n")).status, 200);
    }
    let part = ask("GET", "accept-encoding: gzip\r\nrange: bytes=10-19\r\n");
    assert_eq!((part.status, part.header("content-encoding")), (206, None));
    assert!(part.body == plain.body[10..20]);
    assert_eq!((part.header("etag"), part.header("vary")), (Some(tag.as_str()), Some("accept-encoding")));
    // What was begun in gzip cannot be gone on with in parts; the whole comes.
    for stale in [other.clone(), format!("W/{tag}")] {
        let whole = ask("GET", &format!("range: bytes=10-19\r\nif-range: {stale}\r\n"));
        assert_eq!((whole.status, whole.body.len()), (200, plain.body.len()), "{stale}");
    }
    for several in ["bytes=0-1,5-6", "bytes=5-1", "points=0-1", "bytes=x-"] {
        assert_eq!(ask("GET", &format!("range: {several}\r\n")).status, 200, "{several}");
    }
    let head = ask("HEAD", "range: bytes=10-19\r\n");
    let length = plain.body.len().to_string();
    assert_eq!((head.status, head.header("content-length")), (200, Some(length.as_str())));
    assert_eq!((head.header("etag"), head.header("accept-ranges")), (Some(tag.as_str()), Some("bytes")));
    let head = ask("HEAD", "accept-encoding: gzip\r\n");
    assert_eq!((head.header("etag"), head.header("content-encoding")), (Some(other.as_str()), Some("gzip")));
    assert!(head.header("content-length").is_none_or(|length| length == "0"), "{head:?}");
    let mut events = server.connect();
    events.send(
        format!(
            "GET {path}/events HTTP/1.1\r\nhost: x\r\nconnection: close\r\naccept-encoding: gzip\r\n\r\n"
        )
        .as_bytes(),
    );
    let events = Reply::parse(&events.rest()).expect("a whole response");
    assert_eq!(
        (events.header("content-encoding"), events.header("content-type")),
        (None, Some("text/event-stream"))
    );
    wait_until("all memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
}
