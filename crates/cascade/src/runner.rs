//! The seam between the cascade and what runs its units.

use std::any::Any;
use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::fmt;

use crate::patches::Patches;
use crate::skip::SkipNeighbours;
use crate::{CascadeError, Observer};
use densecloud_cloud::Point;

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

/// Runs the units of a model, a level at a time: what another runtime implements, and all that the cascade
/// knows of one.
///
/// The cascade hands over a whole level, so an implementation chooses its own batches, threads and devices.
/// [`Patchwise`](crate::Patchwise) is the one for runtimes that take a patch at a time on a thread of the
/// caller's; a runtime with a device of its own implements this trait alone and keeps its features there, behind a
/// [`FeatureTable`].
///
/// ```
/// use densecloud_cascade::{
///     CascadeError, CascadeOptions, FeatureTable, LevelInput, LevelOutput, LevelRunner, Observer, Silent, Target,
///     UnitShape, upsample,
/// };
/// use densecloud_geometry::KdTree;
///
/// /// Gives each point back, and the middle between it and its nearest neighbour. Needs no sessions, no patches and
/// /// no features.
/// struct Midpoints;
///
/// impl LevelRunner for Midpoints {
///     fn shape(&self) -> UnitShape {
///         UnitShape { patch_size: 64, neighbours: 8, channels: 0 }
///     }
///     fn units(&self) -> usize {
///         1
///     }
///     fn provider(&self) -> &str {
///         "midpoints"
///     }
///     fn run_level(
///         &self,
///         level: &LevelInput<'_>,
///         _previous: Option<&FeatureTable>,
///         _observer: &dyn Observer,
///     ) -> Result<LevelOutput, CascadeError> {
///         let tree = KdTree::new(level.points);
///         let (mut made, mut found) = (Vec::new(), Vec::new());
///         for (i, &p) in level.points.iter().enumerate() {
///             tree.nearest(p, 2, &mut found);
///             let q = level.points[found[1].index as usize];
///             made.push(level.made(p, i));
///             made.push(level.made(std::array::from_fn(|a| 0.5 * (p[a] + q[a])), i));
///         }
///         Ok(LevelOutput { made, features: None })
///     }
/// }
///
/// // A helix of 200 points.
/// let turn = |i: i32| f64::from(i) * 0.1;
/// let cloud: Vec<[f64; 3]> = (0..200).map(|i| [turn(i).cos(), turn(i).sin(), 0.3 * turn(i)]).collect();
/// let dense = upsample(&cloud, Target::Ratio(4.0), &CascadeOptions::default(), &Midpoints, &Silent)?;
/// assert_eq!(dense.positions.len(), 800);
/// # Ok::<_, CascadeError>(())
/// ```
pub trait LevelRunner: Send + Sync {
    /// The sizes that its units share.
    fn shape(&self) -> UnitShape;

    /// How many units there are. A cascade of more levels repeats the last one.
    fn units(&self) -> usize;

    /// Where it runs, for logs and metrics: `cpu`, for example.
    fn provider(&self) -> &str;

    /// Memory that a cascade over this runner takes.
    fn demand(&self) -> Demand {
        Demand::default()
    }

    /// Runs one unit over all patches of a level. `previous` is the table that this runner gave for the level
    /// before: none at the first level, and where it gave none.
    ///
    /// The output must depend on the arguments alone: not on the number of threads, nor on earlier calls. A runner asks
    /// [`Observer::cancelled`] often, and tells [`Observer::advance`] how far it is. It may use the rayon pool that it
    /// is called on.
    ///
    /// # Errors
    /// [`CascadeError::Backend`] when the runtime fails, [`CascadeError::Cancelled`] when the observer says so,
    /// [`CascadeError::OutOfMemory`] and [`CascadeError::TooManyPoints`] for a level that is too large.
    fn run_level(
        &self,
        level: &LevelInput<'_>,
        previous: Option<&FeatureTable>,
        observer: &dyn Observer,
    ) -> Result<LevelOutput, CascadeError>;
}

/// One level's input: n points and the patches that cover them.
#[derive(Clone, Copy)]
pub struct LevelInput<'a> {
    /// The unit to run, from 0.
    pub unit: usize,
    /// The points, distinct, in local coordinates.
    pub points: &'a [Point],
    /// The patches, and each point's row in the feature table.
    pub patches: &'a Patches,
    /// For each point its nearest points of the previous level's input; none where there are no features of those.
    pub skip: Option<&'a SkipNeighbours>,
    /// Whether [`LevelOutput::features`] are wanted; the last level has no use for them.
    pub want_features: bool,
}

impl LevelInput<'_> {
    /// A point at `at` that was made of point `source`.
    #[must_use]
    pub fn made(&self, at: Point, source: usize) -> MadePoint {
        let moved = (0..3).map(|a| (at[a] - self.points[source][a]).powi(2)).sum::<f32>().sqrt();
        MadePoint { at, displacement: moved / self.patches.sites.spacing[source] }
    }
}

/// What a unit makes of one level.
pub struct LevelOutput {
    /// The points made, at least about twice those of the input: each patch's
    /// [`kept`](Patches::kept) places, twice, is the usual choice. Some may lie far off, or be NaN: strays are left
    /// out later.
    pub made: Vec<MadePoint>,
    /// A row of features for each input point, numbered by [`Patches::row`]; handed back at the next level. None where
    /// none are wanted, and from a runner that has none.
    pub features: Option<FeatureTable>,
}

/// A point that a unit made.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MadePoint {
    /// Where it is, in local coordinates.
    pub at: Point,
    /// Its distance from the point that it was made of, in that point's spacing.
    pub displacement: f32,
}

/// The features of one level, as their runner keeps them: rows in memory, or a handle of a device. The cascade only
/// carries it from one level to the next, and drops it before it samples.
pub struct FeatureTable(Box<dyn Any + Send + Sync>);

impl FeatureTable {
    /// Wraps a runner's own table.
    #[must_use]
    pub fn new(table: impl Any + Send + Sync) -> Self {
        Self(Box::new(table))
    }

    /// The table inside, for the runner that wrapped it; none where it is of another type.
    #[must_use]
    pub fn get<T: Any>(&self) -> Option<&T> {
        self.0.downcast_ref()
    }
}

impl fmt::Debug for FeatureTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("FeatureTable(..)")
    }
}

/// Bytes of this machine's memory that one cascade takes at its height, the input and the result aside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Demand {
    /// Bytes that the smallest cloud takes.
    pub fixed: u64,
    /// Bytes for each point of the last level before that is sampled.
    pub a_point: u64,
}

impl Default for Demand {
    /// What the shipped model takes, which is more than most.
    fn default() -> Self {
        Self { fixed: 1 << 20, a_point: 384 }
    }
}

impl Demand {
    /// Bytes for a last level of `points` points.
    #[must_use]
    pub fn bytes(self, points: u64) -> u64 {
        points.saturating_mul(self.a_point).saturating_add(self.fixed)
    }
}

/// Why a model cannot be loaded or run.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum BackendError {
    /// ONNX Runtime's shared library is nowhere to be found, or cannot be used.
    #[error(
        "cannot load ONNX Runtime: {why}; set ORT_DYLIB_PATH to {DLL_PREFIX}onnxruntime{DLL_SUFFIX} (1.24 or newer), \
         or put it next to the program"
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
    /// The runtime failed before any unit ran.
    #[error("the runtime cannot start: {why}")]
    Start {
        /// The runtime's own words.
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
