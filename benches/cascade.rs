//! Seconds of each stage of a whole cascade.
//!
//! `cargo bench --bench cascade -- [POINTS] [RATIO] [THREADS] [RUNS] [MODEL]`, by default 5000 16 2 5
//! and the model inside the program.

use std::sync::Arc;
use std::time::Instant;

use densecloud::backend::Model;
use densecloud::cascade::{Settings, Stage, Target};
use densecloud::engine::{Engine, EngineConfig, Request, StageTimes};
use densecloud::geometry::{poisson_disk, shape};

fn main() {
    // Cargo adds `--bench`.
    let numbers: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let number = |i: usize, default: f64| numbers.get(i).copied().unwrap_or(default);
    let (points, ratio) = (number(0, 5000.0) as usize, number(1, 16.0));
    let (threads, runs) = (number(2, 2.0) as usize, number(3, 5.0) as usize);

    let mesh = shape("knot").expect("a built-in shape");
    let positions = poisson_disk(&mesh, points, 0).expect("samples of it");
    let folder = std::env::args().skip(1).map(std::path::PathBuf::from).find(|path| path.is_dir());
    let model = folder.map_or_else(Model::embedded, |folder| Model::load(&folder));
    let model = Arc::new(model.expect("a model"));
    let config = EngineConfig { threads, concurrency: 1, queue_points: u64::MAX };
    let start = Instant::now();
    let engine = Engine::new(model, config).expect("an engine");
    let opened = start.elapsed();
    let mut seconds = Vec::new();
    let mut stages: Vec<StageTimes> = Vec::new();
    for _ in 0..=runs {
        let request = Request {
            positions: positions.clone(),
            target: Target::Ratio(ratio),
            settings: Settings::default(),
        };
        let start = Instant::now();
        let outcome = engine.submit(request).expect("admitted").wait().expect("a dense cloud");
        seconds.push(start.elapsed().as_secs_f64());
        stages.push(outcome.stages);
    }
    // The first run warms up.
    seconds.remove(0);
    stages.remove(0);

    println!("{points} points, ratio {ratio}, {threads} threads, {runs} runs; seconds: median (min to max)");
    println!("open the model  {:.3}", opened.as_secs_f64());
    print("whole", &mut seconds);
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
