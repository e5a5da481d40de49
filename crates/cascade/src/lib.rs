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
//!   of them: see [`apart`]. They count towards the target.
//! - Too few distinct points for the unit, or all of them equal, is a [`CascadeError`].
//!
//! # Determinism
//!
//! The result depends on the points, their order, the target, the settings and the model; never on
//! the number of threads. Every patch is computed on its own and written to its own place.

mod anchors;
mod apart;
mod backend;
mod balance;
mod border;
#[cfg(any(test, feature = "fake"))]
pub mod fake;
mod input;
mod level;
mod measured;
mod observer;
mod patches;
mod plan;
mod polish;
mod strays;
mod workers;

pub use backend::{Backend, BackendError, Batch, Output, SKIP_NEIGHBOURS, Session, SkipInput, UnitShape};
#[cfg(any(test, feature = "fake"))]
pub use fake::Fake;
pub use observer::{Observer, Silent, Stage};
pub use plan::{MAX_RATIO, Target};
pub use workers::{Lane, Worker, Workers};

use apart::{Parted, joined};
use densecloud_cloud::{FrameError, Position};
use input::Input;
pub use input::distinct;
use level::{Done, Level};
use plan::Plan;

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
    /// How far a point may lie from the nearest input point, in multiples of the distance that nine
    /// in ten points of its level keep to, each in the input point's spacing; what lies further is
    /// left out. So is what lies beyond all input points around it, past a border, by more than 2 / 15 of
    /// this in their spacing. Positive; infinity keeps everything.
    pub max_distance: f64,
    /// Whether the last level is made even and smooth: its sample's midpoints are sampled once
    /// more, projected onto the surface that all its points suggest, and drawn to the input as far as
    /// that is clean. Without, every point is one that the network put there.
    pub polish: bool,
    /// Chooses where farthest point sampling starts, hence which of many equally good results.
    pub seed: u64,
}

impl Default for CascadeOptions {
    fn default() -> Self {
        Self { overlap: 2.0, inner: 0.3, max_displacement: 0.8, max_distance: 1.5, polish: true, seed: 0 }
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
}

/// Why a cloud cannot be upsampled.
#[derive(Debug, Clone, thiserror::Error)]
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
    /// No local frame fits.
    #[error("{0}")]
    Frame(#[from] FrameError),
    /// The backend failed.
    #[error("{0}")]
    Backend(#[from] BackendError),
    /// The system gave no memory for a table of so many bytes.
    #[error("the system has no {0} bytes of memory for this cloud; ask for fewer points")]
    OutOfMemory(u64),
    /// The observer asked to stop.
    #[error("cancelled")]
    Cancelled,
}

/// Upsamples a cloud.
///
/// Cost: about `overlap * (2^levels - 1) * n / N` runs of the unit for n distinct points in, and memory
/// of 250 to 400 bytes a point out; the skip features are 528 bytes for each point of a level's input, the
/// last level's aside.
///
/// # Errors
/// [`CascadeError`]: the input or target is impossible, the backend failed, or the observer asked
/// to stop.
pub fn upsample(
    positions: &[Position],
    target: Target,
    settings: &CascadeOptions,
    workers: &Workers,
    observer: &dyn Observer,
) -> Result<Upsampled, CascadeError> {
    if !(1.0..=100.0).contains(&settings.overlap) {
        return Err(CascadeError::Overlap(settings.overlap));
    }
    if !(0.0..=1.0).contains(&settings.inner) {
        return Err(CascadeError::Inner(settings.inner));
    }
    if settings.max_displacement.is_nan() || settings.max_displacement <= 0.0 {
        return Err(CascadeError::MaxDisplacement(settings.max_displacement));
    }
    if settings.max_distance.is_nan() || settings.max_distance <= 0.0 {
        return Err(CascadeError::MaxDistance(settings.max_distance));
    }
    let shape = workers.shape();
    let input = Input::prepare(positions)?;
    let plan = Plan::new(target, input.finite, input.points.len(), input.duplicates(), shape)?;
    let lane = Lane::of(plan.sizes.last().map_or(0, |&size| size as u64));
    let (dense, apart) = workers.install(lane, || {
        let Parted { together, apart } = Parted::of(input.points, shape.neighbours + 1);
        let plan = plan.without(apart.len(), together.len(), settings.polish);
        observer.plan(&plan.sizes);
        let mut done = Done { points: together, previous: None, measured: None };
        for (number, &size) in plan.sizes.iter().enumerate() {
            let level = Level {
                number,
                unit: number.min(workers.backend().units() - 1),
                last: number + 1 == plan.sizes.len(),
                points: done.points,
                previous: done.previous,
                measured: done.measured,
            };
            done = level.run(size, settings, workers, observer)?;
        }
        Ok::<_, CascadeError>((joined(done.points, &apart), apart.len()))
    })?;
    Ok(Upsampled {
        positions: dense.iter().map(|p| input.frame.to_world(*p)).collect(),
        dropped_non_finite: positions.len() - input.finite,
        duplicates: input.finite - input.distinct,
        apart,
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
