//! How far a dense cloud strays from the one that it was made of.

use rayon::prelude::*;

use densecloud_cascade::distinct;
use densecloud_cloud::{Frame, FrameError, Point, Position};
use densecloud_geometry::{KdTree, Walk};

/// Neighbours that a source point's spacing is the mean distance to.
const NEIGHBOURS: usize = 8;

/// A cloud that others are measured against, in its own local spacings: the spacing at a place is that of the nearest
/// point, the mean distance to its 8 nearest.
#[derive(Debug)]
pub struct Source {
    frame: Frame,
    tree: KdTree,
    /// A distinct point's, in local units.
    spacing: Vec<f32>,
}

impl Source {
    /// Indexes the finite points of a cloud. O(n log n).
    ///
    /// # Errors
    /// It has no finite point, or all are the same.
    pub fn new(positions: &[Position]) -> Result<Self, FrameError> {
        let source: Vec<Position> = positions.iter().filter(finite).copied().collect();
        let frame = Frame::fit(&source)?;
        let points =
            distinct(&source.iter().map(|p| frame.to_local(*p).map(|c| c + 0.0)).collect::<Vec<Point>>());
        let tree = KdTree::new(&points);
        let spacing = points
            .par_iter()
            .map_init(Walk::default, |walk, p| {
                tree.nearest_next(*p, NEIGHBOURS + 1, walk);
                let others = walk.found.get(1..).unwrap_or_default();
                others.iter().map(|n| n.distance_squared.sqrt()).sum::<f32>() / others.len().max(1) as f32
            })
            .collect();
        Ok(Self { frame, tree, spacing })
    }

    /// How far each finite position is from the nearest point, in local spacings; in order. O(m log n).
    #[must_use]
    pub fn distances(&self, positions: &[Position]) -> Vec<f64> {
        let near = self.nearest(positions);
        near.into_iter().map(|(distance, spacing)| ratio(distance, spacing)).collect()
    }

    /// How far each finite position is from the nearest of `other`, in local spacings of this one; in order.
    /// O(m (log n + log o)).
    #[must_use]
    pub fn distances_to(&self, other: &Self, positions: &[Position]) -> Vec<f64> {
        let (own, theirs) = (self.nearest(positions), other.nearest(positions));
        own.into_iter().zip(theirs).map(|((_, spacing), (distance, _))| ratio(distance, spacing)).collect()
    }

    /// The distance to the nearest point, and the spacing there, in the cloud's units.
    fn nearest(&self, positions: &[Position]) -> Vec<(f64, f64)> {
        let positions: Vec<&Position> = positions.iter().filter(finite).collect();
        let unit = self.frame.scale();
        let near = |p: &&Position| {
            let near = self.tree.nearest_one(self.frame.to_local(**p));
            // A frame has a point.
            near.map_or((0.0, 0.0), |n| {
                let (distance, spacing) = (n.distance_squared.sqrt(), self.spacing[n.index as usize]);
                (unit * f64::from(distance), unit * f64::from(spacing))
            })
        };
        positions.par_iter().map(near).collect()
    }
}

fn finite(p: &&Position) -> bool {
    p.iter().all(|c| c.is_finite())
}

/// 0 where both are.
fn ratio(distance: f64, spacing: f64) -> f64 {
    if distance > 0.0 { distance / spacing } else { 0.0 }
}

/// The share of the finite points of `dense` that lie further than `spacings` local spacings from every
/// point of `source`, as [`Source`] measures them. O((n + m) log n).
///
/// # Errors
/// `source` has no finite point, or all are the same.
pub fn strays(source: &[Position], dense: &[Position], spacings: f64) -> Result<f64, FrameError> {
    let distances = Source::new(source)?.distances(dense);
    let far = distances.iter().filter(|d| **d > spacings).count();
    Ok(far as f64 / distances.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_in_local_spacings() {
        // A grid of spacing 1 beside one of spacing 10; the mean distance to 8 neighbours is 1.21 of it.
        let grid = |step: f64, from: f64| {
            (0..400).map(move |i| [from + step * f64::from(i % 20), step * f64::from(i / 20), 0.0])
        };
        let source: Vec<Position> = grid(1.0, 0.0).chain(grid(10.0, 100.0)).collect();
        let above = |x: f64, z: f64| [x, 100.0 * (x / 290.0).round() + 10.0 * f64::from(x < 50.0), z];
        for (point, stray) in [
            (above(10.0, 3.0), false),
            (above(10.0, 4.5), true),
            (above(190.0, 30.0), false),
            (above(190.0, 45.0), true),
        ] {
            let share = strays(&source, &[point, [5.0, 5.0, 0.1], [f64::NAN; 3]], 3.0).expect("a share");
            assert_eq!(share, if stray { 0.5 } else { 0.0 }, "{point:?}");
        }
        assert!(strays(&[[1.0; 3]; 9], &source, 3.0).is_err());
    }
}
