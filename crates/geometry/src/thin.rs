//! Fewer points of a cloud: one a voxel, or none nearer to another than a distance.

use std::collections::HashMap;

use super::limit::indices;
use super::random::Rng;
use densecloud_cloud::Position;

/// A cube of space.
type Cell = [i64; 3];

/// One point for each cube of side `size` that holds any, of a grid about the origin: the one nearest to the mean of the
/// cube's points, ties by the lowest index. Indices ascend. O(n log n).
///
/// # Panics
/// When `size` is not positive, or above [`MAX_POINTS`](crate::MAX_POINTS).
#[must_use]
pub fn one_a_voxel(positions: &[Position], size: f64) -> Vec<u32> {
    assert!(size > 0.0, "voxels have a size");
    let mut cells: Vec<(Cell, u32)> =
        positions.iter().map(|p| cell(*p, size)).zip(indices(positions.len())).collect();
    cells.sort_unstable();
    let mut kept: Vec<u32> = cells.chunk_by(|a, b| a.0 == b.0).map(|cell| middle(positions, cell)).collect();
    kept.sort_unstable();
    kept
}

/// The point of a voxel that is nearest to their mean.
fn middle(positions: &[Position], voxel: &[(Cell, u32)]) -> u32 {
    // About the first, since coordinates may be large.
    let first = positions[voxel[0].1 as usize];
    let offset = |i: u32| -> [f64; 3] { std::array::from_fn(|a| positions[i as usize][a] - first[a]) };
    let mut mean = [0.0; 3];
    for (_, i) in voxel {
        (0..3).for_each(|a| mean[a] += offset(*i)[a] / voxel.len() as f64);
    }
    let distance = |i: u32| (0..3).map(|a| (offset(i)[a] - mean[a]).powi(2)).sum::<f64>();
    let nearest = |best: u32, i: u32| if distance(i) < distance(best) { i } else { best };
    voxel.iter().map(|(_, i)| *i).fold(voxel[0].1, nearest)
}

/// Points of which no two are nearer than `spacing`, and so many that every other point is nearer than that to one: a
/// Poisson-disk sample of the cloud by dart throwing, in a random order. Indices ascend. O(n).
///
/// # Panics
/// When `spacing` is not positive, or above [`MAX_POINTS`](crate::MAX_POINTS).
#[must_use]
pub fn spaced(positions: &[Position], spacing: f64, seed: u64) -> Vec<u32> {
    assert!(spacing > 0.0, "points have a distance");
    let mut order: Vec<u32> = indices(positions.len()).collect();
    shuffle(&mut order, seed);
    let mut taken: HashMap<Cell, Vec<u32>> = HashMap::new();
    let mut kept = Vec::new();
    for i in order {
        let p = positions[i as usize];
        let own = cell(p, spacing);
        if about(own).any(|cell| taken.get(&cell).is_some_and(|there| is_near(positions, there, p, spacing)))
        {
            continue;
        }
        taken.entry(own).or_default().push(i);
        kept.push(i);
    }
    kept.sort_unstable();
    kept
}

fn is_near(positions: &[Position], there: &[u32], p: Position, spacing: f64) -> bool {
    there.iter().any(|&j| {
        let q = positions[j as usize];
        (0..3).map(|a| (p[a] - q[a]).powi(2)).sum::<f64>() < spacing * spacing
    })
}

fn cell(p: Position, size: f64) -> Cell {
    // Saturates, far beyond where doubles tell neighbours apart.
    p.map(|c| (c / size).floor() as i64)
}

/// A cube and the 26 about it.
fn about(cell: Cell) -> impl Iterator<Item = Cell> {
    (0..27).map(move |i: i64| {
        let step = [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1];
        std::array::from_fn(|a| cell[a].saturating_add(step[a]))
    })
}

/// Fisher and Yates' shuffle.
fn shuffle(order: &mut [u32], seed: u64) {
    let mut random = Rng::new(seed);
    for i in (1..order.len()).rev() {
        order.swap(i, random.below(i as u64 + 1) as usize);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud() -> Vec<Position> {
        let mut random = Rng::new(3);
        (0..3000).map(|_| [500_000.0 + random.f64(), random.f64() - 0.5, 0.1 * random.f64()]).collect()
    }

    fn distance(p: Position, q: Position) -> f64 {
        (0..3).map(|a| (p[a] - q[a]).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn each_voxel_keeps_one_point_of_its_own() {
        let positions = cloud();
        let kept = one_a_voxel(&positions, 0.1);
        assert!(kept.is_sorted());
        let cells = |of: &mut dyn Iterator<Item = u32>| {
            let mut cells: Vec<Cell> = of.map(|i| cell(positions[i as usize], 0.1)).collect();
            cells.sort_unstable();
            cells
        };
        let of_kept = cells(&mut kept.iter().copied());
        let mut of_all = cells(&mut indices(positions.len()));
        of_all.dedup();
        assert_eq!(of_kept, of_all);
        let line = [[0.0; 3], [0.5, 0.0, 0.0], [0.9, 0.0, 0.0], [-0.1, 0.0, 0.0]];
        assert_eq!(one_a_voxel(&line, 1.0), [1, 3], "nearest to the mean; below zero is another voxel");
    }

    #[test]
    fn spaced_points_keep_their_distance_and_leave_no_room() {
        let positions = cloud();
        let kept = spaced(&positions, 0.07, 5);
        assert!(kept.is_sorted() && kept.len() > 100);
        let all: Vec<Position> = kept.iter().map(|&i| positions[i as usize]).collect();
        for (i, p) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|q| distance(*p, *q) >= 0.07));
        }
        assert!(positions.iter().all(|p| all.iter().any(|q| distance(*p, *q) < 0.07)));
        assert_ne!(spaced(&positions, 0.07, 6), kept);
    }
}
