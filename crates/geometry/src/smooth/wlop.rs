//! Weighted locally optimal projection (Huang et al., 2009), with the support of each point's own place.

use super::{Place, decay};
use crate::around::around_each;
use crate::{KdTree, Neighbour};
use densecloud_cloud::Point;

/// Rounds: the points hardly move afterwards.
const ROUNDS: usize = 10;
/// The balance of repulsion and attraction, below 0.5 (section 4.1).
const REPULSION: f32 = 0.45;

/// Where each point ends; where there is no surface, it stays.
pub(super) fn project(tree: &KdTree, points: &[Point], places: &[Place]) -> Vec<Point> {
    let supports = supports(tree, points, places);
    // Equation 4: how crowded the input is about each point.
    let crowds = around_each(tree, points, 1, |i, near| {
        nearest(tree, points[i], &places[i], near);
        crowd(near, supports[i])
    });
    let mut moved = first(tree, points, &supports, places);
    for _ in 0..ROUNDS {
        moved = round(tree, points, &crowds, &moved, &supports, places);
    }
    moved
}

/// Support radius h, over the reach of a place: the weights of its furthest points are 17 %.
const SUPPORT: f32 = 3.0;

/// The support radius h of each point.
fn supports(tree: &KdTree, points: &[Point], places: &[Place]) -> Vec<f32> {
    around_each(tree, points, 1, |i, near| {
        nearest(tree, points[i], &places[i], near);
        near.last().map_or(0.0, |n| SUPPORT * n.distance_squared.sqrt())
    })
}

fn nearest(tree: &KdTree, at: Point, place: &Place, near: &mut Vec<Neighbour>) {
    tree.nearest(at, place.neighbours.max(1), near);
}

/// exp(-r^2 / (h / 4)^2), of the squared distance.
fn weight(distance_squared: f32, support: f32) -> f32 {
    decay(f64::from(distance_squared / (support / 4.0).powi(2).max(f32::MIN_POSITIVE))) as f32
}

/// Where points begin: at the mean of their neighbours, since one that begins at a point of the input is its own median.
fn first(tree: &KdTree, points: &[Point], supports: &[f32], places: &[Place]) -> Vec<Point> {
    around_each(tree, points, 1, |i, near| {
        if places[i].neighbours == 0 {
            return points[i];
        }
        nearest(tree, points[i], &places[i], near);
        let to = mean(near, points, points[i], |n| weight(n.distance_squared, supports[i]));
        let to = to.unwrap_or([0.0; 3]);
        std::array::from_fn(|a| points[i][a] + to[a])
    })
}

/// The sum of the weights of all in the support, the point's own 1 included.
fn crowd(near: &[Neighbour], support: f32) -> f32 {
    near.iter().map(|n| weight(n.distance_squared, support)).sum::<f32>().max(1.0)
}

/// One round of equation 3.
fn round(
    tree: &KdTree,
    points: &[Point],
    crowds: &[f32],
    moved: &[Point],
    supports: &[f32],
    places: &[Place],
) -> Vec<Point> {
    let own = KdTree::new(moved);
    let about = around_each(&own, moved, 1, |i, near| {
        nearest(&own, moved[i], &places[i], near);
        crowd(near, supports[i])
    });
    around_each(&own, moved, 1, |i, near| {
        if places[i].neighbours == 0 {
            return moved[i];
        }
        let (at, support) = (moved[i], supports[i]);
        nearest(tree, at, &places[i], near);
        let attraction = |n: &Neighbour| {
            let distance = n.distance_squared.sqrt().max(1e-2 * support);
            weight(n.distance_squared, support) / (distance * crowds[n.index as usize])
        };
        let middle = mean(near, points, at, attraction).unwrap_or([0.0; 3]);
        nearest(&own, at, &places[i], near);
        let repulsion = |n: &Neighbour| {
            if n.index as usize == i {
                return 0.0;
            }
            let distance = n.distance_squared.sqrt().max(1e-2 * support);
            about[n.index as usize] * weight(n.distance_squared, support) / distance
        };
        let away = mean(near, moved, at, repulsion).unwrap_or([0.0; 3]);
        std::array::from_fn(|a| at[a] + middle[a] - REPULSION * away[a])
    })
}

/// The weighted mean of the neighbours, from `at`; none where all weights are 0.
fn mean(near: &[Neighbour], of: &[Point], at: Point, weight: impl Fn(&Neighbour) -> f32) -> Option<Point> {
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for n in near {
        let (weight, p) = (weight(n), of[n.index as usize]);
        (0..3).for_each(|a| sum[a] += weight * (p[a] - at[a]));
        total += weight;
    }
    (total > 0.0).then(|| sum.map(|c| c / total))
}
