//! How many points each region of a cloud gets.

use rayon::prelude::*;

use super::globals::{PolishGlobals, median, once};
use super::measured::Measured;
use super::part::Within;
use densecloud_cloud::Point;
use densecloud_geometry::{Neighbour, Walk, indices};

/// Points that [`balanced`] should choose from, as a multiple of those wanted.
pub(super) const SURPLUS: f64 = 1.4;
/// Input points of a region: enough to cancel out the noise of a random input.
const REGION: usize = 32;
/// Power that a region's area counts with where the input is noisy. It grows by [`TRUSTED`] where the input is clean, and
/// it is 1 for the part of a difference that exceeds a factor of [`DOUBT`].
const DOUBTED: f32 = 0.5;
const TRUSTED: f32 = 0.25;
const DOUBT: f32 = 2.0;
/// The largest factor by which a region is taken to be too crowded or too empty.
const MOST: f32 = 3.0;

/// What decides the share of a region.
#[derive(Clone, Copy)]
pub(super) struct Shares<'a> {
    pub(super) input: &'a Measured,
    /// For each input point, the area of the surface nearest to it that the units made.
    pub(super) areas: &'a [f32],
    /// How clean the input is, from 0 to 1.
    pub(super) trust: f32,
    /// Where the input is a part of a cloud, which of it is wanted: the candidates are of that alone, and beside them the
    /// darts that are settled.
    pub(super) part: Option<&'a Within<'a>>,
}

/// Chooses `size` of the `candidates` that `sampled` names in the order of farthest point sampling:
/// their indices, in the order of a sampling that is as dense in each region as the input makes plausible.
///
/// Farthest point sampling spreads points evenly over whatever it is given, and not quite: where candidates are
/// few it makes do with less. Where a part is thinner than the input's spacing, what the units make is a tuft rather
/// than a surface, and takes points from everywhere else. So a region's share is weighed: by the area of the surface
/// that the units made of it, and by the number of its input points, each of which stands for the same area in an even
/// input. Areas count for more the more the input is trusted ([`TRUSTED`]): noise roughens a surface, and its area grows
/// with it. Every prefix of the order is an even sampling, hence a point is taken the later, the more crowded its region.
///
/// Fastest when neighbours among the candidates lie near each other in memory.
pub(super) fn balanced(
    candidates: &[Point],
    sampled: &[u32],
    size: usize,
    shares: Shares<'_>,
    globals: &mut PolishGlobals,
) -> Vec<u32> {
    let input = shares.input;
    let mut wanted = vec![false; candidates.len()];
    sampled.iter().for_each(|&i| wanted[i as usize] = true);
    let region = |walk: &mut Walk, (p, wanted): (&Point, &bool)| {
        if !wanted {
            return u32::MAX;
        }
        input.tree.nearest_next(*p, 1, walk);
        walk.found.first().map_or(u32::MAX, |n| n.index)
    };
    let all = candidates.par_iter().zip(&wanted);
    let region_of: Vec<u32> = all.map_init(Walk::default, region).collect();
    let mut counts = vec![0.0_f32; input.points.len()];
    for &i in &sampled[..size] {
        if let Some(count) = counts.get_mut(region_of[i as usize] as usize) {
            *count += 1.0;
        }
    }
    let settled = shares.part.map_or(&[][..], Within::settled_inside);
    for nearest in settled.iter().filter_map(|p| input.tree.nearest_one(*p)) {
        counts[nearest.index as usize] += 1.0;
    }
    let excess = crowding(&counts, shares, globals);
    let mut order: Vec<(f32, u32)> = indices(sampled.len())
        .into_par_iter()
        .map(|rank| {
            let region = region_of[sampled[rank as usize] as usize];
            (rank as f32 * excess.get(region as usize).copied().unwrap_or(1.0), rank)
        })
        .collect();
    order.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    order[..size].iter().map(|o| sampled[o.1 as usize]).collect()
}

/// Crowding of the region around each input point: points chosen for its share of the area, beside the median. `counts`
/// are the points chosen nearest to each input point.
fn crowding(
    counts: &[f32],
    Shares { input, areas, trust, part }: Shares<'_>,
    globals: &mut PolishGlobals,
) -> Vec<f32> {
    let region = |walk: &mut Walk, p: &Point| {
        input.tree.nearest_next(*p, REGION, walk);
        let near = |n: &&Neighbour| part.is_none_or(|part| part.belongs(input.points[n.index as usize]));
        let found: &[Neighbour] = &walk.found;
        // What is wanted stands for the rest of the region.
        let rest = found.len() as f32 / found.iter().filter(near).count().max(1) as f32;
        let sum = |of: &[f32]| rest * found.iter().filter(near).map(|n| of[n.index as usize]).sum::<f32>();
        (sum(counts), sum(areas))
    };
    let (counts, areas): (Vec<f32>, Vec<f32>) =
        input.points.par_iter().map_init(Walk::default, region).unzip();
    let doubted = 1.0 - DOUBTED - trust * TRUSTED;
    let usual = once(&mut globals.usual_area, || median(&areas));
    let shares = beside(usual, areas).map(|a| a / a.clamp(1.0 / DOUBT, DOUBT).powf(doubted));
    let counts = counts.into_iter();
    let density: Vec<f32> =
        counts.zip(shares).map(|(count, share)| count / share.max(f32::MIN_POSITIVE)).collect();
    let usual = once(&mut globals.usual_density, || median(&density));
    beside(usual, density).map(|d| d.clamp(1.0 / MOST, MOST)).collect()
}

/// Each value as a multiple of the `usual` one; all the same where that is nothing.
fn beside(usual: f32, values: Vec<f32>) -> impl Iterator<Item = f32> {
    values.into_iter().map(move |value| if usual > 0.0 { value / usual } else { 1.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::{Rng, farthest_point_sampling};

    /// Random points of a unit square, and of a flat box of a quarter of its area beside it.
    fn scene(square: usize, tuft: usize, height: f32, seed: u64) -> Vec<Point> {
        let mut random = Rng::new(seed);
        let mut next = || random.f64() as f32;
        let mut points: Vec<Point> = (0..square).map(|_| [next(), next(), 0.0]).collect();
        points.extend((0..tuft).map(|_| [2.0 + next() / 2.0, next() / 2.0, next() * height]));
        points
    }

    fn sampled(points: &[Point], count: usize) -> Vec<Point> {
        farthest_point_sampling(points, count, 0).iter().map(|&i| points[i as usize]).collect()
    }

    /// The order that is kept for `input`, when each point of it stands for an `area` and is trusted by `trust`.
    fn kept(order: &[Point], size: usize, input: &[Point], area: fn(&Point) -> f32, trust: f32) -> Vec<u32> {
        let input = Measured::new(input, 0.05);
        let areas: Vec<f32> = input.points.iter().map(area).collect();
        let sampled: Vec<u32> = (0..order.len() as u32).collect();
        let shares = Shares { input: &input, areas: &areas, trust, part: None };
        balanced(order, &sampled, size, shares, &mut PolishGlobals::default())
    }

    #[test]
    fn a_tuft_takes_fewer_points_than_even_spacing_gives_it() {
        // To the input both are flat; the candidates of the tuft fill a box several spacings high.
        let input = scene(800, 200, 0.0, 1);
        let order = sampled(&scene(20_000, 20_000, 0.08, 2), 2800);
        let tuft = |points: &mut dyn Iterator<Item = &Point>| points.filter(|p| p[0] > 1.5).count();
        let even = tuft(&mut order[..2000].iter());
        let kept = kept(&order, 2000, &input, |_| 1.0, 0.0);
        let balanced = tuft(&mut kept.iter().map(|&i| &order[i as usize]));
        assert_eq!(kept.len(), 2000);
        // By area it were 400.
        assert!(even > 800, "{even} of 2000 in the tuft");
        assert!(balanced < even * 3 / 4, "{balanced} of 2000 in the tuft, {even} before");
    }

    #[test]
    fn an_even_cloud_keeps_its_points_and_their_order() {
        let input = sampled(&scene(20_000, 0, 0.0, 1), 500);
        let order = sampled(&scene(20_000, 0, 0.0, 2), 2800);
        let kept = kept(&order, 2000, &input, |_| 1.0, 1.0);
        let same = kept.iter().filter(|i| **i < 2000).count();
        assert!(same > 1800, "{same} of the first 2000 kept");
        // Borders aside, what comes early in the one order does in the other.
        assert!(kept[..500].iter().filter(|i| **i < 700).count() > 480);
    }

    #[test]
    fn areas_decide_where_the_input_is_uneven_and_the_more_the_more_it_is_trusted() {
        // The right half of the square has half the input points, each of which stands for 1.5 times the area.
        let input: Vec<Point> = scene(2000, 0, 0.0, 1)
            .into_iter()
            .enumerate()
            .filter(|(i, p)| p[0] < 0.5 || i % 2 == 0)
            .map(|(_, p)| p)
            .collect();
        let area = |p: &Point| if p[0] < 0.5 { 1.0 } else { 1.5 };
        let order = sampled(&scene(40_000, 0, 0.0, 2), 5600);
        let right = |trust: f32| {
            let kept = kept(&order, 4000, &input, area, trust);
            kept.iter().filter(|i| order[**i as usize][0] > 0.5).count()
        };
        // By number it were 1,333 (and is no less than the candidates allow), by area 1,714.
        let (doubted, trusted) = (right(0.0), right(1.0));
        assert!(doubted + 50 < trusted, "{doubted} and {trusted} of 4000 on the right");
        assert!((1300..1800).contains(&trusted), "{trusted} of 4000 on the right");
    }

    #[test]
    fn areas_of_nothing_leave_the_order_as_it_is() {
        let input = sampled(&scene(20_000, 0, 0.0, 1), 500);
        let order = sampled(&scene(20_000, 0, 0.0, 2), 2800);
        assert_eq!(kept(&order, 2000, &input, |_| 0.0, 1.0), kept(&order, 2000, &input, |_| 1.0, 1.0));
    }
}
