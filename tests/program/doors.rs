//! One cloud, one set of options, every way in: the same bytes.

use std::cell::Cell;
use std::fmt::Write;
use std::path::Path;
use std::time::Duration;

use densecloud::{Input, Options, Upsampler};
use densecloud_server::proto::{
    self, Start, UpsampleRequest, upsample_request::Message as In, upsample_response::Message as Out,
    upsampler_client::UpsamplerClient,
};
use futures::stream;
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use serde_json::Value;

use crate::support::{Serving, agent, densecloud};

/// Random clouds; each goes through every door.
const CLOUDS: u32 = 12;

/// A PLY file with NaN, duplicates, a point or two apart, coordinates near and far, and attributes.
#[derive(Debug, Clone)]
struct Scan {
    points: usize,
    offset: f64,
    double: bool,
    /// Every so many points one is NaN, and one is its neighbour again.
    spoilt: usize,
    attributes: bool,
    seed: u32,
}

fn scans() -> impl Strategy<Value = Scan> {
    let offsets = prop_oneof![Just(0.0), Just(1983.0), Just(-4_649_776.5), Just(1e9)];
    let spoilt = prop_oneof![Just(usize::MAX), Just(2), 3_usize..40];
    (60_usize..300, offsets, any::<bool>(), spoilt, any::<bool>(), any::<u32>()).prop_map(
        |(points, offset, double, spoilt, attributes, seed)| Scan {
            points,
            offset,
            double,
            spoilt,
            attributes,
            seed,
        },
    )
}

/// Options that every door has.
fn options() -> impl Strategy<Value = Vec<(&'static str, String)>> {
    let goal = prop_oneof![
        (1.0..6.0).prop_map(|ratio: f64| ("ratio", ratio.to_string())),
        Just(("ratio", "4".to_owned())),
        (0.9..1.4).prop_map(|spacing: f64| ("spacing", (spacing * 0.05).to_string())),
    ];
    let others = [
        ("seed", "7"),
        ("keep_input", "true"),
        ("source_fields", "true"),
        ("confidence", "true"),
        ("min_confidence", "0.4"),
        ("normals", "estimate"),
        ("overlap", "2.5"),
        ("inner", "0.6"),
        ("max_displacement", "inf"),
        ("max_distance", "1.2"),
        ("no_polish", "true"),
        ("spread", "area"),
        ("quality", "best"),
    ];
    let some = proptest::sample::subsequence(others.to_vec(), 0..=5);
    (goal, some).prop_map(|(goal, some)| {
        let some = some.into_iter().map(|(name, value)| (name, value.to_owned()));
        std::iter::once(goal).chain(some).collect()
    })
}

impl Scan {
    fn ply(&self) -> String {
        let scalar = if self.double { "double" } else { "float" };
        let mut file = format!("ply\nformat ascii 1.0\nelement vertex {}\n", self.points);
        for axis in ["x", "y", "z"] {
            let _ = writeln!(file, "property {scalar} {axis}");
        }
        if self.attributes {
            file += "property uchar red\nproperty ushort label\nproperty float height\n";
        }
        file += "end_header\n";
        let mut state = self.seed;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24)
        };
        let mut last = [0.0; 3];
        for i in 0..self.points {
            let (x, y) = (random(), random());
            let mut at = [self.offset + x, y - self.offset, 0.2 * (x - y) * x];
            if i % self.spoilt == self.spoilt - 1 {
                at = if random() < 0.5 { [f64::NAN; 3] } else { last };
            }
            let _ = write!(file, "{} {} {}", at[0], at[1], at[2]);
            if self.attributes {
                let _ = write!(file, " {} {} {}", i % 256, i * 37 % 9, x as f32);
            }
            file.push('\n');
            last = at;
        }
        file
    }
}

/// The ways into the program, and what they share.
struct Doors {
    folder: tempfile::TempDir,
    serving: Serving,
    library: Upsampler,
    runtime: tokio::runtime::Runtime,
}

impl Doors {
    fn open() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let serving = Serving::start(&["--data-dir", text(&folder.path().join("jobs"))]);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        Self { folder, serving, library: Upsampler::new().expect("a model"), runtime }
    }

    fn library(&self, input: &Path, options: &[(&'static str, String)]) -> Result<Vec<u8>, String> {
        let options = Options::parse(options).map_err(|error| error.to_string())?;
        let input = Input::read_as(input, &options.reading).map_err(|error| error.to_string())?;
        let dense = self.library.upsample(input, options).map_err(|error| error.to_string())?;
        let mut bytes = Vec::new();
        dense.write(&mut bytes).map_err(|error| error.to_string())?;
        Ok(bytes)
    }

    fn command(&self, input: &Path, options: &[(&'static str, String)], more: &[&str]) -> Option<Vec<u8>> {
        let mut program = densecloud();
        program.args(["upsample", text(input), "-", "--quiet"]).args(more);
        for (name, value) in options {
            program.arg(format!("--{}", name.replace('_', "-")));
            if value != "true" {
                program.arg(value);
            }
        }
        let output = program.output().expect("the program starts");
        output.status.success().then_some(output.stdout)
    }

    fn post(
        &self,
        path: &str,
        body: &str,
        options: &[(&'static str, String)],
    ) -> Option<ureq::http::Response<ureq::Body>> {
        let mut request = agent().post(self.serving.url(path));
        for (name, value) in options {
            request = request.query(*name, value);
        }
        let answer = request.send(body).expect("an answer");
        answer.status().is_success().then_some(answer)
    }

    fn http(&self, body: &str, options: &[(&'static str, String)]) -> Option<Vec<u8>> {
        Some(self.post("/upsample", body, options)?.body_mut().read_to_vec().expect("a body"))
    }

    fn job(&self, body: &str, options: &[(&'static str, String)]) -> Option<Vec<u8>> {
        let queued = self.post("/jobs", body, options)?;
        let path = queued.headers()["location"].to_str().expect("a path").to_owned();
        loop {
            let job: Value = serde_json::from_str(&self.serving.page(&path)).expect("JSON");
            match job["state"].as_str() {
                Some("done") => break,
                Some("queued" | "running") => std::thread::sleep(Duration::from_millis(5)),
                _ => return None,
            }
        }
        let mut result = agent().get(self.serving.url(&format!("{path}/result"))).call().expect("an answer");
        Some(result.body_mut().read_to_vec().expect("a body"))
    }

    fn grpc(&self, body: &str, options: &[(&'static str, String)]) -> Option<Vec<u8>> {
        let parameters = options.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        let options = proto::Options { parameters, ..proto::Options::default() };
        let start = In::Start(Start { options: Some(options), layout: None });
        let chunk = In::FileChunk(body.as_bytes().to_vec().into());
        let messages = [start, chunk].map(|message| UpsampleRequest { message: Some(message) });
        self.runtime.block_on(async {
            let address = tonic::transport::Endpoint::from_shared(self.serving.url("")).expect("an address");
            let mut client = UpsamplerClient::new(address.connect_lazy());
            let mut answers = client.upsample(stream::iter(messages)).await.ok()?.into_inner();
            let mut bytes = Vec::new();
            while let Some(answer) = answers.message().await.ok()? {
                if let Some(Out::FileChunk(piece)) = answer.message {
                    bytes.extend(piece);
                }
            }
            Some(bytes)
        })
    }
}

#[test]
fn every_door_gives_the_same_bytes() {
    let doors = Doors::open();
    let mut runner =
        TestRunner::new(Config { cases: CLOUDS, failure_persistence: None, ..Config::default() });
    let (made, refused) = (Cell::new(0), Cell::new(0));
    let outcome = runner.run(&(scans(), options()), |(scan, options)| {
        let (body, input) = (scan.ply(), doors.folder.path().join("in.ply"));
        std::fs::write(&input, &body).expect("a file");
        let library = doors.library(&input, &options);
        let expected = library.as_ref().ok();
        let url = doors.serving.url("");
        for (door, bytes) in [
            ("command line", doors.command(&input, &options, &[])),
            ("command line by a server", doors.command(&input, &options, &["--server", &url])),
            ("HTTP", doors.http(&body, &options)),
            ("job", doors.job(&body, &options)),
            ("gRPC", doors.grpc(&body, &options)),
        ] {
            prop_assert!(bytes.as_ref() == expected, "{door}: {:?}", library.as_ref().map(Vec::len));
        }
        let count = if expected.is_some() { &made } else { &refused };
        count.set(count.get() + 1);
        Ok(())
    });
    let (made, refused) = (made.get(), refused.get());
    outcome.unwrap_or_else(|failed| panic!("{failed}"));
    assert!(made > refused, "{made} made, {refused} refused: too few results to compare");
}

/// In tiles, which the library alone has in a crate of its own: the parts flow in the first case, and are joined in the second.
#[test]
fn clouds_in_tiles_are_the_same_behind_every_door() {
    let doors = Doors::open();
    let scan = Scan { points: 2600, offset: 1983.0, double: false, spoilt: 30, attributes: true, seed: 1 };
    let (body, input) = (scan.ply(), doors.folder.path().join("in.ply"));
    std::fs::write(&input, &body).expect("a file");
    let url = doors.serving.url("");
    for more in [("keep_input", "true"), ("min_confidence", "0.2")] {
        let options: Vec<_> = [("ratio", "2"), ("tile_points", "1000"), more]
            .map(|(name, value)| (name, value.to_owned()))
            .into();
        let expected = doors.command(&input, &options, &[]).expect("a dense cloud");
        assert!(String::from_utf8_lossy(&expected[..2000]).contains("tile_points=1000"));
        for (door, bytes) in [
            ("command line by a server", doors.command(&input, &options, &["--server", &url])),
            ("HTTP", doors.http(&body, &options)),
            ("job", doors.job(&body, &options)),
            ("gRPC", doors.grpc(&body, &options)),
        ] {
            assert!(bytes.as_ref() == Some(&expected), "{door}: {more:?}");
        }
    }
}

/// A file whose every second point is not finite: the size of the result, and so its format, goes by those that are.
#[test]
fn points_that_are_not_finite_do_not_decide_the_format() {
    let doors = Doors::open();
    let scan = Scan { points: 400, offset: 1983.0, double: false, spoilt: 2, attributes: false, seed: 1 };
    let (body, input) = (scan.ply(), doors.folder.path().join("in.ply"));
    std::fs::write(&input, &body).expect("a file");
    let options = vec![("ratio", "4".to_owned())];
    let bytes = doors.library(&input, &options).expect("a dense cloud");
    assert!(doors.command(&input, &options, &[]).as_ref() == Some(&bytes));
    assert!(doors.http(&body, &options).as_ref() == Some(&bytes));
}

/// A plane and points strewn above it, some of them near: behind every door and in every format the result has those that
/// are sure, and tells how many.
#[test]
fn what_is_not_sure_is_left_out_and_the_rest_counted_behind_every_door() {
    let doors = Doors::open();
    let mut body = String::new();
    for i in 0..600 {
        let (x, y) = (f64::from(i % 25), f64::from(i / 25));
        let above = if i % 20 == 0 { 1.5 + f64::from(i % 7) } else { 0.0 };
        let _ = writeln!(body, "{x} {y} {above}");
    }
    let input = doors.folder.path().join("in.xyz");
    std::fs::write(&input, &body).expect("a file");
    let options: Vec<(&'static str, String)> =
        [("ratio", "4"), ("confidence", "true"), ("min_confidence", "0.8")]
            .map(|(n, v)| (n, v.to_owned()))
            .into();
    let library = doors.library(&input, &options).expect("a dense cloud");
    let rows = String::from_utf8(library.clone()).expect("text").lines().count();
    assert!((1000..2400).contains(&rows), "{rows}");
    assert!(doors.command(&input, &options, &[]).as_ref() == Some(&library));
    let mut answer = doors.post("/upsample", &body, &options).expect("an answer");
    assert_eq!(answer.headers()["densecloud-points-out"], rows.to_string().as_str());
    let warnings = answer.headers().get_all("densecloud-warning").iter();
    let left_out = format!("{} points of the result left out", 2400 - rows);
    assert!(
        warnings.filter_map(|told| told.to_str().ok()).any(|told| told.starts_with(&left_out)),
        "{left_out}"
    );
    assert!(answer.body_mut().read_to_vec().expect("a body") == library);
    assert!(doors.job(&body, &options).as_ref() == Some(&library));
    let jobs: Value = serde_json::from_str(&doors.serving.page("/jobs")).expect("JSON");
    assert_eq!(jobs["jobs"][0]["points_out"], rows);
    assert!(doors.grpc(&body, &options).as_ref() == Some(&library));
    for extension in ["ply", "las", "laz", "pcd", "e57", "npy", "csv"] {
        let output = doors.folder.path().join(format!("out.{extension}"));
        let options = Options::parse(&options).expect("options");
        let report = doors.library.upsample_file(&input, &output, options).expect(extension);
        let Input { cloud, .. } = Input::read(&output).expect(extension);
        assert_eq!((cloud.positions.len(), report.points_out), (rows, rows as u64), "{extension}");
        let sure = cloud.attributes.last().expect(extension);
        // Text whose input names no columns names none.
        let is_named = sure.name.eq_ignore_ascii_case("confidence");
        assert!(is_named || extension == "csv", "{extension}: {}", sure.name);
        assert!((0..rows).all(|i| (0.8..=1.0).contains(&sure.values.get(i))), "{extension}");
    }
    let nothing = [("min_confidence", "1".to_owned())];
    let why = doors.library(&input, &nothing).expect_err("nothing is left");
    assert_eq!(why, "no point of the result reaches the confidence 1; ask for less");
    assert!(doors.command(&input, &nothing, &[]).is_none() && doors.job(&body, &nothing).is_none());
    assert!(doors.http(&body, &nothing).is_none() && doors.grpc(&body, &nothing).is_none());
}

/// A table that tells neither its coordinates nor its marks.
#[test]
fn every_door_reads_text_as_it_is_told() {
    let doors = Doors::open();
    let mut body = "number,first,second,third\n".to_owned();
    for i in 0..150 {
        let (x, y) = (i % 15, i / 15);
        let _ = writeln!(body, "{i},{y},{},{x}", (x * y) % 4);
    }
    let input = doors.folder.path().join("in.csv");
    std::fs::write(&input, &body).expect("a file");
    let options = |options: &[(&'static str, &str)]| -> Vec<(&'static str, String)> {
        let all = std::iter::once(("ratio", "2")).chain(options.iter().copied());
        all.map(|(name, value)| (name, value.to_owned())).collect()
    };
    let told = options(&[
        ("axes", "third,first,3"),
        ("separator", "comma"),
        ("decimal", "point"),
        ("format", "text"),
        ("bounds", "-1,-1,12,9"),
    ]);
    let library = doors.library(&input, &told).expect("a dense cloud");
    let url = doors.serving.url("");
    for (door, bytes) in [
        ("command line", doors.command(&input, &told, &[])),
        ("command line by a server", doors.command(&input, &told, &["--server", &url])),
        ("HTTP", doors.http(&body, &told)),
        ("job", doors.job(&body, &told)),
        ("gRPC", doors.grpc(&body, &told)),
    ] {
        assert!(bytes.as_ref() == Some(&library), "{door}");
    }
    let text = String::from_utf8(library).expect("UTF-8");
    assert!(text.starts_with("x,y,z,number\n"), "{}", &text[..40]);
    assert_eq!(text.lines().count(), 1 + 2 * 12 * 9, "the points in the box, twice");
    // What does not fit is refused behind each.
    for (name, value) in [("axes", "a,b,c"), ("separator", "tab"), ("format", "ply"), ("bounds", "3,0,2,1")] {
        let wrong = options(&[(name, value)]);
        assert!(doors.library(&input, &wrong).is_err(), "{name}={value}");
        assert!(doors.command(&input, &wrong, &[]).is_none(), "{name}={value}");
        assert!(doors.http(&body, &wrong).is_none() && doors.grpc(&body, &wrong).is_none(), "{name}={value}");
    }
    assert!(doors.http(&body, &options(&[])).is_none(), "no coordinates are named");
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}
