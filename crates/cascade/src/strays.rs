//! Points that a unit put where no surface is.

use rayon::prelude::*;

use super::measured::Measured;
use densecloud_cloud::Point;

/// A point that a unit made.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Made {
    pub(super) at: Point,
    /// How far from the point it was made of, in that point's spacing.
    pub(super) displacement: f32,
}

/// The share of a level's points that is taken to lie where it should.
const SOUND: f64 = 0.9;
/// What strays by so many times a limit is no near miss.
const WORSE: f32 = 1.5;
/// How far beyond all input points around it a point may lie, in the nearest one's spacing and as a share of the distance
/// limit. The surface itself reaches 0.35 spacings beyond even samples at most.
const BEYOND: f32 = 2.0 / 15.0;
/// The share of this that is left where the input's own points lie on the border.
const AT_BORDER: f32 = 0.5;

/// What may be sampled: the points not moved further than `max_displacement` and not further from
/// the input than `max_distance` times what nine in ten points keep to (even input is covered to
/// 0.8 of its spacing everywhere, random input to 1.4: the cloud itself has to say). Past an open
/// border nothing has been measured, and a unit puts points up to a whole spacing there, so a point
/// with the input on one side only must stay within [`BEYOND`] of that limit, and where the surface is known to end there
/// ([`Borders`](super::border::Borders)) within half of that.
///
/// Where that leaves fewer than `size`, the least strayed of the others make up for it: those [`WORSE`] times
/// past a limit only where there were fewer than `least` without them, and never points that are not finite.
pub(super) fn without_strays(
    made: Vec<Made>,
    size: usize,
    least: usize,
    max_displacement: f32,
    max_distance: f32,
    input: &Measured,
) -> Vec<Point> {
    let distances = input.distances(&made);
    let mut sorted: Vec<f32> = distances.iter().map(|d| d.0).filter(|d| d.is_finite()).collect();
    let sound = (SOUND * sorted.len() as f64) as usize;
    let usual = sorted.get(sound).is_some().then(|| *sorted.select_nth_unstable_by(sound, f32::total_cmp).1);
    // Where most points lie on input points, nothing can be told.
    let limit = usual.filter(|u| *u > 0.0).map_or(f32::INFINITY, |u| max_distance * u);
    let most_beyond = BEYOND * max_distance;
    let strayed = |found: &mut Vec<_>, (m, &(distance, nearest)): (&Made, &(f32, u32))| {
        // NaN stays: `max` would lose it.
        if !distance.is_finite() {
            return distance;
        }
        let most_beyond = most_beyond * (1.0 - (1.0 - AT_BORDER) * input.borders.ends(nearest));
        // No point is further beyond others than it is away from them.
        let beyond =
            if distance > most_beyond { input.beyond(m.at, nearest, most_beyond, found) } else { 0.0 };
        (distance / limit).max(m.displacement / max_displacement).max(beyond / most_beyond)
    };
    let strayed: Vec<f32> = made.par_iter().zip(&distances).map_init(Vec::new, strayed).collect();
    let mut most = 1.0;
    if strayed.iter().filter(|s| **s <= most).count() < size {
        // NaN comes last, and is below no limit.
        let mut sorted = strayed.clone();
        let mut nth = |size: usize| match sorted.get(size - 1) {
            Some(_) => sorted.select_nth_unstable_by(size - 1, f32::total_cmp).1.min(f32::INFINITY),
            None => f32::INFINITY,
        };
        most = nth(size).min(nth(least).max(WORSE));
    }
    made.iter().zip(&strayed).filter(|(_, s)| **s <= most).map(|(m, _)| m.at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::Rng;

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
            let left = without_strays(made.clone(), size, size, limit, f32::INFINITY, &input());
            left.iter().map(|p| p[0]).collect()
        };
        assert_eq!(kept(2, 0.8), [0.3, 0.1, 0.5]);
        assert_eq!(kept(4, 0.8), [0.3, 0.1, 0.9, 0.5], "the least moved makes up for what lacks");
        assert_eq!(kept(6, 0.8).len(), 6);
        assert_eq!(kept(7, 0.8).len(), 6, "what is not finite is never taken");
        assert_eq!(kept(1, f32::INFINITY).len(), 6);
    }

    #[test]
    fn the_worst_strays_make_up_only_for_what_is_needed() {
        let made: Vec<Made> = [0.1, 0.2, 0.9, 1.1, 1.3, 2.0, 7.0]
            .into_iter()
            .map(|displacement| Made { at: [displacement, 0.0, 0.0], displacement })
            .collect();
        let kept = |size, least| {
            let left = without_strays(made.clone(), size, least, 0.8, f32::INFINITY, &input());
            left.len()
        };
        // Up to 1.2, half as much again as the limit, whatever is wanted.
        assert_eq!((kept(2, 1), kept(3, 1), kept(4, 1), kept(6, 1), kept(6, 4)), (2, 3, 4, 4, 4));
        assert_eq!((kept(6, 5), kept(6, 6), kept(7, 6)), (5, 6, 6));
    }

    #[test]
    fn a_stray_is_far_from_the_input_whatever_it_was_made_of() {
        // Ninety points within 0.4 of the line, and one that a stray made beside itself.
        let mut made: Vec<Made> =
            (0..90).map(|i| Made { at: [0.1 * i as f32, 0.4, 0.0], displacement: 0.1 }).collect();
        made.push(Made { at: [4.0, 1.4, 0.0], displacement: 0.1 });
        let left = without_strays(made.clone(), 10, 10, 0.8, 1.5, &input());
        assert_eq!(left.len(), 90);
        assert!(left.iter().all(|p| p[1] < 1.0));
        assert_eq!(without_strays(made, 10, 10, 0.8, f32::INFINITY, &input()).len(), 91);
    }

    #[test]
    fn nothing_goes_far_past_an_open_border() {
        // A square of 10 by 10 points of spacing 1, smooth or rough; most of what was made lies between four of them.
        let farthest = |rough: f32, max_distance| {
            let mut random = Rng::new(1);
            let height = |_| rough * random.normal() as f32;
            let heights: Vec<f32> = (0..100).map(height).collect();
            let at = |i: usize| [(i % 10) as f32, (i / 10) as f32, heights[i]];
            let points: Vec<Point> = (0..100).map(at).collect();
            let input = Measured::new(&points, vec![1.0; 100]);
            let mut made: Vec<Made> = (0..81)
                .map(|i| Made { at: [(i % 9) as f32 + 0.5, (i / 9) as f32 + 0.5, 0.0], displacement: 0.7 })
                .collect();
            let past = |by: f32| Made { at: [9.0 + by, 4.0, 0.0], displacement: 0.7 };
            made.extend([past(0.08), past(0.15), past(0.3), past(0.6)]);
            let left = without_strays(made, 10, 10, 0.8, max_distance, &input);
            assert!(left.len() >= 82);
            left.iter().map(|p| p[0]).fold(0.0, f32::max) - 9.0
        };
        let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{a}, not {b}");
        near(farthest(0.0, 1.5), 0.08);
        // What is rough may be no border.
        near(farthest(0.1, 1.5), 0.15);
        near(farthest(0.0, f32::INFINITY), 0.6);
    }

    #[test]
    fn points_that_lie_on_the_input_are_kept() {
        let made: Vec<Made> = (0..10).map(|i| Made { at: [i as f32, 0.0, 0.0], displacement: 0.0 }).collect();
        assert_eq!(without_strays(made, 10, 10, 0.8, 1.5, &input()).len(), 10);
    }
}
