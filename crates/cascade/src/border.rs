//! Where the input's surface ends, and how far past its last points that is.

use rayon::prelude::*;

use super::globals::{evenness, once};
use super::measured::Measured;

use densecloud_geometry::{Neighbour, normal, one_sided, quadratic_residual};

/// Past its last points a surface is taken to go on for this share of a cell's usual reach, if the input is even: such a
/// sample has points on the border itself. A random one ends before it, and reaches past its last points as far as
/// anywhere else.
const PAST: f32 = 0.15;
/// Around a border the input lies on one smooth sheet, to this share of its spacing: on an open border of a clean scan to
/// 0.03, on the edge of a blade, whose sides are too near each other to be told apart there, to 0.05 and more.
const SMOOTH: f32 = 0.05;
/// Points that this is measured with, the nearest one itself among them. Fewer see the blade as flat.
const SHEET: usize = 25;

/// What an input tells of its borders.
pub(super) struct Borders {
    /// How sure it is, from 0 to 1, that the input's points lie on the borders themselves.
    even: f32,
    /// For each input point, whether the surface may end near it: whether it, or one around it, lies on a border of one
    /// smooth sheet. What is not one sheet can look as if it ended, and goes on at the back.
    possible: Vec<bool>,
}

impl Borders {
    /// Finds the borders of an input by its evenness, which is measured where it is not known. O(n), and a
    /// neighbourhood's search and fit for each point on a border.
    pub(super) fn of(input: &Measured, known: &mut Option<f32>) -> Self {
        let even = once(known, || evenness(nearest_distances(input)));
        let ends = |found: &mut Vec<_>, i: usize| {
            found.clear();
            let ring = [i as u32].into_iter().chain(input.around(i as u32).iter().copied());
            found.extend(ring.map(|index| Neighbour { index, distance_squared: 0.0 }));
            if !one_sided(&input.points, i, found, normal(&input.points, found)) {
                return false;
            }
            input.tree.nearest(input.points[i], SHEET, found);
            (quadratic_residual(&input.points, found) as f32) < SMOOTH * input.spacing[i]
        };
        let count = if even > 0.0 { input.points.len() } else { 0 };
        let ends: Vec<bool> = (0..count).into_par_iter().map_init(Vec::new, ends).collect();
        let around = |i: usize| ends[i] || input.around(i as u32).iter().any(|&j| ends[j as usize]);
        Self { even, possible: (0..count).map(around).collect() }
    }

    /// How sure it is, from 0 to 1, that the surface ends where the input point `i` has neighbours on one side only.
    pub(super) fn ends(&self, i: u32) -> f32 {
        if self.possible.get(i as usize).is_some_and(|p| *p) { self.even } else { 0.0 }
    }

    /// The share of a cell's reach that the surface goes on past a point whose nearest input point is `i`, where that one
    /// has neighbours on one side only.
    pub(super) fn past(&self, i: u32) -> f32 {
        1.0 - (1.0 - PAST) * self.ends(i)
    }
}

/// The input points' distances to the nearest other, in their spacing.
fn nearest_distances(input: &Measured) -> impl Iterator<Item = f32> {
    (0_u32..).zip(&input.points).filter_map(|(i, p)| {
        let q = input.points[*input.around(i).first()? as usize];
        let square: f32 = (0..3).map(|a| (q[a] - p[a]).powi(2)).sum();
        Some(square.sqrt() / input.spacing[i as usize])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::Point;
    use densecloud_geometry::{Rng, farthest_point_sampling};

    /// `n` points with x and y in the unit square, at a height.
    fn square(n: usize, even: bool, height: impl Fn(f32, &mut Rng) -> f32) -> Vec<Point> {
        let mut random = Rng::new(n as u64);
        let many = if even { 8 * n } else { n };
        let mut point = || {
            let [x, y] = [random.f64() as f32, random.f64() as f32];
            [x, y, height(x, &mut random)]
        };
        let all: Vec<Point> = (0..many).map(|_| point()).collect();
        farthest_point_sampling(&all, n, 0).iter().map(|&i| all[i as usize]).collect()
    }

    #[test]
    fn an_even_surface_ends_at_its_points_and_a_random_one_past_them() {
        let past = |even| {
            let points = square(2000, even, |_, _| 0.0);
            let input = Measured::of(&points);
            let borders = Borders::of(&input, &mut None);
            let at = |wanted: fn(f32) -> bool| {
                let found = (0_u32..).zip(&input.points).filter(move |(_, p)| wanted(p[0].min(1.0 - p[0])));
                found.map(|(i, _)| borders.past(i)).fold(0.0, f32::max)
            };
            (at(|x| x < 0.005), at(|x| x > 0.1))
        };
        assert!(past(true).0 < 0.2, "{:?}", past(true));
        assert_eq!((past(true).1, past(false)), (1.0, (1.0, 1.0)));
    }

    #[test]
    fn a_smooth_sheet_may_end_and_noise_and_the_edge_of_a_blade_may_not() {
        // The spacing is 0.025.
        let possible = |points: &[Point]| {
            let input = Measured::of(points);
            let borders = Borders::of(&input, &mut None);
            let at_border =
                (0_u32..).zip(&input.points).filter(|(_, p)| p[0] < 0.02).map(|(i, _)| borders.past(i) < 1.0);
            let at_border: Vec<bool> = at_border.collect();
            at_border.iter().filter(|p| **p).count() as f64 / at_border.len() as f64
        };
        let bent = possible(&square(2000, true, |x, _| 0.3 * x * x));
        assert!(bent > 0.95, "{bent}");
        let noisy = possible(&square(2000, true, |_, random| 0.005 * random.normal() as f32));
        assert!(noisy < 0.05, "{noisy}");
        // Two sides that meet at the edge, at 16 degrees.
        let blade = |x: f32, random: &mut Rng| if random.f64() < 0.5 { 0.14 * x } else { -0.14 * x };
        let blade = possible(&square(2000, true, blade));
        assert!(blade < 0.2, "{blade}");
    }
}
