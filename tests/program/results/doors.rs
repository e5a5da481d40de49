//! The ways into the program: each makes the bytes of a case's result.

use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Map, Value, json};
use tempfile::TempDir;
use ureq::http::Response;

use super::clouds::{self, Kind, Points};
use super::{Case, Door, files, grpc};
use crate::support::{PATIENCE, Serving, agent, densecloud};

/// A folder with all inputs, and the one server of all cases.
pub(super) struct Place {
    folder: TempDir,
    pub(super) serving: Serving,
}

impl Place {
    pub(super) fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, bytes) in files::inputs() {
            std::fs::write(folder.path().join(name), bytes).expect("a file");
        }
        let jobs = folder.path().join("jobs");
        let serving = Serving::start(&["--data-dir", jobs.to_str().expect("UTF-8")]);
        Self { folder, serving }
    }

    pub(super) fn make(&self, case: &Case) -> Vec<u8> {
        match case.door {
            Door::File => self.file(case),
            Door::Pipe => self.pipe(case),
            Door::Command => self.command(case),
            Door::Http => body(case, self.send(case, "/upsample")),
            Door::Job => self.job(case),
            Door::Tensor => self.tensor(case),
            Door::Grpc => grpc::ask(self, case),
        }
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(super) fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// The program in the folder, so that no path of this machine is in a result.
    fn program(&self, arguments: &[String]) -> Command {
        let mut program = densecloud();
        program.current_dir(&self.folder).args(arguments);
        program
    }

    /// The file, and what stands beside it where it has no place for comments.
    fn file(&self, case: &Case) -> Vec<u8> {
        let arguments = upsample(case, case.input, case.output);
        run(case, self.program(&arguments));
        let beside = format!("{}.provenance.txt", case.output);
        let mut bytes = self.read(case.output);
        if self.path(&beside).exists() {
            bytes.extend(self.read(&beside));
            std::fs::remove_file(self.path(&beside)).expect("it is there");
        }
        bytes
    }

    fn pipe(&self, case: &Case) -> Vec<u8> {
        let input = std::fs::File::open(self.path(case.input)).expect("a file");
        let mut program = self.program(&upsample(case, "-", "-"));
        program.stdin(Stdio::from(input));
        run(case, program)
    }

    /// Another command: the file that it writes, or what it says.
    fn command(&self, case: &Case) -> Vec<u8> {
        let words = std::iter::once(case.input).chain(case.options.split('&'));
        let said = run(case, self.program(&words.map(str::to_owned).collect::<Vec<_>>()));
        if case.output == "-" { said } else { self.read(case.output) }
    }

    /// Posts the case's input with its options as the query.
    fn send(&self, case: &Case, target: &str) -> Response<ureq::Body> {
        let url = self.serving.url(&format!("{target}?{}", case.options));
        let mut request = agent().post(url);
        if case.output != "-" {
            request = request.header("accept", case.output);
        }
        request.send(self.read(case.input)).expect("an answer")
    }

    fn job(&self, case: &Case) -> Vec<u8> {
        let queued = self.send(case, "/jobs");
        assert_eq!(queued.status(), 202, "{}", case.name());
        let target = queued.headers()["location"].to_str().expect("a path").to_owned();
        let start = Instant::now();
        loop {
            let job: Value = serde_json::from_str(&self.serving.page(&target)).expect("JSON");
            match job["state"].as_str() {
                Some("done") => break,
                Some("queued" | "running") if start.elapsed() < PATIENCE => {}
                _ => panic!("{}: {job}", case.name()),
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        body(case, agent().get(self.serving.url(&format!("{target}/result"))).call().expect("an answer"))
    }

    /// The Open Inference Protocol: JSON and then the tensor, in both directions.
    fn tensor(&self, case: &Case) -> Vec<u8> {
        let kind = if case.output == "FP32" { Kind::F32 } else { Kind::F64 };
        let points = cloud(case);
        let tensor: Vec<u8> = points.positions.iter().flatten().flat_map(|c| kind.little(*c)).collect();
        let mut parameters: Map<String, Value> =
            case.options().map(|(name, value)| (name.to_owned(), value.into())).collect();
        parameters.insert("binary_data_output".to_owned(), true.into());
        let input = json!({
            "name": "points", "datatype": case.output, "shape": [points.positions.len(), 3],
            "parameters": { "binary_data_size": tensor.len() },
        });
        let head = json!({ "parameters": parameters, "inputs": [input] }).to_string();
        let request = agent()
            .post(self.serving.url("/v2/models/densecloud/infer"))
            .header("inference-header-content-length", head.len().to_string());
        body(case, request.send([head.as_bytes(), &tensor].concat()).expect("an answer"))
    }
}

/// The cloud of a case that goes as numbers.
pub(super) fn cloud(case: &Case) -> Points {
    match case.input {
        "ring" => clouds::ring(500),
        "hill" => clouds::hill(500).coloured().measured(),
        "ground" => clouds::ground(400).coloured(),
        "holes" => clouds::holes(500).measured(),
        other => panic!("{}: no cloud {other:?}", case.name()),
    }
}

fn upsample(case: &Case, input: &str, output: &str) -> Vec<String> {
    let option = |(name, value): (&str, &str)| {
        let name = format!("--{}", name.replace('_', "-"));
        if value == "true" { vec![name] } else { vec![name, value.to_owned()] }
    };
    let begin = ["upsample", input, output, "--quiet"].map(str::to_owned);
    begin.into_iter().chain(case.options().flat_map(option)).collect()
}

/// What it writes to standard output.
fn run(case: &Case, mut program: Command) -> Vec<u8> {
    let output = program.output().expect("the program starts");
    assert!(output.status.success(), "{}: {}", case.name(), String::from_utf8_lossy(&output.stderr));
    output.stdout
}

fn body(case: &Case, mut answer: Response<ureq::Body>) -> Vec<u8> {
    let bytes = answer.body_mut().read_to_vec().expect("a body");
    assert_eq!(answer.status(), 200, "{}: {}", case.name(), String::from_utf8_lossy(&bytes));
    bytes
}
