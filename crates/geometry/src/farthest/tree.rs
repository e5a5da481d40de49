//! Where every point stands: how far from what is chosen, in a tree that tells the farthest.

use pulp::{Arch, Simd, WithSimd};

use super::beside::Beside;
use super::{Item, Key, NONE, Weights, halves};
use crate::kdtree::{bounds, squared};
use densecloud_cloud::Point;

/// Points in a bucket. All buckets are full but the last, and a bucket is one block of memory, so
/// that its update is straight-line vector code.
const BUCKET: usize = 16;
/// Children of a node at most: as many as most processors' vectors hold.
pub(super) const WIDE: usize = 8;
/// More levels of nodes than the largest tree has.
const DEEPEST: usize = 12;
/// The distance of a point that has been chosen: below every real one.
const CHOSEN: f32 = -1.0;

/// A complete description of where every point stands: its bucket's block holds the squared
/// distance to the nearest chosen point.
pub(super) struct Tree {
    /// A node comes after its children: the root is the last.
    nodes: Vec<Node>,
    buckets: Vec<Bucket>,
    /// What the root is to the tree.
    pub(super) all: Child,
}

/// What a node knows of the part of the tree below a child.
#[derive(Clone, Copy)]
pub(super) struct Child {
    pub(super) lo: Point,
    pub(super) hi: Point,
    /// The farthest point.
    pub(super) key: Key,
    /// The least weight.
    pub(super) lightest: f32,
    /// Its place among the nodes or buckets.
    place: u32,
}

/// Up to 8 children, side by side; unused places are infinitely far.
struct Node {
    lo: [[f32; WIDE]; 3],
    hi: [[f32; WIDE]; 3],
    lightest: [f32; WIDE],
    distance: [f32; WIDE],
    index: [u32; WIDE],
    place: [u32; WIDE],
    /// Whether the children are buckets.
    is_lowest: bool,
}

/// Up to 16 points, ascending by index; unused places count as chosen.
struct Bucket {
    x: [f32; BUCKET],
    y: [f32; BUCKET],
    z: [f32; BUCKET],
    /// What a squared distance to the point counts.
    weight: [f32; BUCKET],
    /// Weighted squared distance to the nearest chosen point.
    distance: [f32; BUCKET],
    index: [u32; BUCKET],
}

impl Tree {
    /// Of points none of which is chosen, and others `beside` them that are.
    pub(super) fn over(items: &mut [Item], weights: Weights<'_>, beside: &[Point]) -> Self {
        let buckets = items.len().div_ceil(BUCKET);
        let mut tree = Self { nodes: Vec::new(), buckets: Vec::with_capacity(buckets), all: Child::NONE };
        tree.all = tree.node(items, weights, &Beside::of(beside));
        tree
    }

    /// Makes a node, of any number of points.
    fn node(&mut self, items: &mut [Item], weights: Weights<'_>, beside: &Beside) -> Child {
        let mut below = BUCKET;
        while WIDE * below < items.len() {
            below *= WIDE;
        }
        let mut children = Vec::with_capacity(WIDE);
        self.children(items, below, weights, beside, &mut children);
        self.nodes.push(Node::of(&children, below == BUCKET));
        let place = (self.nodes.len() - 1) as u32;
        children.iter().fold(Child { place, ..Child::NONE }, |all, child| all.with(child))
    }

    /// Halves the points until no more than `most` are left for a child.
    fn children(
        &mut self,
        items: &mut [Item],
        most: usize,
        weights: Weights<'_>,
        beside: &Beside,
        into: &mut Vec<Child>,
    ) {
        if items.len() > most {
            let (left, right) = halves(items, items.len().div_ceil(BUCKET) / 2 * BUCKET, |&item| item);
            self.children(left, most, weights, beside, into);
            return self.children(right, most, weights, beside, into);
        }
        let (lo, hi) = bounds(items.iter().map(|(p, _)| *p));
        let beside = beside.near(lo, hi);
        into.push(match most {
            BUCKET => self.bucket(items, (lo, hi), weights, &beside),
            _ => self.node(items, weights, &beside),
        });
    }

    fn bucket(
        &mut self,
        items: &mut [Item],
        (lo, hi): (Point, Point),
        weights: Weights<'_>,
        beside: &Beside,
    ) -> Child {
        // In a bucket the first of equal distances is the one of the lowest index.
        items.sort_unstable_by_key(|&(_, i)| i);
        let mut bucket = Bucket::of(items, weights);
        let key = Arch::new().dispatch(Beginning { bucket: &mut bucket, beside });
        let lightest = items.iter().map(|&(_, i)| weights.at(i)).fold(f32::INFINITY, f32::min);
        self.buckets.push(bucket);
        Child { lo, hi, key, lightest, place: (self.buckets.len() - 1) as u32 }
    }

    /// The farthest point, and what a squared distance to it counts. It lies in memory that its last update has read.
    pub(super) fn farthest(&self) -> (Point, f32) {
        let index = self.all.key.index();
        let place = |indices: &[u32]| indices.iter().position(|&i| i == index).unwrap_or(0);
        let mut node = &self.nodes[self.nodes.len() - 1];
        while !node.is_lowest {
            node = &self.nodes[node.place[place(&node.index)] as usize];
        }
        let bucket = &self.buckets[node.place[place(&node.index)] as usize];
        let at = place(&bucket.index);
        ([bucket.x[at], bucket.y[at], bucket.z[at]], bucket.weight[at])
    }

    /// Takes a chosen point into account.
    pub(super) fn choose(&mut self, q: Point, index: u32) {
        Arch::new().dispatch(Choice { tree: self, q, index });
    }

    pub(super) fn take_note(&mut self, chosen: &[Item]) {
        for &(at, index) in chosen {
            if self.all.is_reached_from(at) {
                self.choose(at, index);
            }
        }
    }

    /// Whether a point comes before that of `key`, which has that `weight`, and one of the two is within the other's
    /// radius: choosing the one changes what the other has.
    pub(super) fn has_rival_of(&self, at: Point, weight: f32, key: Key) -> bool {
        let all = &self.all;
        let square = squared(all.offset(at));
        let is_beyond = square * all.lightest >= all.key.distance() && square * weight >= key.distance();
        !(all.key < key || is_beyond) && Arch::new().dispatch(Rivals { tree: self, at, weight, key })
    }
}

impl Child {
    /// No point at all.
    const NONE: Self = Self {
        lo: [f32::INFINITY; 3],
        hi: [f32::NEG_INFINITY; 3],
        key: Key::NONE,
        lightest: f32::INFINITY,
        place: 0,
    };

    fn with(self, other: &Self) -> Self {
        Self {
            lo: std::array::from_fn(|a| self.lo[a].min(other.lo[a])),
            hi: std::array::from_fn(|a| self.hi[a].max(other.hi[a])),
            key: self.key.max(other.key),
            lightest: self.lightest.min(other.lightest),
            ..self
        }
    }

    fn offset(&self, q: Point) -> Point {
        std::array::from_fn(|a| (self.lo[a] - q[a]).max(q[a] - self.hi[a]).max(0.0))
    }

    /// Whether `q` may be nearer to some point here than what was chosen before. The distance to
    /// the box is computed as that to a point is; rounding is monotone, so it is never above the
    /// computed distance of a point inside. Equality matters where it marks `q` itself as chosen.
    fn is_reached_from(&self, q: Point) -> bool {
        squared(self.offset(q)) * self.lightest <= self.key.distance()
    }
}

impl Node {
    fn of(children: &[Child], is_lowest: bool) -> Self {
        let at = |i: usize| children.get(i).copied().unwrap_or(Child::NONE);
        let each = |of: fn(&Child) -> f32| std::array::from_fn(|i| of(&at(i)));
        Self {
            lo: std::array::from_fn(|a| std::array::from_fn(|i| at(i).lo[a])),
            hi: std::array::from_fn(|a| std::array::from_fn(|i| at(i).hi[a])),
            lightest: each(|child| child.lightest),
            distance: each(|child| if child.key == Key::NONE { CHOSEN } else { child.key.distance() }),
            index: std::array::from_fn(|i| if i < children.len() { at(i).key.index() } else { NONE }),
            place: std::array::from_fn(|i| at(i).place),
            is_lowest,
        }
    }

    /// The squared distance of each child from `q`, bounded as in [`Child::is_reached_from`].
    #[inline(always)]
    fn squares(&self, q: Point) -> [f32; WIDE] {
        std::array::from_fn(|i| {
            let offset = |a: usize| positive(self.lo[a][i] - q[a], q[a] - self.hi[a][i]);
            squared([offset(0), offset(1), offset(2)])
        })
    }

    /// The children that are reached from `q`: one bit each.
    #[inline(always)]
    fn reached(&self, q: Point) -> u32 {
        let squares = self.squares(q);
        mask::<WIDE>(|i| squares[i] * self.lightest[i] <= self.distance[i])
    }

    /// The farthest point.
    #[inline(always)]
    fn key(&self) -> Key {
        farthest(&self.distance, &self.index)
    }

    #[inline(always)]
    fn set(&mut self, child: usize, key: Key) {
        (self.distance[child % WIDE], self.index[child % WIDE]) = (key.distance(), key.index());
    }
}

/// The greater of two numbers if it is above zero.
#[inline(always)]
pub(super) fn positive(a: f32, b: f32) -> f32 {
    let greater = if a > b { a } else { b };
    if greater > 0.0 { greater } else { 0.0 }
}

/// One bit for each of `N` places that have it.
#[inline(always)]
pub(super) fn mask<const N: usize>(has: impl Fn(usize) -> bool) -> u32 {
    (0..N).fold(0, |bits, i| bits | u32::from(has(i)) << i)
}

/// The farthest of some points, of equally far ones that of the lowest index.
#[inline(always)]
fn farthest<const N: usize>(distance: &[f32; N], index: &[u32; N]) -> Key {
    // Eight maxima at once, then one: a chain of comparisons is the slowest way.
    let greater = |a: f32, b: f32| if a > b { a } else { b };
    let mut best = [CHOSEN; WIDE];
    for chunk in distance.as_chunks::<WIDE>().0 {
        best = std::array::from_fn(|i| greater(best[i], chunk[i]));
    }
    let four: [f32; 4] = std::array::from_fn(|i| greater(best[i], best[i + 4]));
    let best = greater(greater(four[0], four[2]), greater(four[1], four[3]));
    let mut equal = mask::<N>(|i| distance[i] == best);
    let mut lowest = NONE;
    while equal != 0 {
        lowest = lowest.min(index[equal.trailing_zeros() as usize % N]);
        equal &= equal - 1;
    }
    Key::new(best, lowest)
}

impl Bucket {
    fn of(items: &[Item], weights: Weights<'_>) -> Self {
        let mut bucket = Self {
            x: [0.0; BUCKET],
            y: [0.0; BUCKET],
            z: [0.0; BUCKET],
            weight: [0.0; BUCKET],
            distance: [CHOSEN; BUCKET],
            index: [NONE; BUCKET],
        };
        for (place, &([x, y, z], index)) in items.iter().enumerate() {
            (bucket.x[place], bucket.y[place], bucket.z[place]) = (x, y, z);
            bucket.weight[place] = weights.at(index);
            (bucket.distance[place], bucket.index[place]) = (f32::INFINITY, index);
        }
        bucket
    }

    /// Takes a chosen point into account.
    #[inline(always)]
    fn update(&mut self, q: Point, chosen: u32) {
        for i in 0..BUCKET {
            let d = squared([self.x[i] - q[0], self.y[i] - q[1], self.z[i] - q[2]]) * self.weight[i];
            let d = if self.index[i] == chosen { CHOSEN } else { d };
            self.distance[i] = if d < self.distance[i] { d } else { self.distance[i] };
        }
    }

    #[inline(always)]
    fn key(&self) -> Key {
        farthest(&self.distance, &self.index)
    }

    /// Whether a point comes before that of `key`, which has that `weight`, and one of the two is within the other's
    /// radius.
    #[inline(always)]
    fn has_rival_of(&self, at: Point, weight: f32, key: Key) -> bool {
        let mut within = mask::<BUCKET>(|i| {
            let d = squared([self.x[i] - at[0], self.y[i] - at[1], self.z[i] - at[2]]);
            (d * self.weight[i] < self.distance[i]) | (d * weight < key.distance())
        });
        let mut found = false;
        while within != 0 {
            let i = within.trailing_zeros() as usize % BUCKET;
            found |= Key::new(self.distance[i], self.index[i]) > key;
            within &= within - 1;
        }
        found
    }
}

/// A chosen point on its way to where it changes anything.
struct Choice<'a> {
    tree: &'a mut Tree,
    q: Point,
    index: u32,
}

impl WithSimd for Choice<'_> {
    type Output = ();

    /// Without recursion, which would end what is compiled for the processor.
    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { tree: Tree { nodes, buckets, all }, q, index } = self;
        // The nodes from the root on, and their children that are reached and not done.
        let root = nodes.len() - 1;
        let mut path = [(root, nodes[root].reached(q)); DEEPEST];
        let mut depth = 0;
        loop {
            let (at, left) = path[depth % DEEPEST];
            let child = left.trailing_zeros() as usize;
            let node = &mut nodes[at];
            if left == 0 {
                let key = node.key();
                if depth == 0 {
                    all.key = key;
                    return;
                }
                depth -= 1;
                let (above, left) = &mut path[depth % DEEPEST];
                nodes[*above].set(left.trailing_zeros() as usize, key);
                *left &= *left - 1;
            } else if node.is_lowest {
                let bucket = &mut buckets[node.place[child % WIDE] as usize];
                bucket.update(q, index);
                node.set(child, bucket.key());
                path[depth % DEEPEST].1 = left & (left - 1);
            } else {
                let below = node.place[child % WIDE] as usize;
                depth += 1;
                path[depth % DEEPEST] = (below, nodes[below].reached(q));
            }
        }
    }
}

/// A point that is to be chosen, and what is looked for around it.
struct Rivals<'a> {
    tree: &'a Tree,
    at: Point,
    weight: f32,
    key: Key,
}

impl WithSimd for Rivals<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> bool {
        let Self { tree: Tree { nodes, buckets, .. }, at, weight, key } = self;
        let mut open = [(nodes.len() - 1) as u32; WIDE * DEEPEST];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let node = &nodes[open[count % (WIDE * DEEPEST)] as usize];
            let squares = node.squares(at);
            let mut near = mask::<WIDE>(|i| {
                (squares[i] * node.lightest[i] < node.distance[i]) | (squares[i] * weight < key.distance())
            });
            while near != 0 {
                let child = near.trailing_zeros() as usize % WIDE;
                near &= near - 1;
                if Key::new(node.distance[child], node.index[child]) < key {
                    continue;
                }
                let place = node.place[child];
                if !node.is_lowest {
                    open[count % (WIDE * DEEPEST)] = place;
                    count += 1;
                } else if buckets[place as usize].has_rival_of(at, weight, key) {
                    return true;
                }
            }
        }
        false
    }
}

/// The first that a bucket hears of.
struct Beginning<'a> {
    bucket: &'a mut Bucket,
    beside: &'a Beside,
}

impl WithSimd for Beginning<'_> {
    type Output = Key;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Key {
        for q in self.beside.groups() {
            for i in 0..WIDE {
                self.bucket.update(q.map(|axis| axis[i]), NONE);
            }
        }
        self.bucket.key()
    }
}
