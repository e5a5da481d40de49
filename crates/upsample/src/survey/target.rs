//! From a wish for spacing or density to a number of points.

use super::{SAMPLE, Survey};
use densecloud_cascade::{MAX_RATIO, Target};
use densecloud_cloud::{FrameError, Position};

/// The mean distance of a result's points to their nearest neighbours, in units of the square root of
/// the area that each has. 1.07 would be a lattice of triangles, 0.5 chance.
/// `docs/inspect.md` has the measurements.
const EVENNESS: f64 = 0.885;

/// How dense a result should be.
///
/// [`Goal::Spacing`] and [`Goal::Density`] need the surface's area. It is the sum of the points' Voronoi
/// cells, each in the tangent plane of its point, so it needs no sampling pattern, only that points lie on
/// a surface and that gaps between them are not meant to be surface. At a border a cell reaches half a
/// spacing beyond its point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Goal {
    /// As many points as that.
    Target(Target),
    /// So far from each other, in the cloud's units: the mean distance to the nearest neighbour.
    Spacing(f64),
    /// So many for a square unit of surface.
    Density(f64),
}

/// Why there is no number of points for a wish.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GoalError {
    /// Not a positive number.
    #[error("{what} {value} is not a positive number")]
    NotPositive {
        /// `spacing` or `density`.
        what: &'static str,
        /// What was given.
        value: f64,
    },
    /// Outside what the cascade does.
    #[error(
        "that takes {} points, {} for each of the {from}; from 1 to {MAX_RATIO} is possible here: \
         spacing {} to {}, density {} to {}",
        if *points < 1e7 { format!("{points:.0}") } else { readable(*points) },
        readable(points / *from as f64), readable(spacing[0]), readable(spacing[1]), readable(density[0]),
        readable(density[1])
    )]
    OutOfRange {
        /// Points that the wish takes.
        points: f64,
        /// Finite points in the cloud.
        from: usize,
        /// The smallest and the largest spacing that is possible.
        spacing: [f64; 2],
        /// The lowest and the highest density that is possible.
        density: [f64; 2],
    },
    /// There is no surface to measure.
    #[error(transparent)]
    Cloud(#[from] FrameError),
}

/// A positive number for people: four digits that matter, or all before the point, and a power of ten where there would be more than
/// seven of those, or zeros behind the point.
fn readable(number: f64) -> String {
    if !(1e-3..1e7).contains(&number) {
        return format!("{number:.3e}");
    }
    // From -3 to 6.
    let decimals = (3 - number.log10().floor() as i32).max(0) as usize;
    let text = format!("{number:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// The mean distance to the nearest neighbour of so many points on a surface of this area.
pub(super) fn spacing(area: f64, points: f64) -> f64 {
    EVENNESS * (area / points.max(1.0)).sqrt()
}

impl Goal {
    /// The number of points that meets it; O(n log n) for a spacing or a density, else at once.
    ///
    /// # Errors
    /// [`GoalError`].
    pub fn target(self, positions: &[Position]) -> Result<Target, GoalError> {
        self.target_by(|| Survey::of(positions, SAMPLE))
    }

    /// As [`target`](Self::target), by a survey that is made where the goal needs one.
    ///
    /// # Errors
    /// The same.
    pub fn target_by(self, survey: impl FnOnce() -> Result<Survey, FrameError>) -> Result<Target, GoalError> {
        let (what, value) = match self {
            Self::Target(target) => return Ok(target),
            Self::Spacing(spacing) => ("spacing", spacing),
            Self::Density(density) => ("density", density),
        };
        if !(value.is_finite() && value > 0.0) {
            return Err(GoalError::NotPositive { what, value });
        }
        let survey = survey()?;
        let points = match self {
            Self::Density(density) => density * survey.area,
            _ => survey.area * (EVENNESS / value).powi(2),
        };
        let from = survey.finite as f64;
        let most = from * f64::from(MAX_RATIO);
        if !(from..=most).contains(&points.round()) {
            let spacing = |n: f64| spacing(survey.area, n);
            return Err(GoalError::OutOfRange {
                points,
                from: survey.finite,
                spacing: [spacing(most), spacing(from)],
                density: [from / survey.area, most / survey.area],
            });
        }
        Ok(Target::Points(points.round() as u64))
    }
}
