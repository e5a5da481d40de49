//! How likely each point of a result lies on the surface, by the input around it.
//!
//! Nobody knows the surface but through the input, so what tells of a point is how near the input is, how far around it one
//! has to go for enough of it, and whether that lies in a sheet. A logistic model of these says how likely the point lies
//! within one spacing of the surface; its constants were fitted on shapes and on scans whose surface is known better than
//! by the input (`score confidence --fit`, in `training`).

use rayon::prelude::*;

use super::apart::Parted;
use super::globals::{Globals, median};
use super::input::Input;
use super::sites::Sites;
use densecloud_cloud::{Point, Position};
use densecloud_geometry::{KdTree, Neighbour, Plane, Walk};

/// Others of an input point whose mean distance is its spacing, and input points that surround a result's point.
const AROUND: usize = 8;
/// Others of an input point that tell whether it lies in a sheet.
const SHEET: usize = 16;
/// The distance from the nearest input point, in spacings, that counts half of the most that a distance counts.
const HALF: f32 = 0.5;
/// Eight points are nowhere nearer than this, in spacings, so that logarithms end.
const NEAREST: f32 = 0.3;
/// A sheet thinner than this, in the result's spacing, is as good as one of no thickness.
const THINNEST: f32 = 0.02;
/// Result points between two questions whether to stop.
const BLOCK: usize = 1 << 16;

/// The constants of the model: one alone, then one for each of [`Support::features`].
const CONSTANT: f32 = 11.1731;
const WEIGHTS: [f32; FEATURES] = [-9.0120, -3.8998, -3.4054, 0.5559, -1.4350, -1.5274];
const FEATURES: usize = 6;

/// For each of the points that were made of an input, how likely it lies within one spacing of the surface, from 0 to 1. The
/// spacing is the result's there: the input's, over the root of the ratio of the points made to the distinct points of the
/// input. Where the input is a part and its halo, and only the part's own points were made, `ratio` says how many the whole
/// has for each of its points. The input's spacing is the mean distance of a point to its 8 nearest others; there: the median of it over the
/// nearest input point and its 8 nearest others. Points of the input that lie apart from all surface have no part in any of
/// this, and where one is among the points made, it is as unlikely as it is far from the others.
///
/// Each value depends on the input around the point, on the ratio, and on which input points lie apart; not on the other
/// points made. 0 where the input has fewer than 18 distinct points on surfaces, too few to tell.
///
/// None where `cancelled` says so in between, or where the input has no extent.
///
/// Cost: two trees and a few neighbours of each point of the input, eight neighbours and a plane of each point made: about
/// three microseconds of a core a point.
#[must_use]
pub fn confidence(
    input: &[Position],
    made: &[Position],
    ratio: Option<f64>,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<f32>> {
    let Input { frame, points, .. } = Input::prepare(input).ok()?;
    let all = ratio.map_or(made.len(), |ratio| (ratio * input.len() as f64).round() as usize);
    let ratio = all as f32 / points.len() as f32;
    let Parted { together, .. } = Parted::of(&points, SHEET + 2, &mut Globals::new(frame));
    if together.points.len() < SHEET + 2 {
        return Some(vec![0.0; made.len()]);
    }
    let support = Support::of(&together.sites, ratio.sqrt());
    let mut confidence = Vec::with_capacity(made.len());
    for block in made.chunks(BLOCK) {
        if cancelled() {
            return None;
        }
        let of = |walk: &mut Walk, p: &Position| likely(support.features(frame.to_local(*p), walk));
        confidence.par_extend(block.par_iter().map_init(Walk::default, of));
    }
    Some(confidence)
}

/// The model's probability for a point of these features.
fn likely(features: [f32; FEATURES]) -> f32 {
    let sum: f32 = WEIGHTS.iter().zip(features).map(|(weight, feature)| weight * feature).sum();
    1.0 / (1.0 + (-CONSTANT - sum).exp())
}

/// The input's points on surfaces, and what each is like.
struct Support<'a> {
    tree: &'a KdTree,
    points: &'a [Point],
    /// The input's spacing there.
    spacing: Vec<f32>,
    /// How far the points around each are from lying in a plane, from 0 to 1.
    rough: Vec<f32>,
    /// The root of the ratio: what the result's spacing is shorter by.
    root: f32,
}

impl<'a> Support<'a> {
    /// Of more than [`SHEET`] distinct points. O(n log n).
    fn of(Sites { points, tree, .. }: &'a Sites, root: f32) -> Self {
        let own = |walk: &mut Walk, p: &Point| {
            tree.nearest_next(*p, SHEET + 1, walk);
            (mean_distance(&walk.found[1..=AROUND]), roughness(&Plane::fit(points, &walk.found[1..])))
        };
        let (own, rough): (Vec<f32>, Vec<f32>) = points.par_iter().map_init(Walk::default, own).unzip();
        let usual = |walk: &mut Walk, p: &Point| {
            tree.nearest_next(*p, AROUND + 1, walk);
            let own: Vec<f32> = walk.found.iter().map(|n| own[n.index as usize]).collect();
            median(&own)
        };
        let spacing = points.par_iter().map_init(Walk::default, usual).collect();
        Self { tree, points, spacing, rough, root }
    }

    /// What the model goes by.
    fn features(&self, p: Point, walk: &mut Walk) -> [f32; FEATURES] {
        self.tree.nearest_next(p, AROUND, walk);
        let Self { points, spacing, rough, root, .. } = self;
        let nearest = walk.found[0].index as usize;
        let spacing = spacing[nearest];
        let distance = walk.found[0].distance_squared.sqrt() / spacing;
        let around = Plane::fit(points, &walk.found);
        let thickness = around.variances[0].sqrt() as f32 / spacing * root;
        [
            distance / (HALF + distance),
            (mean_distance(&walk.found) / spacing).max(NEAREST).ln(),
            roughness(&around),
            thickness.max(THINNEST).ln(),
            rough[nearest],
            root.ln(),
        ]
    }
}

fn mean_distance(near: &[Neighbour]) -> f32 {
    near.iter().map(|n| n.distance_squared.sqrt()).sum::<f32>() / near.len() as f32
}

/// The extent of points off their plane, as a share of their lesser extent in it.
fn roughness(Plane { variances, .. }: &Plane) -> f32 {
    (variances[0] / variances[1].max(f64::MIN_POSITIVE)).sqrt() as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::Rng;

    /// `n` points of a square of side 1, far from the origin, each off it by a normal number times `noise`.
    fn square(n: usize, seed: u64, noise: f64) -> Vec<Position> {
        let mut random = Rng::new(seed);
        (0..n).map(|_| [5e5 + random.f64(), 4e6 - random.f64(), 100.0 + noise * random.normal()]).collect()
    }

    fn of(input: &[Position], made: &[Position]) -> Vec<f32> {
        confidence(input, made, None, &|| false).expect("an input with an extent")
    }

    fn mean(values: &[f32]) -> f32 {
        values.iter().sum::<f32>() / values.len() as f32
    }

    #[test]
    fn a_plane_is_sure_and_what_is_off_it_is_not() {
        let input = square(2000, 1, 0.0);
        let mut made = square(8000, 2, 0.0);
        // A spacing of the input is 0.025.
        for (off, least, most) in [(0.0, 0.9, 1.0), (0.05, 0.0, 0.3), (0.3, 0.0, 0.01)] {
            made.iter_mut().for_each(|p| p[2] = 100.0 + off);
            let sure = mean(&of(&input, &made));
            assert!((least..=most).contains(&sure), "{sure} where all are off by {off}");
        }
    }

    #[test]
    fn noise_makes_it_less_sure() {
        let sure = [0.0, 0.01, 0.03].map(|noise| mean(&of(&square(2000, 1, noise), &square(8000, 2, noise))));
        assert!(sure[0] > sure[1] + 0.03 && sure[1] > sure[2] + 0.1, "{sure:?}");
    }

    #[test]
    fn outliers_that_are_kept_are_not_sure() {
        let mut random = Rng::new(3);
        let outliers: Vec<Position> =
            (0..20).map(|_| [5e5 + random.f64(), 4e6 - random.f64(), 100.2 + random.f64()]).collect();
        let input = [square(2000, 1, 0.0), outliers.clone()].concat();
        let sure = of(&input, &[outliers, square(8000, 2, 0.0)].concat());
        let (outliers, others) = sure.split_at(20);
        assert!(outliers.iter().all(|sure| *sure < 0.05), "{outliers:?}");
        assert!(mean(others) > 0.9, "{}", mean(others));
    }

    #[test]
    fn the_number_of_threads_changes_nothing() {
        let (input, made) = (square(3000, 1, 0.01), square(70_000, 2, 0.02));
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            pool.install(|| of(&input, &made))
        };
        assert_eq!(on(1), on(3));
    }

    #[test]
    fn what_cannot_be_told_is_not_sure() {
        assert_eq!(of(&square(17, 1, 0.0), &square(30, 2, 0.0)), [0.0; 30]);
        assert_eq!(confidence(&[[1.0; 3]; 9], &square(30, 2, 0.0), None, &|| false), None, "one place");
        assert_eq!(confidence(&square(100, 1, 0.0), &square(30, 2, 0.0), None, &|| true), None, "stopped");
        let input = [square(100, 1, 0.0), vec![[f64::NAN; 3]; 9], square(100, 1, 0.0)].concat();
        let made = square(400, 2, 0.0);
        assert_eq!(of(&input, &made), of(&square(100, 1, 0.0), &made), "NaN and duplicates say nothing");
    }
}
