//! Points with nothing around them: kept as they are, and nothing is made of them.
//!
//! A unit sees neighbours. A lone point's neighbours are far off, on a surface that is not its own, so the unit puts its
//! new points somewhere between; the next level takes those for a surface; and farthest point sampling, which chooses
//! the points far from all others, prefers them to the scan. Each lone point would become a cloud of them.

use rayon::prelude::*;

use super::globals::{Globals, once, usual_spacing};
use super::measured::Measured;
use super::sites::{AROUND, Sites};
use densecloud_cloud::Point;
use densecloud_geometry::{Plane, Walk, farthest_point_sampling, indices};

/// Most points of a group that is no surface. What counts is the distance to the nearest point outside.
const GROUP: usize = 4;
/// A point is alone if its distance to the nearest point outside its group exceeds this many times the [`LOW`]th smallest
/// spacing among its neighbours, of which some may be alone, too. On a surface the ratio is below 2 in an even and a random
/// sample, and at a border; in thin spots beside dense ones, which scans have, up to 4.
const ALONE: f32 = 5.0;
const LOW: usize = 2;
/// Points whose spacing exceeds the cloud's usual one this many times may be outliers too many to stand out from each
/// other.
const SPARSE: f32 = 6.0;
/// And those whose spacing exceeds the [`LOW`]th smallest among their neighbours this many times may be outliers near a
/// surface, or near each other. On a surface only the rim of a denser part has as much.
const THIN: f32 = 2.5;
/// Such points are outliers if they lie in no sheet: if more than this share of their variance is across it. A sheet, even
/// a noisy one, has below 0.03; points spread over a volume have about 0.15.
const ACROSS: f64 = 0.05;
/// Neighbours that this share is measured with.
const SHEET: usize = 16;
/// How often outliers are looked for: those hidden behind others show when the others are gone.
pub(super) const PASSES: usize = 3;

/// A cloud, parted into what lies on surfaces and what lies alone.
pub(super) struct Parted {
    /// Points on surfaces.
    pub(super) together: Measured,
    /// Outliers, in the order of farthest point sampling.
    pub(super) apart: Vec<Point>,
}

impl Parted {
    /// Parts distinct `points`. All stay together where fewer than `least` would. O(n log n).
    pub(super) fn of(points: &[Point], least: usize, globals: &mut Globals) -> Self {
        let mut together = Measured::of(points);
        let mut apart = Vec::new();
        for usual in &mut globals.usual_spacings {
            let alone = alone(&together, usual);
            let count = alone.iter().filter(|alone| **alone).count();
            if count == 0 || alone.len() - count < least {
                break;
            }
            let those = |wanted: bool| {
                let points = together.points.iter().zip(&alone).filter(move |(_, alone)| **alone == wanted);
                points.map(|(p, _)| *p).collect::<Vec<_>>()
            };
            apart.extend(those(true));
            let others = those(false);
            together = Measured::of(&others);
        }
        let order = farthest_point_sampling(&apart, apart.len(), 0);
        Self { together, apart: order.iter().map(|&i| apart[i as usize]).collect() }
    }
}

/// `dense` with the points that lie `apart` strewn among them: any prefix has its share of both.
pub(super) fn joined(dense: Vec<Point>, apart: &[Point]) -> Vec<Point> {
    let (each, count) = (dense.len(), apart.len());
    let mut joined = Vec::with_capacity(each + count);
    let mut left = dense.into_iter();
    for (i, &point) in apart.iter().enumerate() {
        let before = (2 * i + 1) * each / (2 * count);
        joined.extend(left.by_ref().take(before + i - joined.len()));
        joined.push(point);
    }
    joined.extend(left);
    joined
}

/// Which points of a cloud lie alone, by their `usual` spacing.
fn alone(cloud: &Measured, usual: &mut Option<f32>) -> Vec<bool> {
    let Sites { points, tree, spacing } = &**cloud;
    if points.len() <= AROUND {
        return vec![false; points.len()];
    }
    let usual = once(usual, || usual_spacing(spacing));
    let is_alone = |walk: &mut Walk, i: u32| {
        let (p, around) = (points[i as usize], cloud.around(i));
        let mut nearby: [f32; AROUND] = std::array::from_fn(|k| spacing[around[k] as usize]);
        let low = *nearby.select_nth_unstable_by(LOW, f32::total_cmp).1;
        let outside = points[around[GROUP - 1] as usize];
        let group = (0..3).map(|a| (outside[a] - p[a]).powi(2)).sum::<f32>().sqrt();
        if group > ALONE * low {
            return true;
        }
        if spacing[i as usize] <= SPARSE * usual && spacing[i as usize] <= THIN * low {
            return false;
        }
        tree.nearest_next(p, SHEET + 1, walk);
        let variances = Plane::fit(points, &walk.found).variances;
        variances[0] > ACROSS * variances.iter().sum::<f64>()
    };
    indices(points.len()).into_par_iter().map_init(Walk::default, is_alone).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::Frame;
    use densecloud_geometry::Rng;

    fn parted(points: Vec<Point>, least: usize) -> Parted {
        let frame = Frame::fit(&[[0.0; 3], [1.0; 3]]).unwrap();
        Parted::of(&points, least, &mut Globals::new(frame))
    }

    /// A unit square with so many points, even or random.
    fn square(n: usize, even: bool, random: &mut Rng) -> Vec<Point> {
        let many = if even { 8 * n } else { n };
        let all: Vec<Point> = (0..many).map(|_| [random.f64() as f32, random.f64() as f32, 0.0]).collect();
        farthest_point_sampling(&all, n, 0).iter().map(|&i| all[i as usize]).collect()
    }

    fn apart(points: &[Point]) -> Vec<Point> {
        let mut apart = parted(points.to_vec(), 17).apart;
        apart.sort_by(|a, b| a.partial_cmp(b).expect("finite"));
        apart
    }

    #[test]
    fn nothing_on_a_surface_is_apart_however_it_was_sampled() {
        for seed in 0..20 {
            let mut random = Rng::new(seed);
            for even in [true, false] {
                assert_eq!(apart(&square(1000, even, &mut random)), [] as [Point; 0], "{even}");
            }
            // A tenth of the density on the right, beside it, and noise of half a spacing.
            let mut uneven: Vec<Point> = square(2000, false, &mut random);
            uneven.extend(square(200, false, &mut random).iter().map(|p| [p[0] + 1.0, p[1], 0.0]));
            uneven.iter_mut().for_each(|p| p[2] += 0.01 * random.normal() as f32);
            let found = apart(&uneven).len();
            assert!(found <= 5, "{found} of a surface");
            // Lines of a scanner: ten times as dense along as across.
            let lines: Vec<Point> =
                (0..2000).map(|i| [(i % 100) as f32 * 0.01, (i / 100) as f32 * 0.1, 0.0]).collect();
            assert_eq!(apart(&lines).len(), 0);
        }
    }

    #[test]
    fn outliers_are_apart_whether_few_or_many() {
        for count in [1_usize, 3, 30, 200] {
            let mut random = Rng::new(count as u64);
            let mut points = square(2000, true, &mut random);
            // The spacing is 0.022; outliers are at least 0.2 above or below.
            let outliers: Vec<Point> = (0..count)
                .map(|_| {
                    let side = if random.f64() < 0.5 { -1.0 } else { 1.0 };
                    [random.f64() as f32, random.f64() as f32, side * (0.2 + 0.8 * random.f64() as f32)]
                })
                .collect();
            points.extend(&outliers);
            let found = apart(&points);
            assert!(found.iter().all(|p| p[2] != 0.0), "of the surface");
            assert!(found.len() * 10 >= count * 9, "{} of {count}", found.len());
        }
    }

    #[test]
    fn outliers_near_a_surface_and_near_each_other_are_apart() {
        for seed in 0..5 {
            let mut random = Rng::new(seed);
            let mut points = square(2000, true, &mut random);
            // Three spacings and more above or below; 5 % of all, and some within as much of each other.
            points.extend((0..100).map(|_| {
                let side = if random.f64() < 0.5 { -1.0 } else { 1.0 };
                [random.f64() as f32, random.f64() as f32, side * (0.066 + 0.4 * random.f64() as f32)]
            }));
            let found = apart(&points);
            assert!(found.iter().all(|p| p[2] != 0.0), "of the surface");
            assert!(found.len() >= 80, "{} of 100, seed {seed}", found.len());
        }
    }

    #[test]
    fn a_group_is_apart_as_long_as_it_is_no_surface() {
        for (size, expected) in [(2, true), (4, true), (9, false), (50, false)] {
            let mut points = square(1000, true, &mut Rng::new(2));
            points.extend((0..size).map(|i| [(i % 7) as f32 * 0.03, (i / 7) as f32 * 0.03, 1.0]));
            assert_eq!(apart(&points).len(), if expected { size } else { 0 }, "{size}");
        }
    }

    #[test]
    fn enough_points_stay_together() {
        let mut points = square(20, true, &mut Rng::new(3));
        points.push([0.0, 0.0, 50.0]);
        assert_eq!(parted(points.clone(), 20).apart.len(), 1);
        assert_eq!(parted(points, 21).apart.len(), 0);
        let line: Vec<Point> = (0..5).map(|i| [(i * i * i) as f32, 0.0, 0.0]).collect();
        assert_eq!(parted(line, 1).together.points.len(), 5);
    }

    #[test]
    fn each_prefix_has_its_share_of_those_apart() {
        let dense: Vec<Point> = (0..10).map(|i| [i as f32, 0.0, 0.0]).collect();
        let lone = [[-1.0; 3], [-2.0; 3]];
        let order: Vec<f32> = joined(dense.clone(), &lone).iter().map(|p| p[0]).collect();
        assert_eq!(order, [0.0, 1.0, -1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -2.0, 7.0, 8.0, 9.0]);
        assert_eq!(joined(dense.clone(), &[]), dense);
        assert_eq!(joined(vec![], &lone), lone);
    }
}
