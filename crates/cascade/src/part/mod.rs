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
use crate::input::distinct;
use crate::level::{Run, run_levels};
use crate::share::Neighbourhoods;
use crate::sites::Sites;
use crate::weave::{Cloth, woven};
use crate::{CascadeError, CascadeOptions, LevelRunner, Observer, Spread};
use densecloud_cloud::{Point, Position};
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
    let mut globals = part.whole.globals().clone();
    let input = Input::of(part, &globals);
    let (apart_of_all, together) = {
        let parted = Parted::of(&input.points, runner.shape().neighbours + 1, &mut globals);
        (parted.apart, parted.together)
    };
    let frame = globals.frame;
    let belongs = |p: &Point| part.partition.cell_of(frame.to_world(*p)) == part.cell;
    let apart: Vec<Point> = apart_of_all.into_iter().filter(belongs).collect();
    let inside = together.points.iter().filter(|p| belongs(p)).count();
    let size = usize::try_from(part.size).unwrap_or(usize::MAX);
    check_count(size)?;
    let needed = runner.shape().neighbours + 1;
    if together.points.len() < needed || inside + apart.len() > size {
        let (distinct, duplicates) = (together.points.len(), input.duplicates);
        return Err(CascadeError::TooFewPoints { distinct, duplicates, needed });
    }
    let size = size - apart.len();
    let (dense, rim) = if inside == 0 {
        (Vec::new(), Vec::new())
    } else {
        let local = local_spacing(&together, options.spread, &mut globals)?;
        let (levels, ratio) = (part.whole.levels(), size as f64 / inside as f64);
        let within = Within::new(part, globals.frame, ratio, size, levels, (&together.points, &local));
        drop(local);
        let of_level =
            |level| within.size_of_level(together.points.len() << level, level, level + 1 == levels);
        globals.plan((0..levels).map(of_level).collect());
        observer.plan(&globals.sizes);
        let on_lines = options.heeds_lines().then(|| together.points.clone());
        let run = Run { options, runner, observer, part: Some(&within) };
        let (mut dense, rim) = run_levels(together, &run, &mut globals)?;
        if let Some(input) = on_lines {
            if observer.cancelled() {
                return Err(CascadeError::Cancelled);
            }
            let belongs = |p| within.belongs(p);
            dense = woven(dense, Cloth { input: &input, ratio, belongs: &belongs });
        }
        (dense, rim)
    };
    let dense = joined(dense, &apart);
    if dense.len() as u64 != part.size {
        // All points of the cell lie apart, and more are wanted.
        let (distinct, duplicates) = (inside, input.duplicates);
        return Err(CascadeError::TooFewPoints { distinct, duplicates, needed });
    }
    let world = |points: Vec<Point>| points.iter().map(|p| frame.to_world(*p)).collect();
    Ok(UpsampledPart {
        positions: world(dense),
        rim: world(rim),
        duplicates: input.duplicates,
        apart: apart.len(),
    })
}

/// The spacing of the input at each of its points.
fn local_spacing(together: &Sites, spread: Spread, globals: &mut Globals) -> Result<Vec<f32>, CascadeError> {
    let field = globals.field.clone();
    let of = Neighbourhoods::of(together, &mut globals.usual_point, field.as_deref())?;
    let usual = || (0.5 * globals.usual_point.unwrap_or_default()).exp();
    Ok(match spread {
        Spread::Neighbourhood => of.spacing,
        Spread::Area => vec![usual(); together.points.len()],
    })
}

/// The distinct points of a part in the whole's frame.
struct Input {
    points: Vec<Point>,
    /// Of the cell.
    duplicates: usize,
}

impl Input {
    fn of(part: &Part<'_>, globals: &Globals) -> Self {
        let finite = part.positions.iter().filter(|p| p.iter().all(|c| c.is_finite()));
        let local: Vec<Point> = finite.map(|p| globals.frame.to_local(*p).map(|c| c + 0.0)).collect();
        let points = distinct(&local);
        let belongs = |p: &&Point| part.partition.cell_of(globals.frame.to_world(**p)) == part.cell;
        let count = |points: &[Point]| points.iter().filter(belongs).count();
        let duplicates = count(&local) - count(&points);
        Self { points, duplicates }
    }
}

#[cfg(test)]
mod tests;
