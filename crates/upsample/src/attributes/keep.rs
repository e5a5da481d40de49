//! Making room for the input's points among new ones.

use densecloud_cloud::{Frame, Point, Position};
use densecloud_geometry::KdTree;

/// New points asked about for an original before the search is widened.
const NEAREST: usize = 8;

/// `dense` without as many points as there are `originals`: for each of these, in their order, the nearest
/// that is still there. All that is left keeps its order. Nothing is left where `dense` is not larger.
///
/// O(n log n). `None` where the points have no frame: none at all, or all the same.
pub(super) fn without_nearest(dense: Vec<Position>, originals: &[Position]) -> Option<Vec<Position>> {
    if dense.len() <= originals.len() {
        return Some(Vec::new());
    }
    let frame = Frame::fit(&dense).ok()?;
    let points: Vec<Point> = dense.iter().map(|p| frame.to_local(*p)).collect();
    let tree = KdTree::new(&points);
    let mut gone = vec![false; dense.len()];
    let mut near = Vec::new();
    for original in originals {
        let mut wanted = NEAREST;
        // Ends: fewer points are gone than there are, and at last all are asked about.
        loop {
            tree.nearest(frame.to_local(*original), wanted, &mut near);
            if let Some(free) = near.iter().find(|n| !gone[n.index as usize]) {
                gone[free.index as usize] = true;
                break;
            }
            wanted *= 4;
        }
    }
    Some(dense.into_iter().zip(gone).filter_map(|(p, gone)| (!gone).then_some(p)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn as_many_go_as_come(seed in any::<u64>(), n in 2_usize..200, share in 0.0_f64..1.2, crowd in any::<bool>()) {
            let mut random = densecloud_geometry::Rng::new(seed);
            let mut cloud = |n: usize, size: f64| -> Vec<Position> {
                (0..n).map(|_| std::array::from_fn(|_| size * random.f64())).collect()
            };
            let dense = cloud(n, 1.0);
            // All originals in one corner, so that the nearest are soon gone; or all over.
            let originals = cloud((share * n as f64) as usize, if crowd { 1e-3 } else { 1.0 });
            let left = without_nearest(dense.clone(), &originals).expect("points");
            prop_assert_eq!(left.len(), n.saturating_sub(originals.len()));
            let mut rest = dense.iter();
            prop_assert!(left.iter().all(|p| rest.any(|q| p == q)), "another order");
        }
    }
}
