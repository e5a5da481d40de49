//! From a file's points to the distinct local points that the network sees.

use super::{CascadeError, check_count};
use densecloud_cloud::{Frame, Point, Position};
use densecloud_geometry::indices;

/// The input in local coordinates, without non-finite and repeated points.
pub(super) struct Input {
    pub(super) frame: Frame,
    /// Distinct points, in the input's order.
    pub(super) points: Vec<Point>,
    /// How many input points were finite.
    pub(super) finite: usize,
    /// How many were not.
    pub(super) non_finite: usize,
}

impl Input {
    /// O(n log n).
    pub(super) fn prepare(positions: &[Position]) -> Result<Self, CascadeError> {
        check_count(positions.len())?;
        let finite: Vec<Position> =
            positions.iter().copied().filter(|p| p.iter().all(|c| c.is_finite())).collect();
        let frame = Frame::fit(&finite)?;
        let local = local(&finite, frame);
        let (finite, non_finite) = (finite.len(), positions.len() - finite.len());
        Ok(Self { frame, points: distinct(&local), finite, non_finite })
    }
}

/// Finite positions in local coordinates.
pub(super) fn local(positions: &[Position], frame: Frame) -> Vec<Point> {
    // Adding zero turns -0 into 0, so that equal points have equal bits.
    positions.iter().map(|p| frame.to_local(*p).map(|c| c + 0.0)).collect()
}

/// The first of each group of equal points, in the given order. O(n log n).
///
/// # Panics
/// Above [`MAX_POINTS`](densecloud_geometry::MAX_POINTS).
#[must_use]
pub fn distinct(points: &[Point]) -> Vec<Point> {
    let bits = |i: u32| points[i as usize].map(f32::to_bits);
    let mut order: Vec<u32> = indices(points.len()).collect();
    order.sort_unstable_by_key(|&i| (bits(i), i));
    let mut first = vec![true; points.len()];
    for pair in order.windows(2) {
        if bits(pair[0]) == bits(pair[1]) {
            first[pair[1] as usize] = false;
        }
    }
    points.iter().zip(first).filter_map(|(p, first)| first.then_some(*p)).collect()
}
