//! Points that are too near push each other apart.

use rayon::prelude::*;

use super::rings::rings;
use densecloud_cloud::Point;
use densecloud_geometry::KdTree;

/// Steps of relaxation; more flatten what is thin and round what is sharp.
const STEPS: usize = 2;
/// Points push each other when they are nearer than this, in multiples of the usual distance.
const WANTED: f32 = 1.1;
/// The share of what lacks that one step makes up.
const PUSH: f32 = 0.4;
/// No step is longer than this share of the usual distance.
const FARTHEST: f32 = 0.2;

/// Pushes points apart that are nearer to each other than is usual around them: what farthest
/// point sampling leaves uneven. The neighbours are found once, since points move little.
pub(super) fn relax(points: &mut [Point]) {
    let rings = rings(&KdTree::new(points), points);
    for _ in 0..STEPS {
        let before = points.to_vec();
        let distance = |i: usize, j: u32| {
            let (p, q) = (before[i], before[j as usize]);
            (0..3).map(|a| (p[a] - q[a]).powi(2)).sum::<f32>().sqrt()
        };
        let nearest: Vec<f32> = rings
            .par_iter()
            .enumerate()
            .map(|(i, ring)| ring.others().iter().map(|&j| distance(i, j)).fold(f32::INFINITY, f32::min))
            .collect();
        points.par_iter_mut().zip(&rings).enumerate().for_each(|(i, (point, ring))| {
            // A neighbour on a steep spot may have no neighbours of its own.
            let known = ring.others().iter().map(|&j| nearest[j as usize]).filter(|d| d.is_finite());
            let (count, sum) = known.fold((0.0, 0.0), |(count, sum), d| (count + 1.0_f32, sum + d));
            if count == 0.0 {
                return;
            }
            let usual = sum / count;
            let wanted = WANTED * usual;
            let mut push = [0.0; 3];
            for &j in ring.others() {
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
