//! Nearest distances in `f64`.

use rayon::prelude::*;

use super::sphere::distance;
use densecloud_cloud::{Frame, FrameError, Position};
use densecloud_geometry::{KdTree, Neighbour};

/// Candidates looked at before a near-tie is accepted.
const MOST: usize = 64;

/// Answers how far the nearest of a cloud's points is.
///
/// The k-d tree holds `f32` coordinates, whose rounding can swap two neighbours at almost the same
/// distance. So candidates come from the tree, and their distances from the `f64` positions; more
/// candidates are asked for until none left could be nearer. The result is the exact `f64` distance,
/// except where more than 64 points are as near as the nearest within 2e-6 of the cloud's extent; it is
/// then at most that much too large.
#[derive(Debug, Clone)]
pub(crate) struct Nearest {
    positions: Vec<Position>,
    frame: Frame,
    tree: KdTree,
}

impl Nearest {
    /// Indexes a cloud, O(n log n).
    ///
    /// # Errors
    /// The cloud has no frame: it is empty, not finite, or a single spot.
    pub(crate) fn new(positions: &[Position]) -> Result<Self, FrameError> {
        let frame = Frame::fit(positions)?;
        let local: Vec<_> = positions.iter().map(|p| frame.to_local(*p)).collect();
        Ok(Self { positions: positions.to_vec(), frame, tree: KdTree::new(&local) })
    }

    /// The distance from each query to its nearest point, in the queries' order. Parallel.
    #[must_use]
    pub(crate) fn distances(&self, queries: &[Position]) -> Vec<f64> {
        let search = |found: &mut Vec<Neighbour>, q: &Position| self.search(*q, None, found);
        queries.par_iter().map_init(Vec::new, search).collect()
    }

    /// The distance from each of the cloud's own points to the nearest other one; 0 for duplicates.
    #[must_use]
    pub(crate) fn spacings(&self) -> Vec<f64> {
        let search =
            |found: &mut Vec<Neighbour>, (i, p): (usize, &Position)| self.search(*p, Some(i as u32), found);
        self.positions.par_iter().enumerate().map_init(Vec::new, search).collect()
    }

    /// The distance to the nearest point whose index is not `except`.
    fn search(&self, query: Position, except: Option<u32>, found: &mut Vec<Neighbour>) -> f64 {
        let local = self.frame.to_local(query);
        // Bounds the rounding of both points' coordinates and of the squared distance between them.
        let reach = local.iter().fold(1.0, |m: f64, c| m.max(f64::from(c.abs())));
        let rounding = 2e-6 * reach;
        let mut k = if except.is_some() { 3 } else { 2 };
        loop {
            self.tree.nearest(local, k, found);
            let others = found.iter().filter(|n| Some(n.index) != except);
            let best = others
                .map(|n| distance(self.positions[n.index as usize], query))
                .fold(f64::INFINITY, f64::min);
            let farthest = found.last().map_or(0.0, |n| f64::from(n.distance_squared).sqrt());
            if found.len() < k || k >= MOST || farthest > best / self.frame.scale() + rounding {
                return best;
            }
            k *= 2;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn brute(queries: &[Position], points: &[Position]) -> Vec<f64> {
        let nearest = |q: &Position| points.iter().map(|p| distance(*p, *q)).fold(f64::INFINITY, f64::min);
        queries.iter().map(nearest).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn distances_are_those_of_brute_force(
            points in prop::collection::vec(prop::array::uniform3(-1.0..1.0), 2..200),
            queries in prop::collection::vec(prop::array::uniform3(-3.0..3.0), 1..50),
            offset in prop_oneof![Just(0.0), Just(5e6)],
        ) {
            let points: Vec<Position> = points.into_iter().map(|p: Position| p.map(|c| c + offset)).collect();
            let queries: Vec<Position> = queries.into_iter().map(|p: Position| p.map(|c| c + offset)).collect();
            let nearest = Nearest::new(&points).expect("a frame");
            prop_assert_eq!(nearest.distances(&queries), brute(&queries, &points));
        }
    }

    #[test]
    fn near_ties_below_the_rounding_of_floats_are_decided_in_doubles() {
        // All within a part in 10^9 of the same distance, the last the nearest.
        let mut points: Vec<Position> = (0..40).map(|i| [1.0 - 1e-9 * f64::from(i), 0.0, 0.0]).collect();
        points.push([-1.0, -1.0, -1.0]);
        let nearest = Nearest::new(&points).expect("a frame");
        assert_eq!(nearest.distances(&[[0.0; 3]]), [1.0 - 39.0 * 1e-9]);
    }

    #[test]
    fn spacing_leaves_out_the_point_itself_but_not_its_duplicates() {
        let nearest =
            Nearest::new(&[[0.0; 3], [1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 0.0, 0.0]]).expect("a frame");
        assert_eq!(nearest.spacings(), [1.0, 1.0, 0.0, 0.0]);
    }
}
