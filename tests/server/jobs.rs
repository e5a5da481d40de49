//! Jobs: kept, run, told of, and there again after a new start.

use std::path::Path;

use densecloud_cascade::Target;
use densecloud_formats::Format;
use densecloud_server::Config;
use serde_json::Value;

use crate::support::{PLY, Reply, Scripted, Server, cloud, dense, encode, encode_result, wait_until};

fn config(folder: &Path) -> Config {
    Config { jobs: Some(densecloud_jobs::Settings::new(folder.to_owned())), ..Config::default() }
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

fn json(reply: &Reply) -> Value {
    serde_json::from_slice(&reply.body).unwrap_or_else(|e| panic!("{e}: {}", reply.text()))
}

/// Keeps a job and gives its path.
fn submit(server: &Server, query: &str, body: &[u8]) -> String {
    let reply = server.post(&format!("/jobs?{query}"), body);
    assert_eq!(reply.status, 202, "{}", reply.text());
    let job = json(&reply);
    let path = reply.header("location").expect("a location").to_owned();
    assert_eq!(path, format!("/jobs/{}", job["id"].as_str().expect("an id")));
    path
}

fn state(server: &Server, path: &str) -> String {
    json(&server.get(path))["state"].as_str().expect("a state").to_owned()
}

fn wait_for(server: &Server, path: &str, wanted: &str) -> Value {
    wait_until(&format!("{path} is {wanted}"), || state(server, path) == wanted);
    json(&server.get(path))
}

impl Server {
    fn delete(&self, target: &str) -> Reply {
        self.ask("DELETE", target, "", b"")
    }
}

#[test]
fn a_jobs_result_is_what_upsample_answers() {
    let folder = folder();
    let server = Server::start(&Scripted::new(), config(folder.path()));
    for (format, query, accept) in [
        (PLY, "ratio=4", ""),
        (Format::TEXT, "points=1001&seed=7", ""),
        (Format::Las { compressed: true }, "ratio=2.5", ""),
        (PLY, "ratio=3&normals=estimate&source_fields", "accept: text/csv, */*;q=0.1\r\n"),
    ] {
        let body =
            densecloud_formats::encode(Vec::new(), format, &cloud(300), &[], &Default::default()).unwrap();
        let reply = server.ask("POST", &format!("/jobs?{query}"), accept, &body);
        assert_eq!(reply.status, 202, "{}", reply.text());
        let path = reply.header("location").expect("a location").to_owned();
        let job = wait_for(&server, &path, "done");
        let live = server.ask("POST", &format!("/upsample?{query}"), accept, &body);
        let kept = server.get(&format!("{path}/result"));
        assert_eq!((live.status, kept.status), (200, 200));
        assert!(live.body == kept.body, "{format:?} {query}");
        for header in
            ["content-type", "densecloud-points-in", "densecloud-points-out", "densecloud-provenance"]
        {
            assert_eq!(live.header(header), kept.header(header), "{header}");
        }
        assert_eq!(job["result"]["bytes"], kept.body.len());
        assert_eq!(job["progress"]["fraction"], 1.0);
        assert_eq!(job["attempts"], 1);
        assert_eq!(kept.header("etag").expect("a tag").trim_matches('"'), job["result"]["sha256"]);
    }
    let body = encode(&cloud(300), PLY);
    let path = submit(&server, "ratio=4&seed=9", &body);
    wait_for(&server, &path, "done");
    let kept = server.get(&format!("{path}/result"));
    let expected = dense(cloud(300), Target::Ratio(4.0), 9);
    assert!(kept.body == encode_result(&expected, PLY, &kept), "the library's own result");
    assert_eq!(server.metric("densecloud_jobs{state=\"done\"}"), 5.0);
    assert_eq!(server.metric("densecloud_jobs{state=\"queued\"}"), 0.0);
}

#[test]
fn parts_of_a_result_are_sent_and_what_has_not_changed_is_not() {
    let folder = folder();
    let server = Server::start(&Scripted::new(), config(folder.path()));
    let path = submit(&server, "ratio=64", &encode(&cloud(1000), PLY));
    wait_for(&server, &path, "done");
    let target = format!("{path}/result");
    let whole = server.get(&target);
    let (length, tag) = (whole.body.len(), whole.header("etag").expect("a tag").to_owned());
    assert!(length > 512 << 10, "more than two pieces");
    let ask = |headers: &str| server.ask("GET", &target, headers, b"");
    let part = ask("range: bytes=100-299999\r\n");
    assert_eq!(part.status, 206);
    assert!(part.body == whole.body[100..300_000]);
    assert_eq!(part.header("content-range"), Some(format!("bytes 100-299999/{length}").as_str()));
    let end = ask(&format!("range: bytes=-5\r\nif-range: {tag}\r\n"));
    assert!(end.status == 206 && end.body == whole.body[length - 5..]);
    let stale = ask("range: bytes=-5\r\nif-range: \"other\"\r\n");
    assert!(stale.status == 200 && stale.body == whole.body);
    let beyond = ask(&format!("range: bytes={length}-\r\n"));
    assert_eq!((beyond.status, beyond.problem_name().as_str()), (416, "range-not-satisfiable"));
    assert_eq!(beyond.header("content-range"), Some(format!("bytes */{length}").as_str()));
    let same = ask(&format!("if-none-match: \"x\", {tag}\r\n"));
    assert_eq!((same.status, same.body.len()), (304, 0));
    assert_eq!(whole.header("accept-ranges"), Some("bytes"));
}

#[test]
fn a_job_waits_its_turn_and_is_cancelled_wherever_it_is() {
    let folder = folder();
    let backend = Scripted::new();
    let server = Server::start(&backend, config(folder.path()));
    backend.shut();
    let body = encode(&cloud(500), PLY);
    let running = submit(&server, "ratio=16", &body);
    wait_until("the first is in its units", || json(&server.get(&running))["progress"]["stage"] == "units");
    let queued = submit(&server, "ratio=4", &body);
    let last = submit(&server, "ratio=4", &body);
    let job = json(&server.get(&last));
    assert_eq!((job["state"].as_str(), job["position"].as_u64()), (Some("queued"), Some(1)));
    for time in ["created", "expected_start", "expected_end"] {
        assert!(job[time].as_str().expect("a time").ends_with('Z'), "{job}");
    }
    let early = server.get(&format!("{last}/result"));
    assert_eq!((early.status, early.problem_name().as_str()), (409, "job-not-done"));
    assert_eq!(server.metric("densecloud_jobs{state=\"running\"}"), 1.0);
    for path in [&queued, &running] {
        let reply = server.delete(path);
        assert_eq!((reply.status, json(&reply)["state"].as_str()), (200, Some("cancelled")));
    }
    backend.open();
    wait_for(&server, &last, "done");
    for path in [&queued, &running] {
        assert_eq!(state(&server, path), "cancelled");
        assert_eq!(server.get(&format!("{path}/result")).problem_name(), "job-not-done");
    }
    for path in [&queued, &running, &last] {
        assert_eq!(server.delete(path).status, 204);
        assert_eq!(server.get(path).problem_name(), "no-such-job");
        assert_eq!(server.delete(path).status, 404);
    }
    assert_eq!(std::fs::read_dir(folder.path().join("files")).expect("a folder").count(), 0);
}

#[test]
fn the_same_key_and_request_is_the_same_job() {
    let folder = folder();
    let server = Server::start(&Scripted::new(), config(folder.path()));
    let (one, other) = (encode(&cloud(100), PLY), encode(&cloud(101), PLY));
    let ask = |query: &str, body: &[u8]| server.ask("POST", query, "idempotency-key: k-1\r\n", body);
    let first = ask("/jobs?ratio=2", &one);
    let again = ask("/jobs?ratio=2", &one);
    assert_eq!((first.status, again.status), (202, 200));
    assert_eq!(first.header("location"), again.header("location"));
    for (query, body) in [("/jobs?ratio=3", &one), ("/jobs?ratio=2", &other)] {
        let refused = ask(query, body);
        assert_eq!((refused.status, refused.problem_name().as_str()), (422, "idempotency-key-reused"));
    }
    let bad = server.ask("POST", "/jobs?ratio=2", "idempotency-key: \r\n", &one);
    assert_eq!(bad.problem()["parameter"], "Idempotency-Key");
    assert_eq!(json(&server.get("/jobs"))["jobs"].as_array().expect("jobs").len(), 1);
}

#[test]
fn jobs_are_listed_in_pages_the_newest_first() {
    let folder = folder();
    let server = Server::start(&Scripted::new(), config(folder.path()));
    let body = encode(&cloud(60), PLY);
    let mut paths: Vec<_> = (0..5).map(|_| submit(&server, "ratio=2", &body)).collect();
    paths.reverse();
    let mut listed = Vec::new();
    let mut page = "/jobs?limit=2".to_owned();
    loop {
        let reply = json(&server.get(&page));
        for job in reply["jobs"].as_array().expect("jobs") {
            listed.push(format!("/jobs/{}", job["id"].as_str().expect("an id")));
        }
        match reply["next"].as_str() {
            Some(next) => page = next.to_owned(),
            None => break,
        }
    }
    assert_eq!(listed, paths);
    for query in ["limit=0", "limit=101", "before=x", "before=0", "size=3", "limit=2&limit=2"] {
        assert_eq!(server.get(&format!("/jobs?{query}")).problem_name(), "invalid-parameter", "{query}");
    }
}

#[test]
fn what_upsample_refuses_is_refused_and_what_fails_later_is_a_failed_job() {
    let folder = folder();
    let backend = Scripted::new();
    let mut config = config(folder.path());
    config.limits.points_in = 1000;
    config.limits.body_bytes = 50_000;
    let server = Server::start(&backend, config);
    let body = encode(&cloud(100), PLY);
    for (target, body) in [
        ("ratio=65", body.clone()),
        ("ratio=4&sede=1", body.clone()),
        ("points=10", body.clone()),
        ("ratio=4&attributes=red:mean", body.clone()),
        ("ratio=4", b"PK\x03\x04 a ZIP file".to_vec()),
        ("ratio=4", encode(&cloud(1001), PLY)),
        ("ratio=4", vec![b'1'; 60_000]),
        ("ratio=4", body[..body.len() - 1].to_vec()),
    ] {
        let live = server.post(&format!("/upsample?{target}"), &body);
        let kept = server.post(&format!("/jobs?{target}"), &body);
        assert_eq!((live.status, live.problem_name()), (kept.status, kept.problem_name()), "{target}");
    }
    assert_eq!(json(&server.get("/jobs"))["jobs"].as_array().expect("jobs").len(), 0);
    // Only the cascade finds out that all points are one.
    let one = encode(&vec![[1.0, 2.0, 3.0]; 100], PLY);
    let live = server.post("/upsample?ratio=4", &one);
    let job = wait_for(&server, &submit(&server, "ratio=4", &one), "failed");
    assert_eq!(job["problem"]["type"], live.problem()["type"]);
    assert_eq!(job["problem"]["request_id"], job["request_id"]);
    backend.fail();
    let job = wait_for(&server, &submit(&server, "ratio=4", &body), "failed");
    assert_eq!(job["problem"]["type"], "urn:densecloud:problem:internal");
    assert!(!job.to_string().contains("secret"), "{job}");
}

#[test]
fn without_a_folder_there_are_no_jobs() {
    let server = Server::start(&Scripted::new(), Config::default());
    let body = encode(&cloud(100), PLY);
    let replies = [
        server.post("/jobs?ratio=4", &body),
        server.get("/jobs"),
        server.get("/jobs/x"),
        server.get("/jobs/x/events"),
        server.delete("/jobs/x"),
    ];
    for reply in replies {
        assert_eq!((reply.status, reply.problem_name().as_str()), (501, "jobs-off"));
        assert_eq!(reply.problem()["setting"], "--data-dir");
    }
}

#[test]
fn a_disk_that_is_full_refuses_jobs() {
    let folder = folder();
    let mut config = config(folder.path());
    let settings = config.jobs.as_mut().expect("jobs");
    settings.disk = 30_000;
    let server = Server::start(&Scripted::new(), config);
    let body = encode(&cloud(500), PLY);
    let refused = server.post("/jobs?ratio=4", &body);
    assert_eq!((refused.status, refused.problem_name().as_str()), (507, "job-disk-full"));
    assert_eq!(refused.problem()["setting"], "--job-disk");
    wait_for(&server, &submit(&server, "ratio=1", &body), "done");
}

#[test]
fn events_tell_of_the_way_to_the_end() {
    let folder = folder();
    let backend = Scripted::new();
    let server = Server::start(&backend, config(folder.path()));
    backend.shut();
    let path = submit(&server, "ratio=16", &encode(&cloud(500), PLY));
    let mut client = server.connect();
    client.send(format!("GET {path}/events HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").as_bytes());
    let mut bytes = Vec::new();
    while !bytes.windows(7).any(|w| w == b"\"units\"") {
        bytes.extend(client.some());
    }
    assert_eq!(server.metric("densecloud_event_streams"), 1.0);
    backend.open();
    bytes.extend(client.rest());
    // How long a job is watched says nothing of how fast requests are answered.
    wait_until("it is over", || server.metric("densecloud_event_streams") == 0.0);
    assert_eq!(server.metric("densecloud_requests_total{interface=\"http\",outcome=\"ok\"}"), 2.0);
    assert_eq!(server.metric("densecloud_request_duration_seconds_count{interface=\"http\"}"), 1.0);
    let reply = Reply::parse(&bytes).expect("a whole response");
    assert_eq!(reply.header("content-type"), Some("text/event-stream"));
    let text = reply.text();
    let events: Vec<(&str, Value)> = text
        .split("\n\n")
        .filter_map(|event| {
            let (kind, data) = event.strip_prefix("event: ")?.split_once("\ndata: ")?;
            Some((kind, serde_json::from_str(data).expect("JSON")))
        })
        .collect();
    let (last, before) = events.split_last().expect("events");
    assert!(before.iter().all(|(kind, _)| *kind == "progress"), "{text}");
    assert_eq!((last.0, last.1["state"].as_str()), ("done", Some("done")));
    let fractions: Vec<_> = events.iter().map(|(_, job)| job["progress"]["fraction"].as_f64()).collect();
    assert!(fractions.is_sorted(), "{fractions:?}");
    assert_eq!(server.get("/jobs/none/events").status, 404);
}

#[test]
fn a_stopped_server_goes_on_where_it_was() {
    let folder = folder();
    let backend = Scripted::new();
    let mut server = Server::start(&backend, config(folder.path()));
    let body = encode(&cloud(500), PLY);
    let done = submit(&server, "ratio=2", &body);
    wait_for(&server, &done, "done");
    let before = json(&server.get(&done));
    backend.shut();
    let running = submit(&server, "ratio=16", &body);
    wait_until("it runs", || json(&server.get(&running))["progress"]["stage"] == "units");
    let queued = submit(&server, "ratio=4", &body);
    let mut watching = server.connect();
    watching
        .send(format!("GET {running}/events HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").as_bytes());
    watching.some();
    server.stop();
    // The end of the watch: the job has been put back by then.
    watching.rest();
    backend.open();
    assert!(server.join().is_ok());
    let server = Server::start(&Scripted::new(), config(folder.path()));
    assert_eq!(json(&server.get(&done)), before);
    for (path, ratio) in [(&running, 16.0), (&queued, 4.0)] {
        let job = wait_for(&server, path, "done");
        assert_eq!(job["attempts"], 1, "a stop in good order is no failed attempt");
        let kept = server.get(&format!("{path}/result"));
        let expected = dense(cloud(500), Target::Ratio(ratio), 0);
        assert!(kept.body == encode_result(&expected, PLY, &kept));
    }
    drop(server);
}

#[test]
fn a_folder_belongs_to_one_server() {
    let folder = folder();
    let _server = Server::start(&Scripted::new(), config(folder.path()));
    let mut other = Server::start_cold(
        &Scripted::new(),
        densecloud_engine::EngineConfig::default(),
        config(folder.path()),
    );
    let error = other.join().expect_err("locked");
    assert!(error.to_string().contains("--data-dir"), "{error}");
}

#[test]
fn a_job_that_is_over_is_forgotten_in_time_and_its_key_with_it() {
    let folder = folder();
    let mut config = config(folder.path());
    config.jobs.as_mut().expect("jobs").expiry = std::time::Duration::from_secs(1);
    let backend = Scripted::new();
    let server = Server::start(&backend, config);
    let body = encode(&cloud(100), PLY);
    let ask = || server.ask("POST", "/jobs?ratio=2", "idempotency-key: k-1\r\n", &body);
    backend.shut();
    let first = ask();
    let path = first.header("location").expect("a location").to_owned();
    assert_eq!((first.status, ask().status), (202, 200));
    assert!(json(&server.get(&path))["expires"].is_null(), "not before it is over");
    backend.open();
    wait_until("it is forgotten", || server.get(&path).status == 404);
    assert_eq!(server.get(&format!("{path}/result")).problem_name(), "no-such-job");
    let files = || std::fs::read_dir(folder.path().join("files")).expect("a folder").count();
    // A row goes before its files.
    wait_until("its files are gone", || files() == 0);
    assert_eq!(ask().status, 202, "the key is free again");
}

#[test]
fn requests_at_once_under_one_key_are_one_job() {
    let folder = folder();
    let server = Server::start(&Scripted::new(), config(folder.path()));
    let body = encode(&cloud(100), PLY);
    let replies: Vec<Reply> = std::thread::scope(|scope| {
        let ask = || server.ask("POST", "/jobs?ratio=2", "idempotency-key: k-1\r\n", &body);
        let asking: Vec<_> = (0..8).map(|_| scope.spawn(ask)).collect();
        asking.into_iter().map(|one| one.join().expect("no panic")).collect()
    });
    assert_eq!(replies.iter().filter(|reply| reply.status == 202).count(), 1);
    assert_eq!(replies.iter().filter(|reply| reply.status == 200).count(), 7);
    assert!(replies.iter().all(|reply| reply.header("location") == replies[0].header("location")));
    assert_eq!(json(&server.get("/jobs"))["jobs"].as_array().expect("jobs").len(), 1);
}

#[test]
fn of_a_request_no_more_is_kept_than_is_needed() {
    let folder = folder();
    let backend = Scripted::new();
    let server = Server::start(&backend, config(folder.path()));
    let body = encode(&cloud(100), PLY);
    // As long as a head may be.
    let accept = format!("accept: text/csv{}\r\n", ", image/x-nothing".repeat(3500));
    let reply = server.ask("POST", "/jobs?ratio=2", &accept, &body);
    assert_eq!(reply.status, 202, "{}", reply.text());
    let path = reply.header("location").expect("a location").to_owned();
    wait_for(&server, &path, "done");
    assert_eq!(server.get(&format!("{path}/result")).header("content-type"), Some("text/csv; charset=utf-8"));
    let database = rusqlite::Connection::open(folder.path().join("jobs.sqlite")).expect("a database");
    let kept: i64 =
        database.query_row("SELECT max(length(request)) FROM jobs", [], |row| row.get(0)).expect("a row");
    assert!(kept < 200, "{kept}");
    // In the query, and in a form, which may be longer than any URI.
    let long = |count: usize| format!("{}1,2,3", "0".repeat(count));
    let refused = server.post(&format!("/jobs?ratio=2&sensor={}", long(17_000)), &body);
    assert_eq!((refused.status, refused.problem_name().as_str()), (400, "invalid-parameter"));
    assert!(refused.text().contains("16384"), "{}", refused.text());
    // What is kept is what it means; what cannot be said in fewer words is refused.
    let rules = format!("{}:drop", "x".repeat(17_000));
    for (name, value, status) in [("sensor", long(100_000), 202), ("attributes", rules, 400)] {
        let field = |name: &str, value: &str| {
            format!("--b\r\ncontent-disposition: form-data; name=\"{name}\"\r\n\r\n{value}\r\n")
        };
        let file = "--b\r\ncontent-disposition: form-data; name=\"cloud\"; filename=\"a.ply\"\r\n\r\n";
        let fields = field("ratio", "2") + &field(name, &value) + file;
        let form = [fields.as_bytes(), &body, b"\r\n--b--\r\n"].concat();
        let reply = server.ask("POST", "/jobs", "content-type: multipart/form-data; boundary=b\r\n", &form);
        assert_eq!(reply.status, status, "{}", reply.text());
        match status {
            202 => drop(wait_for(&server, reply.header("location").expect("a location"), "done")),
            _ => assert!(reply.text().contains("16384"), "{}", reply.text()),
        };
    }
}

#[test]
fn a_job_that_is_above_a_limit_of_today_fails_and_holds_nobody_up() {
    let folder = folder();
    let backend = Scripted::new();
    let mut server = Server::start(&backend, config(folder.path()));
    backend.shut();
    let running = submit(&server, "ratio=2", &encode(&cloud(100), PLY));
    wait_for(&server, &running, "running");
    let large = submit(&server, "ratio=2", &encode(&cloud(2000), PLY));
    let small = submit(&server, "ratio=2", &encode(&cloud(100), PLY));
    server.stop();
    wait_until("it is draining", || !server.is_ready());
    backend.open();
    assert!(server.join().is_ok());
    let mut config = config(folder.path());
    config.limits.body_bytes = 10_000;
    config.limits.points_out = 800;
    // Less than the cloud, so it would wait for room for ever.
    config.limits.held_bytes = 20_000;
    let server = Server::start(&Scripted::new(), config);
    let job = wait_for(&server, &large, "failed");
    assert_eq!(job["problem"]["type"], "urn:densecloud:problem:body-too-large", "{job}");
    assert_eq!(job["problem"]["setting"], "--max-body-bytes");
    wait_for(&server, &running, "done");
    wait_for(&server, &small, "done");
}

#[test]
fn a_result_that_memory_does_not_suffice_to_compress_has_the_tag_of_what_is_sent() {
    let folder = folder();
    let mut config = config(folder.path());
    config.limits.body_bytes = 50_000;
    config.limits.points_out = 2000;
    // Less than what a compressor takes.
    config.limits.held_bytes = 60_000;
    let server = Server::start(&Scripted::new(), config);
    let path = submit(&server, "ratio=4", &encode(&cloud(100), PLY));
    let job = wait_for(&server, &path, "done");
    let reply = server.ask("GET", &format!("{path}/result"), "accept-encoding: gzip\r\n", b"");
    assert_eq!((reply.status, reply.header("content-encoding")), (200, None));
    assert_eq!(reply.header("etag").expect("a tag").trim_matches('"'), job["result"]["sha256"]);
    assert_eq!(reply.header("accept-ranges"), Some("bytes"));
    assert_eq!(reply.body.len() as u64, job["result"]["bytes"].as_u64().expect("a length"));
}

#[test]
fn a_name_that_is_no_text_is_one_of_no_job() {
    let folder = folder();
    let server = Server::start(&Scripted::new(), config(folder.path()));
    for (method, rest) in [("GET", ""), ("GET", "/result"), ("GET", "/events"), ("DELETE", "")] {
        let reply = server.ask(method, &format!("/jobs/%ff{rest}"), "", b"");
        assert_eq!((reply.status, reply.problem_name().as_str()), (404, "no-such-job"), "{method} {rest}");
    }
}

#[test]
fn watching_asks_the_database_only_when_a_job_has_changed() {
    let folder = folder();
    let backend = Scripted::new();
    let server = Server::start(&backend, config(folder.path()));
    backend.shut();
    let path = submit(&server, "ratio=16", &encode(&cloud(500), PLY));
    wait_until("it is in its units", || json(&server.get(&path))["progress"]["stage"] == "units");
    let mut client = server.connect();
    client.send(format!("GET {path}/events HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").as_bytes());
    let mut bytes = Vec::new();
    while !bytes.windows(7).any(|w| w == b"\"units\"") {
        bytes.extend(client.some());
    }
    let mut step = || {
        let count = |bytes: &[u8]| bytes.windows(15).filter(|w| w == b"event: progress").count();
        let before = count(&bytes);
        backend.pass();
        while count(&bytes) == before {
            bytes.extend(client.some());
        }
    };
    // By the time of this event it has looked at all that had changed before.
    step();
    // What only the database knows, behind the server's back.
    let database = rusqlite::Connection::open(folder.path().join("jobs.sqlite")).expect("a database");
    database.execute("UPDATE jobs SET attempts = 7", []).expect("no lock");
    step();
    backend.open();
    bytes.extend(client.rest());
    let text = Reply::parse(&bytes).expect("a whole response").text();
    let progress = text.split("\n\n").filter(|event| event.starts_with("event: progress"));
    assert!(progress.clone().all(|event| event.contains("\"attempts\":1,")), "{text}");
    assert!(text.contains("event: done") && text.contains("\"attempts\":7,"), "{text}");
}
