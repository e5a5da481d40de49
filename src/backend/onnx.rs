//! ONNX Runtime: one session a unit and a worker thread, one thread inside each.

use std::borrow::Cow;
use std::sync::Arc;

use ort::environment::Environment;
use ort::session::builder::GraphOptimizationLevel;
use ort::session::{
    HasSelectedOutputs, OutputSelector, RunOptions, Session as OrtSession, SessionInputValue,
};
use ort::value::TensorRef;

use super::{
    Backend, BackendError, Batch, Model, Output, SKIP_NEIGHBOURS, Session, UnitShape, library, operators,
};

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
        let fail = |e: ort::Error| BackendError::Library { why: e.to_string() };
        Ok(Box::new(OnnxSession {
            shape: self.shape(),
            units,
            dense_only: options(false).map_err(fail)?,
            with_features: options(true).map_err(fail)?,
        }))
    }
}

fn build(environment: &Environment, bytes: &[u8]) -> Result<OrtSession, String> {
    // The memory pattern planner keeps a plan for every shape it meets; batches differ in the
    // number of skip features, so it would only grow.
    OrtSession::builder(environment)
        .map_err(|e| e.to_string())?
        .with_intra_threads(1)
        .map_err(|e| e.to_string())?
        .with_memory_pattern(false)
        .map_err(|e| e.to_string())?
        .with_operators(operators::domain().map_err(|e| e.to_string())?)
        .map_err(|e| e.to_string())?
        .with_optimization_level(GraphOptimizationLevel::All)
        .map_err(|e| e.to_string())?
        .commit_from_memory(bytes)
        .map_err(|e| e.to_string())
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
