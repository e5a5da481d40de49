//! Where the input lies in a plane, the result does.
//!
//! A unit sees a patch's border as the end of a surface that may bend, and a moving least squares surface past its points
//! follows their errors. An input point and those around it tell how much the surface bends there: new points beside
//! them lie off their plane by no more than they do, and a little.

use rayon::prelude::*;

use super::measured::Measured;
use densecloud_cloud::Point;
use densecloud_geometry::{Neighbour, Plane};

/// How much further a new point may lie off the plane than the input points there, as a share of the range of these.
const MORE: f32 = 0.5;
/// A new point further off the plane than this, in the spacing there, is of another surface.
const OTHER: f32 = 1.0;
/// Input points whose middle variance is a smaller share of their largest lie on a line, and tell of a plane only where
/// they lie in it exactly: where their least variance is at most [`EXACT`] of the middle one.
const LINE: f64 = 0.05;
const EXACT: f64 = 1e-4;

/// The planes of all input points and of those around them.
pub(super) struct Flats(Vec<Option<Flat>>);

/// The plane through an input point.
struct Flat {
    normal: Point,
    /// The lowest and the highest that a new point may lie along the normal, seen from the input point.
    heights: [f32; 2],
    /// Further off is another surface.
    other: f32,
}

impl Flats {
    /// A principal component analysis of nine points for each input point.
    pub(super) fn of(input: &Measured) -> Self {
        let flat = |near: &mut Vec<Neighbour>, i: u32| {
            near.clear();
            let all = [i].into_iter().chain(input.around(i).iter().copied());
            near.extend(all.map(|index| Neighbour { index, distance_squared: 0.0 }));
            Flat::of(input, i, near)
        };
        let count = u32::try_from(input.points.len()).unwrap_or(u32::MAX);
        Self((0..count).into_par_iter().map_init(Vec::new, flat).collect())
    }

    /// Moves `point`, whose nearest input point is `nearest`, back to where the surface may be.
    pub(super) fn hold(&self, point: &mut Point, input: &Measured, nearest: u32) {
        let Some(Some(flat)) = self.0.get(nearest as usize) else { return };
        let origin = input.points[nearest as usize];
        let height: f32 = (0..3).map(|a| flat.normal[a] * (point[a] - origin[a])).sum();
        let [low, high] = flat.heights;
        if height.abs() > flat.other || (low..=high).contains(&height) {
            return;
        }
        let by = height.clamp(low, high) - height;
        point.iter_mut().zip(flat.normal).for_each(|(c, n)| *c += by * n);
    }
}

impl Flat {
    /// Of the input point `i` and those around it, `near`.
    fn of(input: &Measured, i: u32, near: &[Neighbour]) -> Option<Self> {
        let plane = Plane::fit(&input.points, near);
        let [least, middle, most] = plane.variances;
        let tells = middle >= LINE * most || least <= EXACT * middle && middle >= EXACT * most;
        if near.len() < 4 || !tells {
            return None;
        }
        let origin = input.points[i as usize];
        let mut heights = [0.0_f32; 2];
        for n in near {
            let height = plane.height(origin, input.points[n.index as usize]) as f32;
            heights = [heights[0].min(height), heights[1].max(height)];
        }
        let more = MORE * (heights[1] - heights[0]);
        Some(Self {
            normal: plane.normal.map(|c| c as f32),
            heights: [heights[0] - more, heights[1] + more],
            other: OTHER * input.spacing[i as usize],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::Rng;

    /// Random points over the unit square, at a height.
    fn over_square(n: usize, seed: u64, height: impl Fn(f32, f32) -> f32) -> Vec<Point> {
        let mut random = Rng::new(seed);
        let mut at = || {
            let (x, y) = (random.f64() as f32, random.f64() as f32);
            [x, y, height(x, y)]
        };
        (0..n).map(|_| at()).collect()
    }

    /// How far points at that height over the square are off it when they are held by such input.
    fn held(input: &[Point], height: impl Fn(f32, f32) -> f32) -> Vec<f32> {
        let input = Measured::new(input, 0.03);
        let flats = Flats::of(&input);
        let mut points = over_square(500, 7, height);
        let moved = points.iter_mut().map(|p| {
            let before = *p;
            let nearest = input.tree.nearest_one(before).expect("a point").index;
            flats.hold(p, &input, nearest);
            (before[2] - p[2]).abs()
        });
        moved.collect()
    }

    #[test]
    fn beside_a_plane_points_lie_in_it() {
        let plane = over_square(1000, 1, |_, _| 0.25);
        let worst =
            held(&plane, |_, _| 0.26).into_iter().fold(0.0_f32, |most, by| most.max((by - 0.01).abs()));
        assert!(worst < 1e-6, "{worst}");
        // Another surface, further off than the points of this one from each other.
        assert!(held(&plane, |_, _| 0.29).iter().all(|by| *by == 0.0));
    }

    #[test]
    fn beside_a_curved_or_noisy_surface_they_stay() {
        let bowl = |x: f32, y: f32| 0.4 * ((x - 0.5).powi(2) + (y - 0.5).powi(2));
        let moved = held(&over_square(1000, 1, bowl), bowl);
        let mean = moved.iter().sum::<f32>() / 500.0;
        assert!(mean < 2e-5, "{mean}");
        let mut random = Rng::new(5);
        let noisy: Vec<Point> = over_square(1000, 1, |_, _| 0.0)
            .into_iter()
            .map(|[x, y, _]| [x, y, 0.005 * random.normal() as f32])
            .collect();
        let moved = held(&noisy, |_, _| 0.002).iter().filter(|by| **by > 0.0).count();
        assert!(moved < 25, "{moved}");
    }

    #[test]
    fn a_line_tells_of_no_plane() {
        let line: Vec<Point> = (0..50).map(|i| [i as f32 * 0.02, 0.0, 0.0]).collect();
        let input = Measured::new(&line, 0.02);
        assert!(Flats::of(&input).0.iter().all(Option::is_none));
    }
}
