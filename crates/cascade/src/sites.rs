//! Points, the tree over them, and how far apart they lie: made once for all that looks for neighbours among them.

use rayon::prelude::*;

use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Walk};

/// Others that a point's spacing is measured to: the ring around it on an even surface, and some.
pub(super) const AROUND: usize = 8;

/// Points with their tree and their spacing.
#[derive(Debug)]
pub(super) struct Sites {
    pub(super) points: Vec<Point>,
    pub(super) tree: KdTree,
    /// Mean distance of each point to its [`AROUND`] nearest others.
    pub(super) spacing: Vec<f32>,
}

impl Sites {
    /// Keeps the order of the points. O(n log n).
    pub(super) fn new(points: Vec<Point>) -> Self {
        let tree = KdTree::new(&points);
        // In the tree's order for the sake of caches.
        let mean = |walk: &mut Walk, &i: &u32| {
            tree.nearest_next(points[i as usize], AROUND + 1, walk);
            mean_distance(walk)
        };
        let in_order: Vec<f32> = tree.order().par_iter().map_init(Walk::default, mean).collect();
        let mut spacing = vec![0.0; points.len()];
        for (&i, value) in tree.order().iter().zip(in_order) {
            spacing[i as usize] = value;
        }
        Self { points, tree, spacing }
    }
}

/// Of a point that is the first of those found, to the others.
pub(super) fn mean_distance(walk: &Walk) -> f32 {
    let distances = walk.found.iter().map(|n| n.distance_squared.sqrt());
    distances.sum::<f32>() / (walk.found.len() - 1) as f32
}
