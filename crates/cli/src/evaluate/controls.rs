//! Methods that learn nothing, and the floor: what a score is worth beside them.

use densecloud_cloud::{Frame, FrameError, Point, Position};
use densecloud_geometry::{KdTree, Mesh, SampleError, farthest_point_sampling, poisson_disk};

/// Neighbours of each point whose midpoints [`midpoints`] considers.
pub(crate) const MIDPOINT_NEIGHBOURS: usize = 7;

/// By how much one step of [`midpoints`] multiplies the points at most.
pub(crate) const MIDPOINT_STEP: usize = 4;

/// Turns a user's seed into the floor's, so that a reference sampled with the same seed is another
/// sample ("floor" in ASCII).
const FLOOR_SEED: u64 = 0x66_6C6F_6F72;

/// `count` points of the mesh by Poisson-disk sampling, independent of any sample that the same
/// `seed` gives elsewhere: what a method would score that knew the surface.
///
/// # Errors
/// The mesh cannot be sampled.
pub(crate) fn floor(mesh: &Mesh, count: usize, seed: u64) -> Result<Vec<Position>, SampleError> {
    poisson_disk(mesh, count, seed ^ FLOOR_SEED)
}

/// The input over and over, `count` points: does nothing, and has P2F 0 on clean input.
#[must_use]
pub(crate) fn repeat(input: &[Position], count: usize) -> Vec<Position> {
    input.iter().copied().cycle().take(count).collect()
}

/// The input and midpoints of neighbours, `count` points.
///
/// One step: add the midpoint between each point and each of its 7 nearest others, each pair once;
/// of all these keep 4 times the points before, or `count` if that is fewer, by farthest point
/// sampling from the first point. Steps repeat on their own result until `count` is reached, so 4x is
/// one step and 16x are two. O(count log count).
///
/// # Errors
/// The input is not finite, or a single spot.
pub(crate) fn midpoints(input: &[Position], count: usize) -> Result<Vec<Position>, FrameError> {
    let frame = Frame::fit(input)?;
    let mut cloud = input.to_vec();
    while cloud.len() < count {
        let size = count.min(MIDPOINT_STEP * cloud.len());
        let between = neighbour_pairs(&local(&frame, &cloud)).into_iter().map(|[i, j]| {
            let (a, b) = (cloud[i as usize], cloud[j as usize]);
            std::array::from_fn(|k| a[k] + (b[k] - a[k]) / 2.0)
        });
        let candidates: Vec<Position> = cloud.iter().copied().chain(between).collect();
        let kept = farthest_point_sampling(&local(&frame, &candidates), size, 0);
        cloud = kept.iter().map(|i| candidates[*i as usize]).collect();
    }
    cloud.truncate(count);
    Ok(cloud)
}

fn local(frame: &Frame, positions: &[Position]) -> Vec<Point> {
    positions.iter().map(|p| frame.to_local(*p)).collect()
}

/// Pairs of which at least one is among the other's nearest, the smaller index first, in order.
fn neighbour_pairs(points: &[Point]) -> Vec<[u32; 2]> {
    let tree = KdTree::new(points);
    let mut pairs = Vec::new();
    let mut found = Vec::new();
    for (i, p) in points.iter().enumerate() {
        let i = i as u32;
        tree.nearest(*p, MIDPOINT_NEIGHBOURS + 1, &mut found);
        // The point itself is not always among them: duplicates may come before it.
        let others = found.iter().map(|n| n.index).filter(|j| *j != i).take(MIDPOINT_NEIGHBOURS);
        pairs.extend(others.map(|j| [i.min(j), i.max(j)]));
    }
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeat_keeps_the_order_and_cuts() {
        let input = [[1.0; 3], [2.0; 3], [3.0; 3]];
        assert_eq!(repeat(&input, 7), [[1.0; 3], [2.0; 3], [3.0; 3], [1.0; 3], [2.0; 3], [3.0; 3], [1.0; 3]]);
        assert_eq!(repeat(&[], 7), [[0.0; 3]; 0]);
    }

    #[test]
    fn midpoints_of_a_pair_fill_the_line_between() {
        let pair = [[10.0, 0.0, 0.0], [12.0, 0.0, 0.0]];
        assert_eq!(midpoints(&pair, 3).expect("a cloud"), [pair[0], pair[1], [11.0, 0.0, 0.0]]);
        let mut line: Vec<f64> = midpoints(&pair, 5).expect("a cloud").iter().map(|p| p[0]).collect();
        line.sort_by(f64::total_cmp);
        assert_eq!(line, [10.0, 10.5, 11.0, 11.5, 12.0]);
    }

    #[test]
    fn midpoints_give_the_count_even_of_duplicates() {
        let mut input = vec![[0.0; 3]; 30];
        input.push([1.0, 0.0, 0.0]);
        for count in [31, 32, 100, 1000] {
            let cloud = midpoints(&input, count).expect("a cloud");
            assert_eq!(cloud.len(), count);
            assert!(cloud.iter().all(|p| (0.0..=1.0).contains(&p[0])));
        }
        assert!(midpoints(&[[0.0; 3]; 5], 10).is_err());
    }

    #[test]
    fn the_floor_is_another_sample_than_the_same_seed_gives() {
        let mesh = densecloud_geometry::shape("knot").expect("a shape");
        let floor = floor(&mesh, 200, 7).expect("a sample");
        let sample = poisson_disk(&mesh, 200, 7).expect("a sample");
        assert_eq!(floor.len(), 200);
        assert!(floor.iter().all(|p| !sample.contains(p)));
    }
}
