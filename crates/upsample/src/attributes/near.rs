//! The source points that a new point's values come from.

use std::sync::OnceLock;

use rayon::prelude::*;

use densecloud_cloud::{Frame, Point, Position};
use densecloud_geometry::{KdTree, Walk, indices};

/// Source points that a mean is taken over; the last one only sets how far the others reach.
const NEAREST: usize = 6;

/// New points looked up between two questions whether to stop.
const BLOCK: usize = 1 << 18;

/// Rows of the source and their weights, the nearest first: those of weight 0 have no part.
pub(super) type Weighted = [(u32, f32); NEAREST - 1];

/// For each new point its nearest source points, by their rows in the source.
pub(super) struct Near {
    pub(super) weighted: Vec<Weighted>,
    nearest: OnceLock<Vec<u32>>,
}

impl Near {
    /// Looks them up. None when `cancelled` says so, or when no source point is finite.
    pub(super) fn find(
        source: &[Position],
        dense: &[Position],
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Option<Self> {
        let finite = |p: &Position| p.iter().all(|c| c.is_finite());
        let rows: Vec<u32> = indices(source.len()).filter(|&i| finite(&source[i as usize])).collect();
        let positions: Vec<Position> = rows.iter().map(|&i| source[i as usize]).collect();
        let frame = Frame::fit(&positions).ok()?;
        let points: Vec<Point> = positions.iter().map(|p| frame.to_local(*p)).collect();
        drop(positions);
        let tree = KdTree::new(&points);
        let k = NEAREST.min(points.len());
        let look = |walk: &mut Walk, p: Point| {
            tree.nearest_next(p, k, walk);
            let reach = walk.found.last().map_or(0.0, |n| n.distance_squared.sqrt());
            let mut weighted = [(rows[walk.found[0].index as usize], 0.0); NEAREST - 1];
            for (slot, n) in weighted.iter_mut().zip(&walk.found) {
                let d = n.distance_squared.sqrt();
                *slot = (rows[n.index as usize], ((reach - d) / (reach * d)).powi(2));
            }
            // On a source point, or between points that are all the same distance away.
            let exact = walk.found[0].distance_squared == 0.0;
            if exact
                || weighted.iter().all(|(_, w)| *w <= 0.0)
                || weighted.iter().any(|(_, w)| !w.is_finite())
            {
                weighted = [(weighted[0].0, 0.0); NEAREST - 1];
                weighted[0].1 = 1.0;
            }
            weighted
        };
        let mut weighted = vec![[(0, 0.0); NEAREST - 1]; dense.len()];
        for (block, weighted) in dense.chunks(BLOCK).zip(weighted.chunks_mut(BLOCK)) {
            if cancelled() {
                return None;
            }
            // New points come in any order, and those near each other are looked up fastest one after the other.
            let points: Vec<Point> = block.par_iter().map(|p| frame.to_local(*p)).collect();
            let own = KdTree::new(&points);
            let look = |walk: &mut Walk, i: &u32| look(walk, points[*i as usize]);
            let found: Vec<Weighted> = own.order().par_iter().map_init(Walk::default, look).collect();
            own.order().iter().zip(found).for_each(|(&i, near)| weighted[i as usize] = near);
        }
        Some(Self { weighted, nearest: OnceLock::new() })
    }

    /// The row of the nearest source point of each; collected once, and kept.
    pub(super) fn nearest(&self) -> &[u32] {
        self.nearest.get_or_init(|| self.weighted.par_iter().map(|near| near[0].0).collect())
    }
}

/// Which source points have a value; none where all have.
pub(super) type Present = Option<Vec<bool>>;

/// The source points of a new point that have a value and a weight, the nearest first.
pub(super) fn those_with<'a>(
    near: &'a Weighted,
    present: &'a Present,
) -> impl Iterator<Item = (usize, f64)> + 'a {
    let all = near.iter().map(|&(row, weight)| (row as usize, f64::from(weight)));
    all.filter(move |(row, weight)| *weight > 0.0 && present.as_ref().is_none_or(|p| p[*row]))
}
