//! Points that a unit put where no surface is.

use rayon::prelude::*;

use crate::cloud::Point;
use crate::geometry::{KdTree, Walk};

/// A point that a unit made.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Made {
    pub(super) at: Point,
    /// How far from the point it was made of, in that point's spacing.
    pub(super) displacement: f32,
}

/// The cascade's input, as what every later point is measured against.
///
/// A limit on displacement alone lets strays through: a stray is far from everything, so the next
/// level grants it a wide spacing and lets its copies stray further.
pub(super) struct Measured {
    pub(super) tree: KdTree,
    pub(super) points: Vec<Point>,
    /// Mean distance of each point to its nearest others.
    pub(super) spacing: Vec<f32>,
}

/// The share of a level's points that is taken to lie where it should.
const SOUND: f64 = 0.9;

impl Measured {
    /// `spacing` of each of `points`.
    pub(super) fn new(points: &[Point], spacing: Vec<f32>) -> Self {
        Self { tree: KdTree::new(points), points: points.to_vec(), spacing }
    }

    /// For each point the distance to the nearest input point, in that one's spacing; NaN where it is not finite.
    fn distances(&self, made: &[Made]) -> Vec<f32> {
        let measure = |walk: &mut Walk, m: &Made| {
            if !m.at.iter().all(|c| c.is_finite()) {
                return f32::NAN;
            }
            self.tree.nearest_next(m.at, 1, walk);
            walk.found
                .first()
                .map_or(f32::NAN, |n| n.distance_squared.sqrt() / self.spacing[n.index as usize])
        };
        made.par_iter().map_init(Walk::default, measure).collect()
    }
}

/// What may be sampled: the points not moved further than `max_displacement` and not further from
/// the input than `max_distance` times what nine in ten points keep to (even input is covered to
/// 0.8 of its spacing everywhere, random input to 1.4: the cloud itself has to say).
///
/// Where that leaves fewer than `size`, the least strayed of the others make up for it; only points
/// that are not finite are never taken.
pub(super) fn without_strays(
    made: Vec<Made>,
    size: usize,
    max_displacement: f32,
    max_distance: f32,
    input: &Measured,
) -> Vec<Point> {
    let mut strayed = input.distances(&made);
    let mut sorted: Vec<f32> = strayed.iter().copied().filter(|d| d.is_finite()).collect();
    let sound = (SOUND * sorted.len() as f64) as usize;
    let usual = sorted.get(sound).is_some().then(|| *sorted.select_nth_unstable_by(sound, f32::total_cmp).1);
    // Where most points lie on input points, nothing can be told.
    let limit = usual.filter(|u| *u > 0.0).map_or(f32::INFINITY, |u| max_distance * u);
    for (s, m) in strayed.iter_mut().zip(&made) {
        // NaN stays: `max` would lose it.
        if s.is_finite() {
            *s = (*s / limit).max(m.displacement / max_displacement);
        }
    }
    let mut most = 1.0;
    if strayed.iter().filter(|s| **s <= most).count() < size {
        // NaN comes last, and is below no limit.
        let mut sorted = strayed.clone();
        most = match sorted.get(size - 1) {
            Some(_) => sorted.select_nth_unstable_by(size - 1, f32::total_cmp).1.min(f32::INFINITY),
            None => f32::INFINITY,
        };
    }
    made.iter().zip(&strayed).filter(|(_, s)| **s <= most).map(|(m, _)| m.at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Input points 0, 1, ..., 9 on a line, of spacing 1.
    fn input() -> Measured {
        let points: Vec<Point> = (0..10).map(|i| [i as f32, 0.0, 0.0]).collect();
        Measured::new(&points, vec![1.0; 10])
    }

    #[test]
    fn strays_are_left_out_unless_too_few_points_remain() {
        let made: Vec<Made> = [0.3, 2.0, 0.1, 0.9, 7.0, 0.5, f32::NAN]
            .into_iter()
            .map(|displacement| Made { at: [displacement, 0.0, 0.0], displacement })
            .collect();
        let kept = |size, limit| -> Vec<f32> {
            let left = without_strays(made.clone(), size, limit, f32::INFINITY, &input());
            left.iter().map(|p| p[0]).collect()
        };
        assert_eq!(kept(2, 0.8), [0.3, 0.1, 0.5]);
        assert_eq!(kept(4, 0.8), [0.3, 0.1, 0.9, 0.5], "the least moved makes up for what lacks");
        assert_eq!(kept(6, 0.8).len(), 6);
        assert_eq!(kept(7, 0.8).len(), 6, "what is not finite is never taken");
        assert_eq!(kept(1, f32::INFINITY).len(), 6);
    }

    #[test]
    fn a_stray_is_far_from_the_input_whatever_it_was_made_of() {
        // Ninety points within 0.4 of the line, and one that a stray made beside itself.
        let mut made: Vec<Made> =
            (0..90).map(|i| Made { at: [0.1 * i as f32, 0.4, 0.0], displacement: 0.1 }).collect();
        made.push(Made { at: [4.0, 1.4, 0.0], displacement: 0.1 });
        let left = without_strays(made.clone(), 10, 0.8, 1.5, &input());
        assert_eq!(left.len(), 90);
        assert!(left.iter().all(|p| p[1] < 1.0));
        assert_eq!(without_strays(made, 10, 0.8, f32::INFINITY, &input()).len(), 91);
    }

    #[test]
    fn points_that_lie_on_the_input_are_kept() {
        let made: Vec<Made> = (0..10).map(|i| Made { at: [i as f32, 0.0, 0.0], displacement: 0.0 }).collect();
        assert_eq!(without_strays(made, 10, 0.8, 1.5, &input()).len(), 10);
    }
}
