//! A part of a cloud, worked on alone.
//!
//! A cloud that is too large is cut into cells. What is made of a cell's points depends on the points around them, so a part
//! has a halo ([`halo`]); on a few statistics of the whole, which come from [`Whole`]; and at its border on what its
//! neighbours choose, for which both sides go by one rule (`darts.rs`).

mod darts;
mod field;
mod whole;
mod within;

pub(crate) use field::{Field, stands_for_others};
pub use whole::{Survey, Whole, WholeError};
pub(crate) use within::Within;

use crate::apart::{Parted, joined};
use crate::globals::Globals;
use crate::input::{distinct, local};
use crate::level::{Handover, Run, run_levels};
use crate::measured::Measured;
use crate::weave::{Cloth, woven};
use crate::{CascadeError, CascadeOptions, LevelRunner, Observer};
use densecloud_cloud::{Frame, Point, Position};
use densecloud_geometry::{Partition, check_count};
use within::margin;

/// A cell of a cloud with its halo.
#[derive(Debug, Clone, Copy)]
pub struct Part<'a> {
    /// The points of the cell and of its halo, in the order in which the whole has them.
    pub positions: &'a [Position],
    /// The cells of the whole.
    pub partition: &'a Partition,
    /// Which of them is wanted.
    pub cell: u32,
    /// What is known of the whole.
    pub whole: &'a Whole,
    /// Points that the cell shall have, 1 to 64 times its finite points.
    pub size: u64,
}

/// What was made of a part.
#[derive(Debug, Clone, PartialEq)]
pub struct UpsampledPart {
    /// Exactly [`Part::size`] positions that belong to the cell, ordered so that any prefix is about as even as the whole.
    pub positions: Vec<Position>,
    /// Positions of the neighbours' results just outside the cell, about as they will be there.
    pub rim: Vec<Position>,
    /// Points of the cell that coincide with an earlier one.
    pub duplicates: usize,
    /// Points of the cell that lie apart from all others, kept as they are.
    pub apart: usize,
    /// How many levels there were.
    pub levels: usize,
}

/// How far beyond its cell a part's halo has to reach, in the local spacing: the root of the area that an input point has.
/// Each level needs whole patches, and is half as wide as the one before it.
#[must_use]
pub fn halo(whole: &Whole) -> f64 {
    f64::from(margin(0, whole.levels()))
}

/// Upsamples a part of a cloud, on the current rayon pool. Each point of the result is made as in the whole, as far as its
/// surroundings go; where it lies depends on the input within the halo, on the cells and on the [`Whole`] alone.
///
/// Cost and memory: as of [`upsample`](crate::upsample) for the points of cell and halo.
///
/// # Errors
/// As [`upsample`](crate::upsample). A part's points may be too few or too odd where the whole's are not.
pub fn upsample_part(
    part: &Part<'_>,
    options: &CascadeOptions,
    runner: &dyn LevelRunner,
    observer: &dyn Observer,
) -> Result<UpsampledPart, CascadeError> {
    options.check()?;
    check_count(part.positions.len())?;
    let size = usize::try_from(part.size).unwrap_or(usize::MAX);
    check_count(size)?;
    let mut globals = part.whole.globals().clone();
    let Input { points, duplicates } = Input::of(part, &globals);
    let needed = runner.shape().neighbours + 1;
    let Parted { together, apart } = Parted::of(&points, needed, &mut globals);
    drop(points);
    if together.points.len() < needed {
        let distinct = together.points.len();
        return Err(CascadeError::TooFewPoints { distinct, duplicates, needed });
    }
    let frame = globals.frame;
    let apart: Vec<Point> = apart.into_iter().filter(|p| part.has(*p, frame)).collect();
    let wanted = size.checked_sub(apart.len());
    let wanted = wanted.ok_or(CascadeError::NoRoom { places: size, wanted: apart.len() })?;
    let run = Run { options, runner, observer, part: None };
    let (dense, rim) = part.on_surfaces(together, wanted, &run, &mut globals)?;
    let dense = joined(dense, &apart);
    let world = |points: Vec<Point>| points.iter().map(|p| frame.to_world(*p)).collect();
    let (positions, rim, levels) = (world(dense), world(rim), globals.sizes.len());
    Ok(UpsampledPart { positions, rim, duplicates, apart: apart.len(), levels })
}

impl Part<'_> {
    /// Whether a point belongs to the cell.
    fn has(&self, p: Point, frame: Frame) -> bool {
        self.partition.cell_of(frame.to_world(p)) == self.cell
    }

    /// What is made of the points that lie on surfaces: `size` points of the cell, and those just outside.
    fn on_surfaces(
        &self,
        together: Measured,
        size: usize,
        run: &Run<'_>,
        globals: &mut Globals,
    ) -> Result<(Vec<Point>, Vec<Point>), CascadeError> {
        let points = together.sites.points.clone();
        let inside = points.iter().filter(|p| self.has(**p, globals.frame)).count();
        if inside == 0 {
            // All points of the cell lie apart.
            let none = (Vec::new(), Vec::new());
            return if size == 0 { Ok(none) } else { Err(CascadeError::NoRoom { places: 0, wanted: size }) };
        }
        let (levels, ratio) = (self.whole.levels(), size as f64 / inside as f64);
        let together = Handover::input(together, run.options.spread, globals)?;
        let input = (&points[..], together.local.as_deref());
        let within = Within::new(self, globals, ratio, size, input);
        let of_level = |level| within.size_of_level(points.len() << level, level, level + 1 == levels);
        globals.plan((0..levels).map(of_level).collect());
        run.observer.plan(&globals.sizes);
        let (dense, rim) = run_levels(together, &Run { part: Some(&within), ..*run }, globals)?;
        if !run.options.heeds_lines() {
            return Ok((dense, rim));
        }
        if run.observer.cancelled() {
            return Err(CascadeError::Cancelled);
        }
        let belongs = |p| within.belongs(p);
        Ok((woven(dense, Cloth { input: &points, ratio, belongs: &belongs }), rim))
    }
}

/// The distinct points of a part in the whole's frame.
struct Input {
    points: Vec<Point>,
    /// Of the cell.
    duplicates: usize,
}

impl Input {
    fn of(part: &Part<'_>, globals: &Globals) -> Self {
        let finite: Vec<Position> =
            part.positions.iter().copied().filter(|p| p.iter().all(|c| c.is_finite())).collect();
        let local = local(&finite, globals.frame);
        let points = distinct(&local);
        let count = |points: &[Point]| points.iter().filter(|p| part.has(**p, globals.frame)).count();
        let duplicates = count(&local) - count(&points);
        Self { points, duplicates }
    }
}

#[cfg(test)]
mod tests;
