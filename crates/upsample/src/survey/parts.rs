//! A survey of a cloud in parts, each with the points around it.

use rayon::prelude::*;

use super::local::Local;
use super::{Place, Spread, Survey, chosen};
use densecloud_cascade::distinct;
use densecloud_cloud::{Frame, Point, Position};
use densecloud_geometry::KdTree;

/// The surface over the sum of cells: what curves between the points is larger than what they show. The
/// median over held-out shapes (docs/inspect.md).
const UNSEEN: f64 = 1.02;

/// What was measured of the parts of a cloud.
#[derive(Default)]
pub struct Parts {
    measured: Vec<Local>,
    /// The surface's area in the parts.
    area: f64,
    finite: usize,
    duplicates: usize,
}

impl std::fmt::Debug for Parts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Parts")
            .field("finite", &self.finite)
            .field("area", &self.area)
            .finish_non_exhaustive()
    }
}

impl Parts {
    /// Measures `sample` of the first `own` of finite positions, and gives the area of the surface that these are on; the
    /// others lie around them. O(n log n).
    ///
    /// # Panics
    /// Above [`MAX_POINTS`](densecloud_geometry::MAX_POINTS).
    pub fn add(&mut self, positions: &[Position], own: usize, frame: &Frame, sample: usize) -> f64 {
        let local: Vec<Point> = positions.iter().map(|p| frame.to_local(*p).map(|c| c + 0.0)).collect();
        let points = distinct(&local);
        let distinct_own = if own == local.len() { points.len() } else { distinct(&local[..own]).len() };
        drop(local);
        let tree = KdTree::new(&points);
        let mut measured: Vec<Local> = chosen(distinct_own, sample)
            .par_iter()
            .filter_map(|&i| Local::measure(&points, &tree, frame, i as usize))
            .collect();
        let cell = mean(&measured.iter().map(|m| m.cell).collect::<Vec<f64>>());
        let area = UNSEEN * cell * distinct_own as f64;
        self.area += area;
        self.finite += own;
        self.duplicates += own - distinct_own;
        self.measured.append(&mut measured);
        area
    }

    /// Where it was measured, and what the cloud is like there.
    pub(super) fn places(&self) -> Vec<Place> {
        let place = |m: &Local| Place { at: m.at, spacing: m.nearest, density: m.density };
        self.measured.iter().map(place).collect()
    }

    /// The survey of a cloud of so many points, of which the parts are all, or some that stand for all.
    #[must_use]
    pub fn survey(self, finite: usize, non_finite: usize, bounds: [Position; 2]) -> Survey {
        let Self { measured, area, .. } = self;
        // 1 where the parts are all.
        let share = finite as f64 / self.finite.max(1) as f64;
        let of_measured = |what: fn(&Local) -> bool| {
            measured.iter().filter(|m| what(m)).count() as f64 / measured.len().max(1) as f64
        };
        let each = |what: fn(&Local) -> f64| measured.iter().map(what).collect::<Vec<f64>>();
        let relative = each(|m| m.nearest * m.density.sqrt());
        let usual = mean(&relative);
        let variance = mean(&relative.iter().map(|r| (r - usual).powi(2)).collect::<Vec<f64>>());
        Survey {
            finite,
            non_finite,
            duplicates: (share * self.duplicates as f64).round() as usize,
            measured: measured.len(),
            bounds,
            spacing: Spread::of(each(|m| m.nearest)),
            mean_spacing: mean(&each(|m| m.nearest)),
            density: Spread::of(each(|m| m.density)),
            area: area * share,
            unevenness: if usual > 0.0 { variance.sqrt() / usual } else { 0.0 },
            noise: Spread::of(each(|m| m.noise)).median,
            off_surface: of_measured(|m| m.off_surface),
            on_lines: of_measured(|m| m.on_line),
            isolated: of_measured(|m| m.isolated),
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
