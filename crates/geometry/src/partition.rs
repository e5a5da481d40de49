//! Space cut into boxes of about as many points each.

use densecloud_cloud::Position;

/// Boxes that fill space without overlap: the leaves of a k-d tree, whose cells have as many points of a sample each as can
/// be. Outer boxes reach to infinity.
///
/// What belongs where depends on the [`splits`](Self::splits) alone, so whoever has them decides alike.
///
/// ```
/// use densecloud_geometry::Partition;
///
/// let line: Vec<_> = (0..100).map(|i| [f64::from(i), 0.0, 0.0]).collect();
/// let partition = Partition::cut(line, 4);
/// assert_eq!([0.0, 30.0, 60.0, 1e9].map(|x| partition.cell_of([x, 0.0, 0.0])), [0, 1, 2, 3]);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Partition {
    splits: Vec<Split>,
    boxes: Vec<[Position; 2]>,
}

/// One node of the tree, in preorder: a node, all of its lower half, then all of its upper half.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Split {
    /// Points whose coordinate on that axis is below `at` are in the lower half.
    At {
        /// 0, 1 or 2.
        axis: u8,
        /// A finite coordinate.
        at: f64,
        /// Where the node of the upper half is.
        upper: u32,
    },
    /// A box with its number; these ascend from 0.
    Cell(u32),
}

/// Why splits are those of no partition.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the splits are those of no partition")]
pub struct NoPartition;

impl Partition {
    /// Cuts space into `cells` boxes (1 at least) by a sample of finite positions: along the longest side of what is in a
    /// box, near the middle, where the points are thin. Where points coincide there are fewer boxes. O(n log n log cells).
    #[must_use]
    pub fn cut(sample: Vec<Position>, cells: usize) -> Self {
        Self::graded(sample, cells, 0)
    }

    /// As [`cut`](Self::cut), with the first box halved so many times, and each time the lower half again: the first boxes
    /// are small, and what is made of them is soon done. Where there is one box alone it stays.
    ///
    /// ```
    /// use densecloud_geometry::Partition;
    ///
    /// let line: Vec<_> = (0..4000).map(|i| [f64::from(i), 0.0, 0.0]).collect();
    /// let partition = Partition::graded(line.clone(), 2, 2);
    /// let count = |cell| line.iter().filter(|p| partition.cell_of(**p) == cell).count();
    /// // 4000 points: about an eighth, an eighth, a quarter, a half.
    /// let about = |cell, share: usize| count(cell).abs_diff(share) < share / 2;
    /// assert!(partition.len() == 4 && about(0, 500) && about(1, 500) && about(2, 1000) && about(3, 2000));
    /// ```
    #[must_use]
    pub fn graded(mut sample: Vec<Position>, cells: usize, grades: u32) -> Self {
        let (mut splits, mut count) = (Vec::new(), 0);
        let grades = if cells > 1 { grades } else { 0 };
        split(&mut sample, cells.max(1), grades, &mut splits, &mut count);
        Self::of(splits)
    }

    /// The partition that has these splits.
    ///
    /// # Errors
    /// They are those of none.
    pub fn from_splits(splits: Vec<Split>) -> Result<Self, NoPartition> {
        let (mut cells, mut end) = (0, 0);
        check(&splits, &mut end, &mut cells)?;
        if end == splits.len() { Ok(Self::of(splits)) } else { Err(NoPartition) }
    }

    fn of(splits: Vec<Split>) -> Self {
        let mut boxes = Vec::new();
        find_boxes(&splits, 0, [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]], &mut boxes);
        Self { splits, boxes }
    }

    /// All nodes: [`Partition::from_splits`] makes the same partition of them.
    #[must_use]
    pub fn splits(&self) -> &[Split] {
        &self.splits
    }

    /// How many boxes there are.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "there is always one")]
    pub fn len(&self) -> usize {
        self.boxes.len()
    }

    /// The lowest and the highest corner of a box.
    ///
    /// # Panics
    /// There is no such box.
    #[must_use]
    pub fn bounds(&self, cell: u32) -> [Position; 2] {
        self.boxes[cell as usize]
    }

    /// The box that a position is in; its coordinates must not be NaN.
    #[must_use]
    pub fn cell_of(&self, p: Position) -> u32 {
        let mut node = 0;
        loop {
            match self.splits[node] {
                Split::Cell(cell) => return cell,
                Split::At { axis, at, .. } if p[usize::from(axis)] < at => node += 1,
                Split::At { upper, .. } => node = upper as usize,
            }
        }
    }

    /// How far a position is from a box; 0 inside.
    ///
    /// # Panics
    /// There is no such box.
    #[must_use]
    pub fn distance(&self, cell: u32, p: Position) -> f64 {
        let [lo, hi] = self.bounds(cell);
        let off = |a: usize| (lo[a] - p[a]).max(p[a] - hi[a]).max(0.0);
        (0..3).map(|a| off(a).powi(2)).sum::<f64>().sqrt()
    }

    /// How far a position is from the nearest face of the box that it is in; infinite where there is one box alone.
    #[must_use]
    pub fn border_distance(&self, p: Position) -> f64 {
        let [lo, hi] = self.bounds(self.cell_of(p));
        (0..3).map(|a| (p[a] - lo[a]).min(hi[a] - p[a])).fold(f64::INFINITY, f64::min)
    }

    /// Replaces `found` by the boxes that are no further than `reach` from a position, ascending; that which it is in is
    /// among them.
    pub fn near(&self, p: Position, reach: f64, found: &mut Vec<u32>) {
        found.clear();
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            match self.splits[node] {
                Split::Cell(cell) if self.distance(cell, p) <= reach => found.push(cell),
                Split::Cell(_) => {}
                Split::At { axis, at, upper } => {
                    let past = p[usize::from(axis)] - at;
                    if past >= -reach {
                        open.push(upper as usize);
                    }
                    if past < 0.0 || past <= reach {
                        open.push(node + 1);
                    }
                }
            }
        }
    }
}

fn split(points: &mut [Position], cells: usize, grades: u32, splits: &mut Vec<Split>, count: &mut u32) {
    let (cells, grades) = if cells == 1 && grades > 0 { (2, grades - 1) } else { (cells, grades) };
    if let Some((axis, at, lower)) = (cells > 1).then(|| halves(points, cells)).flatten() {
        let node = splits.len();
        splits.push(Split::Cell(0));
        let share = lower as f64 / points.len() as f64;
        let few = ((share * cells as f64).round() as usize).clamp(1, cells - 1);
        let (below, above) = points.split_at_mut(lower);
        split(below, few, grades, splits, count);
        splits[node] = Split::At { axis: axis as u8, at, upper: splits.len() as u32 };
        split(above, cells - few, 0, splits, count);
        return;
    }
    splits.push(Split::Cell(*count));
    *count += 1;
}

/// The share of the points on either side that does not count for how long a side is: a few outliers must not decide.
const TAIL: f64 = 0.05;
/// How far from the middle a plane may lie, as a share of the points, to lie where they are thin: not along a wall.
const ASIDE: f64 = 0.07;
/// Points that tell how thin they are, as a share.
const WINDOW: f64 = 0.01;

/// Sides that are this share of the longest one may be cut, too.
const LONG: f64 = 0.3;

/// Sorts the points into those below a plane and the others: the axis, where the plane is, and how many are below. None
/// where all points are the same.
fn halves(points: &mut [Position], cells: usize) -> Option<(usize, f64, usize)> {
    let last = points.len().checked_sub(1).filter(|last| *last > 0)?;
    let rank = |share: f64| (share * last as f64).round() as usize;
    let sorted: [Vec<f64>; 3] = std::array::from_fn(|a| {
        let mut all: Vec<f64> = points.iter().map(|p| p[a]).collect();
        all.sort_unstable_by(f64::total_cmp);
        all
    });
    let sides = |tail: f64| sorted.each_ref().map(|all| all[last - rank(tail)] - all[rank(tail)]);
    let longest = |sides: [f64; 3]| sides.into_iter().fold(0.0, f64::max);
    let sides = if longest(sides(TAIL)) > 0.0 { sides(TAIL) } else { sides(0.0) };
    let (middle, window) = ((cells / 2) as f64 / cells as f64, rank(WINDOW).max(1));
    let span = |axis: usize, from: usize| sorted[axis][(from + window).min(last)] - sorted[axis][from];
    let ranks = rank((middle - ASIDE).max(0.0))..=rank((middle + ASIDE).min(1.0));
    let axes = (0..3).filter(|a| sides[*a] > 0.0 && sides[*a] >= LONG * longest(sides));
    let places = axes.flat_map(|axis| ranks.clone().map(move |from| (axis, from)));
    // Of equally thin places the first.
    let thin =
        |a: &(usize, usize), b: &(usize, usize)| span(a.0, a.1).total_cmp(&span(b.0, b.1)).then(b.cmp(a));
    let (axis, from) = places.max_by(thin)?;
    let (all, lowest) = (&sorted[axis], sorted[axis][0]);
    let plane = all[from] + 0.5 * span(axis, from);
    // Where the lowest coordinate is that of most points, the next higher one.
    let plane = if plane > lowest { plane } else { *all.iter().find(|c| **c > lowest)? };
    points.sort_unstable_by(|p, q| p[axis].total_cmp(&q[axis]));
    Some((axis, plane, points.partition_point(|p| p[axis] < plane)))
}

/// Walks over one node and all below it, from `at` on.
fn check(splits: &[Split], at: &mut usize, cells: &mut u32) -> Result<(), NoPartition> {
    let node = *splits.get(*at).ok_or(NoPartition)?;
    *at += 1;
    match node {
        Split::Cell(cell) if cell == *cells => *cells += 1,
        Split::At { axis: 0..=2, at: coordinate, upper } if coordinate.is_finite() => {
            check(splits, at, cells)?;
            if *at != upper as usize {
                return Err(NoPartition);
            }
            check(splits, at, cells)?;
        }
        _ => return Err(NoPartition),
    }
    Ok(())
}

/// The box of each cell below a node, which is that `within`.
fn find_boxes(splits: &[Split], node: usize, within: [Position; 2], boxes: &mut Vec<[Position; 2]>) {
    match splits[node] {
        Split::Cell(_) => boxes.push(within),
        Split::At { axis, at, upper } => {
            let (mut lower, mut higher) = (within, within);
            lower[1][usize::from(axis)] = at;
            higher[0][usize::from(axis)] = at;
            find_boxes(splits, node + 1, lower, boxes);
            find_boxes(splits, upper as usize, higher, boxes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;
    use proptest::prelude::*;

    fn random(n: usize, seed: u64, round: bool) -> Vec<Position> {
        let mut rng = Rng::new(seed);
        let mut number = || if round { (4.0 * rng.f64()).floor() } else { 1e6 + 100.0 * rng.f64() };
        (0..n).map(|_| [number(), number(), number()]).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn what_is_near_is_what_all_boxes_say(
            seed in any::<u64>(), n in 1_usize..200, cells in 1_usize..20, round in any::<bool>(), reach in 0.0_f64..60.0,
        ) {
            let partition = Partition::cut(random(n, seed, round), cells);
            prop_assert!((1..=cells).contains(&partition.len()));
            prop_assert_eq!(Partition::from_splits(partition.splits().to_vec()), Ok(partition.clone()));
            let all = 0..partition.len() as u32;
            for p in random(50, seed ^ 1, round) {
                let inside: Vec<u32> = all.clone()
                    .filter(|&c| {
                        let [lo, hi] = partition.bounds(c);
                        (0..3).all(|a| lo[a] <= p[a] && p[a] < hi[a])
                    })
                    .collect();
                prop_assert_eq!(&inside, &[partition.cell_of(p)]);
                let mut found = Vec::new();
                partition.near(p, reach, &mut found);
                let near: Vec<u32> = all.clone().filter(|&c| partition.distance(c, p) <= reach).collect();
                prop_assert_eq!(&found, &near);
                // Whatever box is beside it begins at the nearest face.
                let border = partition.border_distance(p);
                let others = all.clone().filter(|&c| c != inside[0]).map(|c| partition.distance(c, p));
                prop_assert!(others.fold(f64::INFINITY, f64::min) >= border);
            }
        }
    }

    #[test]
    fn boxes_have_about_as_many_points_each() {
        for cells in [1, 2, 3, 7, 60] {
            let points = random(6000, 3, false);
            let partition = Partition::cut(points.clone(), cells);
            let mut counts = vec![0_usize; partition.len()];
            points.iter().for_each(|p| counts[partition.cell_of(*p) as usize] += 1);
            let even = 6000 / cells;
            assert_eq!(counts.len(), cells);
            assert!(
                counts.iter().all(|c| (6 * even..=15 * even).contains(&(10 * c))),
                "{counts:?} of {even}"
            );
        }
    }

    #[test]
    fn borders_keep_off_walls_and_do_not_heed_outliers() {
        // A floor with noise and a wall in its middle, a few points far above.
        let mut rng = Rng::new(4);
        let mut points: Vec<Position> =
            (0..4000).map(|_| [10.0 * rng.f64(), 10.0 * rng.f64(), 0.01 * rng.f64()]).collect();
        points.extend((0..2000).map(|_| [5.0 + 0.01 * rng.f64(), 10.0 * rng.f64(), 3.0 * rng.f64()]));
        points.extend((0..20).map(|i| [1.0, 1.0, 100.0 + f64::from(i)]));
        for cells in [2, 4] {
            let partition = Partition::cut(points.clone(), cells);
            let near = |p: &&Position| partition.border_distance(**p) < 0.02;
            let share = points.iter().filter(near).count() as f64 / points.len() as f64;
            assert!(
                share < 0.02 * cells as f64,
                "{share} of the points lie along the borders of {cells} cells"
            );
        }
    }

    #[test]
    fn points_that_coincide_share_a_box() {
        assert_eq!(Partition::cut(vec![[1.0; 3]; 100], 8).len(), 1);
        assert_eq!(Partition::cut(Vec::new(), 8).len(), 1);
        let mut points = vec![[1.0; 3]; 100];
        points.push([2.0, 1.0, 1.0]);
        assert_eq!(Partition::cut(points, 8).len(), 2);
    }

    #[test]
    fn splits_of_no_partition_are_refused() {
        let cell = Split::Cell;
        let at = |upper| Split::At { axis: 0, at: 0.0, upper };
        for splits in [
            vec![],
            vec![cell(1)],
            vec![cell(0), cell(1)],
            vec![at(2), cell(0)],
            vec![at(1), cell(0), cell(1)],
            vec![at(2), cell(1), cell(0)],
            vec![Split::At { axis: 3, at: 0.0, upper: 2 }, cell(0), cell(1)],
            vec![Split::At { axis: 0, at: f64::NAN, upper: 2 }, cell(0), cell(1)],
        ] {
            assert_eq!(Partition::from_splits(splits.clone()), Err(NoPartition), "{splits:?}");
        }
        assert!(Partition::from_splits(vec![at(2), cell(0), cell(1)]).is_ok());
    }
}
