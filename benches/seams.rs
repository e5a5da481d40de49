//! Whether the borders of parts are to be found in the result: spacing by the distance from the nearest border.
//!
//! `cargo bench --bench seams -- FILE CELLS RATIO`. Lengths are in the spacing that the result has there: the root of the area
//! of an input point, by its 32 nearest, over the ratio.

use std::sync::Arc;

use densecloud_backends::{Model, OnnxBackend};
use densecloud_cascade::{
    CascadeOptions, LevelRunner, Part, Patchwise, Silent, Survey, Target, Whole, halo, upsample,
    upsample_part,
};
use densecloud_cloud::{Point, Position};
use densecloud_formats::read_cloud_file;
use densecloud_geometry::{KdTree, Partition};

/// Where bands about a border end.
const BANDS: [f64; 5] = [1.0, 2.0, 4.0, 8.0, f64::INFINITY];
/// Points of the sample that tells how dense the whole is.
const SAMPLE: usize = 60_000;
/// Points of a place that is surveyed, and how many there are of these at most.
const PLACE: usize = 6000;
const PLACES: usize = 6;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let [file, cells, ratio] = arguments.as_slice() else {
        println!("cargo bench --bench seams -- FILE CELLS RATIO");
        return;
    };
    let (cells, ratio) = (cells.parse().expect("a number"), ratio.parse().expect("a number"));
    let cloud = read_cloud_file(file.as_ref()).expect("a cloud").0.positions;
    let cloud: Vec<Position> = cloud.into_iter().filter(|p| p.iter().all(|c| c.is_finite())).collect();
    let partition = Partition::cut(cloud.clone(), cells);
    let runner = Patchwise::new(Arc::new(
        OnnxBackend::new(Arc::new(Model::embedded().expect("a model"))).expect("a runtime"),
    ));
    let whole = upsample(&cloud, Target::Ratio(ratio), &CascadeOptions::default(), &runner, &Silent);
    let parts = in_parts(&cloud, &partition, ratio, &runner);
    println!("| result | from the border | points | to the nearest | to the 8th |\n|---|---|---|---|---|");
    for (name, points) in [("whole", whole.expect("a result").positions), ("in parts", parts)] {
        tell(name, &points, &cloud, &partition, ratio);
    }
}

/// Offsets from the first point in 32 bits, for a tree.
fn local(points: &[Position], from: Position) -> Vec<Point> {
    points.iter().map(|p| std::array::from_fn(|a| (p[a] - from[a]) as f32)).collect()
}

/// The root of the area about each of `points` that one of the tree's `k` nearest has.
fn spacing(points: &[Point], tree: &KdTree, k: usize) -> Vec<f64> {
    let mut found = Vec::new();
    let of = |p: &Point| {
        tree.nearest(*p, k, &mut found);
        let reach = found.last().map_or(0.0, |n| f64::from(n.distance_squared));
        (std::f64::consts::PI * reach / k as f64).sqrt()
    };
    points.iter().map(of).collect()
}

fn in_parts(
    cloud: &[Position],
    partition: &Partition,
    ratio: f64,
    runner: &dyn LevelRunner,
) -> Vec<Position> {
    let options = CascadeOptions::default();
    let sample: Vec<Position> = cloud.iter().step_by((cloud.len() / SAMPLE).max(1)).copied().collect();
    let fine = Partition::cut(cloud.to_vec(), cloud.len().div_ceil(PLACE));
    let chosen = |p: &&Position| (fine.cell_of(**p) as usize * PLACES) % fine.len() < PLACES;
    let places: Vec<Position> = cloud.iter().filter(chosen).copied().collect();
    let of = |a: usize, f: fn(f64, f64) -> f64| cloud.iter().map(|p| p[a]).reduce(f).expect("points");
    let bounds = [f64::min, f64::max].map(|f| std::array::from_fn(|a| of(a, f)));
    let finite = cloud.len() as u64;
    let survey = Survey { bounds, finite, sample: &sample, places: &places, ratio };
    let whole = Whole::survey(&survey, &options, runner, &Silent).expect("a survey");
    let thin = (sample.len() as f64 / cloud.len() as f64).sqrt();
    let tree = KdTree::new(&local(&sample, bounds[0]));
    let reach = spacing(&local(cloud, bounds[0]), &tree, 16).into_iter().map(|s| halo(&whole) * s * thin);
    let reach: Vec<f64> = reach.collect();
    let part = |cell: u32| {
        let near = |(p, reach): &(&Position, &f64)| partition.distance(cell, **p) <= **reach;
        let positions: Vec<Position> = cloud.iter().zip(&reach).filter(near).map(|(p, _)| *p).collect();
        let own = cloud.iter().filter(|p| partition.cell_of(**p) == cell).count();
        let size = (ratio * own as f64).round() as u64;
        let part = Part { positions: &positions, partition, cell, whole: &whole, size };
        upsample_part(&part, &options, runner, &Silent).expect("a result").positions
    };
    (0..partition.len() as u32).flat_map(part).collect()
}

fn tell(name: &str, points: &[Position], cloud: &[Position], partition: &Partition, ratio: f64) {
    let from = cloud[0];
    let at = local(points, from);
    let usual = spacing(&at, &KdTree::new(&local(cloud, from)), 32);
    let tree = KdTree::new(&at);
    let mut bands: Vec<[Vec<f64>; 2]> = vec![Default::default(); BANDS.len()];
    let mut found = Vec::new();
    for ((p, at), usual) in points.iter().zip(&at).zip(usual) {
        let usual = usual / ratio.sqrt();
        let border = partition.border_distance(*p) / usual;
        let band = BANDS.iter().position(|end| border < *end).unwrap_or(BANDS.len() - 1);
        tree.nearest(*at, 9, &mut found);
        for (lengths, k) in bands[band].iter_mut().zip([1, 8]) {
            lengths.push(f64::from(found[k].distance_squared.sqrt()) / usual);
        }
    }
    for (lengths, end) in bands.iter().zip(BANDS) {
        let [nearest, eighth] = lengths.each_ref().map(|lengths| spread(lengths));
        println!("| {name} | up to {end} | {} | {nearest} | {eighth} |", lengths[0].len());
    }
}

/// Mean and deviation.
fn spread(of: &[f64]) -> String {
    let count = of.len().max(1) as f64;
    let mean = of.iter().sum::<f64>() / count;
    let variance = of.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count;
    format!("{mean:.3} +- {:.3}", variance.sqrt())
}
