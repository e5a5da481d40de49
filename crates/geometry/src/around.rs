//! One value for each point, from the points around it.

use rayon::prelude::*;

use super::{KdTree, Neighbour};
use densecloud_cloud::Point;

/// Queries a task: enough to hide what a task costs.
const CHUNK: usize = 256;

/// What `look` makes of each point's `k` nearest, itself among them, ascending by distance; in the points' order. On all
/// threads of the current pool; the result does not depend on their number. `tree` must be built from `points`.
pub(super) fn around_each<T: Send + Clone>(
    tree: &KdTree,
    points: &[Point],
    k: usize,
    look: impl Fn(usize, &mut Vec<Neighbour>) -> T + Sync,
) -> Vec<T> {
    let look = &look;
    let found: Vec<T> = tree
        .order()
        .par_chunks(CHUNK)
        .flat_map_iter(|chunk| {
            let mut near = Vec::with_capacity(k);
            chunk.iter().map(move |&i| {
                tree.nearest(points[i as usize], k, &mut near);
                look(i as usize, &mut near)
            })
        })
        .collect();
    let mut places = vec![0; points.len()];
    for (place, &i) in tree.order().iter().enumerate() {
        places[i as usize] = place;
    }
    places.into_iter().map(|place| found[place].clone()).collect()
}
