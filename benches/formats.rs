//! Reading and writing a million points in memory: `cargo bench --bench formats [-- RUNS]`, by default 5.
//!
//! Prints the median, the extremes, and the points a second of the median.

use std::hint::black_box;
use std::time::Instant;

use densecloud_cloud::Origin;
use densecloud_formats::{CloudReader, Format, Limits, PlyEncoding, Scalar, encode};
use densecloud_geometry::{shape, uniform};

const POINTS: usize = 1_000_000;

fn main() {
    let runs = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(5);
    let mesh = shape("knot").expect("a built-in shape");
    let positions = uniform(&mesh, POINTS, 1).expect("points");
    let ply = |encoding, scalar| Format::Ply { encoding, scalar };
    for (name, format) in [
        ("PLY, binary, float", ply(PlyEncoding::BinaryLittleEndian, Scalar::F32)),
        ("PLY, binary, double", ply(PlyEncoding::BinaryLittleEndian, Scalar::F64)),
        ("PLY, ascii", ply(PlyEncoding::Ascii, Scalar::F64)),
        ("XYZ", Format::TEXT),
        ("LAS", Format::Las { compressed: false }),
        ("LAZ", Format::Las { compressed: true }),
    ] {
        let write = || encode(Vec::new(), format, &positions, &[], &Origin::default()).expect("a file");
        let bytes = write();
        time(&format!("write {name}"), runs, || write().len());
        time(&format!("read {name}"), runs, || {
            let reader = CloudReader::open(&bytes[..], Limits::default()).expect("a header");
            reader.read().expect("points").positions.len()
        });
    }
}

fn time(name: &str, runs: usize, mut work: impl FnMut() -> usize) {
    let mut seconds: Vec<f64> = (0..=runs)
        .map(|_| {
            let start = Instant::now();
            black_box(work());
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
        POINTS as f64 / median / 1e6
    );
}
