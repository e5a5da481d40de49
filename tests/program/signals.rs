//! The end of the program: by a signal, by two, and as a service manager sees it.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Stdio;

use crate::support::{PATIENCE, Serving, agent, densecloud, request, signal, sphere, wide_sphere};

/// A file of keys that nobody else can read.
fn write_keys(path: &Path, text: &str) {
    std::fs::write(path, text).expect("a file");
    let owners = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(path, owners).expect("permissions");
}

#[test]
fn a_hangup_has_keys_read_again_and_ends_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("keys");
    write_keys(&path, "alice alices-secret-key\n");
    let serving = Serving::start(&["--keys", path.to_str().expect("UTF-8")]);
    let status = |key: &str| {
        let asked = agent().post(serving.url("/upsample?ratio=2")).header("x-api-key", key);
        asked.send(sphere(100).as_bytes()).expect("an answer").status().as_u16()
    };
    let statuses = || [status("alices-secret-key"), status("bobs-own-secret-key")];
    assert_eq!(statuses(), [200, 401]);
    write_keys(&path, "alice alices-secret-key\nbob bobs-own-secret-key\n");
    assert_eq!(statuses(), [200, 401], "not yet");
    serving.signal("HUP");
    assert_eq!(serving.wait_for("keys read again")["keys"], 2);
    assert_eq!(statuses(), [200, 200]);
    write_keys(&path, "bob bobs-own-secret-key\ncarol\n");
    serving.signal("HUP");
    let event = serving.wait_for_event("keys not read again; those before stay");
    assert_eq!(event["level"], "ERROR");
    assert!(event["fields"]["why"].as_str().expect("words").contains("line 2"), "{event}");
    assert_eq!(statuses(), [200, 200]);
    serving.wait_for_metric("densecloud_keys_reloads_total{outcome=\"ok\"} 1");
    serving.wait_for_metric("densecloud_keys_reloads_total{outcome=\"failed\"} 1");
    serving.signal("TERM");
    assert_eq!(serving.end().code(), Some(0));
}

#[test]
fn hangups_cost_a_job_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let jobs = folder.path().to_str().expect("UTF-8");
    let serving = Serving::start(&["--data-dir", jobs, "--job-attempts", "1"]);
    let mut answer = serving.post("/jobs?ratio=16", sphere(2000).as_bytes());
    let text = answer.body_mut().read_to_string().expect("text");
    let job: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let place = format!("/jobs/{}", job["id"].as_str().expect("an id"));
    serving.wait_for("job started");
    for _ in 0..3 {
        serving.signal("HUP");
        serving.wait_for("hangup: there is nothing to read again without --keys");
    }
    serving.wait_for("job done");
    let job: serde_json::Value = serde_json::from_str(&serving.page(&place)).expect("JSON");
    assert_eq!((&job["state"], &job["attempts"]), (&"done".into(), &1.into()), "{job}");
    // Also on its way to its end.
    serving.signal("HUP");
    serving.signal("TERM");
    assert_eq!(serving.end().code(), Some(0));
}

#[test]
fn a_signal_before_it_serves_is_heard() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("densecloud.toml");
    std::fs::write(&file, "port = 0\nlog-format = \"json\"\nthreads = 1\n").expect("a file");
    let mut command = densecloud();
    let command = command.env("DENSECLOUD_CONFIG", &file).arg("serve").stderr(Stdio::piped());
    let mut child = command.spawn().expect("the program starts");
    let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines();
    // The model is loaded after this.
    let begun = lines.by_ref().map_while(Result::ok).any(|line| line.contains("settings read"));
    signal(&child.id().to_string(), "TERM");
    let rest: Vec<_> = lines.map_while(Result::ok).collect();
    assert_eq!(child.wait().expect("an end").code(), Some(0), "{begun}: {rest:?}");
    assert!(rest.last().is_some_and(|line| line.contains("\"stopped\"")), "{rest:?}");
}

#[test]
fn a_second_signal_ends_it_at_once() {
    let serving = Serving::start(&[]);
    let url = serving.url("/upsample?ratio=64");
    // Minutes of work for one thread.
    let client = std::thread::spawn(move || ureq::post(url).send(sphere(5000).as_bytes()).is_err());
    serving.wait_for_metric("densecloud_queue_points 320000");
    serving.signal("TERM");
    serving.wait_for("draining");
    serving.signal("INT");
    assert_eq!(serving.end().code(), Some(130));
    assert!(client.join().expect("no panic"), "the request was not answered");
}

#[test]
fn between_the_signal_and_the_end_of_its_lead_it_serves_but_says_not_ready() {
    let serving = Serving::start(&["--drain-lead", "600"]);
    serving.signal("TERM");
    serving.wait_for("leaving: not ready any more, still serving");
    let agent = agent();
    assert_eq!(agent.get(serving.url("/readyz")).call().expect("an answer").status(), 503);
    assert_eq!(agent.get(serving.url("/healthz")).call().expect("an answer").status(), 200);
    assert_eq!(serving.post("/upsample?ratio=2", sphere(100).as_bytes()).status(), 200);
    serving.signal("TERM");
    assert_eq!(serving.end().code(), Some(143), "the second signal ends it");
    let serving = Serving::start(&["--drain-lead", "0.1"]);
    serving.signal("INT");
    serving.wait_for("leaving: not ready any more, still serving");
    serving.wait_for("draining");
    serving.wait_for("stopped");
    assert_eq!(serving.end().code(), Some(0));
}

#[test]
fn a_service_manager_is_told_of_the_beginning_and_the_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("notify");
    let socket = std::os::unix::net::UnixDatagram::bind(&path).expect("a socket");
    socket.set_read_timeout(Some(PATIENCE)).expect("a timeout");
    let told = || {
        let mut buffer = [0; 64];
        let length = socket.recv(&mut buffer).expect("a message");
        String::from_utf8_lossy(&buffer[..length]).trim().to_owned()
    };
    let mut command = densecloud();
    command.env("NOTIFY_SOCKET", &path);
    let serving = Serving::start_from(command, &[]);
    assert_eq!(told(), "READY=1");
    serving.signal("TERM");
    assert_eq!(told(), "STOPPING=1");
    assert_eq!(serving.end().code(), Some(0));
}

#[test]
fn a_signal_in_the_middle_of_answers_breaks_none_of_them() {
    let serving = Serving::start(&["--drain-timeout", "120"]);
    let connect = || {
        let stream = TcpStream::connect(&serving.address).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        stream
    };
    // 13 MB each, more than the system buffers.
    let request = request("/upsample?ratio=16", "", &wide_sphere(1000, 100));
    let mut clients = Vec::new();
    // Two that are being sent, and are read no further for now.
    for _ in 0..2 {
        let mut stream = connect();
        stream.write_all(&request).expect("sent");
        let mut start = vec![0; 12];
        stream.read_exact(&mut start).expect("an answer");
        clients.push((stream, start));
    }
    // One that waits for the one thread, or is worked on; and one that is being received.
    let mut waiting = connect();
    waiting.write_all(&request).expect("sent");
    clients.push((waiting, Vec::new()));
    let mut uploading = connect();
    uploading.write_all(&request[..request.len() / 2]).expect("sent");
    serving.wait_for_metric("densecloud_requests_in_flight 4");
    serving.signal("TERM");
    serving.wait_for("draining");
    uploading.write_all(&request[request.len() / 2..]).expect("sent");
    clients.push((uploading, Vec::new()));
    let mut bodies = Vec::new();
    for (mut stream, mut answer) in clients {
        stream.read_to_end(&mut answer).expect("the whole answer");
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").expect("a head") + 4;
        let head = String::from_utf8_lossy(&answer[..end]).into_owned();
        assert!(head.starts_with("HTTP/1.1 200"), "{head}");
        let body = answer.split_off(end);
        assert!(head.contains(&format!("content-length: {}\r\n", body.len())), "{head}");
        bodies.push(body);
    }
    assert!(bodies.iter().all(|body| *body == bodies[0]) && bodies[0].len() > 12 << 20);
    assert_eq!(serving.end().code(), Some(0));
}
