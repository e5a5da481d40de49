//! The program as a process, and a client.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use serde_json::Value;
use ureq::Agent;

/// Longer than anything here takes.
pub(crate) const PATIENCE: Duration = Duration::from_secs(120);

pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_densecloud");

pub(crate) fn densecloud() -> Command {
    Command::new(PROGRAM)
}

pub(crate) fn run(arguments: &[&str]) -> Output {
    densecloud().args(arguments).output().expect("the program starts")
}

/// `densecloud serve` in the background, ended with the test.
pub(crate) struct Serving {
    child: Child,
    /// Its events, in order.
    pub(crate) log: Receiver<Value>,
    pub(crate) address: String,
}

impl Serving {
    /// Starts it on a port that the system chooses, and waits until it is ready.
    pub(crate) fn start(options: &[&str]) -> Self {
        Self::start_from(densecloud(), options)
    }

    /// The same by a command that becomes the program and its arguments.
    pub(crate) fn start_from(program: Command, options: &[&str]) -> Self {
        let serving = Self::launch(program, options, |_| {});
        serving.wait_for("ready");
        serving
    }

    /// The same, but waits only until it listens; `see` is shown the fields of every event.
    pub(crate) fn launch(
        mut program: Command,
        options: &[&str],
        mut see: impl FnMut(&Value) + Send + 'static,
    ) -> Self {
        let mut child = program
            .args(["serve", "--port", "0", "--log-format", "json", "--threads", "1"])
            .args(options)
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut lines = BufReader::new(child.stderr.take().expect("piped"));
        let (sender, log) = channel();
        std::thread::spawn(move || {
            let mut line = String::new();
            // The last line may be cut off, like the program.
            while lines.read_line(&mut line).is_ok() && line.ends_with('\n') {
                // A runtime that is interrupted by the end of the process says so in its own form.
                if !line.contains("onnxruntime") {
                    let event: Value = serde_json::from_str(&line).unwrap_or_else(|e| panic!("{e}: {line}"));
                    see(&event["fields"]);
                    // A test that is over reads no more.
                    let _ = sender.send(event);
                }
                line.clear();
            }
        });
        let mut serving = Self { child, log, address: String::new() };
        let listening = serving.wait_for("listening");
        serving.address = listening["address"].as_str().expect("an address").to_owned();
        serving
    }

    /// The fields of the next event with this message.
    pub(crate) fn wait_for(&self, message: &str) -> Value {
        self.wait_for_event(message)["fields"].clone()
    }

    pub(crate) fn wait_for_event(&self, message: &str) -> Value {
        loop {
            let event = self.log.recv_timeout(PATIENCE).unwrap_or_else(|e| panic!("no {message:?}: {e}"));
            if event["fields"]["message"] == message {
                return event;
            }
        }
    }

    pub(crate) fn url(&self, target: &str) -> String {
        format!("http://{}{target}", self.address)
    }

    pub(crate) fn id(&self) -> String {
        self.child.id().to_string()
    }

    pub(crate) fn signal(&self, name: &str) {
        signal(&self.id(), name);
    }

    /// Waits until it has ended by itself.
    pub(crate) fn end(mut self) -> ExitStatus {
        self.child.wait().expect("an end")
    }

    /// Ends it in the middle of whatever it does; all that it said has been seen when this returns.
    pub(crate) fn kill(mut self) {
        self.child.kill().expect("it runs");
        self.child.wait().expect("an end");
        while self.log.recv_timeout(PATIENCE).is_ok() {}
    }

    /// Kilobytes from `/proc/PID/status`.
    pub(crate) fn kilobytes(&self, name: &str) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.id())).expect("it runs");
        let line = status.lines().find_map(|line| line.strip_prefix(name)).expect("a line");
        line.trim().trim_end_matches(" kB").parse().expect("a number")
    }

    /// Waits until its metrics have this line.
    pub(crate) fn wait_for_metric(&self, line: &str) {
        let start = Instant::now();
        loop {
            let page = self.page("/metrics");
            if page.lines().any(|l| l == line) {
                return;
            }
            assert!(start.elapsed() < PATIENCE, "no {line:?}: {page}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    pub(crate) fn page(&self, target: &str) -> String {
        let mut page = agent().get(self.url(target)).call().expect("a page");
        page.body_mut().read_to_string().expect("text")
    }

    /// Posts to `target`: the answer, whatever its status.
    pub(crate) fn post(&self, target: &str, body: &[u8]) -> ureq::http::Response<ureq::Body> {
        agent().post(self.url(target)).send(body).expect("an answer")
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        // Mostly it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The standard library cannot send a signal.
pub(crate) fn signal(process: &str, name: &str) {
    let sent = Command::new("kill").args(["-s", name, process]).status();
    assert!(sent.expect("kill is there").success());
}

pub(crate) fn agent() -> Agent {
    Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE)).build().new_agent()
}

/// The directions of `points` even points of a sphere.
fn directions(points: usize) -> impl Iterator<Item = [f64; 3]> {
    (0..points).map(move |i| {
        let z = 1.0 - (2 * i + 1) as f64 / points as f64;
        let (r, angle) = ((1.0 - z * z).sqrt(), i as f64 * 2.399_963);
        [r * angle.cos(), r * angle.sin(), z]
    })
}

/// A sphere with coordinates as large as a map's, as text.
pub(crate) fn sphere(points: usize) -> String {
    directions(points).map(|[x, y, z]| format!("{:.6} {y:.6} {z:.6}\n", 500_000.0 + x)).collect()
}

/// A sphere as PLY in which each point has `wide` further numbers of 8 bytes, so that few points are many bytes.
pub(crate) fn wide_sphere(points: usize, wide: usize) -> Vec<u8> {
    let mut bytes = format!("ply\nformat binary_little_endian 1.0\nelement vertex {points}\n").into_bytes();
    for name in ["x", "y", "z"] {
        writeln!(bytes, "property float {name}").expect("memory");
    }
    for i in 0..wide {
        writeln!(bytes, "property double extra{i}").expect("memory");
    }
    bytes.extend(b"end_header\n");
    for position in directions(points) {
        for c in position {
            bytes.extend((c as f32).to_le_bytes());
        }
        for extra in 0..wide {
            bytes.extend((extra as f64).to_le_bytes());
        }
    }
    bytes
}

/// The bytes of a request, for a client that does with them what no library would.
pub(crate) fn request(target: &str, headers: &str, body: &[u8]) -> Vec<u8> {
    let length = body.len();
    let head = format!(
        "POST {target} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{headers}content-length: {length}\r\n\r\n"
    );
    [head.as_bytes(), body].concat()
}

/// Paths in a folder, as arguments.
pub(crate) fn within(folder: &tempfile::TempDir) -> impl Fn(&str) -> String {
    let folder = folder.path().to_owned();
    move |name| folder.join(name).to_str().expect("UTF-8").to_owned()
}
