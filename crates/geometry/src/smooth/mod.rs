//! Denoising: points are moved onto the surface that those around them suggest, where they are noisy.

mod bilateral;
mod mls;
mod wlop;

use super::around::around_each;
use super::{KdTree, Neighbour, quadratic_residual};
use densecloud_cloud::Point;

/// How points are moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Smoothing {
    /// Along the normal onto a moving least squares surface that gives outlying neighbours little weight (Fleishman et
    /// al., "Robust moving least-squares fitting with sharp features", 2005).
    MovingLeastSquares,
    /// Along the normal by the mean height of the neighbours, of which those of a like height count most (Fleishman et al.,
    /// "Bilateral mesh denoising", 2003; Digne and de Franchis, "The bilateral filter for point clouds", 2017).
    Bilateral,
    /// To the local median, and apart from each other: weighted locally optimal projection (Huang et al., "Consolidation
    /// of unorganized point clouds for surface reconstruction", 2009). Evens the sampling out as well.
    Wlop,
}

/// What smoothing made of points.
#[derive(Debug, Clone, PartialEq)]
pub struct Smoothed {
    /// Where each point is now.
    pub points: Vec<Point>,
    /// How far each point and those around it lay off a smooth surface (root mean square), in local spacings; infinite
    /// where there is no surface.
    pub noise: Vec<f32>,
}

/// Neighbours that a place has at least, and at most.
const LEAST: usize = 20;
const MOST: usize = 640;
/// Residual of a quadratic surface, in multiples of the neighbourhood's reach, up to which it is one: a neighbourhood
/// several times as wide as its noise is thick. Of the fewest a volume often has less than that by chance.
const FLAT: f32 = 0.28;
const FLAT_OF_FEW: f32 = 0.2;

/// Neighbours whose noise is compared with the gate, and the share of them that are quieter: creases and thin parts are no noise,
/// and are narrower than that.
const AROUND: usize = 64;
const QUIETER: f32 = 0.25;

/// Moves each point, by the noise about it in local spacings: none up to `gate`, all the way from twice that on. A place is as
/// many neighbours, 20 to 640, as make it much wider than its noise; where even the most do not, there is no surface
/// and nothing moves (leaves, outliers). The noise is the lower quartile of 64 places'.
///
/// 10 to 100 microseconds a point, ten times that for WLOP; on all threads of the current pool, and the result does not
/// depend on their number.
#[must_use]
pub fn smooth(points: &[Point], method: Smoothing, gate: f32) -> Smoothed {
    let tree = KdTree::new(points);
    let places = around_each(&tree, points, LEAST, |i, near| Place::of(&tree, points, i, near));
    let noise = around_each(&tree, points, AROUND, |_, near| {
        let mut noise: Vec<f32> = near.iter().map(|n| places[n.index as usize].noise).collect();
        noise.sort_unstable_by(f32::total_cmp);
        noise[(QUIETER * noise.len() as f32) as usize]
    });
    let goals = match method {
        Smoothing::MovingLeastSquares => each_place(&tree, points, &places, mls::foot),
        Smoothing::Bilateral => each_place(&tree, points, &places, bilateral::mean),
        Smoothing::Wlop => wlop::project(&tree, points, &places),
    };
    let moved = |(i, (p, goal)): (usize, (&Point, &Point))| {
        let share = if places[i].neighbours == 0 { 0.0 } else { share(noise[i], gate) };
        std::array::from_fn(|a| p[a] + share * (goal[a] - p[a]))
    };
    Smoothed {
        points: points.iter().zip(&goals).enumerate().map(moved).collect(),
        noise: places.iter().map(|place| place.noise).collect(),
    }
}

/// How much of the way a point goes where it is so noisy.
fn share(noise: f32, gate: f32) -> f32 {
    if gate <= 0.0 {
        return 1.0;
    }
    let t = (noise / gate - 1.0).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// A point's neighbourhood, at the scale of its noise.
#[derive(Debug, Clone, Copy)]
struct Place {
    /// How many points; 0 where there is no surface.
    neighbours: usize,
    /// In local spacings; infinite where there is no surface.
    noise: f32,
    /// The same as a length.
    residual: f32,
}

impl Place {
    const NONE: Self = Self { neighbours: 0, noise: f32::INFINITY, residual: 0.0 };

    fn of(tree: &KdTree, points: &[Point], i: usize, near: &mut Vec<Neighbour>) -> Self {
        let mut neighbours = LEAST;
        loop {
            let reach = near.last().map_or(0.0, |n| n.distance_squared).sqrt();
            let residual = quadratic_residual(points, near) as f32;
            if near.len() < neighbours || reach == 0.0 {
                return Self::NONE;
            }
            let flat = if neighbours == LEAST { FLAT_OF_FEW } else { FLAT };
            if residual <= flat * reach {
                let spacing = reach * (std::f32::consts::PI / neighbours as f32).sqrt();
                return Self { neighbours, noise: residual / spacing, residual };
            }
            if neighbours == MOST {
                return Self::NONE;
            }
            neighbours *= 2;
            tree.nearest(points[i], neighbours, near);
        }
    }
}

/// Where each point's place would have it.
fn each_place(
    tree: &KdTree,
    points: &[Point],
    places: &[Place],
    goal: impl Fn(&[Point], &[Neighbour], &Place) -> Point + Sync,
) -> Vec<Point> {
    around_each(tree, points, LEAST, |i, near| {
        let place = &places[i];
        if place.neighbours == 0 {
            return points[i];
        }
        if place.neighbours > LEAST {
            tree.nearest(points[i], place.neighbours, near);
        }
        goal(points, near, place)
    })
}

/// `point` moved by `height` along `normal`.
fn lifted(point: Point, normal: [f64; 3], height: f64) -> Point {
    std::array::from_fn(|a| (f64::from(point[a]) + height * normal[a]) as f32)
}

/// e^-x for x of 0 or more, to 1e-6: its Taylor polynomial at x / 256, to the 256th. The standard library's is the system's,
/// and other systems have others.
fn decay(x: f64) -> f64 {
    if x > 30.0 {
        return 0.0;
    }
    let y = -x / 256.0;
    let root = 1.0 + y * (1.0 + y / 2.0 * (1.0 + y / 3.0 * (1.0 + y / 4.0 * (1.0 + y / 5.0))));
    (0..8).fold(root, |power, _| power * power)
}

#[cfg(test)]
mod tests;
