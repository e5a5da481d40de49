//! `densecloud serve` as a person runs it, with the model inside it and a client from elsewhere.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Longer than anything here takes.
const PATIENCE: Duration = Duration::from_secs(120);

fn densecloud() -> Command {
    Command::new(env!("CARGO_BIN_EXE_densecloud"))
}

fn run(arguments: &[&str]) -> Output {
    densecloud().args(arguments).output().expect("the program starts")
}

/// The program in the background, ended with the test.
struct Serving {
    child: Child,
    log: Receiver<serde_json::Value>,
    address: String,
}

impl Serving {
    /// Starts it on a port that the system chooses, and waits until it is ready.
    fn start() -> Self {
        Self::start_with(&[])
    }

    fn start_with(options: &[&str]) -> Self {
        Self::start_from(densecloud(), options)
    }

    fn start_from(mut program: Command, options: &[&str]) -> Self {
        let mut child = program
            .args(["serve", "--port", "0", "--log-format", "json", "--threads", "1"])
            .args(options)
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let lines = BufReader::new(child.stderr.take().expect("piped")).lines();
        let (sender, log) = channel();
        std::thread::spawn(move || {
            // A runtime that is interrupted by the end of the process says so in its own form.
            for line in lines.map_while(Result::ok).filter(|line| !line.contains("onnxruntime")) {
                let event = serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line}"));
                // A test that is over reads no more.
                let _ = sender.send(event);
            }
        });
        let mut serving = Self { child, log, address: String::new() };
        let listening = serving.wait_for("listening");
        serving.address = listening["address"].as_str().expect("an address").to_owned();
        serving.wait_for("ready");
        serving
    }

    /// The fields of the next event with this message.
    fn wait_for(&self, message: &str) -> serde_json::Value {
        self.wait_for_event(message)["fields"].clone()
    }

    fn wait_for_event(&self, message: &str) -> serde_json::Value {
        loop {
            let event = self.log.recv_timeout(PATIENCE).unwrap_or_else(|e| panic!("no {message:?}: {e}"));
            if event["fields"]["message"] == message {
                return event;
            }
        }
    }

    fn url(&self, target: &str) -> String {
        format!("http://{}{target}", self.address)
    }

    /// The standard library cannot send a signal.
    fn signal(&self, name: &str) {
        let sent = Command::new("kill").args(["-s", name, &self.child.id().to_string()]).status();
        assert!(sent.expect("kill is there").success());
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        // Mostly it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn text(points: usize) -> String {
    let point = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / points as f64;
        let (r, angle) = ((1.0 - z * z).sqrt(), i as f64 * 2.399_963);
        format!("{:.6} {:.6} {z:.6}\n", 500_000.0 + r * angle.cos(), r * angle.sin())
    };
    (0..points).map(point).collect()
}

#[test]
fn the_server_gives_the_command_lines_bytes_and_stops_when_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    std::fs::write(path("in.xyz"), text(300)).expect("a file");
    let mut serving = Serving::start();
    // First text, then the binary PLY that the command line makes of it.
    for (input, output, ratio) in [("in.xyz", "dense.xyz", "3.7"), ("dense.ply", "denser.ply", "2")] {
        if input == "dense.ply" {
            let made = run(&["upsample", &path("in.xyz"), &path(input), "--ratio", "1.5"]);
            assert!(made.status.success(), "{made:?}");
        }
        let made = run(&["upsample", &path(input), &path(output), "--ratio", ratio, "--seed", "5"]);
        assert!(made.status.success(), "{made:?}");
        let body = std::fs::read(path(input)).expect("a file");
        let mut reply = ureq::post(serving.url(&format!("/upsample?ratio={ratio}&seed=5")))
            .send(&body[..])
            .expect("an answer");
        let served = reply.body_mut().read_to_vec().expect("a body");
        assert!(served == std::fs::read(path(output)).expect("a file"), "{input} at {ratio}");
    }
    serving.signal("TERM");
    assert_eq!(serving.child.wait().expect("an end").code(), Some(0));
}

#[test]
fn the_command_line_leaves_a_job_and_fetches_what_upsample_would_have_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    std::fs::write(path("in.xyz"), text(300)).expect("a file");
    let serving = Serving::start_with(&["--data-dir", &path("jobs")]);
    let server = serving.url("");
    let job = |arguments: &[&str]| run(&[&["job", "--server", &server], arguments].concat());
    let submitted = job(&["submit", &path("in.xyz"), "--ratio", "3", "--seed", "5", "--accept", "model/e57"]);
    let id = String::from_utf8(submitted.stdout).expect("an id").trim().to_owned();
    let watched = job(&["watch", &id]);
    assert_eq!((watched.status.code(), watched.stdout.as_slice()), (Some(0), &b"done\n"[..]), "{watched:?}");
    assert!(String::from_utf8_lossy(&job(&["list"]).stdout).contains(&id));
    assert!(job(&["get", &id, &path("kept.e57")]).status.success());
    let made = run(&["upsample", &path("in.xyz"), &path("made.e57"), "--ratio", "3", "--seed", "5"]);
    assert!(made.status.success(), "{made:?}");
    let read = |name: &str| std::fs::read(path(name)).expect("a file");
    assert!(read("kept.e57") == read("made.e57"));
    assert!(job(&["cancel", &id]).status.success());
    let gone = job(&["get", &id, &path("gone.e57")]);
    assert_eq!(gone.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&gone.stderr).contains("no job"), "{gone:?}");
    assert!(!folder.path().join("gone.e57").exists());
}

#[test]
fn a_key_lets_a_client_in_and_is_in_no_log() {
    const KEY: &str = "only-between-us-two";
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let hash = "17a1b5e3a1d1b0b8f0d1c5b2a3e4f5061728394a5b6c7d8e9fa0b1c2d3e4f506";
    std::fs::write(path("keys"), format!("# hashed\nother sha256:{hash}\nme {KEY}\n")).expect("a file");
    let private = std::os::unix::fs::PermissionsExt::from_mode(0o600);
    std::fs::set_permissions(path("keys"), private).expect("permissions");
    let serving =
        Serving::start_with(&["--keys", &path("keys"), "--data-dir", &path("jobs"), "--log", "debug"]);
    let server = serving.url("");
    let list = |key: Option<&str>| {
        let mut command = densecloud();
        command.args(["job", "--server", &server, "list"]).env_remove("DENSECLOUD_KEY");
        command.envs(key.map(|key| ("DENSECLOUD_KEY", key))).output().expect("the program starts")
    };
    for (key, code) in [(None, 1), (Some("of-somebody-elses"), 1), (Some(KEY), 0)] {
        let output = list(key);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{stderr}");
        assert_eq!(stderr.contains("--keys"), code == 1, "{stderr}");
    }
    serving.signal("TERM");
    let log: Vec<String> = serving.log.iter().map(|event| event.to_string()).collect();
    assert!(log.iter().any(|line| line.contains("\"client\":\"me\"")), "{log:?}");
    assert!(!log.iter().any(|line| line.contains(KEY) || line.contains("somebody-elses")), "{log:?}");
}

#[test]
#[cfg(target_os = "linux")]
fn a_request_for_which_the_system_has_no_memory_gets_507_and_others_go_on() {
    let size = |serving: &Serving| {
        let status =
            std::fs::read_to_string(format!("/proc/{}/status", serving.child.id())).expect("a process");
        let line = status.lines().find_map(|line| line.strip_prefix("VmPeak:")).expect("its size");
        line.trim().trim_end_matches(" kB").parse::<u64>().expect("kilobytes")
    };
    // One heap for all threads, so that the size tells what is left.
    let limited = |kilobytes: &str| {
        let mut shell = Command::new("sh");
        let script = format!("ulimit -v {kilobytes} && exec \"$0\" \"$@\"");
        shell.args(["-c", &script, env!("CARGO_BIN_EXE_densecloud")]).env("MALLOC_ARENA_MAX", "1");
        Serving::start_from(shell, &["--max-memory", "1000000000000"])
    };
    let idle = size(&limited("unlimited"));
    // Room for 300,000 points, but not for what the first level knows of each: 158 MB.
    let serving = limited(&(idle + 140_000).to_string());
    let body = text(300_000);
    let mut refused = ureq::post(serving.url("/upsample?ratio=4"))
        .config()
        .http_status_as_error(false)
        .build()
        .send(body.as_bytes())
        .expect("an answer");
    let answer = refused.body_mut().read_to_string().expect("a body");
    assert_eq!(refused.status(), 507, "{answer}");
    assert!(answer.contains("out-of-memory"), "{answer}");
    let fine = ureq::post(serving.url("/upsample?ratio=4")).send(text(300).as_bytes());
    assert_eq!(fine.expect("an answer").status(), 200);
}

#[test]
fn a_second_signal_ends_it_at_once() {
    let mut serving = Serving::start();
    let url = serving.url("/upsample?ratio=64");
    // Minutes of work for one thread.
    let client = std::thread::spawn(move || ureq::post(url).send(text(5000).as_bytes()).is_err());
    let metrics = serving.url("/metrics");
    let busy = || {
        let page = ureq::get(&metrics).call().expect("a page").body_mut().read_to_string().expect("text");
        page.lines().any(|line| line == "densecloud_queue_points 320000")
    };
    while !busy() {
        std::thread::sleep(Duration::from_millis(20));
    }
    serving.signal("TERM");
    serving.wait_for("draining");
    serving.signal("INT");
    assert_eq!(serving.child.wait().expect("an end").code(), Some(130));
    assert!(client.join().expect("no panic"), "the request was not answered");
}

#[test]
fn between_the_signal_and_the_end_of_its_lead_it_serves_but_says_not_ready() {
    let mut serving = Serving::start_with(&["--drain-lead", "600"]);
    serving.signal("TERM");
    serving.wait_for("leaving: not ready any more, still serving");
    let agent = ureq::Agent::config_builder().http_status_as_error(false).build().new_agent();
    assert_eq!(agent.get(serving.url("/readyz")).call().expect("an answer").status(), 503);
    assert_eq!(agent.get(serving.url("/healthz")).call().expect("an answer").status(), 200);
    let served = agent.post(serving.url("/upsample?ratio=2")).send(text(100).as_bytes());
    assert_eq!(served.expect("an answer").status(), 200);
    serving.signal("TERM");
    assert_eq!(serving.child.wait().expect("an end").code(), Some(143), "the second signal ends it");
    let mut serving = Serving::start_with(&["--drain-lead", "0.1"]);
    serving.signal("INT");
    serving.wait_for("leaving: not ready any more, still serving");
    serving.wait_for("draining");
    serving.wait_for("stopped");
    assert_eq!(serving.child.wait().expect("an end").code(), Some(0));
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
    let mut serving = Serving::start_from(command, &[]);
    assert_eq!(told(), "READY=1");
    serving.signal("TERM");
    assert_eq!(told(), "STOPPING=1");
    assert_eq!(serving.child.wait().expect("an end").code(), Some(0));
}

#[test]
fn a_requests_id_is_in_its_answer_its_problem_and_the_log() {
    let serving = Serving::start();
    let agent = ureq::Agent::config_builder().http_status_as_error(false).build().new_agent();
    let post = |target: &str, id: &str| {
        let request = agent.post(serving.url(target)).header("x-request-id", id);
        request.send(text(100).as_bytes()).expect("an answer")
    };
    for (target, id, status) in [
        ("/upsample?ratio=2", "fine-1", 200),
        ("/upsample?ratio=99", "wrong-2", 400),
        ("/nowhere", "lost-3", 404),
        ("/healthz", "method-4", 405),
        ("/v2/models/densecloud/infer", "tensor-5", 400),
        ("/jobs?ratio=2", "off-6", 501),
    ] {
        let mut answer = post(target, id);
        assert_eq!(
            (answer.status().as_u16(), &answer.headers()["x-request-id"]),
            (status, &id.parse().expect("an id"))
        );
        if answer.headers()["content-type"] == "application/problem+json" {
            let problem = answer.body_mut().read_to_string().expect("a problem");
            assert!(problem.contains(&format!("\"request_id\":\"{id}\"")), "{problem}");
        }
        drop(answer);
        // Probes leave no line.
        if target != "/healthz" {
            let event = serving.wait_for_event("request over");
            assert_eq!(
                (event["span"]["id"].as_str(), event["fields"]["status"].as_u64()),
                (Some(id), Some(status.into()))
            );
            for member in ["timestamp", "level"] {
                assert!(event[member].is_string(), "{event}");
            }
        }
    }
}

#[test]
fn a_file_sets_what_nothing_stronger_sets() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("densecloud.toml");
    // The options of every test here are given, too: a port of zero, one thread, JSON.
    std::fs::write(&file, "max-points-in = 50\nmax-points-out = 100\nport = 1\nlog-format = \"text\"\n")
        .expect("a file");
    let mut command = densecloud();
    command.env("DENSECLOUD_CONFIG", &file).env("DENSECLOUD_MAX_POINTS_OUT", "150");
    let serving = Serving::start_from(command, &[]);
    let agent = ureq::Agent::config_builder().http_status_as_error(false).build().new_agent();
    let refusal = |points: usize, ratio: u32| {
        let url = serving.url(&format!("/upsample?ratio={ratio}"));
        let mut answer = agent.post(url).send(text(points).as_bytes()).expect("an answer");
        answer.body_mut().read_to_string().expect("text")
    };
    assert!(refusal(51, 2).contains("more than 50;"), "{}", refusal(51, 2));
    assert!(refusal(40, 4).contains("\"limit\":150"), "{}", refusal(40, 4));
}

#[test]
fn settings_are_checked_before_a_port_is_bound() {
    for (arguments, named) in [
        (&["serve", "--max-points-in", "0"][..], "--max-points-in"),
        (&["serve", "--max-held-bytes", "5"], "--max-held-bytes"),
        (&["serve", "--log", "=loud="], "--log"),
        (&["serve", "--stall-timeout", "soon"], "--stall-timeout"),
        (&["serve", "--max-memory", "much"], "--max-memory"),
        (&["serve", "--open", "doors"], "--open"),
        (&["serve", "--keys", "/nowhere/keys"], "/nowhere/keys"),
        (&["serve", "--keys", concat!(env!("CARGO_MANIFEST_DIR"), "/LICENSE-MIT")], "line 1"),
        (&["serve", "--no-such-option"], "--no-such-option"),
        (&["serve", "--model", "/nowhere"], "--model"),
        (&["serve", "--data-dir", "Cargo.toml"], "--data-dir"),
        (&["serve", "--data-dir", "Cargo.toml/jobs"], "--data-dir"),
        (&["serve", "--config", "/nowhere.toml"], "/nowhere.toml"),
        (&["serve", "--config", "Cargo.toml"], "Cargo.toml:1: no setting is called `package`"),
        (&["serve", "--cors-origin", "example.org"], "https://example.org"),
        (&["serve", "--cors-origin", "*,https://example.org"], "--cors-origin"),
        (&["serve", "--print-config", "--max-points-in", "0"], "--max-points-in"),
        (&["no-such-command"], "no-such-command"),
    ] {
        let output = run(arguments);
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(64), "{stderr}");
        assert!(stderr.contains(named), "{stderr}");
    }
}

#[test]
fn a_port_that_is_taken_is_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port().to_string();
    let output = run(&["serve", "--port", &port, "--log-format", "json"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let events = stderr.lines().filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok());
    let failed = events.map(|event| event["fields"].clone()).find(|fields| fields["message"] == "failed");
    let why = failed.as_ref().and_then(|fields| fields["why"].as_str()).unwrap_or_else(|| panic!("{stderr}"));
    assert!(why.contains(&port) && why.contains("--port"), "{why}");
    assert!(stderr.contains(&format!("densecloud: {why}")), "people read it, too: {stderr}");
}

/// A server that answers each request with the next of these, and tells what it was sent.
fn canned(answers: Vec<String>) -> (String, Receiver<String>) {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("http://{}", listener.local_addr().expect("an address"));
    let (sender, requests) = channel();
    std::thread::spawn(move || {
        for answer in answers {
            let (mut stream, _) = listener.accept().expect("a client");
            let mut reader = BufReader::new(stream.try_clone().expect("a stream"));
            let mut head = String::new();
            while !head.ends_with("\r\n\r\n") {
                reader.read_line(&mut head).expect("a head");
            }
            let _ = sender.send(head);
            stream.write_all(answer.as_bytes()).expect("an answer");
        }
    });
    (url, requests)
}

fn refusal(status: &str, kind: &str, retry_after: &str) -> String {
    let body = format!(
        "{{\"type\":\"urn:densecloud:problem:{kind}\",\"title\":\"x\",\"detail\":\"told so\",\"request_id\":\"r-1\"}}"
    );
    format!(
        "HTTP/1.1 {status}\r\nconnection: close\r\n{retry_after}content-type: application/problem+json\r\n\
         content-length: {}\r\n\r\n{body}",
        body.len()
    )
}

#[test]
fn upsample_has_a_server_make_the_bytes_that_it_would_have_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let read = |name: &str| std::fs::read(path(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    std::fs::write(path("in.xyz"), text(300)).expect("a file");
    let serving = Serving::start();
    let server = ["--server", &serving.url("/")];
    let all = ["--keep-input", "--source-fields", "--normals", "estimate", "--sensor", "500000,-0.5,9"];
    for (ending, options) in [
        ("xyz", &["--ratio", "2.5", "--seed", "5"][..]),
        ("ply", &[]),
        ("laz", &["--points", "500"]),
        ("csv", &["--spacing", "0.08", "--quiet"]),
        ("dense", &["--density", "40"]),
        ("e57", &all),
        ("npy", &["--attributes", "nx:drop"]),
    ] {
        // The last has attributes to drop.
        let input = if ending == "npy" { path("in.ply") } else { path("in.xyz") };
        if ending == "npy" {
            let made = run(&["upsample", &path("in.xyz"), &input, "--ratio", "1", "--normals", "estimate"]);
            assert!(made.status.success(), "{made:?}");
        }
        let (here, there) = (format!("here.{ending}"), format!("there.{ending}"));
        let made = run(&[&["upsample", &input, &path(&here)], options].concat());
        assert!(made.status.success(), "{made:?}");
        let sent = run(&[&["upsample", &input, &path(&there)], options, &server[..]].concat());
        assert!(sent.status.success(), "{sent:?}");
        assert!(read(&here) == read(&there), "{ending}");
        assert_eq!(sent.stderr.is_empty(), options.contains(&"--quiet"), "{sent:?}");
        let beside = |name: &str| std::fs::read(path(&format!("{name}.provenance.txt"))).ok();
        assert_eq!(beside(&here), beside(&there), "{ending}");
    }
    // By pipes, too.
    let mut piped = densecloud();
    piped.args(["upsample", "-", "-", "--ratio", "2.5", "--seed", "5"]).args(server);
    piped.stdin(std::fs::File::open(path("in.xyz")).expect("a file"));
    assert!(piped.output().expect("an end").stdout == read("here.xyz"));
    // What is wrong is told as it would be here, and leaves no file.
    std::fs::write(path("bad.xyz"), "1 2 3\n4 five 6\n").expect("a file");
    for (input, options, code, told) in [
        ("bad.xyz", &["--ratio", "2"][..], 1, "line 2"),
        ("in.xyz", &["--points", "5"], 1, "points"),
        ("none.xyz", &[], 1, "none.xyz"),
        ("in.xyz", &["--attributes", "red:mean"], 64, "red"),
        ("in.xyz", &["--overlap", "3"], 64, "--overlap"),
        ("in.xyz", &["--no-polish"], 64, "--no-polish"),
        ("in.xyz", &["--model", "elsewhere"], 64, "--model"),
        ("in.xyz", &["--threads", "2"], 64, "--threads"),
    ] {
        let failed = run(&[&["upsample", &path(input), &path("gone.xyz")], options, &server[..]].concat());
        let stderr = String::from_utf8_lossy(&failed.stderr);
        assert_eq!(failed.status.code(), Some(code), "{options:?} {stderr}");
        assert!(stderr.contains(told), "{stderr}");
        assert!(!folder.path().join("gone.xyz").exists());
    }
    for url in ["https://host", "host:8080", "http://"] {
        let failed = run(&["upsample", &path("in.xyz"), "-", "--server", url]);
        assert_eq!(failed.status.code(), Some(64), "{failed:?}");
    }
}

#[test]
fn a_server_that_is_full_is_asked_again_and_given_the_key() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    std::fs::write(path("in.xyz"), text(300)).expect("a file");
    let upsample = |url: &str, output: &str| {
        let mut command = densecloud();
        command.args(["upsample", &path("in.xyz"), &path(output), "--server", url]);
        command.env("DENSECLOUD_KEY", "opensesame").output().expect("an end")
    };
    let done = "HTTP/1.1 200 OK\r\nconnection: close\r\ncontent-type: text/plain; charset=utf-8\r\n\
                content-length: 6\r\n\r\n1 2 3\n";
    let (url, requests) = canned(vec![
        refusal("503 Service Unavailable", "queue-full", "retry-after: 1\r\n"),
        refusal("429 Too Many Requests", "client-queue-full", "retry-after: 1\r\n"),
        done.to_owned(),
    ]);
    let output = upsample(&url, "out.xyz");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{stderr}");
    assert!(stderr.contains("told so; trying again in 1 s (2 of 4)"), "{stderr}");
    assert_eq!(std::fs::read(path("out.xyz")).expect("a file"), b"1 2 3\n");
    for request in requests {
        let request = request.to_ascii_lowercase();
        assert!(request.starts_with("post /upsample?ratio=4&seed=0 "), "{request}");
        assert!(request.contains("authorization: bearer opensesame\r\n"), "{request}");
    }
    // Not for longer than a person would, not where there is no time to wait, and not what will not pass.
    for (status, kind, retry_after) in [
        ("503 Service Unavailable", "queue-full", "retry-after: 3600\r\n"),
        ("503 Service Unavailable", "queue-full", ""),
        ("413 Payload Too Large", "body-too-large", "retry-after: 1\r\n"),
    ] {
        let (url, _requests) = canned(vec![refusal(status, kind, retry_after)]);
        let output = upsample(&url, "none.xyz");
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        assert!(String::from_utf8_lossy(&output.stderr).contains("told so"), "{output:?}");
    }
    // An answer that breaks off is no result.
    let (url, _requests) = canned(vec![done.replace("content-length: 6", "content-length: 60")]);
    let output = upsample(&url, "none.xyz");
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(!folder.path().join("none.xyz").exists() && !folder.path().join("none.xyz.part").exists());
}
