//! Poisson-disk sampling of a mesh by weighted sample elimination.

use super::uniform::Surface;
use super::{Mesh, Rng, SampleError};
use densecloud_cloud::Position;

/// Candidates drawn for each point that stays.
const CANDIDATES_PER_POINT: usize = 5;
/// Small counts are cheap, and gain from more candidates.
const LEAST_CANDIDATES: usize = 2000;
/// Cells a side of the grid at most, so that a cell packs into 63 bits.
const MAX_CELL: f64 = ((1u64 << 21) - 1) as f64;

/// Exactly `count` points spread evenly over the surface (blue noise).
///
/// Weighted sample elimination (Yuksel, "Sample Elimination for Generating Poisson Disk Sample
/// Sets", 2015): of 5 `count` area-uniform candidates, the most crowded goes first, until `count`
/// are left. Crowding sums `(1 - d / 2r)^8` over the other candidates at a straight-line distance
/// `d < 2r`, where `r` is the largest radius that `count` disks could have on this area, and
/// `d` no less than the paper's limit for close pairs.
///
/// O(n log n). 80,000 points take about a second. The order of the points is spatial.
/// Two counts, like two seeds, give independent samples.
///
/// # Errors
/// See [`SampleError`].
pub fn poisson_disk(mesh: &Mesh, count: usize, seed: u64) -> Result<Vec<Position>, SampleError> {
    let limit = u32::MAX as usize / (2 * CANDIDATES_PER_POINT);
    if count > limit {
        return Err(SampleError::TooMany { points: count, limit });
    }
    let surface = Surface::new(mesh)?;
    if count == 0 {
        return Ok(Vec::new());
    }
    let mut rng = Rng::stream(seed, count as u64);
    let candidates = (CANDIDATES_PER_POINT * count).max(LEAST_CANDIDATES);
    let candidates: Vec<Position> = (0..candidates).map(|_| surface.random(&mut rng)).collect();
    // The radius of the disks of a hexagonal packing.
    let r_max = (surface.area() / (2.0 * 3.0_f64.sqrt() * count as f64)).sqrt();
    Ok(eliminate(candidates, count, 2.0 * r_max))
}

/// Removes the most crowded candidate until `count` are left; `reach` is 2 r_max.
fn eliminate(candidates: Vec<Position>, count: usize, reach: f64) -> Vec<Position> {
    let kept_share = count as f64 / candidates.len() as f64;
    // Equation 5 of the paper with its gamma = 1.5 and beta = 0.65, in units of the reach.
    let least_distance = (1.0 - kept_share.powf(1.5)) * 0.65;
    let grid = Grid::new(candidates, reach);
    let n = grid.points.len();
    let mut crowding = vec![0_u64; n];
    for (i, sum) in crowding.iter_mut().enumerate() {
        grid.for_each_within(i, |_, d| *sum += weight(d, least_distance));
    }
    let mut heap = Heap::new(crowding);
    for _ in count..n {
        let worst = heap.pop();
        grid.for_each_within(worst, |j, d| heap.lower(j, weight(d, least_distance)));
    }
    grid.originals.iter().enumerate().filter(|&(i, _)| heap.contains(i)).map(|(_, &p)| p).collect()
}

/// The share of a neighbour at distance `d` (in reaches) in a candidate's crowding, in units of
/// 2^-32. Integers, so that sums do not depend on their order and ties are ties; 2^32 candidates
/// at one place would not overflow.
fn weight(d: f64, least: f64) -> u64 {
    let w = 1.0 - d.max(least);
    let w2 = w * w;
    let w4 = w2 * w2;
    (w4 * w4 * (1u64 << 32) as f64) as u64
}

/// Candidates sorted by the cells of a grid whose side is the reach, so that the neighbours of a
/// point are in nine runs of consecutive points (three cells in x each).
struct Grid {
    originals: Vec<Position>,
    /// Offsets from the lowest corner, in reaches.
    points: Vec<Position>,
    cell_of: Vec<u32>,
    /// For each occupied cell, the nine runs as first and last-but-one index.
    runs: Vec<[(u32, u32); 9]>,
}

impl Grid {
    fn new(candidates: Vec<Position>, reach: f64) -> Self {
        let mut lo = [f64::INFINITY; 3];
        for p in &candidates {
            for a in 0..3 {
                lo[a] = lo[a].min(p[a]);
            }
        }
        let scaled = |p: &Position| -> Position { std::array::from_fn(|a| (p[a] - lo[a]) / reach) };
        // Points beyond the last cell fall into it: slower there, never wrong.
        let key = |p: &Position| -> u64 {
            let s = scaled(p);
            let [x, y, z] = std::array::from_fn(|a| s[a].min(MAX_CELL) as u64);
            z << 42 | y << 21 | x
        };
        let mut order: Vec<(u64, u32)> =
            candidates.iter().enumerate().map(|(i, p)| (key(p), i as u32)).collect();
        order.sort_unstable();
        let originals: Vec<Position> = order.iter().map(|&(_, i)| candidates[i as usize]).collect();
        let points = originals.iter().map(scaled).collect();

        let mut cell_of = Vec::with_capacity(order.len());
        let mut cells: Vec<u64> = Vec::new();
        for &(k, _) in &order {
            if cells.last() != Some(&k) {
                cells.push(k);
            }
            cell_of.push(cells.len() as u32 - 1);
        }
        Self { originals, points, cell_of, runs: runs(&cells, &order) }
    }

    /// Calls `visit` with the index and the distance (in reaches) of all points nearer than one
    /// reach, point `i` itself excluded, always in the same order.
    fn for_each_within(&self, i: usize, mut visit: impl FnMut(usize, f64)) {
        let p = self.points[i];
        for &(start, end) in &self.runs[self.cell_of[i] as usize] {
            let start = start as usize;
            for (j, q) in (start..).zip(&self.points[start..end as usize]) {
                let (x, y, z) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
                let squared = x * x + y * y + z * z;
                if squared < 1.0 && j != i {
                    visit(j, squared.sqrt());
                }
            }
        }
    }
}

/// For each cell the points in the cells around it. Cells come in ascending order, so each of the
/// nine runs only ever moves forward: one sweep, no search.
fn runs(cells: &[u64], order: &[(u64, u32)]) -> Vec<[(u32, u32); 9]> {
    const SIDE: i64 = 1 << 21;
    let mut runs = vec![[(0, 0); 9]; cells.len()];
    for row in 0..9 {
        let (dy, dz) = (row as i64 % 3 - 1, row as i64 / 3 - 1);
        let (mut start, mut end) = (0, 0);
        for (cell, runs) in cells.iter().zip(&mut runs) {
            let [x, y, z] = [0, 21, 42].map(|shift| (cell >> shift) as i64 & (SIDE - 1));
            let (y, z) = (y + dy, z + dz);
            if !(0..SIDE).contains(&y) || !(0..SIDE).contains(&z) {
                continue;
            }
            let base = z * SIDE * SIDE + y * SIDE;
            let first = (base + (x - 1).max(0)) as u64;
            let last = (base + (x + 1).min(SIDE - 1)) as u64;
            while start < order.len() && order[start].0 < first {
                start += 1;
            }
            end = end.max(start);
            while end < order.len() && order[end].0 <= last {
                end += 1;
            }
            runs[row] = (start as u32, end as u32);
        }
    }
    runs
}

/// A binary heap of candidates, the most crowded first, ties by the lowest index. It knows where
/// each one is, because crowding changes all the time.
struct Heap {
    crowding: Vec<u64>,
    heap: Vec<u32>,
    /// Place of a candidate in `heap`, `GONE` once popped.
    place: Vec<u32>,
}

const GONE: u32 = u32::MAX;

impl Heap {
    fn new(crowding: Vec<u64>) -> Self {
        let ids: Vec<u32> = (0..crowding.len() as u32).collect();
        let mut heap = Self { crowding, heap: ids.clone(), place: ids };
        for at in (0..heap.heap.len() / 2).rev() {
            heap.sift_down(at);
        }
        heap
    }

    fn contains(&self, id: usize) -> bool {
        self.place[id] != GONE
    }

    /// Takes out the most crowded one. The heap must not be empty.
    fn pop(&mut self) -> usize {
        let top = self.heap.swap_remove(0);
        self.place[top as usize] = GONE;
        if let Some(&moved) = self.heap.first() {
            self.place[moved as usize] = 0;
            self.sift_down(0);
        }
        top as usize
    }

    fn lower(&mut self, id: usize, by: u64) {
        let at = self.place[id];
        if at != GONE {
            self.crowding[id] -= by;
            self.sift_down(at as usize);
        }
    }

    fn sift_down(&mut self, mut at: usize) {
        let id = self.heap[at];
        let key = self.crowding[id as usize];
        loop {
            let mut child = 2 * at + 1;
            if child >= self.heap.len() {
                break;
            }
            if child + 1 < self.heap.len() && self.before(self.heap[child + 1], self.heap[child]) {
                child += 1;
            }
            let other = self.heap[child];
            let other_key = self.crowding[other as usize];
            if other_key < key || (other_key == key && other > id) {
                break;
            }
            self.heap[at] = other;
            self.place[other as usize] = at as u32;
            at = child;
        }
        self.heap[at] = id;
        self.place[id as usize] = at as u32;
    }

    fn before(&self, a: u32, b: u32) -> bool {
        let (ka, kb) = (self.crowding[a as usize], self.crowding[b as usize]);
        ka > kb || (ka == kb && a < b)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{KdTree, Rng, shape, uniform};
    use super::*;
    use proptest::prelude::*;

    /// The algorithm as the paper states it, with no grid and no heap; indices that stay.
    fn plain(points: &[Position], count: usize) -> Vec<usize> {
        let least = (1.0 - (count as f64 / points.len() as f64).powf(1.5)) * 0.65;
        let share = |p: &Position, q: &Position| {
            let (x, y, z) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
            let squared = x * x + y * y + z * z;
            if squared < 1.0 { weight(squared.sqrt(), least) } else { 0 }
        };
        let mut left: Vec<usize> = (0..points.len()).collect();
        while left.len() > count {
            let crowding = |&i: &usize| -> u64 {
                left.iter().filter(|&&j| j != i).map(|&j| share(&points[i], &points[j])).sum()
            };
            // The last of equal maxima in reverse order is the lowest index.
            let worst = (0..left.len()).rev().max_by_key(|&at| crowding(&left[at]));
            left.remove(worst.expect("a candidate"));
        }
        left
    }

    fn distances(points: &[Position]) -> Vec<f32> {
        let points: Vec<_> = points.iter().map(|p| p.map(|c| c as f32)).collect();
        let tree = KdTree::new(&points);
        let mut out = Vec::new();
        points
            .iter()
            .map(|&p| {
                tree.nearest(p, 2, &mut out);
                out[1].distance_squared.sqrt()
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn equals_the_plain_algorithm(seed in any::<u64>(), n in 2usize..60, share in 0.1f64..1.0, reach in 0.05f64..2.0) {
            let mut rng = Rng::new(seed);
            let candidates: Vec<Position> = (0..n).map(|_| [rng.f64(), rng.f64(), 0.2 * rng.f64()]).collect();
            let count = ((n as f64 * share) as usize).max(1);
            let grid = Grid::new(candidates.clone(), reach);
            let reference: Vec<Position> =
                plain(&grid.points, count).iter().map(|&i| grid.originals[i]).collect();
            prop_assert_eq!(eliminate(candidates, count, reach), reference);
        }
    }

    #[test]
    fn points_keep_their_distance() {
        let mesh = shape("knot").expect("the knot");
        let points = poisson_disk(&mesh, 1000, 1).expect("points");
        assert_eq!(points.len(), 1000);
        let r_max = (mesh.area() / (2.0 * 3.0_f64.sqrt() * 1000.0)).sqrt() as f32;
        let least = |d: &[f32]| d.iter().copied().fold(f32::INFINITY, f32::min) / (2.0 * r_max);
        // The paper reaches 0.7 and above for such counts; random points have no lower bound.
        assert!(least(&distances(&points)) > 0.6, "{}", least(&distances(&points)));
        assert!(least(&distances(&uniform(&mesh, 1000, 1).expect("points"))) < 0.1);
    }

    #[test]
    fn counts_are_exact_and_samples_independent() {
        let mesh = shape("gear").expect("the gear");
        for count in [0, 1, 2, 10, 333] {
            assert_eq!(poisson_disk(&mesh, count, 5).expect("points").len(), count);
        }
        let a = poisson_disk(&mesh, 100, 5).expect("points");
        assert_eq!(a, poisson_disk(&mesh, 100, 5).expect("points"));
        let b = poisson_disk(&mesh, 200, 5).expect("points");
        assert!(a.iter().all(|p| !b.contains(p)), "two sizes share a point");
    }

    #[test]
    fn too_many_points_is_an_error() {
        let mesh = shape("gear").expect("the gear");
        assert!(matches!(poisson_disk(&mesh, usize::MAX, 0), Err(SampleError::TooMany { .. })));
    }

    #[test]
    fn long_thin_and_distant_meshes_work() {
        let sliver = |at: f64| vec![[at, 0.0, 0.0], [at + 1e-7, 0.0, 0.0], [at, 1e-7, 0.0]];
        let mesh =
            Mesh { vertices: [sliver(0.0), sliver(1e6)].concat(), triangles: vec![[0, 1, 2], [3, 4, 5]] };
        assert_eq!(poisson_disk(&mesh, 50, 0).expect("points").len(), 50);
    }
}
