//! A server on a port of its own, a backend that obeys, and a client that can misbehave.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use densecloud::Request;
use densecloud::attributes::Finish;
use densecloud_cascade::{Backend, BackendError, Batch, Fake, Output, Session, UnitShape};
use densecloud_cascade::{CascadeOptions, Target};
use densecloud_cloud::{Cloud, Origin, Position};
use densecloud_engine::{Engine, EngineConfig, Outcome};
use densecloud_formats::{CloudWriter, Format, PlyEncoding, Scalar};
use densecloud_server::{Config, ServeError};
use tokio::sync::oneshot;

/// Longer than anything here takes; a test that needs it all has failed.
pub(crate) const PATIENCE: Duration = Duration::from_secs(180);

pub(crate) const PLY: Format = Format::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F32 };

/// The fake backend behind a gate: batches wait while it is shut, and fail when told to.
#[derive(Clone)]
pub(crate) struct Scripted {
    fake: Fake,
    state: Arc<(Mutex<Script>, Condvar)>,
}

struct Script {
    open: bool,
    /// Batches that go through while it is shut.
    passes: usize,
    fail: bool,
    panic: bool,
}

impl Scripted {
    pub(crate) fn new() -> Self {
        Self::over(Fake::new())
    }

    pub(crate) fn over(fake: Fake) -> Self {
        Self {
            fake,
            state: Arc::new((
                Mutex::new(Script { open: true, passes: 0, fail: false, panic: false }),
                Condvar::new(),
            )),
        }
    }

    pub(crate) fn batches(&self) -> usize {
        self.fake.batches()
    }

    pub(crate) fn shut(&self) {
        self.state.0.lock().unwrap().open = false;
    }

    pub(crate) fn open(&self) {
        self.state.0.lock().unwrap().open = true;
        self.state.1.notify_all();
    }

    /// One batch goes through although it is shut.
    pub(crate) fn pass(&self) {
        self.state.0.lock().unwrap().passes += 1;
        self.state.1.notify_all();
    }

    pub(crate) fn fail(&self) {
        self.state.0.lock().unwrap().fail = true;
    }

    /// The next batch panics, and no other.
    pub(crate) fn panic(&self) {
        self.state.0.lock().unwrap().panic = true;
    }
}

impl Backend for Scripted {
    fn shape(&self) -> UnitShape {
        self.fake.shape()
    }

    fn units(&self) -> usize {
        self.fake.units()
    }

    fn provider(&self) -> &str {
        "scripted"
    }

    fn open(&self) -> Result<Box<dyn Session>, BackendError> {
        Ok(Box::new(self.clone()))
    }
}

impl Session for Scripted {
    fn run(&mut self, unit: usize, batch: &Batch<'_>, output: &mut Output) -> Result<(), BackendError> {
        let (state, changed) = &*self.state;
        let shut = |script: &mut Script| !script.open && script.passes == 0;
        let mut script = changed.wait_while(state.lock().unwrap(), shut).unwrap();
        script.passes = script.passes.saturating_sub(1);
        if std::mem::take(&mut script.panic) {
            drop(script);
            panic!("a bug at /srv/secret/path");
        }
        if script.fail {
            return Err(BackendError::Run { unit, why: "/srv/secret/path".into() });
        }
        drop(script);
        self.fake.run(unit, batch, output)
    }
}

pub(crate) struct Server {
    pub(crate) address: SocketAddr,
    pub(crate) engine: Engine,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<Result<(), ServeError>>>,
}

impl Server {
    /// Starts one and waits until it is ready.
    pub(crate) fn start(backend: &Scripted, config: Config) -> Self {
        let server = Self::start_cold(backend, EngineConfig { threads: 2, ..Default::default() }, config);
        server.wait_for_ready();
        server
    }

    pub(crate) fn start_cold(backend: &Scripted, sizes: EngineConfig, config: Config) -> Self {
        let engine = Engine::with_backend(Arc::new(backend.clone()), sizes).unwrap();
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        listener.set_nonblocking(true).unwrap();
        // Not `block_on`: a test may be in a runtime of its own.
        let listener = {
            let _guard = runtime.enter();
            tokio::net::TcpListener::from_std(listener).unwrap()
        };
        let (stop, stopped) = oneshot::channel();
        let shutdown = async {
            let _ = stopped.await;
        };
        let served = densecloud_server::run(listener, engine.clone(), config, shutdown);
        let thread = std::thread::spawn(move || {
            let result = runtime.block_on(served);
            runtime.shutdown_background();
            result
        });
        Self { address, engine, stop: Some(stop), thread: Some(thread) }
    }

    pub(crate) fn wait_for_ready(&self) {
        wait_until("the server is ready", || self.get("/readyz").status == 200);
    }

    /// As the first signal does.
    pub(crate) fn stop(&mut self) {
        self.stop.take().expect("stopped once").send(()).expect("the server listens");
    }

    pub(crate) fn join(&mut self) -> Result<(), ServeError> {
        self.thread.take().expect("joined once").join().expect("no panic")
    }

    pub(crate) fn connect(&self) -> Client {
        Client::of(TcpStream::connect(self.address).unwrap())
    }

    /// Whether it says that it is ready; one that is about to end may cut the connection instead.
    pub(crate) fn is_ready(&self) -> bool {
        let Ok(stream) = TcpStream::connect(self.address) else { return false };
        let mut client = Client::of(stream);
        let request = b"GET /readyz HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n";
        client.try_send(request) && client.rest().starts_with(b"HTTP/1.1 200 ")
    }

    pub(crate) fn get(&self, path: &str) -> Reply {
        self.ask("GET", path, "", b"")
    }

    pub(crate) fn post(&self, target: &str, body: &[u8]) -> Reply {
        self.ask("POST", target, "", body)
    }

    /// A request of one's own connection, with further headers, each with its line's end.
    pub(crate) fn ask(&self, method: &str, target: &str, headers: &str, body: &[u8]) -> Reply {
        self.begin(method, target, headers, body).reply()
    }

    /// The same, without waiting for the reply.
    pub(crate) fn begin(&self, method: &str, target: &str, headers: &str, body: &[u8]) -> Client {
        let mut client = self.connect();
        client.send_request(method, target, headers, body);
        client
    }

    pub(crate) fn metric(&self, line: &str) -> f64 {
        let page = self.get("/metrics").text();
        let value = page.lines().find_map(|l| l.strip_prefix(line)?.strip_prefix(' ')?.parse().ok());
        value.unwrap_or(0.0)
    }

    pub(crate) fn wait_for_work(&self) {
        wait_until("work is queued", || self.engine.queued_points() > 0);
    }

    pub(crate) fn wait_for_no_work(&self) {
        wait_until("no work is queued", || self.engine.queued_points() == 0);
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let result = thread.join();
            if !std::thread::panicking() {
                result.expect("no panic").expect("the server ends well");
            }
        }
    }
}

pub(crate) struct Client(TcpStream);

impl Client {
    pub(crate) fn of(stream: TcpStream) -> Self {
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream.set_write_timeout(Some(PATIENCE)).unwrap();
        Self(stream)
    }

    pub(crate) fn send(&mut self, bytes: &[u8]) {
        self.0.write_all(bytes).unwrap();
    }

    /// As [`Client::send`], for a server that may have hung up.
    pub(crate) fn try_send(&mut self, bytes: &[u8]) -> bool {
        self.0.write_all(bytes).is_ok()
    }

    /// Closes the sending side: nothing more will come, and the answer is still read.
    pub(crate) fn close_sending(&self) {
        self.0.shutdown(std::net::Shutdown::Write).unwrap();
    }

    pub(crate) fn send_post(&mut self, target: &str, body: &[u8]) {
        self.send_request("POST", target, "", body);
    }

    fn send_request(&mut self, method: &str, target: &str, headers: &str, body: &[u8]) {
        let length = body.len();
        let head = format!(
            "{method} {target} HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {length}\r\n{headers}\r\n"
        );
        self.send(head.as_bytes());
        self.send(body);
    }

    /// Reads a response: to the end of the connection, or as far as its length says.
    pub(crate) fn reply(mut self) -> Reply {
        let mut bytes = Vec::new();
        loop {
            let more = self.read();
            let ended = more.is_empty();
            bytes.extend(more);
            if let Some(reply) = Reply::parse(&bytes)
                && (ended || reply.header("content-length").is_some())
            {
                return reply;
            }
            assert!(!ended, "not a whole response: {:?}", String::from_utf8_lossy(&bytes));
        }
    }

    /// Reads to the end of the connection, or to its breaking.
    pub(crate) fn rest(&mut self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut buffer = vec![0; 1 << 16];
        loop {
            match self.0.read(&mut buffer) {
                Ok(0) => return bytes,
                Ok(count) => bytes.extend_from_slice(&buffer[..count]),
                Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => return bytes,
                Err(error) => panic!("{error} after {} bytes", bytes.len()),
            }
        }
    }

    /// Reads something, which must come.
    pub(crate) fn some(&mut self) -> Vec<u8> {
        let bytes = self.read();
        assert!(!bytes.is_empty(), "the connection has ended");
        bytes
    }

    /// Reads something; nothing at the connection's end.
    fn read(&mut self) -> Vec<u8> {
        let mut buffer = vec![0; 1 << 16];
        let count = self.0.read(&mut buffer).unwrap();
        buffer.truncate(count);
        buffer
    }
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Reply {
    pub(crate) status: u16,
    pub(crate) headers: Vec<(String, String)>,
    pub(crate) body: Vec<u8>,
}

impl Reply {
    /// Nothing where the response is not complete.
    pub(crate) fn parse(bytes: &[u8]) -> Option<Self> {
        let end = bytes.windows(4).position(|w| w == b"\r\n\r\n")? + 4;
        let head = std::str::from_utf8(&bytes[..end]).ok()?;
        let mut lines = head.lines();
        let status = lines.next()?.split(' ').nth(1)?.parse().ok()?;
        let headers = lines
            .filter_map(|line| line.split_once(": "))
            .map(|(name, value)| (name.to_owned(), value.to_owned()))
            .collect();
        let mut reply = Self { status, headers, body: bytes[end..].to_vec() };
        if reply.header("transfer-encoding") == Some("chunked") {
            reply.body = dechunk(&reply.body)?;
        } else if let Some(length) = reply.header("content-length") {
            (reply.body.len() == length.parse::<usize>().ok()?).then_some(())?;
        }
        Some(reply)
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str())
    }

    pub(crate) fn text(&self) -> String {
        String::from_utf8(self.body.clone()).expect("text")
    }

    /// The problem document, checked against the rest of the response.
    pub(crate) fn problem(&self) -> serde_json::Value {
        assert_eq!(self.header("content-type"), Some("application/problem+json"), "{self:?}");
        let problem: serde_json::Value = serde_json::from_slice(&self.body).expect("JSON");
        assert_eq!(problem["status"], self.status);
        assert_eq!(problem["request_id"].as_str(), self.header("x-request-id"));
        assert_eq!(self.header("retry-after").is_some(), matches!(self.status, 429 | 503), "{self:?}");
        problem
    }

    /// The last part of the problem's type.
    pub(crate) fn problem_name(&self) -> String {
        let problem = self.problem();
        let kind = problem["type"].as_str().expect("a type");
        kind.strip_prefix("urn:densecloud:problem:").expect("our prefix").to_owned()
    }
}

/// Undoes the chunked transfer coding; nothing where the last chunk is missing.
fn dechunk(mut bytes: &[u8]) -> Option<Vec<u8>> {
    let mut body = Vec::new();
    loop {
        let line = bytes.windows(2).position(|w| w == b"\r\n")?;
        let size = usize::from_str_radix(std::str::from_utf8(&bytes[..line]).ok()?, 16).ok()?;
        bytes = &bytes[line + 2..];
        if size == 0 {
            return Some(body);
        }
        body.extend_from_slice(bytes.get(..size)?);
        bytes = bytes.get(size + 2..)?;
    }
}

/// A client with a small window, so that a result of some megabytes does not fit between.
pub(crate) fn narrow(server: &Server) -> Client {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let stream = runtime.block_on(async {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.set_recv_buffer_size(4096).unwrap();
        socket.connect(server.address).await.unwrap().into_std().unwrap()
    });
    stream.set_nonblocking(false).unwrap();
    Client::of(stream)
}

/// A spiral on the sphere: even, without a random generator.
pub(crate) fn cloud(points: usize) -> Vec<Position> {
    (0..points)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f64 / points as f64;
            let (r, angle) = ((1.0 - z * z).sqrt(), i as f64 * 2.399_963);
            // Rounded, so that 32-bit files hold them exactly.
            [r * angle.cos(), r * angle.sin(), z].map(|c| f64::from(c as f32))
        })
        .collect()
}

pub(crate) fn encode(positions: &[Position], format: Format) -> Vec<u8> {
    let mut writer = CloudWriter::new(Vec::new(), format, positions.len() as u64).unwrap();
    writer.write(positions).unwrap();
    writer.finish().unwrap()
}

/// As [`encode`], with the line of provenance that a reply names.
pub(crate) fn encode_result(positions: &[Position], format: Format, reply: &Reply) -> Vec<u8> {
    let provenance = reply.header("densecloud-provenance").expect("provenance").to_owned();
    let origin = Origin { comments: vec![provenance], ..Origin::default() };
    densecloud_formats::encode(Vec::new(), format, positions, &[], &origin).unwrap()
}

/// What the library gives, without a server.
pub(crate) fn dense(positions: Vec<Position>, target: Target, seed: u64) -> Vec<Position> {
    outcome(positions.into(), target, seed).made.positions
}

/// As [`dense`], with all that there is about the positions.
pub(crate) fn outcome(cloud: Cloud, target: Target, seed: u64) -> Outcome {
    let sizes = EngineConfig { threads: 1, ..Default::default() };
    let engine = Engine::with_backend(Arc::new(Fake::new()), sizes).unwrap();
    let settings = CascadeOptions { seed, ..Default::default() };
    let request = Request::new(cloud, target, settings, Finish::default());
    engine.submit(request).unwrap().wait().unwrap()
}

pub(crate) fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < PATIENCE, "waited in vain until {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}
