//! Points that stand alone or in small groups, told by the spacing about them and no length.

use super::around::around_each;
use super::plane::Plane;
use super::{KdTree, Neighbour};
use densecloud_cloud::Point;

/// Others that a point is compared with.
const OTHERS: usize = 8;
/// The local spacing is the distance to this one of them: in a group of more points than this it is the group's own.
const SPACING: usize = 4;
/// Local spacings across which two points belong together.
const GAP: f32 = 3.0;
/// Others whose plane is the surface beside a point.
const SURFACE: usize = 16;
/// What a point is off the surface by, at a factor of 1: others' deviations from their plane, and others' spacings.
const DEVIATIONS: f64 = 4.0 / 3.0;
const SPACINGS: f32 = 0.5;

/// Whether each point stands alone, or beside a surface. Alone: its distance to the 4th nearest other is more than `factor`
/// times the median of its 8 nearest others' own, so that a sparse region stays and what is far from a dense one does not
/// (the local outlier factor of Breunig et al., 2000, with medians). Beside a surface: the 16 nearest others lie on a plane, and it
/// is off that by more than `4/3 factor` of their standard deviation and `factor / 2` of their spacings, and as much
/// further from others than these are. O(n log n), about 5 microseconds a point.
///
/// Fewer points than 17 cannot be told apart: none stands alone.
#[must_use]
pub fn lone(points: &[Point], factor: f32) -> Vec<bool> {
    if points.len() <= SURFACE {
        return vec![false; points.len()];
    }
    let tree = KdTree::new(points);
    let spacings = spacings(&tree, points);
    around_each(&tree, points, SURFACE + 1, |i, near| {
        // Another at the same place may come before it.
        near.retain(|n| n.index as usize != i);
        near.truncate(SURFACE);
        let usual = |count: usize| median(near[..count].iter().map(|n| spacings[n.index as usize]).collect());
        let off = SPACINGS * factor * usual(SURFACE);
        spacings[i] > factor * usual(OTHERS) || spacings[i] > off && is_beside(points, i, near, off, factor)
    })
}

/// Whether a point is off the plane of the others, by more than a length and by more than chance.
fn is_beside(points: &[Point], i: usize, others: &[Neighbour], off: f32, factor: f32) -> bool {
    let plane = Plane::fit(points, others);
    let heights = others.iter().map(|n| plane.height(points[i], points[n.index as usize]));
    let height = heights.sum::<f64>().abs() / others.len() as f64;
    let chance = DEVIATIONS * f64::from(factor) * plane.variances[0].sqrt();
    height > chance.max(f64::from(off))
}

fn median(mut values: Vec<f32>) -> f32 {
    values.sort_unstable_by(f32::total_cmp);
    let middle = values.len() / 2;
    0.5 * (values[middle - 1] + values[middle])
}

/// Whether each point's mean distance to its `neighbours` nearest others is more than `deviations` standard deviations above
/// the mean of all (statistical outlier removal as libraries have it: Rusu et al., "Towards 3D point cloud based object maps
/// for household environments", 2008). Of a cloud whose density varies it takes the thin parts. O(n log n).
#[must_use]
pub fn far(points: &[Point], neighbours: usize, deviations: f64) -> Vec<bool> {
    let tree = KdTree::new(points);
    let distances = around_each(&tree, points, neighbours.saturating_add(1), |_, near| {
        let distance = |n: &Neighbour| f64::from(n.distance_squared).sqrt();
        near.iter().map(distance).sum::<f64>() / near.len().saturating_sub(1).max(1) as f64
    });
    let count = distances.len().max(1) as f64;
    let mean = distances.iter().sum::<f64>() / count;
    let variance = distances.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / count;
    distances.iter().map(|d| *d > mean + deviations * variance.sqrt()).collect()
}

/// Whether each point is of a group of fewer than `least`: of points that are joined by steps of at most three local
/// spacings, and by none to others. O(n log n), about 4 microseconds a point.
#[must_use]
pub fn small_groups(points: &[Point], least: usize) -> Vec<bool> {
    if points.len() <= OTHERS {
        return vec![points.len() < least; points.len()];
    }
    let tree = KdTree::new(points);
    let spacings = spacings(&tree, points);
    let steps = around_each(&tree, points, OTHERS + 1, |i, near| {
        let near = others(near, i)
            .filter(|n| n.distance_squared.sqrt() <= GAP * spacings[i].max(spacings[n.index as usize]));
        near.map(|n| n.index).collect::<Vec<u32>>()
    });
    let mut groups = Groups::new(points.len());
    for (i, to) in steps.iter().enumerate() {
        to.iter().for_each(|&j| groups.join(i, j as usize));
    }
    let roots: Vec<usize> = (0..points.len()).map(|i| groups.root(i)).collect();
    let mut sizes = vec![0; points.len()];
    roots.iter().for_each(|&root| sizes[root] += 1);
    roots.iter().map(|&root| sizes[root] < least).collect()
}

/// Whether each point has fewer than `neighbours` others within `radius`. O(n (log n + neighbours)).
#[must_use]
pub fn sparse(points: &[Point], radius: f32, neighbours: usize) -> Vec<bool> {
    let tree = KdTree::new(points);
    around_each(&tree, points, neighbours.saturating_add(1), |_, near| {
        near.len() <= neighbours || near[neighbours].distance_squared > radius * radius
    })
}

/// The distance from each point to its 4th nearest other.
fn spacings(tree: &KdTree, points: &[Point]) -> Vec<f32> {
    around_each(tree, points, SPACING + 1, |_, near| near.last().map_or(0.0, |n| n.distance_squared.sqrt()))
}

/// The first 8 of `near` that are not `i`: another at the same place may come before it.
fn others(near: &[Neighbour], i: usize) -> impl Iterator<Item = &Neighbour> {
    near.iter().filter(move |n| n.index as usize != i).take(OTHERS)
}

/// Sets that grow together (union-find with path halving).
struct Groups(Vec<usize>);

impl Groups {
    fn new(count: usize) -> Self {
        Self((0..count).collect())
    }

    fn root(&mut self, mut i: usize) -> usize {
        while self.0[i] != i {
            self.0[i] = self.0[self.0[i]];
            i = self.0[i];
        }
        i
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Rng;
    use super::*;

    /// A square of random points, and another of a hundredth of the density beside it.
    fn uneven() -> Vec<Point> {
        let mut random = Rng::new(0);
        let mut next = |from: f64, side: f64| (from + side * random.f64()) as f32;
        let dense = (0..2000).map(|_| [next(0.0, 1.0), next(0.0, 1.0), 0.0]).collect::<Vec<_>>();
        let sparse = (0..2000).map(|_| [next(1.1, 10.0), next(0.0, 10.0), 0.0]);
        dense.into_iter().chain(sparse).collect()
    }

    fn marked(marks: &[bool]) -> Vec<usize> {
        marks.iter().enumerate().filter(|(_, mark)| **mark).map(|(i, _)| i).collect()
    }

    #[test]
    fn lone_points_are_told_by_the_spacing_about_them() {
        let mut points = uneven();
        let told = marked(&lone(&points, 4.0)).len();
        assert!(told <= 4, "{told} of a random sampling");
        // Half a unit from a surface with spacings of 0.02: nothing beside one of 0.2.
        points.push([0.5, 0.5, 0.5]);
        points.push([0.2, 0.8, -0.4]);
        let told = marked(&lone(&points, 4.0));
        assert!(told.ends_with(&[4000, 4001]), "{told:?}");
        assert_eq!(lone(&points[..16], 0.1), [false; 16]);
    }

    #[test]
    fn a_point_beside_a_surface_is_told_and_one_on_a_rough_one_is_not() {
        let mut points = uneven();
        // Two spacings off: no further from others than four times what these are.
        points.push([0.5, 0.5, 0.045]);
        points.push([6.0, 5.0, 0.45]);
        let told = marked(&lone(&points, 3.0));
        assert!(told.ends_with(&[4000, 4001]) && told.len() < 10, "{told:?}");
        let mut random = Rng::new(3);
        points.iter_mut().for_each(|p| p[2] += 0.045 * random.normal() as f32);
        let rough = marked(&lone(&points, 3.0));
        assert!(!rough.contains(&4000) && rough.len() < 40, "{rough:?}");
    }

    #[test]
    fn far_points_are_those_of_their_definition() {
        let points = uneven();
        let distance =
            |p: &Point, q: &Point| (0..3).map(|a| f64::from(p[a] - q[a]).powi(2)).sum::<f64>().sqrt();
        let means: Vec<f64> = points
            .iter()
            .map(|p| {
                let mut all: Vec<f64> = points.iter().map(|q| distance(p, q)).collect();
                all.sort_unstable_by(f64::total_cmp);
                all[1..=8].iter().sum::<f64>() / 8.0
            })
            .collect();
        let mean = means.iter().sum::<f64>() / 4000.0;
        let deviation = (means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / 4000.0).sqrt();
        let expected: Vec<bool> = means.iter().map(|m| *m > mean + 2.0 * deviation).collect();
        let told = far(&points, 8, 2.0);
        assert!(marked(&told).len() > 20 && told == expected);
    }

    #[test]
    fn small_groups_are_told_and_their_size_counts() {
        let mut points = uneven();
        points.extend((0..7).map(|i| [0.5 + 0.01 * i as f32, 0.5, 0.7]));
        let told = marked(&small_groups(&points, 10));
        assert!(told.ends_with(&[4000, 4001, 4002, 4003, 4004, 4005, 4006]), "{told:?}");
        assert!(told.len() < 15, "{told:?}");
        let spared = marked(&small_groups(&points, 7));
        assert!(spared.iter().all(|&i| i < 4000), "{spared:?}");
        assert_eq!(small_groups(&points[..3], 4), [true; 3]);
    }

    #[test]
    fn points_with_few_others_in_a_radius_are_those_of_a_count_by_brute_force() {
        let points = uneven();
        let near = |p: &Point, q: &Point| (0..3).map(|a| (p[a] - q[a]).powi(2)).sum::<f32>() <= 0.05 * 0.05;
        let count = |p: &Point| points.iter().filter(|q| near(p, q)).count() - 1;
        let expected: Vec<bool> = points.iter().map(|p| count(p) < 6).collect();
        assert_eq!(sparse(&points, 0.05, 6), expected);
        assert_eq!(sparse(&points[..5], 1.0, 5), [true; 5], "there are no more");
        assert_eq!(sparse(&points[..5], 2.0, 4), [false; 5]);
    }
}
