//! Options of every command that runs the cascade.

use std::cell::OnceCell;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;

use super::CliError;
use densecloud_backends::{Model, OnnxBackend};
use densecloud_cascade::{LevelRunner, Patchwise};
use densecloud_engine::{Engine, EngineConfig};

/// Which model, on how many threads.
#[derive(Debug, Clone, Args)]
pub(super) struct EngineArgs {
    /// Worker threads [default: one a processor]
    #[arg(
        long,
        env = "DENSECLOUD_THREADS",
        value_name = "N",
        default_value_t = 0,
        hide_default_value = true
    )]
    pub(super) threads: usize,

    /// Folder of another model than the one inside the program (model.toml and its unit files)
    #[arg(long, env = "DENSECLOUD_MODEL", value_name = "DIR")]
    pub(super) model: Option<PathBuf>,
}

impl EngineArgs {
    /// Reads the model. The global pool, on which files are read and written and tiles are worked on, gets its threads before
    /// anything else asks for some.
    pub(super) fn model(&self) -> Result<Arc<Model>, CliError> {
        // Where there is a pool by now, it stays.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(self.threads).build_global();
        let model = match &self.model {
            Some(folder) => Model::load(folder),
            None => Model::embedded(),
        };
        model.map(Arc::new).map_err(|e| CliError::Failed(e.to_string()))
    }

    /// Starts an engine for one request at a time.
    pub(super) fn engine(&self, model: Arc<Model>) -> Result<Engine, CliError> {
        let config = EngineConfig { threads: self.threads, concurrency: 1, ..EngineConfig::default() };
        start(model, || config)
    }
}

/// A model and an engine over it, made when they are first asked for, and kept for all inputs of a command.
pub(super) struct Machine<'a> {
    args: &'a EngineArgs,
    model: OnceCell<Arc<Model>>,
    engine: OnceCell<Engine>,
    measured: OnceCell<()>,
}

impl<'a> Machine<'a> {
    pub(super) fn new(args: &'a EngineArgs) -> Self {
        Self { args, model: OnceCell::new(), engine: OnceCell::new(), measured: OnceCell::new() }
    }

    pub(super) fn model(&self) -> Result<Arc<Model>, CliError> {
        once(&self.model, || self.args.model()).cloned()
    }

    pub(super) fn engine(&self) -> Result<&Engine, CliError> {
        once(&self.engine, || self.args.engine(self.model()?))
    }

    /// The engine, when it knows how fast this machine is.
    pub(super) fn measured(&self) -> Result<&Engine, CliError> {
        let engine = self.engine()?;
        once(&self.measured, || engine.warm_up().map_err(|why| CliError::Failed(why.to_string())))?;
        Ok(engine)
    }
}

/// What a cell has, made if need be.
fn once<T>(cell: &OnceCell<T>, make: impl FnOnce() -> Result<T, CliError>) -> Result<&T, CliError> {
    match cell.get() {
        Some(made) => Ok(made),
        None => make().map(|made| cell.get_or_init(|| made)),
    }
}

impl EngineArgs {
    /// What runs a model without an engine, on the global pool.
    pub(super) fn runner(&self, model: Arc<Model>) -> Result<Arc<dyn LevelRunner>, CliError> {
        let backend = OnnxBackend::new(model).map_err(|e| CliError::Failed(e.to_string()))?;
        Ok(Arc::new(Patchwise::new(Arc::new(backend))))
    }
}

/// Loads a model into ONNX Runtime, and starts an engine over it, of sizes that may depend on what is left by then.
pub(super) fn start(model: Arc<Model>, config: impl FnOnce() -> EngineConfig) -> Result<Engine, CliError> {
    let backend = OnnxBackend::new(model).map_err(|e| CliError::Failed(e.to_string()))?;
    Engine::with_backend(Arc::new(backend), config()).map_err(|e| CliError::Failed(e.to_string()))
}
