//! Clean input is exact, and the result is drawn to it.

use rayon::prelude::*;

use super::flats::Flats;
use super::globals::{once, trust};
use super::measured::Measured;
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Walk, project_to_surface};

/// Width of the Gaussian weights of the input points that draw a point, in the nearest one's spacing.
const WIDTH: f32 = 0.4;
/// Weight of staying: what lies in a wide gap is not drawn by its far rim.
const STAYING: f32 = 0.01;

/// How far each input point lies off the surface that the units made, and whether that tells of the
/// surface's errors or of the input's.
///
/// The units see an input point as one of many that may be noisy, so the surface they make passes it
/// by. Where the distances are as small as those on clean input, the points are right and the surface
/// is wrong; where they are larger, the surface has smoothed noise away.
pub(super) struct Anchors<'a> {
    input: &'a Measured,
    /// From the surface to each input point.
    offsets: Vec<Point>,
    flats: Flats,
    /// From 0, where the input is noisy, to 1, where it is clean.
    pub(super) trust: f32,
}

impl<'a> Anchors<'a> {
    /// Against the surface of what the units `made`, of which `tree` is built. The trust is measured where it is not
    /// `known`.
    pub(super) fn new(input: &'a Measured, made: &[Point], tree: &KdTree, known: &mut Option<f32>) -> Self {
        let mut feet = input.points.clone();
        project_to_surface(&mut feet, made, tree);
        let offset = |(p, foot): (&Point, &Point)| std::array::from_fn(|a| p[a] - foot[a]);
        let offsets: Vec<Point> = input.points.iter().zip(&feet).map(offset).collect();
        let trust = once(known, || trust(&offsets, &input.spacing));
        Self { input, offsets, flats: Flats::of(input), trust }
    }

    /// Moves each of `points`, which lie on the surface, by the offsets of the input points around it, and into their
    /// plane where they lie in one.
    pub(super) fn draw(&self, points: &mut [Point]) {
        points.par_iter_mut().for_each_init(Walk::default, |walk, point| {
            self.input.tree.nearest_next(*point, 1, walk);
            let Some(nearest) = walk.found.first().map(|n| n.index) else { return };
            let narrow = -1.0 / (WIDTH * self.input.spacing[nearest as usize]).powi(2);
            let (mut total, mut offset) = (STAYING, [0.0; 3]);
            for i in [nearest].iter().chain(self.input.around(nearest)).map(|&i| i as usize) {
                let q = self.input.points[i];
                let square: f32 = (0..3).map(|a| (q[a] - point[a]).powi(2)).sum();
                let weight = (square * narrow).exp();
                total += weight;
                offset = std::array::from_fn(|a| offset[a] + weight * self.offsets[i][a]);
            }
            for a in 0..3 {
                point[a] += self.trust * offset[a] / total;
            }
            self.flats.hold(point, self.input, nearest);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::Rng;

    /// Random points of a unit square, each at a height that `height` gives.
    fn square(n: usize, seed: u64, height: impl Fn(&mut Rng) -> f32) -> Vec<Point> {
        let mut random = Rng::new(seed);
        (0..n).map(|_| [random.f64() as f32, random.f64() as f32, height(&mut random)]).collect()
    }

    #[test]
    fn clean_input_draws_the_result_to_it_and_noisy_input_hardly() {
        // The units made a plane 0.001 below the truth: a fiftieth of the input's spacing.
        let made = square(4000, 1, |_| -0.001);
        let tree = KdTree::new(&made);
        let off = |input: Vec<Point>| {
            let input = Measured::new(&input, 0.05);
            let anchors = Anchors::new(&input, &made, &tree, &mut None);
            let mut points = square(500, 2, |_| -0.001);
            anchors.draw(&mut points);
            (anchors.trust, points.iter().map(|p| p[2].abs()).sum::<f32>() / 500.0)
        };
        let (trust, left) = off(square(1000, 3, |_| 0.0));
        assert_eq!(trust, 1.0);
        assert!(left < 0.0003, "{left} of 0.001 left");
        let (trust, left) = off(square(1000, 3, |random| 0.005 * random.normal() as f32));
        assert!(trust < 0.01, "noise is trusted by {trust}");
        assert!((left - 0.001).abs() < 0.0002, "noise drew the points to {left}");
    }

    #[test]
    fn a_point_far_from_all_input_stays() {
        let made = square(1000, 1, |_| -0.001);
        let input = Measured::new(&square(500, 3, |_| 0.0), 0.05);
        let anchors = Anchors::new(&input, &made, &KdTree::new(&made), &mut None);
        let mut points = vec![[1.2, 0.5, 0.0]];
        anchors.draw(&mut points);
        assert!(points[0][2].abs() < 1e-5, "drawn to {:?}", points[0]);
    }
}
