//! How many points each region of a cloud gets.

use rayon::prelude::*;

use super::strays::Measured;
use crate::cloud::Point;
use crate::geometry::Neighbour;

/// How many times more points than wanted [`balanced`] should choose from.
pub(super) const SURPLUS: f64 = 1.4;
/// Nearest others that an input point's share of the surface is measured with. Few: beside a thin
/// part the eighth is across a gap already.
const NEIGHBOURS: usize = 3;
/// Input points of a region: enough for the noise of a random input to cancel out.
const REGION: usize = 32;
/// Regions' areas by their spacing count for half as far as they differ by less than this factor: noise
/// and thin parts make as much of a difference, where an even input's points stand for equal areas.
const DOUBT: f32 = 2.0;
/// How much of a region's excess is made up for: the rest is chance. 0 is even spacing alone.
const CORRECTED: f32 = 0.8;
/// A region is never thought more than this many times too crowded or too empty.
const MOST: f32 = 3.0;

/// Chooses `size` of the `candidates` that `sampled` names in the order of farthest point sampling:
/// their indices, in the order of a sampling that is as dense in each region as the input makes plausible.
///
/// Farthest point sampling spreads points evenly over whatever it is given. Where a part is thinner
/// than the input's spacing, what the units make is a tuft rather than a surface, and takes points
/// from everywhere else. The input knows better, up to its noise: each of its points stands for an
/// area, the same one in an even input, about the square of the distance to its nearest others in an
/// uneven one. So a region's share is the number of its input points times their area, of whose
/// differences small ones count for half ([`DOUBT`]). Every prefix of the order is an even sampling,
/// hence a point is taken the later, the more crowded its region is.
///
/// Fastest when neighbours among the candidates lie near each other in memory.
pub(super) fn balanced(candidates: &[Point], sampled: &[u32], size: usize, input: &Measured) -> Vec<u32> {
    let mut wanted = vec![false; candidates.len()];
    sampled.iter().for_each(|&i| wanted[i as usize] = true);
    let region = |(p, wanted): (&Point, &bool)| {
        let nearest = wanted.then(|| input.tree.nearest_one(*p)).flatten();
        nearest.map_or(u32::MAX, |n| n.index)
    };
    let region_of: Vec<u32> = candidates.par_iter().zip(&wanted).map(region).collect();
    let mut counts = vec![0.0_f32; input.points.len()];
    for &i in &sampled[..size] {
        if let Some(count) = counts.get_mut(region_of[i as usize] as usize) {
            *count += 1.0;
        }
    }
    let excess: Vec<f32> = crowding(&counts, input).into_iter().map(|d| d.powf(CORRECTED)).collect();
    let mut order: Vec<(f32, u32)> = (0..sampled.len() as u32)
        .into_par_iter()
        .map(|rank| {
            let region = region_of[sampled[rank as usize] as usize];
            (rank as f32 * excess.get(region as usize).copied().unwrap_or(1.0), rank)
        })
        .collect();
    order.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    order[..size].iter().map(|o| sampled[o.1 as usize]).collect()
}

/// Points for the share of the region around each input point, beside the median; `counts` of the points nearest to it.
fn crowding(counts: &[f32], input: &Measured) -> Vec<f32> {
    let area = |i: usize| {
        let distance = |j: &u32| {
            let q = input.points[*j as usize];
            (0..3).map(|a| (q[a] - input.points[i][a]).powi(2)).sum::<f32>().sqrt()
        };
        let nearest = input.around(i as u32).iter().take(NEIGHBOURS);
        (nearest.map(distance).sum::<f32>() / NEIGHBOURS as f32).powi(2)
    };
    let areas: Vec<f32> = (0..counts.len()).into_par_iter().map(area).collect();
    let region = |found: &mut Vec<_>, p: &Point| {
        input.tree.nearest(*p, REGION, found);
        let sum = |of: &[f32]| found.iter().map(|n: &Neighbour| of[n.index as usize]).sum::<f32>();
        (sum(counts), sum(&areas))
    };
    let (counts, areas): (Vec<f32>, Vec<f32>) = input.points.par_iter().map_init(Vec::new, region).unzip();
    let areas = beside_median(areas).into_iter().map(|a| a / a.clamp(1.0 / DOUBT, DOUBT).sqrt());
    let density = beside_median(counts.into_iter().zip(areas).map(|(count, area)| count / area).collect());
    density.into_iter().map(|d| d.clamp(1.0 / MOST, MOST)).collect()
}

/// Each of some values as a multiple of their median.
fn beside_median(mut values: Vec<f32>) -> Vec<f32> {
    let mut sorted = values.clone();
    let middle = sorted.len() / 2;
    let median = *sorted.select_nth_unstable_by(middle, f32::total_cmp).1;
    values.iter_mut().for_each(|v| *v /= median);
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Rng, farthest_point_sampling};

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

    #[test]
    fn a_tuft_takes_fewer_points_than_even_spacing_gives_it() {
        // To the input both are flat; the candidates of the tuft fill a box several spacings high.
        let input = scene(800, 200, 0.0, 1);
        let input = Measured::new(&input, vec![0.05; 1000]);
        let order = sampled(&scene(20_000, 20_000, 0.08, 2), 2800);
        let tuft = |points: &mut dyn Iterator<Item = &Point>| points.filter(|p| p[0] > 1.5).count();
        let even = tuft(&mut order[..2000].iter());
        let kept = balanced(&order, &(0..2800).collect::<Vec<_>>(), 2000, &input);
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
        let input = Measured::new(&input, vec![0.05; 500]);
        let kept = balanced(&order, &(0..2800).collect::<Vec<_>>(), 2000, &input);
        let same = kept.iter().filter(|i| **i < 2000).count();
        assert!(same > 1800, "{same} of the first 2000 kept");
        // Borders aside, what comes early in the one order does in the other.
        assert!(kept[..500].iter().filter(|i| **i < 700).count() > 480);
    }
}
