//! Clouds packed to be shown, and the page that shows them.

use std::sync::Arc;

use densecloud_formats::{CloudReader, Format, Limits as ReadLimits};
use densecloud_server::{Access, Config, Keys, Limits};
use serde_json::Value;

use crate::support::{PLY, Reply, Scripted, Server, cloud, encode, wait_until};

const PACKED: &str = "application/vnd.densecloud.points";

/// The head of a packed answer, and its positions, with the anchor added.
fn unpacked(reply: &Reply) -> (Value, Vec<[f64; 3]>) {
    assert_eq!((reply.status, reply.header("content-type")), (200, Some(PACKED)));
    let word = |at: usize| u32::from_le_bytes(reply.body[at..at + 4].try_into().unwrap()) as usize;
    let start = 8 + word(4);
    let head: Value = serde_json::from_slice(&reply.body[8..start]).unwrap();
    let anchor: Vec<f64> =
        head["anchor"].as_array().unwrap().iter().map(|part| part.as_f64().unwrap()).collect();
    // A single block of positions alone.
    assert_eq!(
        (word(start), &head["columns"]),
        (head["sent"].as_u64().unwrap() as usize, &serde_json::json!([]))
    );
    let float = |bytes: &[u8]| f64::from(f32::from_le_bytes(bytes.try_into().unwrap()));
    let rows = reply.body[start + 4..].chunks_exact(12);
    let positions = rows.map(|row| [0, 1, 2].map(|i| float(&row[4 * i..4 * i + 4]) + anchor[i])).collect();
    (head, positions)
}

fn assert_near(found: &[[f64; 3]], expected: &[[f64; 3]]) {
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(expected) {
        assert!((0..3).all(|axis| (a[axis] - b[axis]).abs() < 1e-5), "{a:?} {b:?}");
    }
}

#[test]
fn points_come_in_the_files_order_or_as_an_even_sample() {
    let server = Server::start(&Scripted::new(), Config::default());
    let points = cloud(3000);
    for format in [PLY, Format::TEXT, Format::Npy { scalar: densecloud_formats::Scalar::F64, fields: false }]
    {
        let body = encode(&points, format);
        let (head, found) = unpacked(&server.post("/points?order=file", &body));
        assert_near(&found, &points);
        assert_eq!(head["points"], 3000);
        let (head, sample) = unpacked(&server.post("/points?limit=300", &body));
        assert_eq!((&head["points"], &head["sent"]), (&3000.into(), &300.into()));
        // The spiral goes from above to below.
        let upper = sample.iter().filter(|point| point[2] > 0.0).count();
        assert!((110..190).contains(&upper), "{upper}");
        assert_eq!(unpacked(&server.post("/points?limit=300", &body)).1, sample);
    }
}

#[test]
fn a_cloud_is_given_in_the_format_that_is_accepted() {
    let server = Server::start(&Scripted::new(), Config::default());
    let points = cloud(300);
    let reply = server.ask("POST", "/points", "accept: text/csv\r\n", &encode(&points, PLY));
    assert_eq!((reply.status, reply.header("content-type")), (200, Some("text/csv; charset=utf-8")));
    assert_eq!(reply.header("content-disposition"), Some("attachment; filename=\"cloud.csv\""));
    let back = CloudReader::open(&reply.body[..], ReadLimits::default()).unwrap().read().unwrap();
    assert_near(&back.positions, &points);
    // Only what lies in the box.
    let reply =
        server.ask("POST", "/points?bounds=-2,-2,0,2,2,2", "accept: text/csv\r\n", &encode(&points, PLY));
    let back = CloudReader::open(&reply.body[..], ReadLimits::default()).unwrap().read().unwrap();
    assert_eq!(back.positions.len(), 150);
    let refused = server.ask("POST", "/points", "accept: image/png\r\n", &encode(&points, PLY));
    assert_eq!((refused.status, refused.problem_name().as_str()), (406, "not-acceptable"));
}

#[test]
fn points_have_the_limits_of_uploads() {
    let limits = Limits { points_in: 200, body_bytes: 100_000, ..Limits::default() };
    let server = Server::start(&Scripted::new(), Config { limits, ..Config::default() });
    for (body, status, name) in [
        (encode(&cloud(201), PLY), 413, "too-many-points-in"),
        (encode(&cloud(201), Format::TEXT), 413, "too-many-points-in"),
        (vec![b' '; 100_001], 413, "body-too-large"),
        (b"1 2 3\n4 five 6\n".to_vec(), 400, "malformed-cloud"),
        (b"GIF89a".to_vec(), 415, "unsupported-format"),
    ] {
        let refused = server.post("/points", &body);
        assert_eq!((refused.status, refused.problem_name().as_str()), (status, name), "{}", refused.text());
    }
    assert_eq!(unpacked(&server.post("/points", &encode(&cloud(200), PLY))).1.len(), 200);
    wait_until("all memory is given back", || server.metric("densecloud_held_bytes") == 0.0);
}

#[test]
fn a_jobs_result_is_shown_as_its_file_would_be() {
    let folder = tempfile::tempdir().unwrap();
    let jobs = Some(densecloud_jobs::Settings::new(folder.path().to_owned()));
    let server = Server::start(&Scripted::new(), Config { jobs, ..Config::default() });
    let submitted = server.post("/jobs?ratio=2", &encode(&cloud(300), PLY));
    let job = submitted.header("location").expect("a location").to_owned();
    wait_until("it is done", || server.get(&format!("{job}/result")).status == 200);
    let result = server.get(&format!("{job}/result"));
    let result = CloudReader::open(&result.body[..], ReadLimits::default()).unwrap().read().unwrap();
    assert_near(&unpacked(&server.get(&format!("{job}/points?order=file"))).1, &result.positions);
    let text = server.ask("GET", &format!("{job}/points"), "accept: text/plain\r\n", b"");
    let text = CloudReader::open(&text.body[..], ReadLimits::default()).unwrap().read().unwrap();
    assert_near(&text.positions, &result.positions);
    assert_eq!(server.get("/jobs/none/points").problem_name(), "no-such-job");
}

#[test]
fn an_estimate_tells_points_and_seconds_of_what_can_be_told() {
    let server = Server::start(&Scripted::new(), Config::default());
    let reply = server.get("/estimate?points_in=1000&ratio=2.5");
    let estimate: Value = serde_json::from_slice(&reply.body).unwrap();
    assert_eq!(estimate["points_out"], 2500);
    assert!(estimate["seconds"].as_f64().is_some_and(|seconds| seconds > 0.0), "{estimate}");
    let best = server.get("/estimate?points_in=1000&ratio=2.5&quality=best");
    let best: Value = serde_json::from_slice(&best.body).unwrap();
    assert!(best["seconds"].as_f64() > estimate["seconds"].as_f64(), "{best}");
    for query in [
        "",
        "?ratio=4",
        "?points_in=0&ratio=4",
        "?points_in=9",
        "?points_in=9&spacing=1",
        "?points_in=9&points_in=9&ratio=2",
    ] {
        assert_eq!(server.get(&format!("/estimate{query}")).problem_name(), "invalid-parameter", "{query}");
    }
}

#[test]
fn the_page_comes_with_a_policy_that_lets_nothing_else_in() {
    let server = Server::start(&Scripted::new(), Config::default());
    for (path, kind) in
        [("/", "text/html"), ("/page/main.js", "text/javascript"), ("/page/style.css", "text/css")]
    {
        let reply = server.get(path);
        assert!(reply.header("content-type").is_some_and(|found| found.starts_with(kind)), "{path}");
        let policy = reply.header("content-security-policy").expect("a policy");
        assert!(policy.starts_with("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
    }
    for path in ["/page/none.js", "/page/..%2fstyle.css", "/page/", "/index.html"] {
        assert_eq!(server.get(path).problem_name(), "not-found", "{path}");
    }
}

#[test]
fn files_are_those_that_were_named_and_need_the_key() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scan.xyz");
    std::fs::write(&file, "1 2 3\n").unwrap();
    let keys = Some(Arc::new(Keys::of_one("you", "a-key-that-nobody-guesses").unwrap()));
    let access = Access { keys, ..Access::default() };
    let server = Server::start(&Scripted::new(), Config { access, files: vec![file], ..Config::default() });
    let key = "authorization: Bearer a-key-that-nobody-guesses\r\n";
    let reply = server.ask("GET", "/files/0", key, b"");
    assert_eq!((reply.status, &reply.body[..]), (200, &b"1 2 3\n"[..]));
    let about: Value = serde_json::from_slice(&server.ask("GET", "/about", key, b"").body).unwrap();
    assert_eq!(about["files"], serde_json::json!([{ "name": "scan.xyz" }]));
    for other in ["/files/1", "/files/-1", "/files/x", "/files/..%2f0"] {
        assert_eq!(server.ask("GET", other, key, b"").problem_name(), "not-found", "{other}");
    }
    for path in ["/files/0", "/about"] {
        assert_eq!(server.get(path).problem_name(), "unauthorized", "{path}");
    }
    assert_eq!(server.get("/").status, 200, "the page itself is nobody's");
}
