//! Looking at a cloud before working on it: sizes, spacing, density, evenness, noise, outliers. No model.
//!
//! Everything is measured at a random sample of the points, each with its nearest neighbours among
//! all points, so the cost is that of one k-d tree and a sample: O(n log n), well under the time of an
//! upsampling.

mod cell;
mod local;
mod parts;
mod strays;
mod target;

pub use parts::Parts;
pub use strays::{Source, strays};
pub use target::{Goal, GoalError};

use densecloud_cloud::{Frame, FrameError, Position};
use densecloud_formats::Scalar;
use densecloud_geometry::{Rng, indices};

/// Points measured where nobody asks for another number: all medians are then exact to about 1 %.
pub const SAMPLE: usize = 20_000;

/// Points measured where warnings are all that is wanted: enough to see what is unusual.
pub const GLANCE: usize = 2000;

/// What a cloud is like. Lengths are in the cloud's own units.
#[derive(Debug, Clone, PartialEq)]
pub struct Survey {
    /// Points with finite coordinates.
    pub finite: usize,
    /// Points left out because a coordinate is NaN or infinite.
    pub non_finite: usize,
    /// Finite points that coincide with an earlier one, within the resolution of the local frame.
    pub duplicates: usize,
    /// Points that were measured: 0 where there are too few for neighbourhoods, and all measures below are 0.
    pub measured: usize,
    /// The lowest and the highest coordinates.
    pub bounds: [Position; 2],
    /// Distance from a point to its nearest neighbour.
    pub spacing: Spread,
    /// The mean of those distances.
    pub mean_spacing: f64,
    /// Points a square unit of surface, about each point.
    pub density: Spread,
    /// The surface's area: the sum of the points' cells (see [`Goal`]).
    pub area: f64,
    /// Coefficient of variation of the distances to the nearest neighbour, each compared with the density
    /// about it: about 0.1 for an even (Poisson-disk) sampling, 0.5 for a random one.
    pub unevenness: f64,
    /// Root mean square distance of points from the smooth surface that their neighbours suggest: the
    /// median over the cloud.
    pub noise: f64,
    /// Share of points whose neighbours fill a volume rather than a surface, and lie in no sheet of several either:
    /// vegetation, heavy noise.
    pub off_surface: f64,
    /// Share of points whose neighbours lie on a line: scan lines far apart, wires.
    pub on_lines: f64,
    /// Share of points that stand alone: three times further from others than those from each other.
    pub isolated: f64,
}

/// How a measure varies over a cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// One in a hundred is below.
    pub low: f64,
    /// Half are below.
    pub median: f64,
    /// One in a hundred is above.
    pub high: f64,
}

/// What a cloud is like at one of its points. Lengths are in the cloud's own units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// The point.
    pub at: Position,
    /// Distance to the nearest other point.
    pub spacing: f64,
    /// Points a square unit of surface, about it.
    pub density: f64,
}

impl Survey {
    /// Measures a cloud at `sample` of its points. The same cloud gives the same survey on any number of
    /// threads.
    ///
    /// # Errors
    /// There is no finite point, or all are the same.
    ///
    /// # Panics
    /// Above [`MAX_POINTS`](densecloud_geometry::MAX_POINTS).
    pub fn of(positions: &[Position], sample: usize) -> Result<Self, FrameError> {
        Ok(Self::with_places(positions, sample)?.0)
    }

    /// As [`Survey::of`], and the places where it was measured, in no particular order.
    ///
    /// # Errors
    /// As [`Survey::of`].
    ///
    /// # Panics
    /// As [`Survey::of`].
    pub fn with_places(positions: &[Position], sample: usize) -> Result<(Self, Vec<Place>), FrameError> {
        let finite: Vec<Position> =
            positions.iter().copied().filter(|p| p.iter().all(|c| c.is_finite())).collect();
        let frame = Frame::fit(&finite)?;
        let mut bounds = [finite[0], finite[0]];
        for p in &finite {
            for a in 0..3 {
                bounds[0][a] = bounds[0][a].min(p[a]);
                bounds[1][a] = bounds[1][a].max(p[a]);
            }
        }
        let mut parts = Parts::default();
        parts.add(&finite, finite.len(), &frame, sample);
        let places = parts.places();
        Ok((parts.survey(finite.len(), positions.len() - finite.len(), bounds), places))
    }

    /// How far apart the points of a result of so many points will be, about.
    #[must_use]
    pub fn result_spacing(&self, points: u64) -> f64 {
        target::spacing(self.area, points as f64)
    }

    /// What a person should know before upsampling this cloud, a sentence each: where it is not what the
    /// network was made for. Empty for most. `storage` is the type that its coordinates were stored in.
    #[must_use]
    pub fn warnings(&self, storage: Scalar) -> Vec<String> {
        let mut warnings = Vec::new();
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let range = self.density.high / self.density.low;
        if range > 1000.0 {
            warnings.push(format!(
                "the density varies {range:.0}-fold (points a square unit: {:.3e} to {:.3e}); thin parts stay thin",
                self.density.low, self.density.high
            ));
        }
        if self.off_surface > 0.25 {
            warnings.push(format!(
                "{} of the points have neighbours that fill a volume rather than a surface (vegetation, heavy \
                 noise, parts thinner than points are apart): new points there are guesses; filter, smooth or \
                 sample more densely first",
                percent(self.off_surface)
            ));
        }
        if self.on_lines > 0.25 {
            warnings.push(format!(
                "{} of the points lie on lines further apart than the points along them (a scanner's rings): \
                 lines become denser, gaps between them may stay; thin out along the lines first",
                percent(self.on_lines)
            ));
        }
        if self.isolated > 0.02 {
            warnings.push(format!(
                "{} of the points stand alone (outliers?); filter first: those far off are kept as they are, but new \
                 points appear about others",
                percent(self.isolated)
            ));
        }
        warnings.extend(self.unit_warning(storage));
        warnings
    }

    /// Whether the coordinates look like something that is no length, or are too coarse.
    fn unit_warning(&self, storage: Scalar) -> Option<String> {
        let [lo, hi] = self.bounds;
        let side = |a: usize| hi[a] - lo[a];
        let within = |a: usize, limit: f64| lo[a] >= -limit && hi[a] <= limit;
        let across = side(0).max(side(1));
        // A degree is about 111 km: heights in metres dwarf it.
        if within(0, 180.0) && within(1, 90.0) && across < 5.0 && side(2) > 100.0 * across {
            return Some(
                "x and y look like degrees and z like metres; project the cloud to a metric coordinate system first"
                    .into(),
            );
        }
        let largest = lo.iter().chain(&hi).fold(0.0_f64, |m, c| m.max(c.abs()));
        let step = largest * f64::from(f32::EPSILON);
        (storage == Scalar::F32 && step > 0.1 * self.spacing.median).then(|| {
            format!(
                "the coordinates are 32-bit floats, rounded to {step:.2e} where points are {:.2e} apart: detail was \
                 lost before; store the cloud with 64-bit ones",
                self.spacing.median
            )
        })
    }
}

impl Spread {
    fn of(mut values: Vec<f64>) -> Self {
        values.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| {
            let last = values.len().saturating_sub(1) as f64;
            values.get((share * last).round() as usize).copied().unwrap_or(0.0)
        };
        Self { low: at(0.01), median: at(0.5), high: at(0.99) }
    }
}

/// `wanted` of `n` indices at random, always the same; all where there are no more.
fn chosen(n: usize, wanted: usize) -> Vec<u32> {
    let mut indices: Vec<u32> = indices(n).collect();
    if wanted < n {
        let mut random = Rng::new(0);
        for i in 0..wanted {
            let other = i + (random.f64() * (n - i) as f64) as usize;
            indices.swap(i, other.min(n - 1));
        }
        indices.truncate(wanted);
    }
    indices
}

#[cfg(test)]
mod tests;
