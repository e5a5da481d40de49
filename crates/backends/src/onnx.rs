//! ONNX Runtime: one session a unit and a worker thread, one thread inside each.

use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError};

use ort::environment::Environment;
use ort::session::builder::GraphOptimizationLevel;
use ort::session::{
    HasSelectedOutputs, OutputSelector, RunOptions, Session as OrtSession, SessionInputValue,
};
use ort::value::TensorRef;

use super::{
    Backend, BackendError, Batch, Demand, Model, Output, SKIP_NEIGHBOURS, Session, UnitShape, library,
    operators,
};

/// Bytes that a cascade takes however small it is.
const BYTES: u64 = 1 << 20;
/// Bytes that a cascade takes at its height for each point of its last level before that is sampled: merged points, trees
/// and tables. The skip features of the level before come on top, two bytes a channel for each of half as many points.
/// Measured in all: 250 to 310 with the shipped model's 264 channels (`BENCHMARKS.md`, "Many points"); with reserve.
const GEOMETRY_BYTES_A_POINT: u64 = 120;

/// A model on ONNX Runtime's CPU provider.
#[derive(Debug)]
pub struct OnnxBackend {
    environment: Environment,
    model: Arc<Model>,
}

impl OnnxBackend {
    /// Loads the runtime's library; the model's graphs are built by [`Backend::open`].
    ///
    /// # Errors
    /// [`BackendError::Library`] when ONNX Runtime cannot be loaded.
    pub fn new(model: Arc<Model>) -> Result<Self, BackendError> {
        Ok(Self { environment: library::environment()?, model })
    }

    /// ONNX Runtime's environment, for other graphs in this process: it allows no second one.
    #[must_use]
    pub fn environment(&self) -> &Environment {
        &self.environment
    }
}

impl Backend for OnnxBackend {
    fn shape(&self) -> UnitShape {
        self.model.shape()
    }

    fn units(&self) -> usize {
        self.model.units.len()
    }

    fn provider(&self) -> &str {
        "cpu"
    }

    fn demand(&self) -> Demand {
        Demand { fixed: BYTES, a_point: GEOMETRY_BYTES_A_POINT + self.model.card.channels as u64 }
    }

    fn open(&self) -> Result<Box<dyn Session>, BackendError> {
        let mut units = Vec::new();
        for (file, bytes) in self.model.card.units.iter().zip(&self.model.units) {
            let session = build(&self.environment, bytes).map_err(|why| BackendError::Model {
                model: self.model.card.name.clone(),
                why: format!("{}: {why}", file.file),
            })?;
            units.push(session);
        }
        let options = |features| -> ort::Result<_> {
            let outputs = OutputSelector::no_default().with("dense");
            let outputs = if features { outputs.with("features") } else { outputs };
            Ok(RunOptions::new()?.with_outputs(outputs))
        };
        let fail = |e: ort::Error| BackendError::Start { why: e.to_string() };
        Ok(Box::new(OnnxSession {
            shape: self.shape(),
            units,
            dense_only: options(false).map_err(fail)?,
            with_features: options(true).map_err(fail)?,
        }))
    }
}

fn build(environment: &Environment, bytes: &[u8]) -> ort::Result<OrtSession> {
    // Two at once make ONNX Runtime register the operators' domain twice, which it refuses.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    // The memory pattern planner keeps a plan for every shape it meets; batches differ in the
    // number of skip features, so it would only grow.
    OrtSession::builder(environment)?
        .with_intra_threads(1)?
        .with_memory_pattern(false)?
        .with_operators(operators::domain()?)?
        .with_optimization_level(GraphOptimizationLevel::All)?
        .commit_from_memory(bytes)
}

struct OnnxSession {
    shape: UnitShape,
    units: Vec<OrtSession>,
    dense_only: RunOptions<HasSelectedOutputs>,
    with_features: RunOptions<HasSelectedOutputs>,
}

impl Session for OnnxSession {
    fn run(&mut self, unit: usize, batch: &Batch<'_>, output: &mut Output) -> Result<(), BackendError> {
        self.run_unit(unit, batch, output)
            .map_err(|e| BackendError::Run { unit: unit + 1, why: e.to_string() })
    }
}

impl OnnxSession {
    fn run_unit(&mut self, unit: usize, batch: &Batch<'_>, output: &mut Output) -> ort::Result<()> {
        let (b, n) = (batch.patches, batch.patch_points);
        let mut inputs: Vec<(Cow<'_, str>, SessionInputValue<'_>)> =
            vec![("points".into(), TensorRef::from_array_view(([b, n, 3], batch.points))?.into())];
        if let Some(skip) = &batch.skip {
            let rows = skip.features.len() / self.shape.channels;
            inputs.push((
                "previous_features".into(),
                TensorRef::from_array_view(([rows, self.shape.channels], skip.features))?.into(),
            ));
            let of_each = [b, n, SKIP_NEIGHBOURS];
            inputs.push(("skip_indices".into(), TensorRef::from_array_view((of_each, skip.indices))?.into()));
            inputs.push((
                "skip_distances".into(),
                TensorRef::from_array_view((of_each, skip.distances))?.into(),
            ));
        }
        let options = if batch.want_features { &self.with_features } else { &self.dense_only };
        let outputs = self.units[unit].run_with_options(inputs, options)?;
        output.dense.clear();
        output.dense.extend_from_slice(outputs["dense"].try_extract_tensor::<f32>()?.1);
        output.features.clear();
        if batch.want_features {
            output.features.extend_from_slice(outputs["features"].try_extract_tensor::<f32>()?.1);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::UnitFile;
    use densecloud_cascade::SkipInput;
    use densecloud_geometry::Rng;
    use half::f16;

    /// The same graphs with their operators in a domain that nobody registers, so that only the functions
    /// in the file are left. (Within a process ONNX Runtime keeps what was registered once.)
    fn without_kernels(mut model: Model) -> Model {
        for bytes in &mut model.units {
            let (domain, other) = (b"densecloud", b"standalone");
            let mut at = 0;
            while let Some(found) = bytes[at..].windows(domain.len()).position(|window| window == domain) {
                at += found;
                bytes.to_mut()[at..at + domain.len()].copy_from_slice(other);
            }
            assert!(at > 0, "the graph has no operators of ours");
        }
        model
    }

    /// Output of a unit on random points.
    fn run(model: Model, unit: usize, points: usize) -> Output {
        let (backend, model) = {
            let model = Arc::new(model);
            (OnnxBackend::new(Arc::clone(&model)).unwrap(), model)
        };
        let mut session = backend.open().unwrap();
        let mut random = Rng::new(7);
        let mut numbers = |n: usize| -> Vec<f32> { (0..n).map(|_| random.f64() as f32 - 0.5).collect() };
        let cloud = numbers(points * 3);
        let features: Vec<f16> = numbers(200 * model.card.channels).into_iter().map(f16::from_f32).collect();
        let distances: Vec<f32> = numbers(points * SKIP_NEIGHBOURS).iter().map(|d| 1.0 + d).collect();
        let indices: Vec<i64> = (0..points * SKIP_NEIGHBOURS).map(|i| (i * 37 % 200) as i64).collect();
        let skip = SkipInput { features: &features, indices: &indices, distances: &distances };
        let batch = Batch {
            patches: 1,
            patch_points: points,
            points: &cloud,
            skip: (unit > 0).then_some(skip),
            want_features: true,
        };
        let mut output = Output::default();
        session.run(unit, &batch, &mut output).unwrap();
        output
    }

    #[test]
    fn our_kernels_agree_with_the_functions_in_the_file() {
        let model = Model::embedded().unwrap();
        for unit in 0..model.units.len() {
            for points in [model.card.patch_size, model.card.neighbours + 1] {
                let ours = run(model.clone(), unit, points);
                let plain = run(without_kernels(model.clone()), unit, points);
                for (ours, plain) in [(&ours.dense, &plain.dense), (&ours.features, &plain.features)] {
                    assert_eq!(ours.len(), plain.len());
                    let worst = ours.iter().zip(plain).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                    assert!(worst < 1e-4, "{worst} at unit {}, {points} points", unit + 1);
                }
            }
        }
    }

    /// What our kernels refuse, in their own words: so it is they that run, not the functions in the file.
    #[test]
    fn our_kernels_are_the_ones_that_run() {
        let model = Arc::new(Model::embedded().unwrap());
        let (n, c) = (model.card.patch_size, model.card.channels);
        let mut session = OnnxBackend::new(Arc::clone(&model)).unwrap().open().unwrap();
        let (points, features) = (vec![0.5; n * 3], vec![f16::ONE; 7 * c]);
        let (indices, distances) = (vec![7; n * SKIP_NEIGHBOURS], vec![1.0; n * SKIP_NEIGHBOURS]);
        let skip = SkipInput { features: &features, indices: &indices, distances: &distances };
        let mut refused = |points: &[f32], skip| {
            let patch_points = points.len() / 3;
            let batch = Batch { patches: 1, patch_points, points, skip: Some(skip), want_features: false };
            session.run(1, &batch, &mut Output::default()).unwrap_err().to_string()
        };
        let row = refused(&points, skip);
        assert!(row.contains("an index of BilateralSkip names no row"), "{row}");
        let few =
            refused(&points[..9], SkipInput { indices: &indices[..15], distances: &distances[..15], ..skip });
        assert!(few.contains("3 rows have no 16 others each"), "{few}");
    }

    #[test]
    fn the_shipped_model_takes_what_was_measured() {
        let model = Arc::new(Model::embedded().unwrap());
        assert_eq!(OnnxBackend::new(model).unwrap().demand(), Demand::default());
    }

    #[test]
    fn a_file_that_is_no_graph_is_refused_by_name() {
        let mut model = Model::embedded().unwrap();
        model.units[1] = Cow::Borrowed(b"no graph");
        model.card.units[1] = UnitFile { file: "second.onnx".into(), sha256: String::new() };
        let refused = OnnxBackend::new(Arc::new(model)).unwrap().open().err().unwrap().to_string();
        assert!(refused.contains("second.onnx"), "{refused}");
    }
}
