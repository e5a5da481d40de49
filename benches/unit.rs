//! Milliseconds of a unit for a patch, and the share of the processor's peak that it reaches.
//!
//! `cargo bench --bench unit -- [RUNS] [MODEL]`, by default 200 runs of the model inside the program; one thread. The
//! peak is what ONNX Runtime's own product of two 1024 x 1024 matrices reaches between the runs. Multiplications and
//! additions are counted by the formula below: the matrix products of the unit and nothing else.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use densecloud_backends::{Model, OnnxBackend};
use densecloud_cascade::{Backend, Batch, Output, SKIP_NEIGHBOURS, SkipInput};
use densecloud_geometry::{poisson_disk, shape};
use half::f16;
use ort::editor::{Graph, Node, ONNX_DOMAIN, Opset};
use ort::environment::Environment;
use ort::session::Session;
use ort::value::{Outlet, Shape, SymbolicDimensions, Tensor, TensorElementType, ValueType};

fn main() {
    let arguments = || std::env::args().skip(1);
    let runs = arguments().find_map(|a| a.parse().ok()).unwrap_or(200);
    let folder = arguments().map(PathBuf::from).find(|path| path.is_dir());
    let model = folder.map_or_else(Model::embedded, |folder| Model::load(&folder)).expect("a model");
    let backend = OnnxBackend::new(Arc::new(model)).expect("ONNX Runtime");
    let (n, k, c) = {
        let shape = backend.shape();
        (shape.patch_size, shape.neighbours, shape.channels)
    };
    // A patch of a surface, as the cascade would cut it.
    let cloud = poisson_disk(&shape("knot").expect("a built-in shape"), 8 * n, 0).expect("samples of it");
    let mut patch = cloud.clone();
    let distance = |p: &[f64; 3]| (0..3).map(|a| (p[a] - cloud[0][a]).powi(2)).sum::<f64>();
    patch.sort_by(|p, q| distance(p).total_cmp(&distance(q)));
    let radius = distance(&patch[n - 1]).sqrt();
    let points: Vec<f32> =
        patch[..n].iter().flat_map(|p| (0..3).map(|a| ((p[a] - cloud[0][a]) / radius) as f32)).collect();
    let features: Vec<f16> = (0..n * c).map(|i| f16::from_f32((i % 17) as f32 / 17.0 - 0.5)).collect();
    let indices: Vec<i64> = (0..n * SKIP_NEIGHBOURS).map(|i| ((i * 31) % n) as i64).collect();
    let distances: Vec<f32> = (0..n * SKIP_NEIGHBOURS).map(|i| (1 + i % 5) as f32).collect();
    let skip = SkipInput { features: &features, indices: &indices, distances: &distances };

    let mut session = backend.open().expect("sessions");
    let mut product = product(backend.environment(), 1024);
    let mut output = Output::default();
    let mut times = vec![Vec::new(); backend.units() + 1];
    for _ in 0..runs {
        for (unit, times) in times[..backend.units()].iter_mut().enumerate() {
            let batch = Batch {
                patches: 1,
                patch_points: n,
                points: &points,
                skip: (unit > 0).then_some(skip),
                want_features: unit + 1 < backend.units(),
            };
            let start = Instant::now();
            session.run(unit, &batch, &mut output).expect("a run");
            times.push(start.elapsed().as_secs_f64());
        }
        if times[0].len() % 10 == 0 {
            let start = Instant::now();
            product();
            times[backend.units()].push(start.elapsed().as_secs_f64());
        }
    }
    for times in &mut times {
        times.sort_by(f64::total_cmp);
    }
    let median = |times: &[f64]| times[times.len() / 2];
    let peak = 2.0 * 1024f64.powi(3) / median(&times[backend.units()]);
    let operations = operations(n, k, c);
    println!(
        "patch of {n} points, {k} neighbours: {:.1} million operations in matrix products",
        operations / 1e6
    );
    println!("product of 1024 x 1024 matrices: {:.1} billion operations a second", peak / 1e9);
    for (unit, times) in times[..backend.units()].iter().enumerate() {
        println!(
            "unit {}: {:.2} ms ({:.2} to {:.2} for nine in ten runs), {:.0} % of that",
            unit + 1,
            1e3 * median(times),
            1e3 * times[times.len() / 20],
            1e3 * times[times.len() * 19 / 20],
            100.0 * operations / median(times) / peak
        );
    }
}

/// Multiplications and additions of all linear maps on a patch, each counted where the fast form computes it.
fn operations(n: usize, k: usize, c: usize) -> f64 {
    let (block, growth) = (24, 12);
    let edges = k * (growth * 2 * growth + growth * growth);
    let points = 4 * block * 4 * growth;
    let squeezes = block * ((block + 60) + (block + 120) + (block + 180));
    let expansion = c * 128 + 2 * (128 * 128 + 128 * 64 + 64 * 3);
    2.0 * (n * (3 * block + 4 * edges + points + squeezes + expansion)) as f64
}

/// A product of two matrices in ONNX Runtime, on one thread.
fn product(environment: &Environment, size: usize) -> impl FnMut() + use<> {
    let side = size as i64;
    let matrix = |name: &str| {
        let kind = ValueType::Tensor {
            ty: TensorElementType::Float32,
            shape: Shape::new([side, side]),
            dimension_symbols: SymbolicDimensions::empty(2),
        };
        Outlet::new(name, kind)
    };
    let mut graph = Graph::new().expect("a graph");
    graph.set_inputs([matrix("a"), matrix("b")]).expect("inputs");
    graph.set_outputs([matrix("c")]).expect("outputs");
    graph
        .add_node(Node::new("MatMul", ONNX_DOMAIN, "product", ["a", "b"], ["c"], []).expect("a node"))
        .expect("a node");
    let mut model = ort::editor::Model::new([Opset::new(ONNX_DOMAIN, 17).expect("a set")]).expect("a model");
    model.set_graph(graph).expect("a whole graph");
    let options = Session::builder(environment).expect("options").with_intra_threads(1).expect("one thread");
    let mut session = model.into_session(&options).expect("a session");
    let full = Tensor::from_array(([size, size], vec![0.5_f32; size * size])).expect("a matrix");
    move || {
        session.run(ort::inputs![&full, &full]).expect("a product");
    }
}
