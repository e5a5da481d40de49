//! One upsampling unit as the rest of the program sees it, and the runtimes behind it.
//!
//! A [`Backend`] is a loaded cascade. Each worker thread opens its own [`Session`] on it, and runs
//! [`Batch`]es of patches through one unit at a time. [`onnx`] is the real one; [`fake`] moves
//! points without a network, so that the engine and the server can be tested without a model.

use half::f16;

/// How many nearest points of the previous level each point takes skip features from (the paper's
/// section 3.2, inter-level skip connections).
pub const SKIP_NEIGHBOURS: usize = 5;

/// The sizes that every unit of a cascade shares.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnitShape {
    /// Points in a full patch (N).
    pub patch_size: usize,
    /// Neighbours in an edge block (K): a patch must hold more points than this.
    pub neighbours: usize,
    /// Feature channels a point (C).
    pub channels: usize,
}

/// Input of one run of a unit: B patches of N points each, all of the same N.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    /// B.
    pub patches: usize,
    /// N, at most [`UnitShape::patch_size`] and more than [`UnitShape::neighbours`].
    pub patch_points: usize,
    /// `[B, N, 3]`, each patch minus its centroid, over the largest distance to it.
    pub points: &'a [f32],
    /// The inter-level skip; needed by every unit but the first.
    pub skip: Option<SkipInput<'a>>,
    /// Whether [`Output::features`] is wanted; the last level has no use for it.
    pub want_features: bool,
}

/// What a unit takes over from the level before it.
#[derive(Debug, Clone, Copy)]
pub struct SkipInput<'a> {
    /// `[M, C]`: one row a point of the previous level's input, in half precision: they are what takes
    /// most memory.
    pub features: &'a [f16],
    /// `[B, N, 5]`: for each point the rows of its nearest points of the previous level's input.
    pub indices: &'a [i64],
    /// `[B, N, 5]`: their squared distances, in any one unit of length a patch.
    pub distances: &'a [f32],
}

/// Output of one run; the buffers are reused from run to run.
#[derive(Debug, Clone, Default)]
pub struct Output {
    /// `[B, 2N, 3]` in each patch's normalised frame.
    pub dense: Vec<f32>,
    /// `[B, N, C]` after the unit's own skip; empty when not wanted.
    pub features: Vec<f32>,
}

/// A loaded cascade.
pub trait Backend: Send + Sync {
    /// The sizes that its units share.
    fn shape(&self) -> UnitShape;

    /// How many units there are. A cascade of more levels repeats the last one.
    fn units(&self) -> usize;

    /// Where it runs, for logs and metrics: `cpu`, for example.
    fn provider(&self) -> &str;

    /// Opens what one worker thread needs.
    ///
    /// # Errors
    /// [`BackendError`] when the runtime refuses the model.
    fn open(&self) -> Result<Box<dyn Session>, BackendError>;
}

/// One worker's own way into a backend.
pub trait Session: Send {
    /// Runs unit `unit` (from 0) on one batch, and overwrites `output`.
    ///
    /// The result for a patch does not depend on the thread or on earlier runs.
    ///
    /// # Errors
    /// [`BackendError::Run`] when the runtime fails.
    fn run(&mut self, unit: usize, batch: &Batch<'_>, output: &mut Output) -> Result<(), BackendError>;
}

/// Why a model cannot be loaded or run.
#[derive(Debug, Clone, thiserror::Error)]
pub enum BackendError {
    /// ONNX Runtime's shared library is nowhere to be found, or cannot be used.
    #[error(
        "cannot load ONNX Runtime: {why}; set ORT_DYLIB_PATH to libonnxruntime.so (1.24 or newer), or put \
         it next to the program"
    )]
    Library {
        /// The loader's own words, and where it looked.
        why: String,
    },
    /// A model folder is incomplete, damaged, or not a densecloud model.
    #[error("model {model}: {why}")]
    Model {
        /// The model's name or folder.
        model: String,
        /// What is wrong with it.
        why: String,
    },
    /// The runtime failed while running a unit.
    #[error("unit {unit} failed: {why}")]
    Run {
        /// The unit, from 1.
        unit: usize,
        /// The runtime's own words.
        why: String,
    },
}
