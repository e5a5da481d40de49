//! The last step, without learning: even coverage, and points on the surface they suggest.
//!
//! Farthest point sampling can only be as even as its candidates allow, and it prefers the
//! candidates that stand off the surface. So the last level's sample is only the start: the
//! midpoints of its neighbours, which average two errors and lie in its gaps, are sampled again
//! (with an eye to the input's density), points that are too near push each other apart, and each
//! is projected onto the moving least squares surface of all that the unit made. Coarser levels go
//! without: there a chord cuts a curve that the next unit would follow.

use rayon::prelude::*;

use super::balance::{SURPLUS, balanced};
use super::strays::Measured;
use crate::cloud::Point;
use crate::geometry::{
    KdTree, Neighbour, Rng, estimate_normals, farthest_point_sampling, project_to_surface,
};

/// Neighbours that a point shares midpoints with: the ring around it, and some.
const NEIGHBOURS: usize = 7;
/// An input point further than this from every midpoint, in its own spacing, is a tip that they fall
/// short of.
const SHORT: f32 = 0.5;
/// Neighbours that a normal is estimated from.
const NORMAL_NEIGHBOURS: usize = 12;
/// A midpoint is of one surface if the edge lies within 45 degrees of both tangent planes: this is
/// the sine. Others bridge sheets or cut corners.
const STEEPEST: f32 = 0.7;
/// Steps of relaxation; more flatten what is thin and round what is sharp.
const STEPS: usize = 2;
/// Points push each other when they are nearer than this, in multiples of the usual distance.
const WANTED: f32 = 1.1;
/// The share of what lacks that one step makes up.
const PUSH: f32 = 0.4;
/// No step is longer than this share of the usual distance.
const FARTHEST: f32 = 0.2;

/// `size` points, spread evenly over what the unit `made`, of which `sample` is an even sample.
pub(super) fn polish(
    made: &[Point],
    sample: &[Point],
    size: usize,
    input: &Measured,
    random: &mut Rng,
) -> Vec<Point> {
    let mut candidates = midpoints(sample);
    if candidates.len() < size {
        candidates.extend_from_slice(sample);
    }
    candidates.extend(fallen_short_of(&candidates, input));
    let first = random.below(candidates.len() as u64) as usize;
    let count = ((SURPLUS * size as f64) as usize).min(candidates.len());
    let order = farthest_point_sampling(&candidates, count, first);
    let order: Vec<Point> = order.iter().map(|&i| candidates[i as usize]).collect();
    let mut dense: Vec<Point> = balanced(&order, size, input).iter().map(|&i| order[i as usize]).collect();
    relax(&mut dense);
    project_to_surface(&mut dense, made, &KdTree::new(made));
    dense
}

/// Pushes points apart that are nearer to each other than is usual around them: what farthest
/// point sampling leaves uneven. The neighbours are found once, since points move little.
fn relax(points: &mut [Point]) {
    let pairs = neighbours(points);
    let mut starts = vec![0; points.len() + 1];
    for &(i, _) in &pairs {
        starts[i as usize + 1] += 1;
    }
    for i in 0..points.len() {
        starts[i + 1] += starts[i];
    }
    let around = |i: usize| &pairs[starts[i]..starts[i + 1]];
    for _ in 0..STEPS {
        let before = points.to_vec();
        let distance = |i: usize, j: u32| {
            let (p, q) = (before[i], before[j as usize]);
            (0..3).map(|a| (p[a] - q[a]).powi(2)).sum::<f32>().sqrt()
        };
        let nearest: Vec<f32> = (0..before.len())
            .into_par_iter()
            .map(|i| around(i).iter().map(|p| distance(i, p.1)).fold(f32::INFINITY, f32::min))
            .collect();
        points.par_iter_mut().enumerate().for_each(|(i, point)| {
            let pairs = around(i);
            // A neighbour on a steep spot may have no neighbours of its own.
            let known = pairs.iter().map(|p| nearest[p.1 as usize]).filter(|d| d.is_finite());
            let (count, sum) = known.fold((0.0, 0.0), |(count, sum), d| (count + 1.0_f32, sum + d));
            if count == 0.0 {
                return;
            }
            let usual = sum / count;
            let wanted = WANTED * usual;
            let mut push = [0.0; 3];
            for &(_, j) in pairs {
                let length = distance(i, j);
                if length < wanted && length > 0.0 {
                    let by = PUSH * (wanted - length) / length;
                    for a in 0..3 {
                        push[a] += by * (before[i][a] - before[j as usize][a]);
                    }
                }
            }
            let moved = push.iter().map(|c| c * c).sum::<f32>().sqrt();
            let share = (FARTHEST * usual / moved.max(f32::MIN_POSITIVE)).min(1.0);
            for a in 0..3 {
                point[a] += share * push[a];
            }
        });
    }
}

/// Of every point `i` its nearest others `j` on the same surface: pairs `(i, j)`, ascending by `i`.
fn neighbours(points: &[Point]) -> Vec<(u32, u32)> {
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
        others.map(|n| (i, n.index)).collect()
    };
    (0..points.len() as u32).into_par_iter().map_init(Vec::new, pairs_of).flatten_iter().collect()
}

/// The input points that no candidate comes near: what was measured must not vanish.
fn fallen_short_of(candidates: &[Point], input: &Measured) -> Vec<Point> {
    let tree = KdTree::new(candidates);
    let points = input.points.par_iter().zip(&input.spacing);
    let far = points.filter(|(p, spacing)| {
        tree.nearest_one(**p).is_none_or(|n| n.distance_squared.sqrt() > SHORT * **spacing)
    });
    far.map(|(p, _)| *p).collect()
}

/// Of every point and its nearest others on the same surface, each pair once.
fn midpoints(points: &[Point]) -> Vec<Point> {
    let mut pairs = neighbours(points);
    pairs.par_iter_mut().for_each(|pair| *pair = (pair.0.min(pair.1), pair.0.max(pair.1)));
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
        let input = Measured::new(&sample[..500], vec![0.05; 500]);
        let dense = polish(&made, &sample, 2000, &input, &mut Rng::new(5));
        assert_eq!(dense.len(), 2000);
        assert!(dense.iter().all(|p| (p[2] - 0.5).abs() < 1e-6));
        let (before, after) = (variation(&sample), variation(&dense));
        assert!(after < 0.4 * before, "{after} from {before}");
    }

    #[test]
    fn a_tip_of_one_point_keeps_its_reach() {
        let made = square(3000, 0.5, 1);
        let sample: Vec<Point> =
            farthest_point_sampling(&made, 2000, 0).iter().map(|&i| made[i as usize]).collect();
        let mut measured = sample[..500].to_vec();
        measured.push([0.5, 1.06, 0.5]);
        let input = Measured::new(&measured, vec![0.05; 501]);
        let dense = polish(&made, &sample, 2000, &input, &mut Rng::new(5));
        assert!(dense.iter().any(|p| p[1] > 1.04), "nothing near the tip");
    }

    #[test]
    fn sheets_are_not_bridged() {
        // Sheets 0.035 apart: with a spacing of 0.022 that is nearer than some neighbours in a
        // sheet. What is left are edges of less than 45 degrees.
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
        let input = Measured::new(&points, vec![1.0; 3]);
        assert_eq!(polish(&points, &points, 5, &input, &mut Rng::new(1)).len(), 5);
    }
}
