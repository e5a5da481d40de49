//! `densecloud serve` where the machine, its files or its clients are at fault: a full disk, a damaged model, requests
//! made to exhaust it; and the threat model's list of tests.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use densecloud::cloud::Origin;
use densecloud::formats::Format;
use serde_json::{Value, json};
use ureq::Agent;

/// Longer than anything here takes.
const PATIENCE: Duration = Duration::from_secs(120);

const PROGRAM: &str = env!("CARGO_BIN_EXE_densecloud");

/// The program in the background, ended with the test.
struct Serving {
    child: Child,
    log: Receiver<Value>,
    address: String,
}

impl Serving {
    /// Starts it by `launcher`, which ends in becoming the program and its arguments.
    fn start(launcher: &[&str], options: &[&str]) -> Self {
        let line =
            [launcher, &[PROGRAM, "serve", "--port", "0", "--log-format", "json", "--threads", "1"]].concat();
        let mut child = Command::new(line[0])
            .args(&line[1..])
            .args(options)
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let lines = BufReader::new(child.stderr.take().expect("piped")).lines();
        let (sender, log) = channel();
        std::thread::spawn(move || {
            for event in
                lines.map_while(Result::ok).filter_map(|line| serde_json::from_str::<Value>(&line).ok())
            {
                // A test that is over reads no more.
                let _ = sender.send(event["fields"].clone());
            }
        });
        let mut serving = Self { child, log, address: String::new() };
        serving.address = serving.wait_for("listening")["address"].as_str().expect("an address").to_owned();
        serving.wait_for("ready");
        serving
    }

    fn wait_for(&self, message: &str) -> Value {
        loop {
            let fields = self.log.recv_timeout(PATIENCE).unwrap_or_else(|e| panic!("no {message:?}: {e}"));
            if fields["message"] == message {
                return fields;
            }
        }
    }

    fn url(&self, target: &str) -> String {
        format!("http://{}{target}", self.address)
    }

    fn id(&self) -> String {
        self.child.id().to_string()
    }

    /// Leaves a job; the status, and the document or problem.
    fn submit(&self, query: &str, body: &[u8]) -> (u16, Value) {
        read(agent().post(self.url(&format!("/jobs?{query}"))).send(body))
    }

    fn job(&self, id: &str) -> Value {
        read(agent().get(self.url(&format!("/jobs/{id}"))).call()).1
    }

    /// Waits until a job is over.
    fn end_of(&self, job: &Value) -> Value {
        let id = job["id"].as_str().unwrap_or_else(|| panic!("no job: {job}"));
        let start = Instant::now();
        loop {
            let job = self.job(id);
            if !["queued", "running"].contains(&job["state"].as_str().expect("a state")) {
                return job;
            }
            assert!(start.elapsed() < PATIENCE, "{job}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Bytes of the result of a job that is done.
    fn result(&self, job: &Value) -> Vec<u8> {
        let place = format!("/jobs/{}/result", job["id"].as_str().expect("an id"));
        let mut answer = agent().get(self.url(&place)).call().expect("an answer");
        assert_eq!(answer.status().as_u16(), 200);
        answer.body_mut().read_to_vec().expect("a body")
    }

    /// The most memory that it ever took, in bytes.
    fn peak(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.id())).expect("it runs");
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("a line");
        line.trim().trim_end_matches(" kB").parse::<u64>().expect("a number") * 1024
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        // Mostly it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn agent() -> Agent {
    Agent::config_builder().http_status_as_error(false).timeout_global(Some(PATIENCE)).build().new_agent()
}

fn read(answer: Result<ureq::http::Response<ureq::Body>, ureq::Error>) -> (u16, Value) {
    let mut answer = answer.expect("an answer");
    let text = answer.body_mut().read_to_string().expect("text");
    (answer.status().as_u16(), serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text}")))
}

/// A cloud as PLY in which each point has `wide` further numbers of 8 bytes, so that few points are many bytes.
fn cloud(points: usize, wide: usize) -> Vec<u8> {
    let mut bytes = format!("ply\nformat binary_little_endian 1.0\nelement vertex {points}\n").into_bytes();
    for name in ["x", "y", "z"] {
        writeln!(bytes, "property float {name}").expect("memory");
    }
    for i in 0..wide {
        writeln!(bytes, "property double extra{i}").expect("memory");
    }
    bytes.extend(b"end_header\n");
    for i in 0..points {
        let z = 1.0 - (2 * i + 1) as f64 / points as f64;
        let (r, angle) = ((1.0 - z * z).sqrt(), i as f64 * 2.399_963);
        for c in [r * angle.cos(), r * angle.sin(), z] {
            bytes.extend((c as f32).to_le_bytes());
        }
        for extra in 0..wide {
            bytes.extend((extra as f64).to_le_bytes());
        }
    }
    bytes
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

#[test]
fn a_file_that_finds_no_room_costs_its_own_job_and_room_that_is_made_is_used() {
    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("jobs");
    // No file may grow past a megabyte: writes fail half way, as on a full disk. The shell's units are 512 bytes, or
    // 1024, and the signal that goes with the failure is ignored.
    let launcher = ["sh", "-c", "trap '' XFSZ; ulimit -S -f 2048; exec \"$@\"", "sh"];
    let serving = Serving::start(&launcher, &["--data-dir", text(&data)]);
    let limit = (1 << 20) * if cfg!(target_os = "linux") { 1 } else { 2 };
    let small = cloud(400, 100);
    let (status, accepted) = serving.submit("ratio=2", &small);
    assert_eq!(status, 202, "{accepted}");
    let done = serving.end_of(&accepted);
    assert_eq!(done["state"], "done", "{done}");
    let kept = serving.result(&done);

    // Its cloud finds no room: refused at once.
    let large = cloud(3000, 100);
    assert!(large.len() > limit);
    let (status, problem) = serving.submit("ratio=2", &large);
    assert_eq!((status, &problem["type"]), (507, &json!("urn:densecloud:problem:disk-full")), "{problem}");
    assert_eq!(problem["setting"], "--data-dir");
    // Its result finds no room: the job fails, and says so.
    let middle = cloud(800, 100);
    assert!(middle.len() < limit && 4 * middle.len() > limit);
    let (status, accepted) = serving.submit("ratio=4", &middle);
    assert_eq!(status, 202, "{accepted}");
    let failed = serving.end_of(&accepted);
    assert_eq!(failed["problem"]["type"], "urn:densecloud:problem:disk-full", "{failed}");
    assert_eq!(failed["problem"]["status"], 507);
    // Nothing is left of either, and what was there is as it was.
    let files = || std::fs::read_dir(data.join("files")).expect("a folder").count();
    assert_eq!(files(), 1);
    assert_eq!(serving.job(done["id"].as_str().expect("an id")), done);
    assert!(serving.result(&done) == kept);

    let lifted = Command::new("prlimit").args(["--pid", &serving.id(), "--fsize=unlimited:"]).status();
    assert!(lifted.expect("prlimit is there").success());
    for (query, body) in [("ratio=2", &large), ("ratio=4", &middle)] {
        let (status, accepted) = serving.submit(query, body);
        assert_eq!(status, 202, "{accepted}");
        assert_eq!(serving.end_of(&accepted)["state"], "done");
    }
    assert_eq!(files(), 3);
}

/// A disk of its own, 2 MB large, where the system lets a program have one.
#[test]
fn a_disk_that_is_full_refuses_jobs_keeps_those_it_has_and_takes_more_when_there_is_room() {
    let folder = tempfile::tempdir().expect("a folder");
    let mount = "mount -t tmpfs -o size=2m none \"$0\" && exec \"$@\"";
    let launcher =
        ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount, text(folder.path())];
    let allowed = Command::new(launcher[0]).args(&launcher[1..]).arg("true").output();
    if !allowed.is_ok_and(|output| output.status.success()) {
        println!("no disk of one's own is to be had here; the test beside this one limits files instead");
        return;
    }
    let data = folder.path().join("jobs");
    let serving = Serving::start(&launcher, &["--data-dir", text(&data)]);
    // The disk as the program sees it.
    let disk = PathBuf::from(format!("/proc/{}/root{}", serving.id(), text(folder.path())));
    let small = cloud(400, 10);
    let done = serving.end_of(&serving.submit("ratio=2", &small).1);
    assert_eq!(done["state"], "done", "{done}");
    let kept = serving.result(&done);

    let mut filler = std::fs::File::create(disk.join("filler")).expect("a file");
    while filler.write_all(&[0; 512]).is_ok() {}
    for _ in 0..3 {
        let (status, problem) = serving.submit("ratio=2", &small);
        assert_eq!(
            (status, &problem["type"]),
            (507, &json!("urn:densecloud:problem:disk-full")),
            "{problem}"
        );
    }
    assert_eq!(serving.job(done["id"].as_str().expect("an id")), done);
    assert!(serving.result(&done) == kept);
    let live = agent().post(serving.url("/upsample?ratio=2")).send(&small[..]).expect("an answer");
    assert_eq!(live.status().as_u16(), 200, "who needs no disk is served");

    std::fs::remove_file(disk.join("filler")).expect("room");
    drop(filler);
    let again = serving.end_of(&serving.submit("ratio=2", &small).1);
    assert_eq!(again["state"], "done", "{again}");
    assert!(serving.result(&again) == kept);
}

#[test]
fn a_signal_in_the_middle_of_answers_breaks_none_of_them() {
    let mut serving = Serving::start(&["env"], &["--drain-timeout", "120"]);
    let connect = || {
        let stream = TcpStream::connect(&serving.address).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        stream
    };
    // 13 MB each, more than the system buffers.
    let request = post("/upsample?ratio=16", "", &cloud(1000, 100));
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
    let in_flight = || {
        let mut page = agent().get(serving.url("/metrics")).call().expect("a page");
        page.body_mut()
            .read_to_string()
            .expect("text")
            .lines()
            .any(|l| l == "densecloud_requests_in_flight 4")
    };
    let start = Instant::now();
    while !in_flight() {
        assert!(start.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(
        Command::new("kill").args(["-s", "TERM", &serving.id()]).status().expect("kill is there").success()
    );
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
    assert_eq!(serving.child.wait().expect("an end").code(), Some(0));
}

#[test]
fn a_damaged_model_is_named_before_a_port_is_bound() {
    let ours = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/default");
    let read = |name: &str| std::fs::read(ours.join(name)).expect("a file");
    let hash = |bytes: &[u8]| {
        use sha2::{Digest, Sha256};
        Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect::<String>()
    };
    let unit = read("unit2.onnx");
    let half = unit[..unit.len() / 2].to_vec();
    let mut flipped = unit.clone();
    flipped[1000] ^= 1;
    // Whole by its card, and yet no model.
    let card = String::from_utf8(read("model.toml")).expect("text");
    let other_card = card.replace(&hash(&unit), &hash(&half)).into_bytes();
    let no_card = card.replace("patch_size", "patch").into_bytes();
    // Taken, so that a program that came to bind it would name it.
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port().to_string();
    let out_card = card.replace("unit2.onnx", "../unit2.onnx").into_bytes();
    type Damage<'a> = (&'a str, &'a [(&'a str, Option<&'a [u8]>)], &'a [&'a str]);
    let damages: [Damage; 6] = [
        ("a bit is flipped", &[("unit2.onnx", Some(&flipped))], &["unit2.onnx is damaged", "SHA-256"]),
        ("it is cut short", &[("unit2.onnx", Some(&half))], &["unit2.onnx is damaged"]),
        ("it is gone", &[("unit2.onnx", None)], &["unit2.onnx"]),
        ("its card says so", &[("unit2.onnx", Some(&half)), ("model.toml", Some(&other_card))], &["unit"]),
        ("its card leads elsewhere", &[("model.toml", Some(&out_card))], &["not a plain file name"]),
        ("the card is broken", &[("model.toml", Some(&no_card))], &["model.toml", "patch_size"]),
    ];
    for (what, changes, words) in damages {
        let folder = tempfile::tempdir().expect("a folder");
        for name in ["model.toml", "unit1.onnx", "unit2.onnx", "unit3.onnx", "unit4.onnx"] {
            match changes.iter().find(|(changed, _)| *changed == name) {
                Some((_, None)) => {}
                Some((_, Some(bytes))) => std::fs::write(folder.path().join(name), bytes).expect("a file"),
                None => std::fs::write(folder.path().join(name), read(name)).expect("a file"),
            }
        }
        let model = folder.path();
        let output = Command::new(PROGRAM)
            .args(["serve", "--port", &port, "--threads", "1", "--model", text(model)])
            .output()
            .expect("the program starts");
        let said = String::from_utf8_lossy(&output.stderr);
        // A wrong setting, unless only the runtime can tell.
        let code = if what == "its card says so" { 1 } else { 64 };
        assert_eq!(output.status.code(), Some(code), "{what}: {said}");
        assert!(said.contains(text(model)) || said.contains("model default"), "{what}: {said}");
        for word in words {
            assert!(said.contains(word), "{what}: {said}");
        }
        assert!(!said.contains("listening") && !said.contains(&port), "{what}: {said}");
        assert!(!said.contains("panicked"), "{what}: {said}");
    }
}

#[test]
fn what_a_client_sends_makes_no_line_of_the_log() {
    let mut child = Command::new(PROGRAM)
        .args(["serve", "--port", "0", "--log-format", "text", "--log", "debug,ort=warn", "--threads", "1"])
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut log = BufReader::new(child.stderr.take().expect("piped"));
    let mut line = String::new();
    while !line.contains("listening") {
        line.clear();
        assert!(log.read_line(&mut line).expect("text") > 0, "it ended");
    }
    let (_, address) = line.split_once("address=").expect("an address");
    let url = format!("http://{}", address.split_whitespace().next().expect("an address"));
    while agent().get(format!("{url}/readyz")).call().expect("an answer").status().as_u16() != 200 {
        std::thread::sleep(Duration::from_millis(20));
    }
    let forged = "%0A2026-01-01T00:00:00Z%20%20INFO%20forged%1B%5B31m%0D%0Aforged";
    let address = url.trim_start_matches("http://");
    let send = |bytes: &[u8]| {
        let mut stream = TcpStream::connect(address).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        stream.write_all(bytes).expect("sent");
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        assert!(answer.starts_with(b"HTTP/1.1 4"), "{:?}", String::from_utf8_lossy(&answer));
    };
    for target in [
        format!("/upsample?ratio=2&{forged}=1"),
        format!("/upsample?ratio={forged}"),
        format!("/upsample?ratio=2&attributes={forged}:mean"),
        format!("/jobs/{forged}"),
        format!("/v2/models/{forged}"),
        format!("/{forged}"),
    ] {
        let body = b"ply\nformat ascii 1.0\ncomment a\x1b[31m\nforged \x1b[31m\nend_header\n";
        send(&post(&target, "x-request-id: a b\r\n", body));
    }
    let cloud = b"ply\nformat ascii 1.0\nelement forged\x1b[31m 4\nproperty float x\nend_header\n";
    send(&post("/upsample?ratio=2", "accept: forged\x1b[31m\r\n", cloud));
    send(&post("/upsample?ratio=2", "content-encoding: forged, \u{e4}\r\n", cloud));
    send(b"GET /\x1b[31mforged HTTP/1.1\r\nhost: x\r\n\r\n");
    let sent = Command::new("kill").args(["-s", "TERM", &child.id().to_string()]).status();
    assert!(sent.expect("kill is there").success());
    let mut rest = String::new();
    log.read_to_string(&mut rest).expect("text");
    assert!(child.wait().expect("an end").success());
    assert!(rest.contains("forged"), "{rest}");
    for line in rest.lines().filter(|line| !line.contains("onnxruntime")) {
        assert!(line.starts_with("20") && line.as_bytes()[10] == b'T', "not the log's own line: {line:?}");
        assert!(!line.starts_with("2026-01-01T00:00:00Z  INFO forged"), "{line:?}");
        assert!(!line.contains(|c: char| c.is_control()), "{line:?}");
    }
}

/// What is sent, and the statuses of which one must come back.
type Bomb = (&'static str, Vec<u8>, &'static [u16]);

fn post(target: &str, headers: &str, body: &[u8]) -> Vec<u8> {
    let length = body.len();
    let head = format!(
        "POST {target} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{headers}content-length: {length}\r\n\r\n"
    );
    [head.as_bytes(), body].concat()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

/// A small cloud in a binary format, some of whose bytes are then other ones.
fn forged(format: Format, changes: &[(usize, &[u8])]) -> Vec<u8> {
    let positions: Vec<_> = (0..50).map(|i| [f64::from(i), f64::from(i * i % 17), 1.0]).collect();
    let mut bytes =
        densecloud::formats::encode(Vec::new(), format, &positions, &[], &Origin::default()).expect("memory");
    for (at, new) in changes {
        bytes[*at..at + new.len()].copy_from_slice(new);
    }
    bytes
}

fn bombs() -> Vec<Bomb> {
    const UP: &str = "/upsample?ratio=2";
    const INFER: &str = "/v2/models/densecloud/infer";
    let good = cloud(500, 0);
    let up = |body: &[u8]| post(UP, "", body);
    let infer = |json: &Value| post(INFER, "", json.to_string().as_bytes());
    let tensor = |shape: Value, data: Value| {
        json!({ "inputs": [{ "name": "points", "datatype": "FP32", "shape": shape, "data": data }],
                "parameters": { "ratio": 2 } })
    };
    let nothing = vec![b'\n'; 64 << 20];
    let ply = |lines: &str| format!("ply\nformat binary_little_endian 1.0\n{lines}end_header\n").into_bytes();
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let npy = |shape: &str| {
        let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape}, 3), }}");
        let header = format!("{header:<117}\n");
        [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), &[0; 6000]]
            .concat()
    };
    let pcd = |count: &str, points: &str, data: &str| {
        let header = format!(
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {count}\nWIDTH {points}\nHEIGHT 1\nPOINTS {points}\n\
             DATA {data}\n"
        );
        [header.as_bytes(), &[255; 6000]].concat()
    };
    let chunked = |chunks: &[u8]| {
        let head = format!(
            "POST {UP} HTTP/1.1\r\nhost: x\r\nconnection: close\r\ntransfer-encoding: chunked\r\n\r\n"
        );
        [head.as_bytes(), chunks].concat()
    };
    let announced = |length: &str| {
        format!("POST {UP} HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {length}\r\n\r\n")
            .into_bytes()
    };
    let deep = format!("{{\"inputs\": {}", "[".repeat(100_000));
    let get = |target: &str, headers: &str| {
        format!("GET {target} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{headers}\r\n").into_bytes()
    };
    const LAS: Format = Format::Las { compressed: false };
    const LAZ: Format = Format::Las { compressed: true };
    const MOST: &[u8] = &[255; 4];
    vec![
        // What a body becomes.
        ("gzip", post(UP, "content-encoding: gzip\r\n", &gzip(&nothing)), &[413]),
        ("gzip in parts", post(UP, "content-encoding: gzip\r\n", &gzip(b"\n").repeat(20_000)), &[413, 422]),
        ("deflate", post(UP, "content-encoding: deflate\r\n", &zlib(&nothing)), &[413]),
        ("gzip twice", post(UP, "content-encoding: gzip, gzip\r\n", &gzip(&gzip(&nothing))), &[415]),
        ("gzip of JSON", post(INFER, "content-encoding: gzip\r\n", &gzip(&nothing)), &[413]),
        // What a header claims.
        ("PLY points", up(&ply(&format!("element vertex 4294967295\n{xyz}"))), &[413]),
        ("PLY points past 64 bits", up(&ply(&format!("element vertex 99999999999999999999\n{xyz}"))), &[400]),
        (
            "PLY other elements",
            up(&ply(&format!("element face 4294967295\nproperty list uint int a\nelement vertex 9\n{xyz}"))),
            &[400, 413],
        ),
        (
            "PLY empty elements",
            up(&ply(&format!("element none 18446744073709551615\nelement vertex 9\n{xyz}"))),
            &[400],
        ),
        (
            "PLY lists",
            up(&[ply(&format!("element vertex 9\nproperty list uint int a\n{xyz}")), vec![255; 900]]
                .concat()),
            &[400],
        ),
        (
            "PLY properties",
            up(&ply(&format!("element vertex 9\n{}", "property double a\n".repeat(50_000)))),
            &[400],
        ),
        ("LAS points", up(&forged(LAS, &[(107, MOST), (247, &[255; 8])])), &[400, 413]),
        ("LAS records", up(&forged(LAS, &[(100, MOST)])), &[400]),
        ("LAS offset of points", up(&forged(LAS, &[(96, MOST)])), &[400]),
        ("LAZ points", up(&forged(LAZ, &[(107, MOST), (247, &[255; 8])])), &[400, 413]),
        ("PCD points", up(&pcd("1 1 1", "4294967295", "binary")), &[413]),
        ("PCD numbers a field", up(&pcd("1 1 4294967295", "9", "binary")), &[400]),
        ("PCD compressed", up(&pcd("1 1 1", "9", "binary_compressed")), &[400]),
        ("NumPy points", up(&npy("4294967295")), &[413]),
        ("NumPy points past 64 bits", up(&npy("99999999999999999999")), &[400, 413]),
        ("OFF points", up(b"OFF\n4294967295 4294967295 0\n0 0 0\n"), &[413]),
        ("a line", up(&vec![b'1'; 900_000]), &[400, 413, 415, 422]),
        // What tensors claim.
        ("tensor", infer(&tensor(json!([4_294_967_295_u32, 3]), json!([]))), &[400, 413]),
        ("tensor past 64 bits", infer(&tensor(json!([i64::MAX, 3]), json!([]))), &[400, 413]),
        ("tensor in JSON", infer(&tensor(json!([2000, 3]), json!(vec![0.5; 6000]))), &[413]),
        ("tensor longer than it says", infer(&tensor(json!([2, 3]), json!(vec![0.5; 6000]))), &[400]),
        ("deep JSON", post(INFER, "", deep.as_bytes()), &[400]),
        (
            "a long header of tensors",
            post(INFER, "inference-header-content-length: 18446744073709551615\r\n", b"{}"),
            &[400],
        ),
        // What a result would be.
        ("ratio", post("/upsample?ratio=64", "", &good), &[413]),
        ("endless ratio", post("/upsample?ratio=1e308", "", &good), &[400]),
        ("no ratio", post("/upsample?ratio=nan", "", &good), &[400]),
        ("points", post("/upsample?points=18446744073709551615", "", &good), &[413, 422]),
        ("spacing", post("/upsample?spacing=1e-300", "", &good), &[413, 422]),
        ("density", post("/upsample?density=1e300", "", &good), &[413, 422]),
        // HTTP itself.
        ("body", post(UP, "", &vec![b' '; 2 << 20]), &[413]),
        ("announced body", announced("9223372036854775807"), &[413]),
        ("announced body at the end of 64 bits", announced("18446744073709551615"), &[413, 431]),
        ("chunk", chunked(b"FFFFFFFFFFFFFFFF0\r\n"), &[400]),
        ("chunk extension", chunked(format!("1;{}", "a".repeat(100_000)).as_bytes()), &[400]),
        ("headers", get("/healthz", &"a: b\r\n".repeat(5000)), &[431]),
        ("a header", get("/healthz", &format!("a: {}\r\n", "b".repeat(200_000))), &[431]),
        ("a path", get(&format!("/{}", "a".repeat(200_000)), ""), &[414, 431]),
        ("a query", post(&format!("/upsample?ratio=2{}", "&a=b".repeat(10_000)), "", &good), &[400]),
        (
            "attributes",
            post(&format!("/upsample?ratio=2&attributes={}", "a:mean,".repeat(5000)), "", &good),
            &[400],
        ),
        (
            "ranges of accepted types",
            post(UP, &format!("accept: {}\r\n", "a/b;q=1,".repeat(5000)), &good),
            &[406],
        ),
    ]
}

#[test]
fn what_is_made_to_exhaust_the_server_is_refused_and_takes_no_memory() {
    let serving = Serving::start(
        &["env"],
        &[
            "--max-body-bytes",
            "1000000",
            "--max-points-in",
            "1000",
            "--max-points-out",
            "4000",
            "--stall-timeout",
            "60",
        ],
    );
    // Threads and buffers that the first requests make are not the bombs'.
    for _ in 0..3 {
        let answer =
            agent().post(serving.url("/upsample?ratio=4")).send(&cloud(1000, 0)[..]).expect("an answer");
        assert_eq!(answer.status().as_u16(), 200);
    }
    let before = serving.peak();
    let mut wrong = Vec::new();
    for (what, bytes, statuses) in bombs() {
        let start = Instant::now();
        let mut stream = TcpStream::connect(&serving.address).expect("a connection");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket");
        // It may be refused, and the connection closed, before all of it is sent.
        let _ = stream.write_all(&bytes);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let answer = String::from_utf8_lossy(&answer);
        let status = answer.split(' ').nth(1).and_then(|status| status.parse().ok());
        if !status.is_some_and(|status| statuses.contains(&status)) || start.elapsed() > PATIENCE {
            wrong.push(format!("{what}, {} bytes, {statuses:?}: {answer}", bytes.len()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let after = serving.peak();
    // Each body may be held once as it came and once as points; what the bombs claim is from 64 MB to 16 EB.
    println!("{} KiB more than before", (after - before) >> 10);
    assert!(after - before < 48 << 20, "{before} bytes before, {after} after");
    let answer = agent().post(serving.url("/upsample?ratio=4")).send(&cloud(1000, 0)[..]).expect("an answer");
    assert_eq!(answer.status().as_u16(), 200);
    let mut page = agent().get(serving.url("/metrics")).call().expect("a page");
    let page = page.body_mut().read_to_string().expect("text");
    for line in ["densecloud_held_bytes 0", "densecloud_queue_points 0", "densecloud_requests_in_flight 0"] {
        assert!(page.lines().any(|l| l == line), "{line}: {page}");
    }
}

/// All of the repository's sources in a folder.
fn sources(folder: &Path, into: &mut String) {
    for entry in std::fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs" || e == "py") {
            into.push_str(&std::fs::read_to_string(&path).expect("text"));
        }
    }
}

#[test]
fn every_test_that_the_threat_model_names_is_there() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = String::new();
    for folder in ["src", "tests"] {
        sources(&root.join(folder), &mut all);
    }
    let model = std::fs::read_to_string(root.join("SECURITY.md")).expect("the threat model");
    let mut named = 0;
    for row in model.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| threat")) {
        let tests = row.trim_end_matches(" |").rsplit(" | ").next().expect("a column");
        let names: Vec<_> = tests.split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty(), "no test: {row}");
        for name in names {
            // A test, a fuzz target, or a check of the supply chain.
            let there = all.contains(&format!("fn {name}()"))
                || all.contains(&format!("fn {name}(steps"))
                || all.contains(&format!("def {name}("))
                || root.join(name).exists();
            assert!(there, "{name} is not there: {row}");
            named += 1;
        }
    }
    assert!(named > 30, "{named}");
}
