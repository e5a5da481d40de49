//! What the program makes, to the byte: the SHA-256 of each case's result, held against `results.txt`.
//!
//! A case is an input, a way into the program (file, pipe, HTTP, job, tensor, gRPC) and options. Inputs are made here,
//! by arithmetic that is the same everywhere; LAZ and E57 are what an earlier case wrote.
//!
//! One list holds for processors with AVX-512 and for those with AVX2 alone: eight results were made again under
//! valgrind, which offers the latter (`valgrind --tool=none`), and no byte differed. Another
//! C library, whose exponentials are rounded in another way, may give others.
//!
//! `results.txt` is to be renewed only when results are meant to change: with other weights, another version (its
//! number is in the provenance of each result), or a change to what is computed.
//!
//! ```sh
//! DENSECLOUD_RENEW_RESULTS=1 cargo test --test program results
//! ```

mod clouds;
mod doors;
mod files;
mod grpc;

use std::collections::HashSet;
use std::path::Path;

use sha2::{Digest, Sha256};

use doors::Place;

/// What was recorded: a case's name and its hash in each line, in the order of the cases.
const RECORDED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/program/results.txt");
const RENEW: &str = "DENSECLOUD_RENEW_RESULTS";

/// A way into the program.
#[derive(Debug, Clone, Copy)]
enum Door {
    /// `upsample IN OUT`.
    File,
    /// `upsample - -`.
    Pipe,
    /// `POST /upsample`.
    Http,
    /// `POST /jobs`.
    Job,
    /// The Open Inference Protocol.
    Tensor,
    Grpc,
    /// A command that is not `upsample`.
    Command,
}

struct Case {
    door: Door,
    /// A file, a cloud of `doors::cloud`, or a command.
    input: &'static str,
    /// A file, a media type or a type of numbers; `-` is whatever comes.
    output: &'static str,
    /// In the words of HTTP's query; of a command its arguments.
    options: &'static str,
}

impl Case {
    fn name(&self) -> String {
        let door = format!("{:?}", self.door).to_lowercase();
        format!("{door}:{}:{}?{}", self.input, self.output, self.options)
    }

    fn options(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        self.options.split('&').map(|option| option.split_once('=').expect("NAME=VALUE"))
    }
}

const fn case(door: Door, input: &'static str, output: &'static str, options: &'static str) -> Case {
    Case { door, input, output, options }
}

/// In this order, as some read what others wrote.
#[rustfmt::skip]
const CASES: &[Case] = &[
    // Ratios and seeds.
    case(Door::File, "ring.ply", "out.ply", "ratio=1"),
    case(Door::File, "ring.ply", "out.ply", "ratio=1.5&seed=1"),
    case(Door::File, "ring.ply", "out.ply", "ratio=2"),
    case(Door::File, "ring.ply", "out.ply", "ratio=2.5&seed=7"),
    case(Door::File, "ring.ply", "out.ply", "ratio=4"),
    case(Door::File, "ring.ply", "out.ply", "ratio=4&threads=1"),
    case(Door::File, "ring.ply", "out.ply", "ratio=7.3&seed=18446744073709551615"),
    case(Door::File, "ring.ply", "ring16.ply", "ratio=16"),
    // Other goals.
    case(Door::File, "ring.ply", "out.ply", "points=1234&seed=3"),
    case(Door::File, "ring.ply", "out.ply", "spacing=0.07"),
    case(Door::File, "hill.ply", "out.ply", "density=900&keep_input=true"),
    // The cascade's settings.
    case(Door::File, "ring.ply", "out.ply", "ratio=4&no_polish=true"),
    case(Door::File, "noisy.ply", "out.ply", "ratio=2.5&overlap=3&inner=1"),
    case(Door::File, "noisy.ply", "out.ply", "ratio=2&max_displacement=inf&max_distance=inf"),
    case(Door::File, "chest.ply", "out.ply", "ratio=4&max_displacement=0.5&max_distance=1.2&overlap=1.5"),
    case(Door::File, "noisy.ply", "out.ply", "ratio=4&seed=2"),
    // Attributes and normals.
    case(Door::File, "hill.ply", "out.ply", "ratio=4&keep_input=true"),
    case(Door::File, "hill.ply", "out.ply", "ratio=2.5&source_fields=true&attributes=label:mean,red:nearest,warmth:drop"),
    case(Door::File, "ball.ply", "out.ply", "ratio=4"),
    case(Door::File, "ball.ply", "out.ply", "ratio=2&normals=estimate"),
    case(Door::File, "ring.ply", "out.ply", "ratio=4&normals=estimate&sensor=0.5,-2,5"),
    case(Door::File, "holes.ply", "out.ply", "ratio=4&keep_input=true&source_fields=true"),
    case(Door::File, "holes.ply", "out.ply", "ratio=1.5"),
    // Encodings of PLY, and coordinates that 32 bits are too coarse for.
    case(Door::File, "chest.ply", "out.ply", "ratio=7.3"),
    case(Door::File, "big-endian.ply", "out.ply", "ratio=2.5&seed=9"),
    case(Door::File, "big-endian-float.ply", "out.ply", "ratio=4"),
    case(Door::File, "ground.ply", "out.ply", "ratio=4"),
    // Text.
    case(Door::File, "ring.xyz", "out.xyz", "ratio=7.3"),
    case(Door::File, "ground.txt", "out.txt", "ratio=2"),
    case(Door::File, "hill.csv", "out.csv", "ratio=2.5&attributes=label:nearest,intensity:drop"),
    case(Door::File, "hill.csv", "out.ply", "ratio=2&keep_input=true&normals=estimate"),
    case(Door::File, "ground.ply", "out.pts", "ratio=1.5"),
    // LAS and LAZ.
    case(Door::File, "ground.las", "out.las", "ratio=4"),
    case(Door::File, "ground.las", "kept.laz", "ratio=1&keep_input=true"),
    case(Door::File, "kept.laz", "out.laz", "ratio=2.5&keep_input=true&source_fields=true"),
    case(Door::File, "kept.laz", "out.ply", "ratio=2"),
    case(Door::File, "ground.ply", "out.laz", "ratio=4&normals=estimate"),
    case(Door::File, "hill.ply", "out.las", "ratio=2&keep_input=true"),
    // E57.
    case(Door::File, "ground.las", "kept.e57", "ratio=1&keep_input=true"),
    case(Door::File, "kept.e57", "out.e57", "ratio=4&seed=4"),
    case(Door::File, "kept.e57", "out.csv", "ratio=1.5"),
    case(Door::File, "hill.ply", "out.e57", "ratio=2.5&source_fields=true"),
    // PCD; the side of normals is that of its viewpoint.
    case(Door::File, "ring.pcd", "out.pcd", "ratio=2"),
    case(Door::File, "binary.pcd", "out.pcd", "ratio=4&normals=estimate"),
    case(Door::File, "compressed.pcd", "out.pcd", "ratio=7.3"),
    case(Door::File, "ground.las", "out.pcd", "ratio=2.5"),
    // COPC, and a part of a cloud.
    case(Door::File, "ground.las", "out.copc.laz", "ratio=4"),
    case(Door::File, "ring.ply", "out.copc.laz", "ratio=2.5&keep_input=true"),
    case(Door::File, "ground.las", "out.laz", "ratio=2.5&bounds=465000,5204900,465123.25,5205100"),
    // NumPy.
    case(Door::File, "table.npy", "out.npy", "ratio=4"),
    case(Door::File, "columns.npy", "out.npy", "ratio=2.5"),
    case(Door::File, "fields.npy", "out.npy", "ratio=2&source_fields=true"),
    case(Door::File, "fields.npy", "out.pcd", "ratio=4"),
    // Meshes.
    case(Door::File, "grid.off", "out.ply", "ratio=2.5"),
    case(Door::File, "grid.off", "out.ply", "ratio=16"),
    case(Door::File, "ball.obj", "out.ply", "ratio=4"),
    case(Door::File, "ball.obj", "out.npy", "ratio=1.5"),

    case(Door::Pipe, "ground.ply", "-", "ratio=2.5&keep_input=true"),
    case(Door::Pipe, "big-endian.ply", "-", "ratio=4"),
    case(Door::Pipe, "hill.csv", "-", "ratio=4&seed=5"),
    case(Door::Pipe, "ground.las", "-", "ratio=1.5&seed=6"),
    case(Door::Pipe, "kept.laz", "-", "ratio=4"),
    case(Door::Pipe, "kept.e57", "-", "ratio=2"),
    case(Door::Pipe, "compressed.pcd", "-", "ratio=2&source_fields=true"),
    case(Door::Pipe, "fields.npy", "-", "ratio=7.3"),
    case(Door::Pipe, "grid.off", "-", "ratio=4"),

    case(Door::Http, "ring.ply", "-", "ratio=16"),
    case(Door::Http, "hill.ply", "application/vnd.laszip", "ratio=4&keep_input=true"),
    case(Door::Http, "ground.ply", "application/x-pcd", "points=2001&seed=7"),
    case(Door::Http, "ground.las", "application/x-ply", "ratio=2.5&source_fields=true&attributes=intensity:nearest"),
    case(Door::Http, "kept.e57", "application/vnd.las", "ratio=4"),
    case(Door::Http, "binary.pcd", "model/e57", "ratio=2&normals=estimate&sensor=0,0,9"),
    case(Door::Http, "fields.npy", "-", "ratio=4"),
    case(Door::Http, "holes.ply", "application/x-npy", "ratio=2.5"),
    case(Door::Http, "hill.csv", "text/csv", "ratio=1.5"),
    case(Door::Http, "noisy.ply", "text/plain", "ratio=1.5&seed=8"),
    case(Door::Http, "ring.xyz", "-", "spacing=0.08"),
    case(Door::Http, "hill.ply", "-", "density=700"),

    case(Door::Job, "ring.ply", "-", "ratio=7.3&seed=1"),
    case(Door::Job, "ground.las", "application/vnd.laszip", "ratio=4&keep_input=true&source_fields=true"),
    case(Door::Job, "hill.csv", "model/e57", "ratio=2"),
    case(Door::Job, "ball.obj", "-", "points=999"),

    case(Door::Tensor, "ring", "FP32", "ratio=4&seed=7"),
    case(Door::Tensor, "ring", "FP32", "ratio=16"),
    case(Door::Tensor, "ground", "FP64", "ratio=2.5&keep_input=true"),
    case(Door::Tensor, "holes", "FP64", "points=1500"),
    case(Door::Tensor, "hill", "FP32", "spacing=0.04"),

    case(Door::Grpc, "ring", "-", "ratio=4&seed=7"),
    case(Door::Grpc, "hill", "-", "ratio=2.5&source_fields=true&attributes=label:drop"),
    case(Door::Grpc, "ground", "points", "ratio=7.3&keep_input=true"),
    case(Door::Grpc, "holes", "application/x-ply", "ratio=2&normals=estimate&sensor=1,2,3"),
    case(Door::Grpc, "ground.las", "-", "ratio=1.5"),
    case(Door::Grpc, "compressed.pcd", "points", "density=150"),
    case(Door::Grpc, "hill.ply", "text/csv", "points=1801"),

    case(Door::Command, "inspect", "-", "hill.ply&--json"),
    case(Door::Command, "inspect", "-", "ring16.ply&--source&ring.ply"),
    case(Door::Command, "sample", "sampled.ply", "grid.off&sampled.ply&--points&800&--noise&0.01"),
    case(Door::Command, "sample", "-", "shape:stairs&-&--points&500&--method&uniform&--seed&5"),
    case(Door::Command, "evaluate", "-", "--pred&ring16.ply&--reference&ring.ply&--json&-&--quiet"),
    case(Door::Command, "render", "picture.png", "ring16.ply&picture.png&--size&240x200"),
];

#[test]
fn results_are_what_they_were() {
    let names: HashSet<String> = CASES.iter().map(Case::name).collect();
    assert_eq!(names.len(), CASES.len(), "each case has a name of its own");
    let place = Place::new();
    let found: Vec<String> =
        CASES.iter().map(|case| format!("{} {}", case.name(), sha256(&place.make(case)))).collect();
    if std::env::var_os(RENEW).is_some() {
        std::fs::write(RECORDED, found.join("\n") + "\n").expect("it can be written");
        return;
    }
    let recorded = std::fs::read_to_string(RECORDED).unwrap_or_else(|e| panic!("{RECORDED}: {e}"));
    let differ = differences(&recorded.lines().collect::<Vec<_>>(), &found);
    assert!(
        differ.is_empty(),
        "{} of {} results are not what {} has:\n{}\n\
         Only where they are meant to change: {RENEW}=1 cargo test --test program results",
        differ.len(),
        CASES.len(),
        Path::new(RECORDED).display(),
        differ.join("\n")
    );
}

/// What is wrong with each line that is not the recorded one; also with recorded lines that no case has made.
fn differences(recorded: &[&str], found: &[String]) -> Vec<String> {
    let name = |line: &str| line.rsplit_once(' ').map_or(line, |(name, _)| name).to_owned();
    let has = |lines: &[String], wanted: &str| lines.iter().any(|line| name(line) == wanted);
    let recorded: Vec<String> = recorded.iter().map(|line| (*line).to_owned()).collect();
    let wrong = found.iter().filter(|line| !recorded.contains(line)).map(|line| {
        let what = if has(&recorded, &name(line)) { "differs" } else { "is not recorded" };
        format!("{} {what}", name(line))
    });
    let stale = recorded.iter().filter(|line| !has(found, &name(line)));
    let mut all: Vec<String> = wrong.chain(stale.map(|line| format!("{} is no case", name(line)))).collect();
    if all.is_empty() && recorded != found {
        all.push("their order differs, or one is there twice".to_owned());
    }
    all
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}
