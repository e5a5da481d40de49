//! Points near a border, chosen by a rule that the parts on both sides of it compute alike.
//!
//! Farthest point sampling goes on from what it has chosen before, so two parts would choose differently along their border,
//! and leave gaps and crowds there. So the points near a border are chosen first, among candidates that need no network:
//! the input's points, and middles between neighbours, on the moving least squares surface of the input. A candidate is
//! chosen by a number that its coordinates give, unless one with a lower number is chosen within its radius (Cook's dart
//! throwing, "Stochastic sampling in computer graphics", 1986; Luby's maximal independent set). What decides lies within a few radii, hence in the halo of
//! either part.

use rayon::prelude::*;

use crate::polish::{midpoints, rings};
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Neighbour, Walk, indices, project_to_surface};

/// Darts lie no further from the border than this many of their radii: points nearer than one push each other apart.
pub(super) const BAND: f32 = 3.0;
/// What decides about a dart lies within this many radii of it.
const CHAIN: f32 = 8.0;
/// What decides about a candidate lies within this many spacings of it.
const RINGS: f32 = 4.0;
/// Candidates for each point of the result, at least; and for each candidate of the round before, about.
const CANDIDATES: f64 = 3.5;
const A_ROUND: f64 = 4.0;
/// Darts are chosen this many radii from each other first, and then in the gaps.
const SCALES: [f32; 3] = [1.6, 1.25, 1.0];
/// Neighbours of a candidate that are looked at: more than lie within its radius at the first scale.
const LOOKED_AT: usize = 40;

/// A point of the result near a border.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Dart {
    pub(super) at: Point,
    /// The spacing of the input there.
    pub(super) spacing: f32,
}

/// How far apart darts are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sparing {
    /// Points of the result for each of the input.
    pub(super) ratio: f64,
    /// The radius within which there is no other dart, in the spacing that the result has there.
    pub(super) radius: f32,
}

impl Sparing {
    /// The radius where the input has this `spacing`.
    pub(super) fn radius_at(self, spacing: f32) -> f32 {
        self.radius * spacing / (self.ratio as f32).sqrt()
    }
}

/// Candidates, in an order that is theirs alone.
struct Candidates {
    at: Vec<Point>,
    spacing: Vec<f32>,
}

/// Chooses the darts about the border from which each point is as far as `border` says: they depend on the `points` within a
/// few spacings of it alone. `spacing`: of the input at each point. O(n log n) for n points near the border.
pub(super) fn darts(
    points: &[Point],
    spacing: &[f32],
    sparing: Sparing,
    border: &(dyn Fn(Point) -> f32 + Sync),
) -> Vec<Dart> {
    let candidates = Candidates::of(points, spacing, sparing, border);
    let darts = candidates
        .chosen(sparing)
        .into_iter()
        .map(|i| Dart { at: candidates.at[i as usize], spacing: candidates.spacing[i as usize] });
    darts.filter(|dart| border(dart.at) <= BAND * sparing.radius_at(dart.spacing)).collect()
}

impl Candidates {
    fn of(
        points: &[Point],
        spacing: &[f32],
        sparing: Sparing,
        border: &(dyn Fn(Point) -> f32 + Sync),
    ) -> Self {
        let mut near = Self { at: points.to_vec(), spacing: spacing.to_vec() };
        let (mut count, mut width) = (1.0, RINGS);
        near.keep(sparing, width, border);
        let surface = near.at.clone();
        while count < CANDIDATES * sparing.ratio && near.at.len() > 1 {
            near = near.with_midpoints();
            (count, width) = (A_ROUND * count, 0.5 * width);
            near.keep(sparing, width, border);
        }
        project_to_surface(&mut near.at, &surface, &KdTree::new(&surface));
        near.sorted()
    }

    /// Keeps what lies within the band, and `width` spacings beyond what decides about it.
    fn keep(&mut self, sparing: Sparing, width: f32, border: &(dyn Fn(Point) -> f32 + Sync)) {
        let is_near = |(p, spacing): (&Point, &f32)| {
            border(*p) <= (BAND + CHAIN) * sparing.radius_at(*spacing) + width * spacing
        };
        let kept: Vec<bool> = self.at.par_iter().zip(&self.spacing).map(is_near).collect();
        let (mut of_points, mut of_spacing) = (kept.iter(), kept.iter());
        self.at.retain(|_| *of_points.next().expect("one each"));
        self.spacing.retain(|_| *of_spacing.next().expect("one each"));
        *self = std::mem::replace(self, Self { at: Vec::new(), spacing: Vec::new() }).sorted();
    }

    /// By their coordinates: equally near neighbours then come in the same order in whatever part they are found.
    fn sorted(self) -> Self {
        let mut order: Vec<u32> = indices(self.at.len()).collect();
        let key = |i: &u32| self.at[*i as usize].map(f32::to_bits);
        order.par_sort_unstable_by_key(key);
        order.dedup_by_key(|i| key(i));
        Self {
            at: order.iter().map(|&i| self.at[i as usize]).collect(),
            spacing: order.iter().map(|&i| self.spacing[i as usize]).collect(),
        }
    }

    fn with_midpoints(mut self) -> Self {
        let rings = rings(&KdTree::new(&self.at), &self.at);
        let (middles, spacing) = midpoints(&self.at, &rings, Some(&self.spacing));
        self.at.extend(middles);
        self.spacing.extend(spacing);
        self
    }

    /// The candidates that are darts, in the order of their numbers.
    fn chosen(&self, sparing: Sparing) -> Vec<u32> {
        let tree = KdTree::new(&self.at);
        let near = |walk: &mut Walk, i: u32| -> Vec<Neighbour> {
            let reach = (SCALES[0] * sparing.radius_at(self.spacing[i as usize])).powi(2);
            tree.nearest_next(self.at[i as usize], LOOKED_AT, walk);
            walk.found.iter().copied().filter(|n| n.index != i && n.distance_squared < reach).collect()
        };
        let mut found: Vec<(u32, Vec<Neighbour>)> =
            tree.order().par_iter().map_init(Walk::default, |walk, &i| (i, near(walk, i))).collect();
        found.par_sort_unstable_by_key(|(i, _)| *i);
        let mut order: Vec<u32> = indices(self.at.len()).collect();
        order.par_sort_unstable_by_key(|&i| (number(self.at[i as usize]), i));
        let mut is_chosen = vec![false; self.at.len()];
        for scale in SCALES {
            for &i in &order {
                let reach = (scale * sparing.radius_at(self.spacing[i as usize])).powi(2);
                let mut within = found[i as usize].1.iter().filter(|n| n.distance_squared < reach);
                is_chosen[i as usize] |= within.all(|n| !is_chosen[n.index as usize]);
            }
        }
        order.retain(|&i| is_chosen[i as usize]);
        order
    }
}

/// A number that looks random, and is always the same for the same point (the end of SplitMix64).
pub(super) fn number(p: Point) -> u64 {
    p.iter().fold(0x9e37_79b9_7f4a_7c15_u64, |mixed, c| {
        let mut z = mixed ^ u64::from(c.to_bits()).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::{Rng, farthest_point_sampling};

    fn plane(n: usize, even: bool, noise: f32, seed: u64) -> Vec<Point> {
        let mut random = Rng::new(seed);
        let mut next = || random.f64() as f32;
        let many: Vec<Point> =
            (0..if even { 8 * n } else { n }).map(|_| [next(), next(), noise * (next() - 0.5)]).collect();
        farthest_point_sampling(&many, n, 0).iter().map(|&i| many[i as usize]).collect()
    }

    #[test]
    fn darts_are_even_and_depend_on_what_is_near_alone() {
        for (even, noise) in [(true, 0.0), (false, 0.0), (true, 0.6)] {
            let spacing = (1.0 / 2000_f32).sqrt();
            let points = plane(2000, even, noise * spacing, 1);
            let sparing = Sparing { ratio: 4.0, radius: 0.8 };
            let radius = sparing.radius_at(spacing);
            let border = |p: Point| (p[0] - 0.5).abs();
            let all = darts(&points, &vec![spacing; points.len()], sparing, &border);
            let at: Vec<Point> = all.iter().map(|dart| dart.at).collect();
            // As many as fit, along a line across the square.
            let share = at.len() as f32 / (2.0 * BAND * radius) * spacing * spacing / 4.0;
            assert!((0.5..1.0).contains(&share), "{share} of what is wanted");
            let (tree, mut found) = (KdTree::new(&at), Vec::new());
            for p in &at {
                tree.nearest(*p, 2, &mut found);
                let least = if even { 0.999 } else { 0.5 };
                assert!(found[1].distance_squared.sqrt() > least * radius && border(*p) <= BAND * radius);
            }
            let near: Vec<Point> = points.iter().copied().filter(|p| border(*p) < 0.35).collect();
            assert_eq!(darts(&near, &vec![spacing; near.len()], sparing, &border), all);
        }
    }
}
