//! How far a dense cloud strays from the one that it was made of.

use rayon::prelude::*;

use densecloud_cascade::distinct;
use densecloud_cloud::{Frame, FrameError, Point, Position};
use densecloud_geometry::{KdTree, Walk};

/// Neighbours that a source point's spacing is the mean distance to.
const NEIGHBOURS: usize = 8;

/// The share of the finite points of `dense` that lie further than `spacings` local spacings from every
/// point of `source`: the spacing at a point is that of the nearest source point, the mean distance to its
/// 8 nearest. O((n + m) log n).
///
/// # Errors
/// `source` has no finite point, or all are the same.
pub fn strays(source: &[Position], dense: &[Position], spacings: f64) -> Result<f64, FrameError> {
    let finite = |p: &&Position| p.iter().all(|c| c.is_finite());
    let source: Vec<Position> = source.iter().filter(finite).copied().collect();
    let frame = Frame::fit(&source)?;
    let points =
        distinct(&source.iter().map(|p| frame.to_local(*p).map(|c| c + 0.0)).collect::<Vec<Point>>());
    let tree = KdTree::new(&points);
    let spacing: Vec<f32> = points
        .par_iter()
        .map_init(Walk::default, |walk, p| {
            tree.nearest_next(*p, NEIGHBOURS + 1, walk);
            let others = walk.found.get(1..).unwrap_or_default();
            others.iter().map(|n| n.distance_squared.sqrt()).sum::<f32>() / others.len().max(1) as f32
        })
        .collect();
    let dense: Vec<&Position> = dense.iter().filter(finite).collect();
    let far = dense.par_iter().filter(|p| {
        tree.nearest_one(frame.to_local(***p)).is_some_and(|n| {
            f64::from(n.distance_squared.sqrt()) > spacings * f64::from(spacing[n.index as usize])
        })
    });
    Ok(far.count() as f64 / dense.len().max(1) as f64)
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
