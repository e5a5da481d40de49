//! The last step, without learning: even coverage, and points on the surface they suggest.
//!
//! Farthest point sampling can only be as even as its candidates allow, and it prefers the
//! candidates that stand off the surface. So the last level's sample is only the start: the
//! midpoints of its neighbours, which average two errors and lie in its gaps, are sampled again,
//! and each point kept is projected onto the moving least squares surface of all that the unit
//! made. Coarser levels go without: there a chord cuts a curve that the next unit would follow.

use rayon::prelude::*;

use crate::cloud::Point;
use crate::geometry::{
    KdTree, Neighbour, Rng, estimate_normals, farthest_point_sampling, project_to_surface,
};

/// Neighbours that a point shares midpoints with: the ring around it, and some.
const NEIGHBOURS: usize = 7;
/// Neighbours that a normal is estimated from.
const NORMAL_NEIGHBOURS: usize = 12;
/// A midpoint is of one surface if the edge lies within 45 degrees of both tangent planes: this is
/// the sine. Others bridge sheets or cut corners.
const STEEPEST: f32 = 0.7;

/// `size` points, spread evenly over what the unit `made`, of which `sample` is an even sample.
pub(super) fn polish(made: &[Point], sample: &[Point], size: usize, random: &mut Rng) -> Vec<Point> {
    let mut candidates = midpoints(sample);
    if candidates.len() < size {
        candidates.extend_from_slice(sample);
    }
    let first = random.below(candidates.len() as u64) as usize;
    let kept = farthest_point_sampling(&candidates, size, first);
    let mut dense: Vec<Point> = kept.iter().map(|&i| candidates[i as usize]).collect();
    project_to_surface(&mut dense, made, &KdTree::new(made));
    dense
}

/// Of every point and its nearest others on the same surface, each pair once.
fn midpoints(points: &[Point]) -> Vec<Point> {
    let tree = KdTree::new(points);
    let normals = estimate_normals(points, NORMAL_NEIGHBOURS);
    let steep = |normal: [f32; 3], edge: [f32; 3], length: f32| {
        (0..3).map(|a| normal[a] * edge[a]).sum::<f32>().abs() > STEEPEST * length
    };
    let pairs_of = |found: &mut Vec<Neighbour>, i: u32| -> Vec<(u32, u32)> {
        let point = points[i as usize];
        tree.nearest(point, NEIGHBOURS + 1, found);
        let others = found.iter().filter(|n| n.index != i).filter(|n| {
            let other = points[n.index as usize];
            let edge = std::array::from_fn(|a| other[a] - point[a]);
            let length = n.distance_squared.sqrt();
            !steep(normals[i as usize], edge, length) && !steep(normals[n.index as usize], edge, length)
        });
        others.map(|n| (i.min(n.index), i.max(n.index))).collect()
    };
    let mut pairs: Vec<(u32, u32)> =
        (0..points.len() as u32).into_par_iter().map_init(Vec::new, pairs_of).flatten_iter().collect();
    pairs.par_sort_unstable();
    pairs.dedup();
    let middle = |&(i, j): &(u32, u32)| -> Point {
        let (p, q) = (points[i as usize], points[j as usize]);
        std::array::from_fn(|a| 0.5 * (p[a] + q[a]))
    };
    pairs.par_iter().map(middle).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of unit side, at some height.
    fn square(n: u64, height: f32, seed: u64) -> Vec<Point> {
        let mut random = Rng::new(seed);
        (0..n).map(|_| [random.f64() as f32, random.f64() as f32, height]).collect()
    }

    /// Coefficient of variation of nearest-neighbour distances.
    fn variation(points: &[Point]) -> f64 {
        let tree = KdTree::new(points);
        let mut found = Vec::new();
        let distances: Vec<f64> = points
            .iter()
            .map(|&p| {
                tree.nearest(p, 2, &mut found);
                f64::from(found[1].distance_squared).sqrt()
            })
            .collect();
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        let square = distances.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / distances.len() as f64;
        square.sqrt() / mean
    }

    #[test]
    fn the_result_is_more_even_than_the_sample_and_stays_on_the_surface() {
        let made = square(3000, 0.5, 1);
        let sample: Vec<Point> =
            farthest_point_sampling(&made, 2000, 0).iter().map(|&i| made[i as usize]).collect();
        let dense = polish(&made, &sample, 2000, &mut Rng::new(5));
        assert_eq!(dense.len(), 2000);
        assert!(dense.iter().all(|p| (p[2] - 0.5).abs() < 1e-6));
        let (before, after) = (variation(&sample), variation(&dense));
        assert!(after < 0.6 * before, "{after} from {before}");
    }

    #[test]
    fn sheets_are_not_bridged() {
        // Sheets 0.035 apart: with a spacing of 0.022 that is nearer than some neighbours in a sheet. What
        // is left are edges of less than 45 degrees.
        let even = |height: f32, seed| -> Vec<Point> {
            let all = square(8000, height, seed);
            farthest_point_sampling(&all, 2000, 0).iter().map(|&i| all[i as usize]).collect()
        };
        let (mut points, other) = (even(0.0, 1), even(0.035, 2));
        points.extend(other);
        let middles = midpoints(&points);
        let between = middles.iter().filter(|p| (0.01..0.025).contains(&p[2])).count();
        assert!(between * 40 < middles.len(), "{between} of {} between the sheets", middles.len());
    }

    #[test]
    fn every_pair_comes_once() {
        let points = square(60, 0.0, 4);
        let mut middles: Vec<[u32; 3]> = midpoints(&points).iter().map(|p| p.map(f32::to_bits)).collect();
        let count = middles.len();
        assert!((60 * 7 / 2..=60 * 7).contains(&count), "{count} pairs");
        middles.sort_unstable();
        middles.dedup();
        assert_eq!(middles.len(), count);
    }

    #[test]
    fn too_few_midpoints_are_made_up_for() {
        let points = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        assert_eq!(polish(&points, &points, 5, &mut Rng::new(1)).len(), 5);
    }
}
