//! The cascade on a whole cloud: plan, patches, units, merge, resample.
//!
//! For each level, on a cloud of n points (the paper's section 3, its whole-cloud form): seeds by
//! farthest point sampling, a patch of the N nearest points around each, one unit on all patches,
//! and farthest point sampling of what the unit made, strays aside, down to 2n points. The last
//! level samples straight to the target, so that any ratio is exact, and ends with a polish that
//! makes the cloud even and smooth ([`CascadeOptions::polish`]).
//!
//! # What happens to difficult input
//!
//! - Points with a NaN or infinite coordinate are no measurements: they are left out, counted in
//!   [`Upsampled::dropped_non_finite`], and a ratio counts the finite points alone.
//! - Points that coincide in local `f32` are one point to the network, but each counts towards the
//!   target: the result has the size that the header promised.
//! - Points that lie apart from all surface (outliers, groups of up to four) are kept as they are, and nothing is made
//!   of them. They count towards the target.
//! - Where the input lies on scan lines, dense along and thin across, the result is not made by the network but
//!   interpolated along the lines and, where the surface goes on, between them. Not without the polish, which is the network
//!   alone, and not where all is to be equally dense ([`Spread::Area`]).
//! - Too few distinct points for the unit, or all of them equal, is a [`CascadeError`].
//!
//! # Determinism
//!
//! The result depends on the points, their order, the target, the options and the model; never on
//! the number of threads. Every patch is computed on its own and written to its own place. The few numbers that depend on
//! the whole cloud are gathered in one value, `Globals`.
//!
//! # Runtimes and threads
//!
//! The cascade knows a runtime as a [`LevelRunner`], which runs one unit over all patches of a level. [`Patchwise`] makes
//! one of a [`Backend`] that takes a patch at a time. The work runs on the rayon pool that [`upsample`] is called on;
//! queues, pools and turns are the engine's.

mod anchors;
mod apart;
mod balance;
mod border;
mod confidence;
#[cfg(any(test, feature = "fake"))]
mod fake;
mod flats;
mod globals;
mod input;
mod level;
mod lines;
mod measured;
mod observer;
mod part;
mod patches;
mod patchwise;
mod plan;
mod polish;
mod runner;
mod session;
mod share;
mod sites;
mod skip;
mod sphere;
mod strays;
mod vector;
mod weave;

pub use confidence::confidence;
#[cfg(any(test, feature = "fake"))]
pub use fake::Fake;
pub use input::distinct;
pub use observer::{Observer, Silent, Stage};
pub use part::{Part, Survey, UpsampledPart, Whole, WholeError, halo, upsample_part};
pub use patches::Patches;
pub use patchwise::{OnDemand, Patchwise, Sessions, Workspace};
pub use plan::{MAX_RATIO, Quality, Target};
pub use runner::{
    BackendError, Demand, FeatureTable, LevelInput, LevelOutput, LevelRunner, MadePoint, UnitShape,
};
pub use session::{Backend, Batch, Output, SKIP_NEIGHBOURS, Session, SkipInput};
pub use share::Spread;
pub use skip::SkipNeighbours;
pub use sphere::Sphere;

use apart::{Parted, joined};
use densecloud_cloud::{FrameError, Position};
use densecloud_geometry::{TooManyPoints, check_count};
use globals::Globals;
use input::Input;
use level::{Handover, Run, run_levels};
use plan::{Choice, Plan};
use weave::{Cloth, woven};

/// How to run the cascade; the defaults are what the shipped model was measured with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CascadeOptions {
    /// How many patches a point lies in on average (the paper uses 3). At least 1; cost grows in
    /// proportion.
    pub overlap: f64,
    /// Share of each patch, around its seed, whose outputs are merged, 0 to 1. Towards the border
    /// of a patch the unit sees neighbours on one side only, and farthest point sampling would
    /// prefer the strays it makes there.
    pub inner: f64,
    /// How far a point may be moved from the one that it was made of, in multiples of that one's
    /// spacing, the mean distance to its 8 nearest; what moved further is a stray and left out. Positive;
    /// infinity keeps everything.
    pub max_displacement: f64,
    /// The largest distance of a new point from its nearest input point: points further away are left out. Its unit is the
    /// distance that nine in ten points of the level keep to, measured in the spacing of the input there. Past an open
    /// border, where no input point lies further out, the limit is 2 / 15 of this, in spacings. Positive; infinity keeps
    /// everything.
    pub max_distance: f64,
    /// Whether the last level is evened out and smoothed: midpoints of its points are sampled, and projected onto the
    /// surface through all of them, and through the input where that is clean. Without a polish every point of the
    /// result is an output of the network.
    pub polish: bool,
    /// Whether each neighbourhood gets its share of the points, or the whole becomes equally dense.
    pub spread: Spread,
    /// Whether a level more is run, to choose among its points.
    pub quality: Quality,
    /// Chooses where farthest point sampling starts, hence which of many equally good results.
    pub seed: u64,
}

impl Default for CascadeOptions {
    fn default() -> Self {
        Self {
            overlap: 2.0,
            inner: 0.3,
            max_displacement: 0.8,
            max_distance: 1.5,
            polish: true,
            spread: Spread::default(),
            quality: Quality::default(),
            seed: 0,
        }
    }
}

/// A dense cloud and what was done to the input.
#[derive(Debug, Clone, PartialEq)]
pub struct Upsampled {
    /// Exactly [`Target::points_out`] positions, ordered so that any prefix is spread as evenly as
    /// the whole.
    pub positions: Vec<Position>,
    /// Points left out because a coordinate was NaN or infinite.
    pub dropped_non_finite: usize,
    /// Points that coincided with an earlier one.
    pub duplicates: usize,
    /// Points that lie apart from all others, kept as they are.
    pub apart: usize,
    /// How many levels there were.
    pub levels: usize,
}

/// Why a cloud cannot be upsampled.
#[derive(Debug, Clone, thiserror::Error)]
#[non_exhaustive]
pub enum CascadeError {
    /// A ratio outside 1 to 64.
    #[error("ratio {0} is outside 1 to {MAX_RATIO}")]
    Ratio(f64),
    /// A number of points outside 1 to 64 times the input.
    #[error(
        "{wanted} points from {from} is a ratio outside 1 to {MAX_RATIO}; ask for {from} to {}",
        from * MAX_RATIO as u64
    )]
    Points {
        /// The number asked for.
        wanted: u64,
        /// Finite points in the input.
        from: u64,
    },
    /// An overlap that is not at least 1 (or absurdly large).
    #[error("overlap {0} is outside 1 to 100")]
    Overlap(f64),
    /// Fewer distinct points than the unit has neighbours.
    #[error(
        "the cloud has {distinct} distinct finite points; the model needs at least {needed}{}",
        if duplicates > &0 { format!(" ({duplicates} more are duplicates)") } else { String::new() }
    )]
    TooFewPoints {
        /// Distinct finite points found.
        distinct: usize,
        /// Points that coincide with one of them.
        duplicates: usize,
        /// The least that works.
        needed: usize,
    },
    /// A part of a cloud shows too little surface for the points that are wanted there.
    #[error(
        "there are {places} places for {wanted} points: the points here lie apart, or on no surface; ask for fewer \
         points, or for larger tiles"
    )]
    NoRoom {
        /// Where points could be put.
        places: usize,
        /// Points that are wanted.
        wanted: usize,
    },
    /// So many points coincide that the distinct ones would need a higher ratio than there is.
    #[error(
        "only {distinct} of {total} points are distinct, so the target would take a ratio above \
         {MAX_RATIO} of those; remove the duplicates or ask for a lower ratio"
    )]
    TooManyDuplicates {
        /// Distinct finite points.
        distinct: usize,
        /// Finite points.
        total: usize,
    },
    /// An inner share outside 0 to 1.
    #[error("inner share {0} is outside 0 to 1")]
    Inner(f64),
    /// A displacement limit that is not a positive number.
    #[error("the displacement limit {0} is not above 0")]
    MaxDisplacement(f64),
    /// A distance limit that is not a positive number.
    #[error("the distance limit {0} is not above 0")]
    MaxDistance(f64),
    /// More points than indices can tell apart, in the input, the result, or between.
    #[error("{0}")]
    TooManyPoints(#[from] TooManyPoints),
    /// No local frame fits.
    #[error("{0}")]
    Frame(#[from] FrameError),
    /// The backend failed.
    #[error("{0}")]
    Backend(#[from] BackendError),
    /// No point of the result is as sure as was asked for.
    #[error("no point of the result reaches the confidence {0}; ask for less")]
    NoneSure(f64),
    /// The system has no memory for a table of this many bytes.
    #[error("the system has no {0} bytes of memory for this cloud; ask for fewer points")]
    OutOfMemory(u64),
    /// The observer asked to stop.
    #[error("cancelled")]
    Cancelled,
}

impl CascadeOptions {
    /// Whether scan lines count: not where the result is to be the network's alone, or equally dense.
    fn heeds_lines(&self) -> bool {
        self.polish && self.spread == Spread::Neighbourhood
    }

    /// Checks each option.
    fn check(&self) -> Result<(), CascadeError> {
        if !(1.0..=100.0).contains(&self.overlap) {
            return Err(CascadeError::Overlap(self.overlap));
        }
        if !(0.0..=1.0).contains(&self.inner) {
            return Err(CascadeError::Inner(self.inner));
        }
        if self.max_displacement.is_nan() || self.max_displacement <= 0.0 {
            return Err(CascadeError::MaxDisplacement(self.max_displacement));
        }
        if self.max_distance.is_nan() || self.max_distance <= 0.0 {
            return Err(CascadeError::MaxDistance(self.max_distance));
        }
        Ok(())
    }
}

/// Upsamples a cloud, on the current rayon pool.
///
/// Cost: about `overlap * (2^levels - 1) * n / N` runs of the unit for n distinct points in, and memory
/// of 250 to 310 bytes a point out; the skip features are 528 bytes for each point of a level's input, the
/// last level's aside.
///
/// # Errors
/// [`CascadeError`]: the input or target is impossible, the backend failed, or the observer asked
/// to stop.
pub fn upsample(
    positions: &[Position],
    target: Target,
    options: &CascadeOptions,
    runner: &dyn LevelRunner,
    observer: &dyn Observer,
) -> Result<Upsampled, CascadeError> {
    options.check()?;
    let input = Input::prepare(positions)?;
    let mut globals = Globals::new(input.frame);
    let among = if options.polish { Choice::Polished } else { Choice::Made };
    cascade(input, (target, among), &Run { options, runner, observer, part: None }, &mut globals)
}

/// Whether [`upsample`] would begin, on a runner of this shape: what it refuses before any work. O(n log n).
///
/// # Errors
/// As of [`upsample`], but for those of the runner.
pub fn check(
    positions: &[Position],
    target: Target,
    options: &CascadeOptions,
    shape: UnitShape,
) -> Result<(), CascadeError> {
    options.check()?;
    let Input { points, finite, .. } = Input::prepare(positions)?;
    Plan::new(target, options.quality, finite, points.len(), shape).map(drop)
}

/// Runs all levels. Takes the statistics that `globals` has, and fills in the others.
fn cascade(
    input: Input,
    (target, among): (Target, Choice),
    run: &Run<'_>,
    globals: &mut Globals,
) -> Result<Upsampled, CascadeError> {
    let Input { frame, points, finite, non_finite } = input;
    let (shape, duplicates) = (run.runner.shape(), finite - points.len());
    let plan = Plan::new(target, run.options.quality, finite, points.len(), shape)?;
    let Parted { together, apart } = Parted::of(&points, shape.neighbours + 1, globals);
    drop(points);
    if globals.sizes.is_empty() {
        globals.plan(plan.sizes(apart.len(), together.points.len(), among));
    }
    run.observer.plan(&globals.sizes);
    let levels = globals.sizes.len();
    let input = run.options.heeds_lines().then(|| together.points.clone());
    let together = Handover::input(together, run.options.spread, globals)?;
    let (mut dense, _) = run_levels(together, run, globals)?;
    if let Some(input) = input {
        if run.observer.cancelled() {
            return Err(CascadeError::Cancelled);
        }
        let ratio = dense.len() as f64 / input.len().max(1) as f64;
        dense = woven(dense, Cloth { input: &input, ratio, belongs: &|_| true });
    }
    let dense = joined(dense, &apart);
    Ok(Upsampled {
        positions: dense.iter().map(|p| frame.to_world(*p)).collect(),
        dropped_non_finite: non_finite,
        duplicates,
        apart: apart.len(),
        levels,
    })
}

/// `count` copies of a value; an error where there is no memory for them, which elsewhere would end the
/// program.
fn filled<T: Clone>(value: T, count: usize) -> Result<Vec<T>, CascadeError> {
    let mut values = Vec::new();
    let bytes = (count as u64).saturating_mul(size_of::<T>() as u64);
    values.try_reserve_exact(count).map_err(|_| CascadeError::OutOfMemory(bytes))?;
    values.resize(count, value);
    Ok(values)
}

#[cfg(test)]
mod tests;
