//! Exact nearest neighbours by a k-d tree of our own.

use pulp::{Arch, Simd, WithSimd};

use super::limit::indices;
use densecloud_cloud::Point;

/// Points in a leaf at most; leaves hold between half of this and this.
const LEAF: usize = 32;
/// Halves of more points than this are built in parallel: less is not worth a task.
const PARALLEL: usize = 1 << 13;
/// Up to this many neighbours are kept sorted, which is faster than a heap for few.
const SORTED_MAX: usize = 64;
/// Points whose distances are computed at once: as many as most processors' vectors hold.
const LANES: usize = 8;
/// More levels of inner nodes than the largest tree has.
const DEEPEST: usize = 32;

/// The key of no point: above all others.
const NOTHING: u64 = i64::MAX as u64;

/// A point found near a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Index of the point in the slice that the tree was made from.
    pub index: u32,
    /// Its squared distance, in `f32` as `dx * dx + dy * dy + dz * dz`.
    pub distance_squared: f32,
}

/// Where [`KdTree::nearest_next`] is, and what it found there, as [`KdTree::nearest`] gives it.
#[derive(Debug, Clone, Default)]
pub struct Walk {
    /// The last answer.
    pub found: Vec<Neighbour>,
    at: Point,
}

/// A balanced k-d tree over points, which it copies into leaf order.
///
/// Exact: the same neighbours in the same order as comparing all squared distances (in `f32`),
/// ties by the lowest index. Query in the order of [`KdTree::order`] when all points are
/// queried: that is about twice as fast.
///
/// Precondition: coordinates are finite. With NaN inside, nothing panics, and the result means
/// nothing.
///
/// ```
/// use densecloud_geometry::KdTree;
///
/// let tree = KdTree::new(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]]);
/// let mut found = Vec::new();
/// tree.nearest([0.9, 0.0, 0.0], 2, &mut found);
/// assert_eq!(found.iter().map(|n| n.index).collect::<Vec<_>>(), [1, 0]);
/// ```
#[derive(Debug, Clone)]
pub struct KdTree {
    /// Original index of the point at each place.
    order: Vec<u32>,
    /// Coordinates in leaf order, one array an axis, so that a leaf's distances vectorise; then so many zeros that whole
    /// vectors can be read from any point on.
    axes: [Vec<f32>; 3],
    /// Inner nodes of a complete binary tree from left to right, so that a subtree's are together.
    /// The range of a node is halved exactly, so ranges need not be stored.
    splits: Vec<Split>,
    /// Number of levels of inner nodes.
    depth: u32,
    lo: Point,
    hi: Point,
}

/// Points at or below `value` on `axis` are to the left (ties may be on both sides).
#[derive(Debug, Clone, Copy, Default)]
struct Split {
    axis: u32,
    value: f32,
}

impl KdTree {
    /// Builds the tree: O(n log n), on all threads of the current pool. An empty slice gives a tree
    /// that finds nothing.
    ///
    /// # Panics
    /// Above [`MAX_POINTS`](crate::MAX_POINTS).
    #[must_use]
    pub fn new(points: &[Point]) -> Self {
        let n = points.len();
        let mut depth = 0;
        while n.div_ceil(1 << depth) > LEAF {
            depth += 1;
        }
        let mut items: Vec<(Point, u32)> = points.iter().copied().zip(indices(n)).collect();
        let mut splits = vec![Split::default(); (1 << depth) - 1];
        build(&mut items, depth, &mut splits);
        let (lo, hi) = bounds(points.iter().copied());
        let axis = |a: usize| items.iter().map(|(p, _)| p[a]).chain([0.0; LANES]).collect();
        Self {
            order: items.iter().map(|&(_, i)| i).collect(),
            axes: std::array::from_fn(axis),
            splits,
            depth,
            lo,
            hi,
        }
    }

    /// Builds the tree and puts the points into its order: index `i` is then the `i`th of the points
    /// that come back, and points near each other mostly lie near each other in memory.
    ///
    /// # Panics
    /// Above [`MAX_POINTS`](crate::MAX_POINTS).
    #[must_use]
    pub fn in_order(points: &[Point]) -> (Self, Vec<Point>) {
        let (tree, sorted, _) = Self::sorted(points);
        (tree, sorted)
    }

    /// As [`Self::in_order`], with the index that each of the points had.
    ///
    /// # Panics
    /// Above [`MAX_POINTS`](crate::MAX_POINTS).
    #[must_use]
    pub fn sorted(points: &[Point]) -> (Self, Vec<Point>, Vec<u32>) {
        let mut tree = Self::new(points);
        let sorted = tree.order.iter().map(|&i| points[i as usize]).collect();
        let in_order = indices(tree.order.len()).collect();
        let order = std::mem::replace(&mut tree.order, in_order);
        (tree, sorted, order)
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// Whether there is no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// The indices of all points, near ones mostly near each other: a good order for queries.
    #[must_use]
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// The `k` nearest points, ascending by distance, ties by index; all when there are fewer.
    /// `out` is cleared first; its capacity is reused.
    pub fn nearest(&self, query: Point, k: usize, out: &mut Vec<Neighbour>) {
        self.nearest_below(query, k, NOTHING, out);
    }

    /// As [`KdTree::nearest`], into `walk.found`, for a row of queries near each other: the last
    /// answer bounds the next one. A walk belongs to one tree and one `k`.
    pub fn nearest_next(&self, query: Point, k: usize, walk: &mut Walk) {
        let limit = match walk.found.last() {
            // The k points found are no further than this, by the triangle inequality; rounding may
            // take a few of the last bits.
            Some(last) if walk.found.len() == k => {
                let step = squared(std::array::from_fn(|a| query[a] - walk.at[a])).sqrt();
                let reach = (last.distance_squared.sqrt() + step) * (1.0 + 1e-5);
                u64::from((reach * reach).to_bits()) << 32 | u64::from(u32::MAX)
            }
            _ => NOTHING,
        };
        self.nearest_below(query, k, limit, &mut walk.found);
        walk.at = query;
    }

    /// `limit`: a key above those of the answer.
    fn nearest_below(&self, query: Point, k: usize, limit: u64, out: &mut Vec<Neighbour>) {
        out.clear();
        let k = k.min(self.len());
        if k == 0 {
            return;
        }
        match k {
            1 => self.sorted_below::<1>(query, k, limit, out),
            2..=8 => self.sorted_below::<8>(query, k, limit, out),
            9..=16 => self.sorted_below::<16>(query, k, limit, out),
            17..=24 => self.sorted_below::<24>(query, k, limit, out),
            25..=32 => self.sorted_below::<32>(query, k, limit, out),
            33..=SORTED_MAX => self.sorted_below::<SORTED_MAX>(query, k, limit, out),
            _ => {
                let mut best = Pool { keys: Vec::with_capacity(2 * k), k, worst: limit };
                self.search(query, &mut best);
                best.shrink();
                best.keys.sort_unstable();
                out.extend(best.keys.iter().map(|&key| neighbour(key)));
            }
        }
    }

    /// The same where `k` is `M` at most.
    fn sorted_below<const M: usize>(&self, query: Point, k: usize, limit: u64, out: &mut Vec<Neighbour>) {
        let mut best = Sorted::<M>::new(k, limit);
        self.search(query, &mut best);
        out.extend(best.keys[M - k..].iter().map(|&key| neighbour(key as u64)));
    }

    /// The nearest point, ties by index; `None` for an empty tree.
    #[must_use]
    pub fn nearest_one(&self, query: Point) -> Option<Neighbour> {
        let mut best = Sorted::<1>::new(1, NOTHING);
        if self.is_empty() {
            return None;
        }
        self.search(query, &mut best);
        Some(neighbour(best.keys[0] as u64))
    }

    /// The nearest of the points whose indices are `accepted`, no further than `reach`; ties by index. Looks at all
    /// points that are nearer, and so costs as much as finding those.
    ///
    /// ```
    /// use densecloud_geometry::KdTree;
    ///
    /// let tree = KdTree::new(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [5.0, 0.0, 0.0]]);
    /// assert_eq!(tree.nearest_that([0.9, 0.0, 0.0], 9.0, |i| i != 1).map(|n| n.index), Some(0));
    /// assert_eq!(tree.nearest_that([0.9, 0.0, 0.0], 0.5, |i| i != 1), None);
    /// ```
    #[must_use]
    pub fn nearest_that(
        &self,
        query: Point,
        reach: f32,
        accepted: impl Fn(u32) -> bool,
    ) -> Option<Neighbour> {
        let none = u64::from((reach * reach).to_bits()) << 32 | u64::from(u32::MAX);
        let mut best = That { key: none, accepted };
        if !self.is_empty() {
            self.search(query, &mut best);
        }
        (best.key != none).then(|| neighbour(best.key))
    }

    fn search(&self, query: Point, best: &mut impl Best) {
        // Compiled for the processor's own vectors: distances are most of the time.
        Arch::new().dispatch(Search { tree: self, query, best });
    }
}

/// A search on its way.
struct Search<'a, B> {
    tree: &'a KdTree,
    query: Point,
    best: &'a mut B,
}

impl<B: Best> WithSimd for Search<'_, B> {
    type Output = ();

    /// Without recursion, which would end what is compiled for the processor.
    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        let KdTree { lo, hi, depth, .. } = self.tree;
        let offset = |a: usize| (lo[a] - self.query[a]).max(self.query[a] - hi[a]).max(0.0);
        let all = Place { first: 0, start: 0, end: self.tree.len() as u32, height: *depth };
        // What lies on the other side of the splits on the way down, with its offset.
        let mut aside = [(all, std::array::from_fn(offset)); DEEPEST];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (mut place, offset) = aside[count % DEEPEST];
            if squared(offset) > self.best.worst() {
                continue;
            }
            while place.height > 0 {
                let far;
                (place, far) = self.parted(place, offset);
                aside[count % DEEPEST] = far;
                count += 1;
            }
            self.scan(place.start as usize, place.end as usize);
        }
    }
}

impl<B: Best> Search<'_, B> {
    /// A node's child on the query's side, which is no further off, and the other one with its offset.
    ///
    /// `offset` is how far the node's cell is from the query on each axis. Its squared length is
    /// computed with the expression of the distances; rounding is monotone, so it never exceeds
    /// the computed distance of a point inside, and nothing is lost by comparing the two.
    #[inline(always)]
    fn parted(&self, Place { first, start, end, height }: Place, offset: Point) -> (Place, (Place, Point)) {
        let middle = start.midpoint(end);
        let node = first + (1 << (height - 1)) - 1;
        let left = Place { first, start, end: middle, height: height - 1 };
        let right = Place { first: node + 1, start: middle, end, height: height - 1 };
        let Split { axis, value } = self.tree.splits[node as usize];
        let [x, y, z] = self.query;
        let beyond = [x, y, z][axis as usize % 3] - value;
        // Not by index: what is read as a whole right after a part of it was written waits for that.
        let further = |a: usize| if a as u32 == axis { offset[a].max(beyond.abs()) } else { offset[a] };
        let offset = std::array::from_fn(further);
        if beyond <= 0.0 { (left, (right, offset)) } else { (right, (left, offset)) }
    }

    #[inline(always)]
    fn scan(&mut self, start: usize, end: usize) {
        let [qx, qy, qz] = self.query;
        let mut distances = [[0.0_f32; LANES]; LEAF / LANES];
        // Most points are too far, which no branch predictor can foresee: pick the others without
        // a branch.
        let worst = self.best.worst();
        let mut near = 0_u32;
        for (group, distances) in distances.iter_mut().enumerate().take((end - start).div_ceil(LANES)) {
            let from = start + group * LANES;
            let [xs, ys, zs] = self.tree.axes.each_ref().map(|axis| &axis[from..from + LANES]);
            for lane in 0..LANES {
                distances[lane] = squared([xs[lane] - qx, ys[lane] - qy, zs[lane] - qz]);
            }
            for (lane, &d) in distances.iter().enumerate() {
                near |= u32::from(d <= worst) << (group * LANES + lane);
            }
        }
        near &= u32::MAX >> (LEAF - (end - start));
        while near != 0 {
            let place = near.trailing_zeros() as usize % LEAF;
            near &= near - 1;
            let index = self.tree.order[start + place];
            let distance = distances[place / LANES][place % LANES];
            self.best.offer(u64::from(distance.to_bits()) << 32 | u64::from(index));
        }
    }
}

/// A subtree: its first inner node, its points, and its levels of inner nodes.
#[derive(Clone, Copy)]
struct Place {
    first: u32,
    start: u32,
    end: u32,
    height: u32,
}

/// The best candidates so far. A key is the bits of the squared distance above the index: for
/// numbers that are not negative the order of bits is the order of values, so one comparison of
/// integers orders by distance and then by index.
trait Best {
    fn offer(&mut self, key: u64);
    /// The squared distance above which nothing is of use.
    fn worst(&self) -> f32;
}

/// Keeps `k <= M` keys sorted, at the end of `keys`; before them are such as are below all others.
struct Sorted<const M: usize> {
    keys: [i64; M],
}

impl<const M: usize> Sorted<M> {
    fn new(k: usize, limit: u64) -> Self {
        let limit = limit.min(i64::MAX as u64) as i64;
        Self { keys: std::array::from_fn(|i| if i + k < M { i64::MIN } else { limit }) }
    }
}

impl<const M: usize> Best for Sorted<M> {
    /// All places alike, in vectors: which one a key goes to cannot be foreseen.
    #[inline(always)]
    fn offer(&mut self, key: u64) {
        let key = key as i64;
        if key >= self.keys[M - 1] {
            return;
        }
        let (fours, rest) = self.keys.as_chunks_mut::<4>();
        let mut last = i64::MIN;
        for keys in fours {
            let [a, b, c, d] = *keys;
            *keys = [a.min(key).max(last), b.min(key).max(a), c.min(key).max(b), d.min(key).max(c)];
            last = d;
        }
        for place in rest {
            (*place, last) = ((*place).min(key).max(last), *place);
        }
    }

    #[inline(always)]
    fn worst(&self) -> f32 {
        distance(self.keys[M - 1] as u64)
    }
}

/// Keeps the best of the accepted keys.
struct That<F> {
    key: u64,
    accepted: F,
}

impl<F: Fn(u32) -> bool> Best for That<F> {
    #[inline(always)]
    fn offer(&mut self, key: u64) {
        if key < self.key && (self.accepted)(key as u32) {
            self.key = key;
        }
    }

    #[inline(always)]
    fn worst(&self) -> f32 {
        distance(self.key)
    }
}

/// Keeps up to `2 k` keys unsorted and throws away the worse half when full: constant time a key,
/// for a bound that is a little late.
struct Pool {
    keys: Vec<u64>,
    k: usize,
    worst: u64,
}

impl Pool {
    fn shrink(&mut self) {
        if self.keys.len() > self.k {
            let (_, &mut worst, _) = self.keys.select_nth_unstable(self.k - 1);
            self.worst = worst;
            self.keys.truncate(self.k);
        }
    }
}

impl Best for Pool {
    #[inline(always)]
    fn offer(&mut self, key: u64) {
        if key < self.worst {
            self.keys.push(key);
            if self.keys.len() == 2 * self.k {
                self.shrink();
            }
        }
    }

    #[inline(always)]
    fn worst(&self) -> f32 {
        distance(self.worst)
    }
}

fn neighbour(key: u64) -> Neighbour {
    Neighbour { index: key as u32, distance_squared: f32::from_bits((key >> 32) as u32) }
}

#[inline(always)]
fn distance(key: u64) -> f32 {
    // No key yet: everything is welcome.
    if key == NOTHING { f32::INFINITY } else { f32::from_bits((key >> 32) as u32) }
}

/// The one expression for squared lengths in this module: results must agree to the last bit.
#[inline(always)]
pub(super) fn squared([x, y, z]: Point) -> f32 {
    x * x + y * y + z * z
}

fn build(items: &mut [(Point, u32)], levels: u32, splits: &mut [Split]) {
    if levels == 0 {
        // The order inside a leaf must not depend on how the selection below is implemented.
        items.sort_unstable_by_key(|&(_, i)| i);
        return;
    }
    let (lo, hi) = bounds(items.iter().map(|(p, _)| *p));
    let side = |a: usize| hi[a] - lo[a];
    let axis = (1..3).fold(0, |best, a| if side(a) > side(best) { a } else { best });
    let middle = items.len() / 2;
    // Ties by index make the two halves unique.
    let (_, &mut (pivot, _), _) =
        items.select_nth_unstable_by(middle, |(p, i), (q, j)| p[axis].total_cmp(&q[axis]).then(i.cmp(j)));
    let parallel = items.len() > PARALLEL;
    let (left, right) = items.split_at_mut(middle);
    let (left_splits, rest) = splits.split_at_mut((1 << (levels - 1)) - 1);
    rest[0] = Split { axis: axis as u32, value: pivot[axis] };
    let right_splits = &mut rest[1..];
    if parallel {
        rayon::join(|| build(left, levels - 1, left_splits), || build(right, levels - 1, right_splits));
    } else {
        build(left, levels - 1, left_splits);
        build(right, levels - 1, right_splits);
    }
}

pub(super) fn bounds(points: impl Iterator<Item = Point>) -> (Point, Point) {
    let mut lo = [f32::INFINITY; 3];
    let mut hi = [f32::NEG_INFINITY; 3];
    for p in points {
        for a in 0..3 {
            lo[a] = lo[a].min(p[a]);
            hi[a] = hi[a].max(p[a]);
        }
    }
    (lo, hi)
}

#[cfg(test)]
mod tests {
    use super::super::Rng;
    use super::*;
    use proptest::prelude::*;

    fn brute(points: &[Point], q: Point, k: usize) -> Vec<Neighbour> {
        let mut all: Vec<Neighbour> = points
            .iter()
            .zip(0..)
            .map(|(p, index)| Neighbour {
                index,
                distance_squared: squared([p[0] - q[0], p[1] - q[1], p[2] - q[2]]),
            })
            .collect();
        all.sort_by(|a, b| a.distance_squared.total_cmp(&b.distance_squared).then(a.index.cmp(&b.index)));
        all.truncate(k);
        all
    }

    /// Random points; a coarse grid makes ties and duplicates, a flat one zero extents.
    fn cloud(seed: u64, n: usize, kind: u8) -> Vec<Point> {
        let mut rng = Rng::new(seed);
        (0..n)
            .map(|_| {
                let p: Point = std::array::from_fn(|_| (2.0 * rng.f64() - 1.0) as f32);
                match kind {
                    0 => p,
                    1 => p.map(|c| (c * 3.0).round()),
                    2 => [p[0], 0.0, 0.0],
                    _ => [0.25; 3],
                }
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn finds_what_brute_force_finds(
            seed in any::<u64>(), n in 0usize..700, k in prop::sample::select(vec![0usize, 1, 2, 5, 32, 64, 65, 312]), kind in 0u8..4,
        ) {
            let points = cloud(seed, n, kind);
            let tree = KdTree::new(&points);
            let mut out = vec![Neighbour { index: 9, distance_squared: 9.0 }];
            let mut walk = Walk::default();
            for q in cloud(seed ^ 1, 4, 0).into_iter().chain(points.iter().copied().take(4)).chain([[7.0, -3.0, 0.1]]) {
                tree.nearest(q, k, &mut out);
                prop_assert_eq!(&out, &brute(&points, q, k));
                tree.nearest_next(q, k, &mut walk);
                prop_assert_eq!(&walk.found, &out);
                let third = |i: u32| i % 3 == 1;
                let nearest = brute(&points, q, n).into_iter().find(|n| third(n.index));
                prop_assert_eq!(tree.nearest_that(q, 100.0, third), nearest);
                prop_assert_eq!(tree.nearest_one(q), brute(&points, q, 1).first().copied());
            }
        }
    }

    #[test]
    fn in_order_indices_name_the_points_that_come_back() {
        let points = cloud(6, 40_000, 0);
        let (tree, sorted) = KdTree::in_order(&points);
        let plain = KdTree::new(&points);
        let (mut found, mut wanted) = (Vec::new(), Vec::new());
        for q in cloud(7, 50, 0) {
            tree.nearest(q, 9, &mut found);
            plain.nearest(q, 9, &mut wanted);
            let at = |points: &[Point], found: &[Neighbour]| -> Vec<Point> {
                found.iter().map(|n| points[n.index as usize]).collect()
            };
            assert_eq!(at(&sorted, &found), at(&points, &wanted));
        }
    }

    #[test]
    fn agrees_with_kiddo_on_distances() {
        let points = cloud(3, 5000, 0);
        let tree = KdTree::new(&points);
        let reference = kiddo::ImmutableKdTree::<f32, 3>::new_from_slice(&points).expect("a tree");
        let mut out = Vec::new();
        for q in cloud(4, 50, 0) {
            tree.nearest(q, 10, &mut out);
            let theirs = reference
                .query(&q)
                .nearest_n::<kiddo::SquaredEuclidean<f32>>(std::num::NonZero::new(10).expect("ten"))
                .execute();
            for (ours, theirs) in out.iter().zip(theirs) {
                assert!((ours.distance_squared - theirs.distance).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn order_is_a_permutation() {
        let tree = KdTree::new(&cloud(5, 1000, 1));
        let mut order = tree.order().to_vec();
        order.sort_unstable();
        assert!(order.iter().copied().eq(0..1000));
        assert_eq!((tree.len(), tree.is_empty()), (1000, false));
        assert!(KdTree::new(&[]).is_empty());
    }
}
