//! Reading and writing a million points in memory: `cargo bench --bench formats [-- RUNS]`, by default 5. With the name of a
//! file, `[-- RUNS FILE]`, that one: read, and written as LAZ and COPC; `RAYON_NUM_THREADS` says on how many threads.
//!
//! Prints the median, the extremes, and the points a second of the median.

use std::fmt::Write as _;
use std::hint::black_box;
use std::io;
use std::path::Path;
use std::time::Instant;

use densecloud_cloud::{Attribute, Origin, Position, Values};
use densecloud_formats::{
    CloudReader, Decimal, Format, Limits, PlyEncoding, Scalar, Separator, encode, read_cloud_file,
};
use densecloud_geometry::{shape, uniform};

const POINTS: usize = 1_000_000;

fn main() {
    let runs = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(5);
    if let Some(path) = std::env::args().skip(1).find(|a| !a.starts_with("--") && a.parse::<usize>().is_err())
    {
        return time_file(Path::new(&path), runs);
    }
    let mesh = shape("knot").expect("a built-in shape");
    let positions = uniform(&mesh, POINTS, 1).expect("points");
    let ply = |encoding, scalar| Format::Ply { encoding, scalar };
    let columns = |separator| Format::Xyz { names: true, separator, decimal: Decimal::Point };
    let (bare, colours) = (Vec::new(), colours());
    for (name, format, attributes) in [
        ("PLY, binary, float", ply(PlyEncoding::BinaryLittleEndian, Scalar::F32), &bare),
        ("PLY, binary, double", ply(PlyEncoding::BinaryLittleEndian, Scalar::F64), &bare),
        ("PLY, ascii", ply(PlyEncoding::Ascii, Scalar::F64), &bare),
        ("XYZ", Format::TEXT, &bare),
        ("XYZ, names, colours", columns(Separator::Space), &colours),
        ("CSV, names, colours", columns(Separator::Comma), &colours),
        ("LAS", Format::Las { compressed: false }, &bare),
        ("LAZ", Format::Las { compressed: true }, &bare),
        ("LAS, colours", Format::Las { compressed: false }, &colours),
        ("LAZ, colours", Format::Las { compressed: true }, &colours),
    ] {
        let write =
            || encode(Vec::new(), format, &positions, attributes, &Origin::default()).expect("a file");
        let bytes = write();
        time(&format!("write {name}"), runs, || {
            write();
            POINTS
        });
        time_reading(name, runs, &bytes);
    }
    time_reading("PTS, three decimals", runs, pts(&positions).as_bytes());
}

/// Reads a file, and writes what it holds as LAZ and COPC.
fn time_file(path: &Path, runs: usize) {
    let read = || read_cloud_file(path).expect("a cloud").0;
    time("read", runs, || read().positions.len());
    let cloud = read();
    for (name, format) in [("LAZ", Format::Las { compressed: true }), ("COPC", Format::Copc)] {
        let write = || encode(io::sink(), format, &cloud.positions, &cloud.attributes, &cloud.origin);
        time(&format!("write {name}"), runs, || {
            write().expect("a file");
            cloud.positions.len()
        });
    }
}

fn colours() -> Vec<Attribute> {
    let part = |(shift, name): (usize, &str)| Attribute {
        name: name.to_owned(),
        values: Values::U8((0..POINTS).map(|i| (i >> shift) as u8).collect()),
    };
    ["red", "green", "blue"].into_iter().enumerate().map(part).collect()
}

/// As scanners write it: a count, then positions, an intensity and a colour. No number tells that its points begin fractions
/// and part no thousands, so that each is looked at.
fn pts(positions: &[Position]) -> String {
    let mut text = format!("{POINTS}\n");
    for (i, position) in positions.iter().enumerate() {
        let [x, y, z] = position.map(|c| 500.0 + 100.0 * c);
        let (intensity, red) = (i % 4096, i % 256);
        writeln!(text, "{x:.3} {y:.3} {z:.3} {intensity} {red} 0 255").expect("memory");
    }
    text
}

fn time_reading(name: &str, runs: usize, bytes: &[u8]) {
    time(&format!("read {name}"), runs, || {
        let reader = CloudReader::open(bytes, Limits::default()).expect("a header");
        reader.read().expect("points").positions.len()
    });
}

fn time(name: &str, runs: usize, mut work: impl FnMut() -> usize) {
    let mut points = 0;
    let mut seconds: Vec<f64> = (0..=runs)
        .map(|_| {
            let start = Instant::now();
            points = black_box(work());
            start.elapsed().as_secs_f64()
        })
        .skip(1)
        .collect();
    seconds.sort_by(f64::total_cmp);
    let median = seconds[runs / 2];
    println!(
        "{name:<26} {:7.0} ms ({:.0} to {:.0}), {:5.1} million points a second",
        1e3 * median,
        1e3 * seconds[0],
        1e3 * seconds[runs - 1],
        points as f64 / median / 1e6
    );
}
