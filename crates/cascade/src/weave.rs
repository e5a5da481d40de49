//! The result where the input lies on scan lines.
//!
//! There it is not made by the network but interpolated: between the points of each line, and between lines that a
//! surface bridges. A neighbourhood becomes denser by the same factor along and across, as if the sensor had had so many
//! more lines and so many more points on each. What is not bridged stays open: its share of points goes to the lines.

use rayon::prelude::*;

use super::apart::joined;
use super::lines::{Lines, Stretch};
use super::vector::{cosine, dot, mix};
use densecloud_cloud::Point;
use densecloud_geometry::{farthest_point_sampling_beside, scaled_farthest_point_sampling};

/// A ratio above a square by less than this is that square.
const SPARE: f64 = 0.1;
/// Of the two ways across a gap, the one along this fills it, so that it is not filled from both of its lines.
const WAY: Point = [0.61, 0.53, 0.59];
/// Bridges beside each other go the same way: the least cosine.
const SIDE_BY_SIDE: f32 = 0.5;

/// What of a result is woven.
#[derive(Clone, Copy)]
pub(super) struct Cloth<'a> {
    /// The input: the result's own, or that of a part and its halo.
    pub(super) input: &'a [Point],
    /// Points of the result for each of the input.
    pub(super) ratio: f64,
    /// Where points may be put.
    pub(super) belongs: &'a (dyn Fn(Point) -> bool + Sync),
}

/// The `dense` cloud, as many points, with those near lines replaced; any prefix is spread as evenly as
/// the whole. Nothing is changed where there are no lines. About as much work as the polish.
pub(super) fn woven(dense: Vec<Point>, Cloth { input, ratio, belongs }: Cloth<'_>) -> Vec<Point> {
    let across = (ratio.sqrt() - SPARE).ceil() as usize;
    let Some(lines) = (across > 1).then(|| Lines::of(input)).flatten() else { return dense };
    let (replaced, kept) = parted(dense, &lines);
    let along = ((ratio - SPARE) / across as f64).ceil() as usize;
    let lattice = Lattice { lines: &lines, across, belongs };
    joined(kept, &lattice.chosen(along, replaced))
}

/// The points whose nearest input point lies on a line, and the others, each in the given order.
fn parted(dense: Vec<Point>, lines: &Lines<'_>) -> (Vec<Point>, Vec<Point>) {
    let near = |p: &Point| lines.tree.nearest_one(*p).is_some_and(|n| lines.is_woven(n.index));
    let near: Vec<bool> = dense.par_iter().map(near).collect();
    let (replaced, kept): (Vec<_>, Vec<_>) = dense.into_iter().zip(near).partition(|(_, near)| *near);
    let points = |parted: Vec<(Point, bool)>| parted.into_iter().map(|(p, _)| p).collect();
    (points(replaced), points(kept))
}

/// The lines, and further ones between those that are bridged.
struct Lattice<'a> {
    lines: &'a Lines<'a>,
    /// Parts that a gap is cut into.
    across: usize,
    belongs: &'a (dyn Fn(Point) -> bool + Sync),
}

/// A point, and the spacing along its line.
type Knot = (Point, f32);

impl Lattice<'_> {
    /// As many points as are `replaced`. First those of the lattice that cuts lines into as many parts as `along`; then
    /// those halfway between; and where even these do not suffice, some of the replaced ones.
    fn chosen(&self, along: usize, replaced: Vec<Point>) -> Vec<Point> {
        let count = replaced.len();
        let places = |parts: usize, step| (1..parts).step_by(step).map(move |k| k as f32 / parts as f32);
        let (points, spacing) = self.points(true, &places(along, 1).collect::<Vec<_>>());
        let pick =
            |points: &[Point], chosen: Vec<u32>| chosen.into_iter().map(|i| points[i as usize]).collect();
        let mut chosen: Vec<Point> =
            pick(&points, scaled_farthest_point_sampling(&points, &spacing, count, 0));
        if chosen.len() < count {
            let (finer, spacing) = self.points(false, &places(2 * along, 2).collect::<Vec<_>>());
            let left = count - chosen.len();
            let more = farthest_point_sampling_beside(&finer, &spacing, left, &chosen);
            chosen.extend(pick(&finer, more));
        }
        let left = count - chosen.len();
        chosen.extend(&replaced[..left]);
        chosen
    }

    /// All points at these `places` between the points of lines, 0 to 1, and on lines between those; and at the points
    /// themselves and across from them, if those are wanted.
    fn points(&self, own: bool, places: &[f32]) -> (Vec<Point>, Vec<f32>) {
        let knots = |stretch: Option<&Stretch>| {
            let mut knots: Vec<Knot> = Vec::new();
            if let Some(stretch) = stretch {
                self.knots(stretch, own, places, |p| {
                    if (self.belongs)(p) {
                        knots.push((p, stretch.spacing));
                    }
                });
            }
            knots
        };
        self.lines.woven().flat_map_iter(knots).unzip()
    }

    /// Those that belong to one point of a line.
    fn knots(&self, stretch: &Stretch, own: bool, places: &[f32], mut found: impl FnMut(Point)) {
        let p = self.lines.place(stretch);
        let bridges = [0, 1].map(|side| self.fills(stretch, side).then(|| stretch.sides[side].foot));
        if own {
            found(p);
            bridges
                .iter()
                .flatten()
                .for_each(|foot| self.steps().for_each(|step| found(mix(p, *foot, step))));
        }
        for next in self.lines.pairs(stretch) {
            let q = self.lines.place(next);
            places.iter().for_each(|&place| found(mix(p, q, place)));
            for (side, foot) in bridges.iter().enumerate().filter_map(|(side, foot)| Some((side, (*foot)?))) {
                let Some(beside) = self.beside(stretch, side, next) else { continue };
                for step in self.steps() {
                    let (from, to) = (mix(p, foot, step), mix(q, beside, step));
                    places.iter().for_each(|&place| found(mix(from, to, place)));
                }
            }
        }
    }

    /// The places of the new lines in a gap.
    fn steps(&self) -> impl Iterator<Item = f32> {
        let across = self.across;
        (1..across).map(move |k| k as f32 / across as f32)
    }

    /// Whether the gap on that side is filled from this line, not from the other.
    fn fills(&self, stretch: &Stretch, side: usize) -> bool {
        let fills = |stretch: &Stretch, side: usize| {
            stretch.sides[side].bridged && dot(self.lines.across(stretch, side), WAY) > 0.0
        };
        let back =
            || self.lines.opposite(stretch, side).filter(|(other, _)| self.lines.is_woven(other.point));
        stretch.sides[side].bridged
            && (fills(stretch, side) || !back().is_some_and(|(other, back)| fills(other, back)))
    }

    /// The foot of the `next` point's bridge that goes beside this one's.
    fn beside(&self, stretch: &Stretch, side: usize, next: &Stretch) -> Option<Point> {
        let bridge = self.lines.across(stretch, side);
        let its = self.lines.onward(next, bridge);
        let beside = cosine(self.lines.across(next, its), bridge) > SIDE_BY_SIDE;
        (next.sides[its].bridged && beside).then(|| next.sides[its].foot)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{CascadeOptions, Fake, Patchwise, Silent, Spread, Target, upsample};
    use densecloud_cloud::Position;
    use densecloud_geometry::Rng;

    fn woven(dense: Vec<Point>, input: &[Point]) -> Vec<Point> {
        let ratio = dense.len() as f64 / input.len() as f64;
        super::woven(dense, Cloth { input, ratio, belongs: &|_| true })
    }

    /// Eleven lines one apart, with ten points each to a gap; the upper ones stand higher.
    fn scan(step: f32) -> Vec<Point> {
        let mut random = Rng::new(5);
        let mut points = Vec::new();
        for line in 0..11 {
            let height = if line > 5 { step } else { 0.0 };
            let phase = random.f64();
            points.extend((0..120).map(|k| [(0.1 * (f64::from(k) + phase)) as f32, line as f32, height]));
        }
        points
    }

    /// So many points for each of the scan, anywhere near it.
    fn about(scan: &[Point], ratio: usize) -> Vec<Point> {
        let mut random = Rng::new(6);
        let mut near = |p: &Point| [p[0], p[1] + 0.3 * random.f64() as f32, p[2]];
        (0..ratio).flat_map(|_| scan.iter().map(&mut near).collect::<Vec<_>>()).collect()
    }

    /// How many points lie at each of the places across a gap that it is cut into.
    fn places(points: &[Point], parts: usize) -> Vec<usize> {
        let mut counts = vec![0; parts];
        for p in points {
            let place = p[1] * parts as f32;
            assert!((place - place.round()).abs() < 1e-3, "{p:?} is on no line");
            counts[place.round() as usize % parts] += 1;
        }
        counts
    }

    #[test]
    fn a_part_gets_its_share_where_it_belongs() {
        let scan = scan(0.0);
        let belongs = |p: Point| p[0] < 4.0;
        let dense: Vec<Point> = about(&scan, 4).into_iter().filter(|p| belongs(*p)).collect();
        let count = dense.len();
        let woven = super::woven(dense, Cloth { input: &scan, ratio: 4.0, belongs: &belongs });
        assert!(woven.len() == count && woven.iter().all(|p| belongs(*p)));
        let counts = places(&woven, 2);
        assert!(counts.iter().all(|n| (0.8..1.3).contains(&(2.0 * *n as f32 / count as f32))), "{counts:?}");
    }

    #[test]
    fn a_gap_gets_lines_as_dense_as_its_own() {
        let scan = scan(0.0);
        for (ratio, parts) in [(2, 2), (4, 2), (6, 3), (9, 3), (16, 4)] {
            let dense = woven(about(&scan, ratio), &scan);
            assert_eq!(dense.len(), ratio * scan.len());
            let counts = places(&dense, parts);
            let usual = dense.len() as f32 / parts as f32;
            // There is a gap less than lines.
            assert!(
                counts.iter().all(|n| (0.8..1.3).contains(&(*n as f32 / usual))),
                "{counts:?} at {ratio}"
            );
            // And so is any part of it.
            let counts = places(&dense[..scan.len()], parts);
            let usual = scan.len() as f32 / parts as f32;
            assert!(
                counts.iter().all(|n| (0.7..1.4).contains(&(*n as f32 / usual))),
                "{counts:?} at {ratio}"
            );
        }
        let same = about(&scan, 1);
        assert_eq!(woven(same.clone(), &scan), same, "nothing is to become denser");
    }

    #[test]
    fn a_step_stays_open_and_its_share_goes_to_the_lines() {
        let scan = scan(3.0);
        let dense = woven(about(&scan, 4), &scan);
        assert_eq!(dense.len(), 4 * scan.len());
        assert!(dense.iter().all(|p| p[2] == 0.0 || p[2] == 3.0));
        assert!(!dense.iter().any(|p| (5.01..5.99).contains(&p[1])), "bridged");
    }

    #[test]
    fn what_is_not_near_a_line_is_kept() {
        let mut random = Rng::new(8);
        let mut blade = || [30.0 + 9.0 * random.f64() as f32, 9.0 * random.f64() as f32, 0.0];
        let sparse: Vec<Point> = (0..1000).map(|_| blade()).collect();
        let dense: Vec<Point> = (0..4000).map(|_| blade()).collect();
        let both = |lawn: &[Point], lined: Vec<Point>| [lawn, &lined].concat();
        let input = both(&sparse, scan(0.0));
        let found = woven(both(&dense, about(&scan(0.0), 4)), &input);
        assert_eq!(found.iter().filter(|p| p[0] > 25.0).copied().collect::<Vec<_>>(), dense);
        places(&found.iter().filter(|p| p[0] < 25.0).copied().collect::<Vec<_>>(), 2);
        let first = found[..1000].iter().filter(|p| p[0] > 25.0).count() as f32;
        assert!((first / 1000.0 - dense.len() as f32 / found.len() as f32).abs() < 0.02);
    }

    #[test]
    fn the_cascade_weaves_where_it_may() {
        let scan: Vec<Position> = scan(0.0).iter().map(|p| p.map(f64::from)).collect();
        let runner = Patchwise::new(Arc::new(Fake::new()));
        let run = |ratio, options, threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let run = || upsample(&scan, Target::Ratio(ratio), &options, &runner, &Silent).unwrap().positions;
            pool.install(run)
        };
        let midway = |points: &[Position]| {
            let off = points.iter().map(|p| (p[1] - p[1].round()).abs());
            off.filter(|off| *off > 0.49).count() as f32 / points.len() as f32
        };
        let usual = CascadeOptions::default();
        for ratio in [1.9, 4.0, 4.3] {
            let found = run(ratio, usual, 1);
            assert_eq!(found.len(), (ratio * scan.len() as f64).round() as usize);
            assert!(midway(&found) > 0.4, "{} at {ratio}", midway(&found));
            assert_eq!(run(ratio, usual, 4), found, "threads");
        }
        for options in
            [CascadeOptions { polish: false, ..usual }, CascadeOptions { spread: Spread::Area, ..usual }]
        {
            let found = run(4.0, options, 2);
            assert!(midway(&found) < 0.2, "{} with {options:?}", midway(&found));
        }
    }
}
