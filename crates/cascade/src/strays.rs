//! Points that a unit put where no surface is.

use rayon::prelude::*;

use super::globals::{LevelGlobals, most_strayed, once, usual_distance};
use super::measured::Reference;
use super::runner::MadePoint;
use densecloud_cloud::Point;

/// How far beyond all input points around it a point may lie, in the nearest one's spacing and as a share of the distance
/// limit. The surface itself reaches 0.35 spacings beyond even samples at most.
const BEYOND: f32 = 2.0 / 15.0;
/// The share of this that is left where the input's own points lie on the border.
const AT_BORDER: f32 = 0.5;

/// How far points may stray, and how many are needed.
#[derive(Debug, Clone, Copy)]
pub(super) struct StrayLimits {
    /// The most that a point is moved from the one it was made of, in that one's spacing.
    pub(super) displacement: f32,
    /// The largest distance from the input, in multiples of what nine in ten points keep.
    pub(super) distance: f32,
    /// Points that are wanted: the least strayed make up for what lacks.
    pub(super) wanted: usize,
    /// Points that are needed, whatever strays are among them.
    pub(super) least: usize,
}

/// Points that may be sampled.
pub(super) struct Kept {
    pub(super) points: Vec<Point>,
    /// For each the nearest input point.
    pub(super) nearest: Vec<u32>,
}

/// The points that may be sampled: those not moved further than the displacement and not further from the input than the
/// distance, in multiples of what nine in ten points keep to (even input is covered to 0.8 of its spacing everywhere,
/// random input to 1.4: the cloud itself has to say). Past an open border nothing has been measured, and a unit puts
/// points up to a whole spacing there, so a point with the input on one side only must stay within [`BEYOND`] of that
/// limit, and where the surface is known to end there ([`Borders`](super::border::Borders)) within half of that.
///
/// Where that leaves fewer than are wanted, the least strayed of the others make up for it ([`most_strayed`]), but never
/// points that are not finite.
pub(super) fn without_strays(
    made: &[MadePoint],
    limits: &StrayLimits,
    Reference { input, borders, .. }: &Reference,
    globals: &mut LevelGlobals,
) -> Kept {
    let distances = input.distances(made);
    let usual = once(&mut globals.usual_distance, || usual_distance(distances.iter().map(|d| d.0)));
    // Where most points lie on input points, nothing can be told.
    let limit = if usual > 0.0 { limits.distance * usual } else { f32::INFINITY };
    let most_beyond = BEYOND * limits.distance;
    let strayed = |found: &mut Vec<_>, (m, &(distance, nearest)): (&MadePoint, &(f32, u32))| {
        // NaN stays: `max` would lose it.
        if !distance.is_finite() {
            return distance;
        }
        let most_beyond = most_beyond * (1.0 - (1.0 - AT_BORDER) * borders.ends(nearest));
        // No point is further beyond others than it is away from them.
        let beyond =
            if distance > most_beyond { input.beyond(m.at, nearest, most_beyond, found) } else { 0.0 };
        (distance / limit).max(m.displacement / limits.displacement).max(beyond / most_beyond)
    };
    let strayed: Vec<f32> = made.par_iter().zip(&distances).map_init(Vec::new, strayed).collect();
    let most = once(&mut globals.most_strayed, || most_strayed(&strayed, limits.wanted, limits.least));
    let kept = made.iter().zip(&distances).zip(&strayed).filter(|(_, s)| **s <= most);
    let (points, nearest) = kept.map(|((m, (_, nearest)), _)| (m.at, *nearest)).unzip();
    Kept { points, nearest }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::globals::Globals;
    use crate::measured::Measured;
    use densecloud_cloud::Frame;
    use densecloud_geometry::Rng;

    /// Input points 0, 1, ..., 9 on a line, of spacing 1.
    fn input() -> Reference {
        let points: Vec<Point> = (0..10).map(|i| [i as f32, 0.0, 0.0]).collect();
        reference(&points)
    }

    fn reference(points: &[Point]) -> Reference {
        let frame = Frame::fit(&[[0.0; 3], [1.0; 3]]).unwrap();
        Reference::new(Measured::new(points, 1.0), None, &mut Globals::new(frame))
    }

    /// What is left where so many are wanted and needed, and points are moved and far by no more than this.
    fn left(
        made: &[MadePoint],
        [wanted, least]: [usize; 2],
        [displacement, distance]: [f32; 2],
    ) -> Vec<Point> {
        left_of(made, [wanted, least], [displacement, distance], &input())
    }

    fn left_of(
        made: &[MadePoint],
        [wanted, least]: [usize; 2],
        [displacement, distance]: [f32; 2],
        input: &Reference,
    ) -> Vec<Point> {
        let limits = StrayLimits { displacement, distance, wanted, least };
        without_strays(made, &limits, input, &mut LevelGlobals::default()).points
    }

    #[test]
    fn strays_are_left_out_unless_too_few_points_remain() {
        let made: Vec<MadePoint> = [0.3, 2.0, 0.1, 0.9, 7.0, 0.5, f32::NAN]
            .into_iter()
            .map(|displacement| MadePoint { at: [displacement, 0.0, 0.0], displacement })
            .collect();
        let kept = |size, limit| -> Vec<f32> {
            let left = left(&made, [size, size], [limit, f32::INFINITY]);
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
        let made: Vec<MadePoint> = [0.1, 0.2, 0.9, 1.1, 1.3, 2.0, 7.0]
            .into_iter()
            .map(|displacement| MadePoint { at: [displacement, 0.0, 0.0], displacement })
            .collect();
        let kept = |size, least| left(&made, [size, least], [0.8, f32::INFINITY]).len();
        // Up to 1.2, half as much again as the limit, whatever is wanted.
        assert_eq!((kept(2, 1), kept(3, 1), kept(4, 1), kept(6, 1), kept(6, 4)), (2, 3, 4, 4, 4));
        assert_eq!((kept(6, 5), kept(6, 6), kept(7, 6)), (5, 6, 6));
    }

    #[test]
    fn a_stray_is_far_from_the_input_whatever_it_was_made_of() {
        // Ninety points within 0.4 of the line, and one that a stray made beside itself.
        let mut made: Vec<MadePoint> =
            (0..90).map(|i| MadePoint { at: [0.1 * i as f32, 0.4, 0.0], displacement: 0.1 }).collect();
        made.push(MadePoint { at: [4.0, 1.4, 0.0], displacement: 0.1 });
        let near = left(&made, [10, 10], [0.8, 1.5]);
        assert_eq!(near.len(), 90);
        assert!(near.iter().all(|p| p[1] < 1.0));
        assert_eq!(left(&made, [10, 10], [0.8, f32::INFINITY]).len(), 91);
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
            let input = reference(&points);
            let mut made: Vec<MadePoint> = (0..81)
                .map(|i| MadePoint {
                    at: [(i % 9) as f32 + 0.5, (i / 9) as f32 + 0.5, 0.0],
                    displacement: 0.7,
                })
                .collect();
            let past = |by: f32| MadePoint { at: [9.0 + by, 4.0, 0.0], displacement: 0.7 };
            made.extend([past(0.08), past(0.15), past(0.3), past(0.6)]);
            let left = left_of(&made, [10, 10], [0.8, max_distance], &input);
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
        let made: Vec<MadePoint> =
            (0..10).map(|i| MadePoint { at: [i as f32, 0.0, 0.0], displacement: 0.0 }).collect();
        assert_eq!(left(&made, [10, 10], [0.8, 1.5]).len(), 10);
    }
}
