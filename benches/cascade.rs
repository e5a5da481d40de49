//! Seconds of each stage of a whole cascade, and of one level alone.
//!
//! `cargo bench --bench cascade [-- POINTS RATIO [THREADS] [RUNS] [MODEL]]`; without POINTS one level and four sizes,
//! by default on 2 threads, 5 runs each, with the model inside the program.

use std::sync::Arc;
use std::time::Instant;

use densecloud::Request;
use densecloud::attributes::Finish;
use densecloud_backends::{Model, OnnxBackend};
use densecloud_cascade::{CascadeOptions, Stage, Target};
use densecloud_engine::{Engine, EngineConfig, StageTimes};
use densecloud_geometry::{poisson_disk, shape};

/// Points in, ratio, and whether the last level is polished.
const SIZES: [(usize, f64, bool); 5] =
    [(5000, 2.0, false), (2048, 16.0, true), (5000, 16.0, true), (20_000, 4.0, true), (100_000, 4.0, true)];

fn main() {
    // Cargo adds `--bench`.
    let numbers: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let number = |i: usize, default: f64| numbers.get(i).copied().unwrap_or(default);
    let one = [(number(0, 0.0) as usize, number(1, 16.0), true)];
    let sizes = if numbers.is_empty() { &SIZES[..] } else { &one[..] };
    let (threads, runs) = (number(2, 2.0) as usize, number(3, 5.0) as usize);

    let folder = std::env::args().skip(1).map(std::path::PathBuf::from).find(|path| path.is_dir());
    let model = folder.map_or_else(Model::embedded, |folder| Model::load(&folder));
    let model = Arc::new(model.expect("a model"));
    let config = EngineConfig { threads, concurrency: 1, queue_points: u64::MAX, ..EngineConfig::default() };
    let start = Instant::now();
    let engine = Engine::with_backend(Arc::new(OnnxBackend::new(model).expect("a runtime")), config)
        .expect("an engine");
    println!("{threads} threads; open the model: {:.3} s", start.elapsed().as_secs_f64());
    for &(points, ratio, polish) in sizes {
        measure(&engine, points, ratio, polish, runs);
    }
}

fn measure(engine: &Engine, points: usize, ratio: f64, polish: bool, runs: usize) {
    let mesh = shape("knot").expect("a built-in shape");
    let positions = poisson_disk(&mesh, points, 0).expect("samples of it");
    let mut seconds = Vec::new();
    let mut stages: Vec<StageTimes> = Vec::new();
    for _ in 0..=runs {
        let settings = CascadeOptions { polish, ..CascadeOptions::default() };
        let request =
            Request::new(positions.clone().into(), Target::Ratio(ratio), settings, Finish::default());
        let start = Instant::now();
        let outcome = engine.submit(request).expect("admitted").wait().expect("a dense cloud");
        seconds.push(start.elapsed().as_secs_f64());
        stages.push(outcome.stages);
    }
    // The first run warms up.
    seconds.remove(0);
    stages.remove(0);

    let what = if polish { "" } else { ", no polish" };
    println!("\n{points} points, ratio {ratio}{what}, {runs} runs; seconds: median (min to max)");
    print("whole", &mut seconds);
    println!("{:<15} {:.0}", "points out / s", points as f64 * ratio / seconds[seconds.len() / 2]);
    for (i, stage) in Stage::ALL.into_iter().enumerate() {
        let of = |times: &StageTimes| times.iter().nth(i).map_or(0.0, |(_, time)| time.as_secs_f64());
        print(stage.name(), &mut stages.iter().map(of).collect::<Vec<_>>());
    }
}

fn print(name: &str, seconds: &mut [f64]) {
    seconds.sort_by(f64::total_cmp);
    let (min, max) = (seconds[0], seconds[seconds.len() - 1]);
    println!("{name:<15} {:.3} ({min:.3} to {max:.3})", seconds[seconds.len() / 2]);
}
