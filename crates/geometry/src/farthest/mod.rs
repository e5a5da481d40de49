//! Farthest point sampling with a spatial index.

mod beside;
mod blocks;
mod tree;

use super::kdtree::bounds;
use super::limit::indices;
use densecloud_cloud::Point;
use tree::Tree;

/// Points in a block at most: what a core's cache holds.
const BLOCK: usize = 1 << 13;
/// From this many points on blocks are faster on two threads.
const BLOCKS_FROM: usize = 1 << 17;
/// The index of what is none of the points.
const NONE: u32 = u32::MAX;

/// Indices of `count` points, spread as evenly as can be: the first is `first` (clamped to the
/// last point), and each next one is the point farthest from all those before, ties by the
/// lowest index. All points when there are fewer than `count`; no index comes twice, so
/// duplicates come last.
///
/// Exact: the same indices as the plain algorithm, which compares every point with every chosen
/// one; squared distances are `f32`. Here the points are in the buckets of a k-d tree. Each node
/// knows its bounding box and its farthest point, so a new choice descends only where it is nearer
/// than the farthest point so far (the idea of Han et al., "QuickFPS", 2023), and the next choice
/// is read off the root. About O((n + count) log n) on surfaces. Large clouds are sampled block by
/// block on all threads of the current pool, with the same result.
///
/// Precondition: coordinates are finite.
///
/// # Panics
/// Above [`MAX_POINTS`](crate::MAX_POINTS).
///
/// ```
/// use densecloud_geometry::farthest_point_sampling;
///
/// let line: Vec<_> = (0..9).map(|i| [i as f32, 0.0, 0.0]).collect();
/// assert_eq!(farthest_point_sampling(&line, 4, 0), [0, 8, 4, 2]);
/// ```
#[must_use]
pub fn farthest_point_sampling(points: &[Point], count: usize, first: usize) -> Vec<u32> {
    sample(points, Weights::Even, count, first)
}

/// As [`farthest_point_sampling`], with distances to a point measured in the `spacing` there, so that a subset of
/// varying density is as even as can be everywhere: where spacing doubles, chosen points lie twice as far apart.
/// A subset's density goes by the inverse square of the spacing.
///
/// Precondition: one spacing a point, positive and finite.
///
/// # Panics
/// Above [`MAX_POINTS`](crate::MAX_POINTS), and where spacings are not as many as points.
///
/// ```
/// use densecloud_geometry::scaled_farthest_point_sampling;
///
/// let line: Vec<_> = (0..9).map(|i| [i as f32, 0.0, 0.0]).collect();
/// // Twice as dense from 4 on.
/// let spacing = [2.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0];
/// assert_eq!(scaled_farthest_point_sampling(&line, &spacing, 5, 0), [0, 8, 4, 6, 2]);
/// ```
#[must_use]
pub fn scaled_farthest_point_sampling(
    points: &[Point],
    spacing: &[f32],
    count: usize,
    first: usize,
) -> Vec<u32> {
    assert_eq!(points.len(), spacing.len(), "one spacing a point");
    sample(points, Weights::Of(spacing), count, first)
}

/// As [`scaled_farthest_point_sampling`], beside points that are chosen already: the first is the point farthest from all of
/// `beside`, which are none of `points`; where these are none, the one of index 0.
///
/// # Panics
/// As [`scaled_farthest_point_sampling`].
///
/// ```
/// use densecloud_geometry::farthest_point_sampling_beside;
///
/// let line: Vec<_> = (0..9).map(|i| [i as f32, 0.0, 0.0]).collect();
/// assert_eq!(farthest_point_sampling_beside(&line, &[1.0; 9], 3, &[[-1.0, 0.0, 0.0]]), [8, 3, 1]);
/// ```
#[must_use]
pub fn farthest_point_sampling_beside(
    points: &[Point],
    spacing: &[f32],
    count: usize,
    beside: &[Point],
) -> Vec<u32> {
    assert_eq!(points.len(), spacing.len(), "one spacing a point");
    let first = if beside.is_empty() { First::Point(0) } else { First::Beside(beside) };
    start(points, Weights::Of(spacing), count, first)
}

/// What a sampling starts with.
#[derive(Clone, Copy)]
enum First<'a> {
    /// One of its points.
    Point(u32),
    /// Points that are none of its own, of which there is one at least.
    Beside(&'a [Point]),
}

impl<'a> First<'a> {
    fn beside(self) -> &'a [Point] {
        match self {
            Self::Point(_) => &[],
            Self::Beside(beside) => beside,
        }
    }
}

/// What a squared distance to each point counts.
#[derive(Clone, Copy)]
enum Weights<'a> {
    /// The same to all.
    Even,
    /// The inverse square of the spacing at each.
    Of(&'a [f32]),
}

impl Weights<'_> {
    fn at(self, i: u32) -> f32 {
        match self {
            Self::Even => 1.0,
            Self::Of(spacing) => 1.0 / (spacing[i as usize] * spacing[i as usize]),
        }
    }
}

fn sample(points: &[Point], weights: Weights<'_>, count: usize, first: usize) -> Vec<u32> {
    let first = first.min(indices(points.len()).len().saturating_sub(1)) as u32;
    start(points, weights, count, First::Point(first))
}

fn start(points: &[Point], weights: Weights<'_>, count: usize, first: First<'_>) -> Vec<u32> {
    let count = count.min(indices(points.len()).len());
    if count == 0 {
        return Vec::new();
    }
    if points.len() > BLOCKS_FROM {
        return blocks::sample(points, weights, count, first, BLOCK);
    }
    in_turn(points, weights, count, first)
}

/// One point after the other, on one thread.
fn in_turn(points: &[Point], weights: Weights<'_>, count: usize, first: First<'_>) -> Vec<u32> {
    let mut chosen = Vec::with_capacity(count);
    let mut tree =
        Tree::over(&mut points.iter().copied().zip(0..).collect::<Vec<_>>(), weights, first.beside());
    let mut next = match first {
        First::Point(first) => first,
        First::Beside(_) => tree.all.key.index(),
    };
    loop {
        chosen.push(next);
        if chosen.len() == count {
            return chosen;
        }
        tree.choose(points[next as usize], next);
        next = tree.all.key.index();
    }
}

/// A point and its index.
type Item = (Point, u32);

/// A squared distance (of a point that is not chosen, so not negative) above an index, ordered by
/// distance and then by lower index, in one integer.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Key(i64);

impl Key {
    /// Below the key of any point.
    const NONE: Self = Self(i64::MIN);

    fn new(distance: f32, index: u32) -> Self {
        // The sign of a point that is chosen survives, so its key is below all others, too.
        Self(i64::from(distance.to_bits() as i32) << 32 | i64::from(!index))
    }

    fn distance(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }

    fn index(self) -> u32 {
        !(self.0 as u32)
    }
}

/// The first `middle` points along the longest side of their box, and the others; ties by index make
/// the two unique.
fn halves<T>(items: &mut [T], middle: usize, item: impl Fn(&T) -> Item) -> (&mut [T], &mut [T]) {
    let (lo, hi) = bounds(items.iter().map(|of| item(of).0));
    let side = |a: usize| hi[a] - lo[a];
    let axis = (1..3).fold(0, |best, a| if side(a) > side(best) { a } else { best });
    items.select_nth_unstable_by(middle, |a, b| {
        let ((p, i), (q, j)) = (item(a), item(b));
        p[axis].total_cmp(&q[axis]).then(i.cmp(&j))
    });
    items.split_at_mut(middle)
}

#[cfg(test)]
mod tests {
    use super::super::Rng;
    use super::super::kdtree::squared;
    use super::*;
    use proptest::prelude::*;

    fn plain(points: &[Point], weights: &[f32], count: usize, first: usize) -> Vec<u32> {
        plain_beside(points, weights, count, first, &[])
    }

    fn plain_beside(
        points: &[Point],
        weights: &[f32],
        count: usize,
        first: usize,
        beside: &[Point],
    ) -> Vec<u32> {
        let count = count.min(points.len());
        let to = |p: &Point, q: &Point| squared([p[0] - q[0], p[1] - q[1], p[2] - q[2]]);
        let nearest = |(p, weight): (&Point, &f32)| {
            beside.iter().map(|q| to(p, q) * weight).fold(f32::INFINITY, f32::min)
        };
        let mut nearest: Vec<f32> = points.iter().zip(weights).map(nearest).collect();
        let mut chosen = Vec::new();
        let farthest = |a: usize, b: usize| if nearest[b] > nearest[a] { b } else { a };
        let mut next = match beside {
            [] => first.min(points.len().saturating_sub(1)),
            _ => (0..points.len()).fold(0, farthest),
        };
        while chosen.len() < count {
            chosen.push(next as u32);
            let q = points[next];
            for ((d, p), weight) in nearest.iter_mut().zip(points).zip(weights) {
                *d = d.min(to(p, &q) * weight);
            }
            let mut best: Option<usize> = None;
            for i in (0..points.len()).filter(|&i| !chosen.contains(&(i as u32))) {
                if best.is_none_or(|b| nearest[i] > nearest[b]) {
                    best = Some(i);
                }
            }
            next = best.unwrap_or(0);
        }
        chosen
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]
        #[test]
        fn chooses_what_the_plain_algorithm_chooses(
            seed in any::<u64>(), n in 0usize..300, share in 0.0f64..1.2, first in 0usize..320, kind in 0u8..5,
        ) {
            let mut rng = Rng::new(seed);
            let points: Vec<Point> = (0..n)
                .map(|_| {
                    let p: Point = std::array::from_fn(|_| (2.0 * rng.f64() - 1.0) as f32);
                    match kind {
                        0 => p,
                        1 => p.map(|c| (c * 2.0).round()), // ties and duplicates
                        2 => p.map(|c| (c * 8.0).round() / 8.0), // a grid
                        3 => [p[0], p[0], p[0]], // a line
                        _ => [0.5; 3],
                    }
                })
                .collect();
            let count = (n as f64 * share) as usize;
            let even = vec![1.0; n];
            // From one side to the other a hundred times as many points a volume, and random factors.
            let uneven: Vec<f32> = points.iter().map(|p| 10.0_f32.powf(p[0]) * (0.5 + rng.f64() as f32)).collect();
            prop_assert_eq!(&farthest_point_sampling(&points, count, first), &plain(&points, &even, count, first));
            let weights: Vec<f32> = uneven.iter().map(|s| 1.0 / (s * s)).collect();
            for (spacing, weights) in [(&even, &even), (&uneven, &weights)] {
                let wanted = plain(&points, weights, count, first);
                prop_assert_eq!(&scaled_farthest_point_sampling(&points, spacing, count, first), &wanted);
                if n > 0 && count > 0 {
                    let first = first.min(n - 1) as u32;
                    prop_assert_eq!(&blocks::sample(&points, Weights::Of(spacing), count.min(n), First::Point(first), 20), &wanted);
                    let others: Vec<Point> = (0..1 + n / 8).map(|_| std::array::from_fn(|_| rng.f64() as f32)).collect();
                    let wanted = plain_beside(&points, weights, count, 0, &others);
                    prop_assert_eq!(&farthest_point_sampling_beside(&points, spacing, count, &others), &wanted);
                    let first = First::Beside(&others);
                    prop_assert_eq!(&blocks::sample(&points, Weights::Of(spacing), count.min(n), first, 20), &wanted);
                }
            }
        }
    }

    #[test]
    fn blocks_choose_what_one_tree_chooses() {
        let mesh = crate::shape("knot").expect("a built-in shape");
        let points: Vec<Point> =
            crate::uniform(&mesh, 40_000, 1).expect("points").iter().map(|p| p.map(|c| c as f32)).collect();
        let spacing: Vec<f32> = points.iter().map(|p| 30.0_f32.powf(-0.5 * p[0])).collect();
        let uneven = Weights::Of(&spacing);
        for (weights, count) in [(uneven, 1000), (Weights::Even, 15_000), (uneven, 15_000), (uneven, 40_000)]
        {
            let first = First::Point(7);
            let wanted = in_turn(&points, weights, count, first);
            for threads in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
                assert!(
                    pool.install(|| blocks::sample(&points, weights, count, first, 3000)) == wanted,
                    "{count} points"
                );
            }
        }
    }

    #[test]
    fn every_point_is_chosen_once_even_among_duplicates() {
        let points = [[0.0; 3], [0.0; 3], [1.0, 0.0, 0.0], [0.0; 3]];
        assert_eq!(farthest_point_sampling(&points, 4, 1), [1, 2, 0, 3]);
        assert_eq!(farthest_point_sampling(&points, 9, 9), [3, 2, 0, 1]);
        assert!(farthest_point_sampling(&[], 3, 0).is_empty());
        assert!(farthest_point_sampling(&points, 0, 0).is_empty());
    }
}
