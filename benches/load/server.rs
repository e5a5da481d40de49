//! The program's server as a process, and what it takes of the memory.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Longer than a start and an end take.
const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) struct Server {
    child: Child,
    pub(crate) address: SocketAddr,
    folder: tempfile::TempDir,
}

impl Server {
    /// Starts it on a port that the system chooses, and waits until it is ready. Its log goes to a file, as a real
    /// server's would.
    pub(crate) fn start(options: &[String], jobs: bool) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("log");
        let mut command = Command::new(env!("CARGO_BIN_EXE_densecloud"));
        command.args(["serve", "--port", "0", "--log-format", "json"]).args(options);
        if jobs && !options.iter().any(|o| o.starts_with("--data-dir")) {
            command.arg("--data-dir").arg(folder.path().join("jobs"));
        }
        command.stdout(Stdio::null()).stderr(std::fs::File::create(&log).unwrap());
        let child = command.spawn().expect("the program starts");
        let mut server = Self { child, address: ([127, 0, 0, 1], 0).into(), folder };
        let start = Instant::now();
        while server.address.port() == 0 || !server.says("ready") {
            let text = server.log();
            assert!(server.child.try_wait().unwrap().is_none(), "the server ended: {text}");
            assert!(start.elapsed() < PATIENCE, "the server is not ready: {text}");
            if let Some(event) = server.event("listening") {
                server.address = event["address"].as_str().unwrap().parse().unwrap();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        server
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap()
    }

    fn event(&self, message: &str) -> Option<serde_json::Value> {
        let events = self.log();
        let mut events = events.lines().filter_map(|l| serde_json::from_str::<serde_json::Value>(l).ok());
        events.find(|event| event["fields"]["message"] == message).map(|mut event| event["fields"].take())
    }

    fn says(&self, message: &str) -> bool {
        self.event(message).is_some()
    }

    fn file(&self, name: &str) -> PathBuf {
        format!("/proc/{}/{name}", self.child.id()).into()
    }

    /// Bytes of memory that it takes.
    pub(crate) fn memory(&self) -> u64 {
        self.status("VmRSS:")
    }

    /// The most that it took since the last [`Server::forget_peak`].
    pub(crate) fn peak(&self) -> u64 {
        self.status("VmHWM:")
    }

    /// Lets the next peak be that of what comes now. Where the system does not, peaks are those since the start.
    pub(crate) fn forget_peak(&self) {
        let _ = std::fs::write(self.file("clear_refs"), "5");
    }

    fn status(&self, name: &str) -> u64 {
        let status = std::fs::read_to_string(self.file("status")).expect("the server runs");
        let line = status.lines().find_map(|line| line.strip_prefix(name)).unwrap();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap() * 1024
    }

    /// Tells it to stop; whether it did so in good order, and nothing went wrong inside it before.
    pub(crate) fn stop(mut self) -> bool {
        let id = self.child.id().to_string();
        assert!(Command::new("kill").args(["-s", "TERM", &id]).status().unwrap().success());
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            assert!(start.elapsed() < PATIENCE, "the server does not stop");
            std::thread::sleep(Duration::from_millis(20));
        };
        let log = self.log();
        let faults: Vec<_> = log.lines().filter(|l| l.contains("\"level\":\"ERROR\"")).take(5).collect();
        for fault in &faults {
            println!("the server's log: {fault}");
        }
        if !status.success() {
            println!("the server ended with {status}");
        }
        faults.is_empty() && status.success()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Mostly it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
