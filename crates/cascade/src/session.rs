//! A unit that takes a patch at a time on the caller's thread: what [`Patchwise`](crate::Patchwise) runs levels with.
//!
//! A [`Backend`] is a loaded model. Each thread at work holds a [`Session`] of it, and runs [`Batch`]es of patches
//! through one unit after another.

use crate::{BackendError, Demand, UnitShape};
use half::f16;

/// How many nearest points of the previous level each point takes skip features from (the paper's
/// section 3.2, inter-level skip connections).
pub const SKIP_NEIGHBOURS: usize = 5;

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

/// A loaded model, of which each thread opens a session of its own.
pub trait Backend: Send + Sync {
    /// The sizes that its units share.
    fn shape(&self) -> UnitShape;

    /// How many units there are. A cascade of more levels repeats the last one.
    fn units(&self) -> usize;

    /// Where it runs, for logs and metrics: `cpu`, for example.
    fn provider(&self) -> &str;

    /// Memory that a cascade over it takes.
    fn demand(&self) -> Demand {
        Demand::default()
    }

    /// Opens what one thread needs.
    ///
    /// # Errors
    /// [`BackendError`] when the runtime refuses the model.
    fn open(&self) -> Result<Box<dyn Session>, BackendError>;
}

/// One thread's own way into a backend.
pub trait Session: Send {
    /// Runs unit `unit` (from 0) on one batch, and overwrites `output`.
    ///
    /// The result for a patch does not depend on the thread or on earlier runs.
    ///
    /// # Errors
    /// [`BackendError::Run`] when the runtime fails.
    fn run(&mut self, unit: usize, batch: &Batch<'_>, output: &mut Output) -> Result<(), BackendError>;
}
