//! Clouds of more points than a tile: their results leave tile by tile.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use densecloud::{Options, Report, backends::ModelName};
use densecloud_cascade::{Fake, Observer, Patchwise};
use densecloud_cloud::{Attribute, Cloud, Origin, Values};
use densecloud_formats::{CloudReader, Format, Limits, encode};
use densecloud_server::Config;
use densecloud_tiles::{Folder, Input, Step, Tiling, Watch, Work, plan};
use serde_json::Value;

use crate::support::{Client, PLY, Reply, Scripted, Server, cloud, wait_until};

/// A server whose temporary files lie in this folder.
pub(crate) fn config(temp: &Path) -> Config {
    Config { temp: Some(temp.to_owned()), ..Config::default() }
}

/// What the library makes of a cloud in tiles.
pub(crate) struct Expected {
    pub(crate) file: Vec<u8>,
    pub(crate) report: Report,
    /// Warnings that are told before the points.
    pub(crate) early: Vec<String>,
}

struct Nobody;

impl Observer for Nobody {}
impl Watch for Nobody {}

fn options(pairs: &[(&str, &str)], format: Option<Format>) -> Options {
    Options { format, ..Options::parse(pairs).expect("options") }
}

/// Plans and works on a cloud in tiles as `watch` hears it, and gives what `done` makes of that.
fn in_tiles<R>(
    body: &[u8],
    options: &Options,
    fake: Fake,
    watch: &dyn Watch,
    done: impl FnOnce(Arc<Tiling>, &Work<'_>) -> R,
) -> R {
    let temp = tempfile::tempdir().expect("a folder");
    let folder = Folder::temporary(temp.path()).expect("a folder");
    let reader = CloudReader::open_as(body, Limits::default(), &options.reading).expect("a header");
    let Input::Large(large) = Input::read(reader, 1000).expect("a cloud") else { panic!("small") };
    let (runner, model) = (Patchwise::new(Arc::new(fake)), ModelName::default());
    let (model, tile_points) = (&model, 1000);
    let work = Work { options, model, runner: &runner, tile_points, watch };
    let tiling = plan(*large, &work, &folder).expect("a plan");
    done(Arc::new(tiling), &work)
}

pub(crate) fn expected(body: &[u8], pairs: &[(&str, &str)]) -> Expected {
    expected_as(body, pairs, None)
}

fn expected_as(body: &[u8], pairs: &[(&str, &str)], format: Option<Format>) -> Expected {
    in_tiles(body, &options(pairs, format), Fake::new(), &Nobody, |tiling, work| {
        tiling.run_all(work).expect("tiles");
        let flows = tiling.flows().then(|| tiling.flow(std::io::sink()).expect("a file").report());
        let mut file = Vec::new();
        let report = tiling.join().expect("parts").write(&mut file).expect("a file");
        let early = flows.map_or_else(|| report.warnings.clone(), |report| report.warnings);
        Expected { file, report, early }
    })
}

/// How many batches there are before each tile, and in all.
pub(crate) fn batches(body: &[u8], pairs: &[(&str, &str)]) -> Vec<usize> {
    struct Counts(Fake, std::sync::Mutex<Vec<usize>>);
    impl Observer for Counts {}
    impl Watch for Counts {
        fn step(&self, step: Step) {
            if let Step::Tile { .. } = step {
                self.1.lock().unwrap().push(self.0.batches());
            }
        }
    }
    let fake = Fake::new();
    let counts = Counts(fake.clone(), std::sync::Mutex::default());
    in_tiles(body, &options(pairs, None), fake.clone(), &counts, |tiling, work| {
        tiling.run_all(work).expect("tiles");
    });
    let mut counts = counts.1.into_inner().unwrap();
    counts.push(fake.batches());
    counts
}

/// A sphere with a colour and a point that comes twice.
fn sphere(points: usize) -> Cloud {
    let mut positions = cloud(points);
    positions[9] = positions[8];
    let red = Values::U8((0..points).map(|i| i as u8).collect());
    Cloud { attributes: vec![Attribute { name: "red".into(), values: red }], ..Cloud::from(positions) }
}

fn file(cloud: &Cloud, format: Format) -> Vec<u8> {
    encode(Vec::new(), format, &cloud.positions, &cloud.attributes, &Origin::default()).expect("a file")
}

fn entries(folder: &Path) -> usize {
    std::fs::read_dir(folder).expect("a folder").count()
}

/// A cloud, and a query for it that makes four tiles.
fn request() -> (Vec<u8>, [(&'static str, &'static str); 2]) {
    (file(&sphere(3500), PLY), [("ratio", "2"), ("tile_points", "1000")])
}

const TARGET: &str = "/upsample?ratio=2&tile_points=1000";

/// A request on a connection of its own, whose work stops before a tile: what has come of its answer by then.
fn held_back(server: &Server, backend: &Scripted, tile: usize, headers: &str) -> (Client, Vec<u8>) {
    let (body, pairs) = request();
    let before = batches(&body, &pairs)[tile];
    backend.shut();
    (0..before).for_each(|_| backend.pass());
    let mut client = server.begin("POST", TARGET, headers, &body);
    let mut bytes = Vec::new();
    // A head, a file's header, and points.
    while bytes.len() < 3000 {
        bytes.extend(client.some());
    }
    (client, bytes)
}

#[test]
fn the_bytes_are_those_of_the_library_however_they_come_and_go() {
    let temp = tempfile::tempdir().expect("a folder");
    let mut config = config(temp.path());
    let folder = tempfile::tempdir().expect("a folder");
    config.jobs = Some(densecloud_jobs::Settings::new(folder.path().to_owned()));
    let server = Server::start(&Scripted::new(), config);
    let cloud = sphere(3500);
    let las = Format::Las { compressed: false };
    for (from, accept, more) in [
        (PLY, None, ""),
        (Format::TEXT, None, ""),
        (las, None, ""),
        (PLY, Some(Format::Las { compressed: true }), "&keep_input=true&confidence=true"),
        (PLY, Some(Format::TEXT), ""),
        (PLY, None, "&min_confidence=0.3"),
    ] {
        let body = file(&cloud, from);
        let query = format!("ratio=2&tile_points=1000{more}");
        let pairs: Vec<(&str, &str)> = query.split('&').map(|pair| pair.split_once('=').unwrap()).collect();
        let Expected { file, report, early } = expected_as(&body, &pairs, accept);
        let header = accept.map_or(String::new(), |format| format!("accept: {}\r\n", format.media_type()));
        let reply = server.ask("POST", &format!("/upsample?{query}"), &header, &body);
        assert_eq!(reply.status, 200, "{}", String::from_utf8_lossy(&reply.body));
        assert!(reply.body == file, "{from} {accept:?}");
        assert_eq!(reply.header("densecloud-points-in"), Some("3500"));
        assert_eq!(reply.header("densecloud-points-out"), Some(&*report.points_out.to_string()));
        assert_eq!(reply.header("densecloud-provenance"), Some(&*report.provenance));
        let told: Vec<_> = reply.headers.iter().filter(|(name, _)| name == "densecloud-warning").collect();
        assert_eq!(told.len(), early.len(), "{told:?}");
        // Text alone does not tell its length beforehand, and LAZ is not sent before it is whole.
        let is_text = accept.unwrap_or(from) == Format::TEXT;
        assert_eq!(reply.header("content-length").is_none(), is_text, "{from} {accept:?}");
        assert_eq!(reply.header("trailer"), None);
        let job = server.ask("POST", &format!("/jobs?{query}"), &header, &body);
        assert_eq!(job.status, 202, "{}", job.text());
        let path = job.header("location").expect("a location").to_owned();
        let state = || -> Value { serde_json::from_slice(&server.get(&path).body).expect("JSON") };
        wait_until("the job is done", || state()["state"] == "done");
        assert!(server.get(&format!("{path}/result")).body == file, "{from} {accept:?}: the job's");
        assert_eq!(state()["points_out"], report.points_out);
    }
    let (body, pairs) = request();
    let expected = expected(&body, &pairs).file;
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(&body).unwrap();
    let gzip = "content-encoding: gzip\r\naccept-encoding: zstd\r\nte: trailers\r\n";
    let reply = server.ask("POST", TARGET, gzip, &encoder.finish().unwrap());
    assert_eq!(reply.header("content-encoding"), Some("zstd"));
    assert!(zstd::decode_all(&reply.body[..]).expect("zstd") == expected);
    wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
    wait_until("the folders are removed", || entries(temp.path()) == 0);
    assert_eq!(server.engine.queued_points(), 0);
}

#[test]
fn the_first_part_comes_before_the_second_tile_is_begun() {
    let temp = tempfile::tempdir().expect("a folder");
    let backend = Scripted::new();
    let server = Server::start(&backend, config(temp.path()));
    let (mut client, mut bytes) = held_back(&server, &backend, 1, "te: trailers\r\n");
    assert!(Reply::parse(&bytes).is_none() && entries(temp.path()) == 1);
    backend.open();
    bytes.extend(client.rest());
    let reply = Reply::parse(&bytes).expect("the whole answer");
    let (body, pairs) = request();
    assert!(reply.body == expected(&body, &pairs).file);
    wait_until("the folder is removed", || entries(temp.path()) == 0);
}

#[test]
fn what_is_known_at_the_end_comes_after_the_points() {
    let temp = tempfile::tempdir().expect("a folder");
    let server = Server::start(&Scripted::new(), config(temp.path()));
    let (body, pairs) = request();
    let Expected { report, early, .. } = expected(&body, &pairs);
    let late: Vec<_> = report.warnings.iter().filter(|told| !early.contains(told)).collect();
    assert!(matches!(late[..], [told] if told.contains("coincide")), "{late:?}");
    for (headers, has) in [("te: trailers\r\n", true), ("", false)] {
        let bytes = server.begin("POST", TARGET, headers, &body).rest();
        let reply = Reply::parse(&bytes).expect("the whole answer");
        assert_eq!(reply.header("trailer").is_some(), has);
        assert_eq!(reply.header("content-length").is_some(), !has);
        let end = String::from_utf8_lossy(&bytes[bytes.len() - 400..]).into_owned();
        let Some((_, end)) = end.rsplit_once("\r\n0\r\n") else {
            assert!(!has, "no last chunk");
            continue;
        };
        assert!(end.contains(&format!("densecloud-warning: {}\r\n", late[0])), "{end}");
        assert!(end.contains("server-timing: "), "{end}");
    }
}

#[test]
fn a_failure_midway_breaks_the_answer_off() {
    let temp = tempfile::tempdir().expect("a folder");
    for headers in ["", "te: trailers\r\n", "accept: text/plain\r\n"] {
        let backend = Scripted::new();
        let server = Server::start(&backend, config(temp.path()));
        let (mut client, mut bytes) = held_back(&server, &backend, 1, headers);
        backend.fail();
        backend.open();
        bytes.extend(client.rest());
        assert!(bytes.starts_with(b"HTTP/1.1 200 ") && Reply::parse(&bytes).is_none(), "it looks whole");
        assert!(!String::from_utf8_lossy(&bytes).contains("secret"));
        wait_until("it is counted", || {
            server.metric("densecloud_requests_total{interface=\"http\",outcome=\"failed\"}") == 1.0
        });
        wait_until("the folder is removed", || entries(temp.path()) == 0);
        assert_eq!(server.engine.queued_points(), 0);
        // Before the first part there is a proper answer.
        let (body, _) = request();
        let reply = server.post(TARGET, &body);
        assert_eq!((reply.status, reply.problem_name().as_str()), (500, "internal"));
    }
}

#[test]
fn where_nothing_but_a_length_tells_the_end_there_is_one() {
    let temp = tempfile::tempdir().expect("a folder");
    let server = Server::start(&Scripted::new(), config(temp.path()));
    let (body, pairs) = request();
    for (accept, format) in [("*/*", None), ("text/plain", Some(Format::TEXT))] {
        let mut client = server.connect();
        let length = body.len();
        let head = format!(
            "POST {TARGET} HTTP/1.0\r\naccept: {accept}\r\nte: trailers\r\ncontent-length: {length}\r\n\r\n"
        );
        client.send(head.as_bytes());
        client.send(&body);
        let reply = Reply::parse(&client.rest()).expect("the whole answer");
        assert!(reply.header("content-length").is_some(), "{accept}");
        assert!(reply.body == expected_as(&body, &pairs, format).file, "{accept}");
    }
}

#[test]
fn who_leaves_takes_the_work_and_its_folder_along() {
    let temp = tempfile::tempdir().expect("a folder");
    let backend = Scripted::new();
    let server = Server::start(&backend, config(temp.path()));
    for tile in [1, 2] {
        let (client, _) = held_back(&server, &backend, tile, "");
        assert!(entries(temp.path()) == 1 && server.engine.queued_points() > 0);
        drop(client);
        wait_until("it is cancelled", || server.metric("densecloud_requests_in_flight") == 0.0);
        let before = backend.batches();
        backend.open();
        server.wait_for_no_work();
        assert!(backend.batches() <= before + 2, "no more than what was at work");
        wait_until("the folder is removed", || entries(temp.path()) == 0);
        wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
    }
    // While it is planned.
    backend.shut();
    let (body, _) = request();
    let client = server.begin("POST", TARGET, "", &body);
    wait_until("it is planned", || entries(temp.path()) == 1);
    drop(client);
    wait_until("it is cancelled", || server.metric("densecloud_requests_in_flight") == 0.0);
    backend.open();
    wait_until("the folder is removed", || entries(temp.path()) == 0);
    server.wait_for_no_work();
}

#[test]
fn a_jobs_progress_is_by_tiles_and_it_is_cancelled_within_one() {
    let (temp, folder) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let mut config = config(temp.path());
    config.jobs = Some(densecloud_jobs::Settings::new(folder.path().to_owned()));
    let backend = Scripted::new();
    let server = Server::start(&backend, config);
    let (body, pairs) = request();
    let counts = batches(&body, &pairs);
    backend.shut();
    (0..counts[2]).for_each(|_| backend.pass());
    let reply = server.post("/jobs?ratio=2&tile_points=1000", &body);
    let path = reply.header("location").expect("a location").to_owned();
    let job = || -> Value { serde_json::from_slice(&server.get(&path).body).expect("JSON") };
    let fraction = || job()["progress"]["fraction"].as_f64().expect("a number");
    // Two of four tiles, which are of about the same size.
    wait_until("two tiles are done", || fraction() > 0.45);
    assert!(fraction() < 0.75, "{}", fraction());
    assert_eq!(job()["state"], "running");
    assert_eq!(server.ask("DELETE", &path, "", b"").status, 200);
    let before = backend.batches();
    backend.open();
    server.wait_for_no_work();
    wait_until("the folder is removed", || entries(temp.path()) == 0);
    assert!(backend.batches() <= before + 2, "no more than what was at work");
    assert_eq!(job()["state"], "cancelled");
    wait_until("its tiles are removed", || entries(&folder.path().join("files")) == 0);
}

#[test]
fn a_job_goes_on_with_the_tiles_that_were_done() {
    let (temp, folder) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let mut config = config(temp.path());
    config.jobs = Some(densecloud_jobs::Settings::new(folder.path().to_owned()));
    let backend = Scripted::new();
    let mut server = Server::start(&backend, config.clone());
    let (body, pairs) = request();
    let counts = batches(&body, &pairs);
    backend.shut();
    (0..counts[2]).for_each(|_| backend.pass());
    let path =
        server.post("/jobs?ratio=2&tile_points=1000", &body).header("location").expect("one").to_owned();
    let job = |server: &Server| -> Value { serde_json::from_slice(&server.get(&path).body).expect("JSON") };
    let (tiles, files) = (folder.path().join("tiles"), folder.path().join("files"));
    let two = "densecloud_steps_total{step=\"tile\",outcome=\"done\"} 2";
    wait_until("two tiles are kept", || server.get("/metrics").text().contains(two));
    server.stop();
    wait_until("it is draining", || !server.is_ready());
    backend.open();
    server.join().expect("it ends well");
    drop(server);
    assert_eq!(entries(&tiles), 0);
    assert!(entries(&files) > counts.len(), "the job's tiles stay");
    // What an earlier version left of a job.
    drop(Folder::kept(&tiles, "another").expect("a folder"));
    let warm = Scripted::new();
    drop(Server::start(&warm, Config::default()));
    let again = Scripted::new();
    let server = Server::start(&again, config);
    wait_until("it is done", || job(&server)["state"] == "done");
    let kept = server.get(&format!("{path}/result"));
    assert!(kept.body == expected(&body, &pairs).file);
    assert_eq!(
        again.batches() - warm.batches(),
        counts[counts.len() - 1] - counts[2],
        "no tile is made twice: {counts:?}"
    );
    assert_eq!((entries(&tiles), entries(&files)), (0, 1), "the result alone");
}

#[test]
fn a_job_is_planned_once_the_disk_has_room_for_all_of_it() {
    let (body, pairs) = request();
    let needed =
        in_tiles(&body, &options(&pairs, None), Fake::new(), &Nobody, |tiling, _| tiling.disk_bytes());
    // A tile alone would find room in less.
    for (temp_bytes, becomes, state) in [(needed - 1, "later", "queued"), (needed, "done", "done")] {
        let (temp, folder) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
        let mut config = config(temp.path());
        config.limits.temp_bytes = temp_bytes;
        config.jobs = Some(densecloud_jobs::Settings::new(folder.path().to_owned()));
        let server = Server::start(&Scripted::new(), config);
        let job = server.post("/jobs?ratio=2&tile_points=1000", &body);
        let path = job.header("location").expect("a location").to_owned();
        let count = |outcome: &str| {
            server.metric(&format!("densecloud_steps_total{{step=\"whole\",outcome=\"{outcome}\"}}"))
        };
        let all = || ["done", "failed", "later", "lost"].map(count).iter().sum::<f64>();
        wait_until("it is planned, or not", || all() > 0.0);
        assert!(count(becomes) > 0.0, "with {temp_bytes} bytes it is not {becomes}");
        wait_until("its state is told", || {
            let told: Value = serde_json::from_slice(&server.get(&path).body).expect("JSON");
            told["state"] == state
        });
    }
}

#[test]
fn a_long_upload_lies_on_the_disk() {
    let temp = tempfile::tempdir().expect("a folder");
    let mut config = config(temp.path());
    config.limits.temp_bytes = 40 << 20;
    let server = Server::start(&Scripted::new(), config);
    let header = |points: usize| {
        let axes = ["x", "y", "z"].map(|axis| format!("property float {axis}\n")).concat();
        format!("ply\nformat binary_little_endian 1.0\nelement vertex {points}\n{axes}end_header\n")
    };
    let mut client = server.connect();
    let length = header(4_000_000).len() + 48_000_000;
    let head = format!("POST /upsample?ratio=1 HTTP/1.1\r\nhost: x\r\ncontent-length: {length}\r\n\r\n");
    client.send(head.as_bytes());
    client.send(header(4_000_000).as_bytes());
    for _ in 0..30 {
        client.send(&vec![1; 1 << 20]);
    }
    wait_until("eight megabytes are held", || {
        server.metric("densecloud_held_bytes") > 7.0 * f64::from(1 << 20)
    });
    assert!(server.metric("densecloud_held_bytes") <= 9.0 * f64::from(1 << 20));
    // It has no name there.
    assert_eq!(entries(temp.path()), 0);
    assert!(server.engine.queued_points() == 4_000_000, "its points are reserved by its header");
    for _ in 0..15 {
        client.try_send(&vec![1; 1 << 20]);
    }
    let reply = client.reply();
    assert_eq!((reply.status, reply.problem_name().as_str()), (503, "temp-full"));
    wait_until("all is given back", || server.metric("densecloud_held_bytes") == 0.0);
    server.wait_for_no_work();
    // What is not long enough.
    let reply =
        server.post("/upsample?ratio=1&tile_points=1000", &[header(5000).as_bytes(), &[0; 600]].concat());
    assert_eq!((reply.status, reply.problem_name().as_str()), (400, "malformed-cloud"));
    wait_until("the folder is removed", || entries(temp.path()) == 0);
}

#[test]
fn what_cannot_be_made_in_tiles_is_refused() {
    let temp = tempfile::tempdir().expect("a folder");
    let mut config = config(temp.path());
    (config.limits.points_out, config.limits.temp_bytes) = (8000, 300_000);
    let server = Server::start(&Scripted::new(), config);
    let (body, _) = request();
    let reply = server.ask("POST", TARGET, "accept: model/e57\r\n", &body);
    assert_eq!((reply.status, reply.problem_name().as_str()), (422, "impossible-cloud"));
    assert!(reply.text().contains("E57 is written of a whole cloud"), "{}", reply.text());
    let reply = server.post(&format!("{TARGET}&attributes=blue:drop"), &body);
    assert_eq!((reply.status, reply.problem_name().as_str()), (400, "invalid-parameter"));
    // Known when it is planned alone.
    let reply = server.post("/upsample?spacing=0.001&tile_points=1000", &body);
    assert!([413, 422].contains(&reply.status), "{}", reply.text());
    let reply = server.post(TARGET, &body);
    assert_eq!((reply.status, reply.problem_name().as_str()), (503, "temp-full"));
    wait_until("the folder is removed", || entries(temp.path()) == 0);
    server.wait_for_no_work();
}
