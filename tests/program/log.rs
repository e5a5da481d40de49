//! The log, where nobody can write it or nobody reads it: the server serves on.

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, PipeReader, pipe};
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::support::{PATIENCE, agent, densecloud, signal, sphere};

/// The program, whose log a test takes away.
struct Serving {
    child: Child,
    url: String,
}

impl Serving {
    /// Starts it and waits until it is ready; its port is not to be had from its log.
    fn start(log: impl Into<Stdio>) -> Self {
        let address = own_address();
        let (host, port) = (format!("--host={}", address.ip()), format!("--port={}", address.port()));
        let child = densecloud()
            .args(["serve", "--log-format=json", "--threads=1", &host, &port])
            .stderr(log)
            .spawn()
            .expect("the program starts");
        let mut serving = Self { child, url: format!("http://{address}") };
        let start = Instant::now();
        while serving.status("/readyz") != Some(200) {
            assert_eq!(serving.child.try_wait().expect("a process"), None, "it has ended");
            assert!(start.elapsed() < PATIENCE, "it does not get ready");
            std::thread::sleep(Duration::from_millis(20));
        }
        serving
    }

    /// None where nothing answers.
    fn status(&self, target: &str) -> Option<u16> {
        Some(agent().get(format!("{}{target}", self.url)).call().ok()?.status().as_u16())
    }

    /// Lines that the log has lost, by its own count.
    fn lost(&self) -> u64 {
        let mut page = agent().get(format!("{}/metrics", self.url)).call().expect("a page");
        let page = page.body_mut().read_to_string().expect("text");
        let count = page.lines().find_map(|line| line.strip_prefix("densecloud_log_lines_lost_total "));
        count.expect("a count").parse().expect("a number")
    }

    /// Waits until it has lost more than so many.
    fn wait_for_more_lost(&self, lines: u64) {
        let start = Instant::now();
        while self.lost() <= lines {
            assert!(start.elapsed() < PATIENCE, "no more than {lines} lines are lost");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Whether it does all that it is for.
    fn serves(&self) {
        let url = format!("{}/upsample?ratio=2", self.url);
        let answer = agent().post(url).send(sphere(100).as_bytes()).expect("an answer");
        assert_eq!(answer.status().as_u16(), 200);
        assert_eq!(self.status("/healthz"), Some(200));
        assert_eq!(self.status("/readyz"), Some(200));
    }

    fn end(mut self) -> ExitStatus {
        signal(&self.child.id().to_string(), "TERM");
        self.child.wait().expect("an end")
    }
}

/// A port of an address that is this call's own, where nobody else takes it before the program does.
fn own_address() -> SocketAddr {
    static CALLS: AtomicU8 = AtomicU8::new(1);
    let [.., high, low] = std::process::id().to_be_bytes();
    let address = Ipv4Addr::new(127, CALLS.fetch_add(1, Ordering::Relaxed), high, low);
    TcpListener::bind((address, 0)).and_then(|free| free.local_addr()).expect("a port")
}

impl Drop for Serving {
    fn drop(&mut self) {
        // Mostly it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Lines of more than the system buffers in a pipe, and more than the program keeps.
fn say_much(serving: &Serving) {
    let name = "x".repeat(50_000);
    for _ in 0..40 {
        assert_eq!(serving.status(&format!("/{name}")), Some(404));
    }
}

#[test]
fn a_log_that_cannot_be_written_costs_lines_that_are_counted() {
    // A full disk, and a stream that is not for writing.
    let full = OpenOptions::new().write(true).open("/dev/full").expect("a device");
    let read_only = File::open("/dev/null").expect("a device");
    for (what, log) in [("full", full), ("read-only", read_only)] {
        let serving = Serving::start(log);
        // That it listens, and that it is ready.
        serving.wait_for_more_lost(1);
        for _ in 0..3 {
            let before = serving.lost();
            serving.serves();
            serving.wait_for_more_lost(before);
        }
        assert_eq!(serving.end().code(), Some(0), "{what}");
    }
}

#[test]
fn a_reader_who_leaves_costs_lines_and_nothing_else() {
    let (reader, writer) = pipe().expect("a pipe");
    let serving = Serving::start(writer);
    assert_eq!(serving.lost(), 0);
    drop(reader);
    serving.serves();
    serving.wait_for_more_lost(0);
    serving.serves();
    assert_eq!(serving.end().code(), Some(0));
}

#[test]
fn a_reader_who_stands_still_holds_up_nothing_not_even_the_end() {
    let (reader, writer) = pipe().expect("a pipe");
    let serving = Serving::start(writer);
    say_much(&serving);
    serving.wait_for_more_lost(0);
    serving.serves();
    assert_eq!(serving.end().code(), Some(0));
    drop(reader);
}

/// The log's events, as they are read from now on.
fn read(reader: PipeReader) -> Receiver<Value> {
    let (sender, events) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(reader).lines().map_while(Result::ok) {
            if !line.contains("onnxruntime") {
                let event = serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line:.200}"));
                // A test that is over reads no more.
                let _ = sender.send(event);
            }
        }
    });
    events
}

#[test]
fn a_reader_who_goes_on_has_whole_lines_to_the_last() {
    let (reader, writer) = pipe().expect("a pipe");
    let serving = Serving::start(writer);
    say_much(&serving);
    serving.wait_for_more_lost(14);
    let (reading, start) = (read(reader), Instant::now());
    let mut events = Vec::new();
    // Until there is room for a line again, and all before it have been read.
    while events.last().is_none_or(|event: &Value| event["span"]["path"] != "/nowhere") {
        assert!(start.elapsed() < PATIENCE, "nothing is written any more");
        match reading.recv_timeout(Duration::from_millis(100)) {
            Ok(event) => events.push(event),
            Err(_) => assert_eq!(serving.status("/nowhere"), Some(404)),
        }
    }
    assert_eq!(serving.end().code(), Some(0));
    events.extend(reading);
    let messages: Vec<_> = events.iter().filter_map(|event| event["fields"]["message"].as_str()).collect();
    assert_eq!(messages.last(), Some(&"stopped"));
    let paths = events.iter().filter_map(|event| event["span"]["path"].as_str());
    let there = paths.filter(|path| path.len() > 50_000).count() as u64;
    let told = events.iter().find(|event| event["fields"]["message"] == "lines of the log were lost");
    let lost = told.expect("it is told")["fields"]["lost"].as_u64().expect("a number");
    assert!((1..=40).contains(&lost) && there <= 25, "{lost} were lost, {there} are there");
}

/// What a command that does not start says: its lines as JSON, and its code.
fn refused(mut command: Command) -> (Vec<Value>, Option<i32>) {
    let output = command.output().expect("the program starts");
    let text = String::from_utf8(output.stderr).expect("text");
    let lines = text.lines().filter(|line| !line.contains("onnxruntime"));
    let lines = lines.map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}")));
    (lines.collect(), output.status.code())
}

#[test]
fn what_keeps_it_from_starting_is_a_line_of_json_where_the_log_is() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("a file");
        path.to_str().expect("UTF-8").to_owned()
    };
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port().to_string();
    let by_file = file("json.toml", "log-format = \"json\"\nport = \"many\"\n");
    let fine = file("fine.toml", "log-format = \"json\"\n");
    let broken = file("broken.toml", "log-format = \"json\"\nport = \n");
    let keys = file("keys", "alice short\n");
    for (arguments, code, named) in [
        (&["--log-format=json", "--port", &port][..], 1, port.as_str()),
        (&["--log-format=json", "--log=off", "--port", &port], 1, &port),
        (&["--prot", "1", "--log-format", "json"], 64, "--prot"),
        (&["--log-format=json", "--port", "many"], 64, "many"),
        (&["--log-format=json", "--max-points-in=0"], 64, "--max-points-in"),
        (&["--log-format=json", "--keys", &keys], 64, "line 1"),
        (&["--log-format=json", "--model", "/nowhere"], 64, "/nowhere"),
        (&["--log-format=json", "--log", "=loud="], 64, "--log"),
        (&["--log-format=json", "--data-dir", "/proc/nowhere"], 64, "--data-dir"),
        (&["--log-format=json", "--config", "/nowhere.toml"], 64, "/nowhere.toml"),
        (&["--config", &by_file], 64, "json.toml:2: `port`"),
        (&["--config", &broken], 64, "broken.toml:2"),
        (&["--config", &fine, "--port", "many"], 64, "many"),
    ] {
        let mut command = densecloud();
        command.arg("serve").args(arguments);
        let (events, found) = refused(command);
        assert_eq!((events.last().map(|event| &event["level"]), found), (Some(&"ERROR".into()), Some(code)));
        let fields = &events.last().expect("a line")["fields"];
        assert_eq!(fields["message"], "failed", "{arguments:?}");
        assert!(fields["why"].as_str().expect("words").contains(named), "{arguments:?}: {fields}");
        let failures = events.iter().filter(|event| event["fields"]["message"] == "failed");
        assert_eq!(failures.count(), 1, "{arguments:?}");
    }
    let mut command = densecloud();
    command.args(["serve", "--prot"]).env("DENSECLOUD_LOG_FORMAT", "json");
    assert_eq!(refused(command).1, Some(64));
}
