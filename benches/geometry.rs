//! Times of the geometry that every cloud goes through: `cargo bench --bench geometry [-- RUNS WORD ...]`.
//!
//! Prints the median and the extremes of some runs, on one thread, for points on a surface; only
//! of measurements whose names hold all the words, where there are words. Kiddo
//! is there to compare with; our tree is queried in its own order, kiddo in the same.

use std::hint::black_box;
use std::num::NonZero;
use std::time::Instant;

use densecloud_cloud::Point;
use densecloud_geometry::{
    KdTree, SurfaceDistance, estimate_normals, farthest_point_sampling, poisson_disk, shape, uniform,
};
use kiddo::{ImmutableKdTree, SquaredEuclidean};

fn main() {
    let runs = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(5);
    let mesh = shape("knot").expect("a built-in shape");
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let points: Vec<Point> =
        uniform(&mesh, 240_000, 1).expect("points").iter().map(|p| p.map(|c| c as f32)).collect();
    let few = &points[..100_000];

    time("farthest point sampling, 240,000 -> 80,000", runs, || {
        farthest_point_sampling(&points, 80_000, 0).len()
    });
    time("farthest point sampling, 100,000 -> 25,000", runs, || {
        farthest_point_sampling(few, 25_000, 0).len()
    });
    time("farthest point sampling, 100,000 -> 1,000", runs, || farthest_point_sampling(few, 1_000, 0).len());

    time("k-d tree, 240,000 points: build", runs, || KdTree::new(&points).len());
    let tree = KdTree::new(&points);
    let build = || ImmutableKdTree::<f32, 3>::new_from_slice(&points).expect("a tree");
    time("kiddo, 240,000 points: build", runs, || build().size());
    let kiddo = build();
    for k in [1, 5, 32, 312] {
        // The same number of neighbours for each k keeps the times alike.
        let queries = &tree.order()[..(2_400_000 / k).min(points.len())];
        let mut out = Vec::new();
        time(&format!("k-d tree, {} queries, k = {k}", queries.len()), runs, || {
            let mut found = 0;
            for &i in queries {
                tree.nearest(points[i as usize], k, &mut out);
                found += out.len();
            }
            found
        });
        let count = NonZero::new(k).expect("k above zero");
        time(&format!("kiddo, {} queries, k = {k}", queries.len()), runs, || {
            let nearest = |&i: &u32| {
                kiddo.query(&points[i as usize]).nearest_n::<SquaredEuclidean<f32>>(count).execute().len()
            };
            queries.iter().map(nearest).sum::<usize>()
        });
    }

    time("normals of 100,000 points, k = 16, one thread", runs, || {
        one.install(|| estimate_normals(few, 16).len())
    });
    let dense = uniform(&mesh, 100_000, 2).expect("points");
    let surface = SurfaceDistance::new(&mesh);
    time("distance of 100,000 points to 38,400 triangles", runs, || {
        dense.iter().filter(|&&p| surface.distance(p) < 1e-9).count()
    });
    time("Poisson-disk sampling, 80,000 points", runs.min(3), || {
        poisson_disk(&mesh, 80_000, 1).expect("points").len()
    });
}

fn time<T>(what: &str, runs: usize, mut work: impl FnMut() -> T) {
    if !std::env::args()
        .skip(1)
        .filter(|a| !a.starts_with('-') && a.parse::<usize>().is_err())
        .all(|a| what.contains(&a))
    {
        return;
    }
    let mut times: Vec<(f64, f64)> = (0..runs.max(1))
        .map(|_| {
            let (start, cpu) = (Instant::now(), cpu_seconds());
            black_box(work());
            (start.elapsed().as_secs_f64() * 1e3, (cpu_seconds() - cpu) * 1e3)
        })
        .collect();
    times.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (wall, least, most) = (times[times.len() / 2].0, times[0].0, times[times.len() - 1].0);
    times.sort_by(|a, b| a.1.total_cmp(&b.1));
    let cpu = times[times.len() / 2].1;
    println!("{what:<50} {wall:8.1} ms  ({least:.1} to {most:.1}), {cpu:8.1} ms of processor");
}

/// Processor time of all threads so far, which a busy machine does not change much; 0 where the
/// system does not tell.
fn cpu_seconds() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let nanoseconds = tasks.filter_map(|task| {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok()
    });
    nanoseconds.sum::<f64>() / 1e9
}
