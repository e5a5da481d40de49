//! `densecloud serve` as a person runs it, with the model inside it and a client from elsewhere.

use std::io::{BufRead, BufReader};
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
        Self::start_as(densecloud(), options)
    }

    /// Starts a program that takes our arguments.
    fn start_as(mut program: Command, options: &[&str]) -> Self {
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
        loop {
            let event = self.log.recv_timeout(PATIENCE).unwrap_or_else(|e| panic!("no {message:?}: {e}"));
            if event["fields"]["message"] == message {
                return event["fields"].clone();
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
        command.args(["job", "--server", &server, "list"]).env_remove("DENSECLOUD_API_KEY");
        command.envs(key.map(|key| ("DENSECLOUD_API_KEY", key))).output().expect("the program starts")
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
        Serving::start_as(shell, &["--max-memory", "1000000000000"])
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
    let output = run(&["serve", "--port", &port]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains(&port) && stderr.contains("--port"), "{stderr}");
}
