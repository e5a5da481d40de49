//! From a file's points to the distinct local points that the network sees.

use super::CascadeError;
use densecloud_cloud::{Frame, Point, Position};

/// The input in local coordinates, without non-finite and repeated points.
pub(super) struct Input {
    pub(super) frame: Frame,
    /// Distinct points, in the input's order.
    pub(super) points: Vec<Point>,
    /// How many input points were finite.
    pub(super) finite: usize,
    /// Length of `points`, which outlives them.
    pub(super) distinct: usize,
}

impl Input {
    /// O(n log n).
    pub(super) fn prepare(positions: &[Position]) -> Result<Self, CascadeError> {
        let finite: Vec<Position> =
            positions.iter().copied().filter(|p| p.iter().all(|c| c.is_finite())).collect();
        let frame = Frame::fit(&finite)?;
        // Adding zero turns -0 into 0, so that equal points have equal bits.
        let local: Vec<Point> = finite.iter().map(|p| frame.to_local(*p).map(|c| c + 0.0)).collect();
        let points = distinct(&local);
        Ok(Self { frame, finite: finite.len(), distinct: points.len(), points })
    }

    pub(super) fn duplicates(&self) -> usize {
        self.finite - self.distinct
    }
}

/// The first of each group of equal points, in the given order.
pub fn distinct(points: &[Point]) -> Vec<Point> {
    let bits = |i: u32| points[i as usize].map(f32::to_bits);
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.sort_unstable_by_key(|&i| (bits(i), i));
    let mut first = vec![true; points.len()];
    for pair in order.windows(2) {
        if bits(pair[0]) == bits(pair[1]) {
            first[pair[1] as usize] = false;
        }
    }
    points.iter().zip(first).filter_map(|(p, first)| first.then_some(*p)).collect()
}
