//! Scan lines: where the input is dense along lines and thin across them.
//!
//! A sensor that sweeps or spins measures every few millimetres along a line and leaves a gap to the next one. A
//! point's nearest ones are then those of its own line, so that whatever looks at them sees a wire, and no surface between
//! lines. Here lines are found by the points alone: each point's two nearest lie along its line, for all points about
//! it; the nearest that lie beside it are of the next lines, and further off. The gap to those is bridged where the
//! surface goes on: lines run side by side, gaps are about as wide as others there, and line follows on line without a
//! step.
//!
//! A wire is a line with none beside it, and a few wires side by side are no surface either: it takes [`RUN`] lines.
//! All is told by a point's surroundings, and nothing by the whole.

use rayon::prelude::*;

use super::vector::{cosine, dot, length, mix, sub, unit};
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Walk, common_axis, indices};

/// Points whose nearest two tell the direction of a line, and of how many of them it may be less clear.
const NEAR: usize = 16;
const NEAREST: usize = 8;
/// The share of those directions along the line, by the nearest ones, and by all where a line is certain. Without lines
/// it is about 0.5, below 0.7 for 99 in 100 points of a random sample, and 0.85 to 1 on lines.
const ALONG: f64 = 0.6;
const CERTAIN: f64 = 0.7;
/// The next line is further off than this, in the spacing along the line, and nearer than that.
const LEAST: f32 = 1.5;
const MOST: f32 = 2000.0;
/// The next point of a line is no further off than this, in the same unit, and lies ahead: the cosine.
const FOLLOWS: f32 = 4.0;
const AHEAD: f32 = 0.8;
/// A point beside lies no further ahead than this share of its distance from the line; on the other side if it is
/// opposite: the cosine.
const BESIDE: f32 = 0.7;
const OPPOSITE: f32 = 0.7;
/// The line on the other side is no further off than this, in the distance of the nearer one: a wider gap is open.
const AS_FAR: f32 = 8.0;
/// A gap that is wider than the usual one about it by more than this is open.
const WIDER: f32 = 3.0;
/// The least cosine between lines side by side.
const PARALLEL: f32 = 0.8;
/// The least cosine between a bridge and the gaps on either side of it.
const SHARPEST: f32 = 0.5;
/// A bridge at less than this to both, where they go on in one direction, climbs a step.
const STEP: f32 = 0.87;
/// Lines one after the other that make a surface.
const RUN: usize = 5;
/// Points about one on a line, of which more than this share must be on lines for certain.
const COMPANY: usize = 64;
const SHARE: f32 = 0.2;

/// No point.
const NONE: u32 = u32::MAX;

/// A cloud's lines.
pub(super) struct Lines<'a> {
    pub(super) points: &'a [Point],
    pub(super) tree: KdTree,
    /// For each point its stretch, or [`NONE`].
    at: Vec<u32>,
    stretches: Vec<Stretch>,
}

/// A point that may lie on a line.
#[derive(Clone)]
pub(super) struct Stretch {
    pub(super) point: u32,
    /// The line's direction, of unit length; either of the two.
    along: Point,
    certain: bool,
    /// The usual distance between the points of the line.
    pub(super) spacing: f32,
    /// The next points of the line, or [`NONE`].
    followers: [u32; 2],
    pub(super) sides: [Side; 2],
    /// Whether a gap is as wide as between lines.
    sound: bool,
    /// Whether the line and those beside it are a surface.
    woven: bool,
}

/// The next line on one side.
#[derive(Clone, Copy)]
pub(super) struct Side {
    /// The nearest point on that side, or [`NONE`].
    to: u32,
    /// The place on that line right beside.
    pub(super) foot: Point,
    /// How far off it is; infinite where there is none.
    gap: f32,
    pub(super) bridged: bool,
}

impl<'a> Lines<'a> {
    /// The lines of distinct `points`; none where no point lies on one. O(n log n); where there are lines, up to
    /// 150 bytes a point.
    pub(super) fn of(points: &'a [Point]) -> Option<Self> {
        if points.len() <= COMPANY {
            return None;
        }
        let tree = KdTree::new(points);
        let stretches = stretches(points, &tree);
        let mut at = vec![NONE; points.len()];
        stretches.iter().zip(0..).for_each(|(s, place)| at[s.point as usize] = place);
        let mut lines = Self { points, tree, at, stretches };
        let certain: Vec<bool> = lines.stretches.iter().map(|s| s.certain).collect();
        // Elsewhere a few points are certain by chance, and what is beside them need not be looked for.
        if !lines.in_company(&certain, |s| s.certain).contains(&true) {
            return None;
        }
        lines.find();
        lines.measure();
        lines.bridge();
        lines.weave();
        lines.stretches.iter().any(|s| s.woven).then_some(lines)
    }

    /// The stretches of lines that are a surface.
    pub(super) fn woven(&self) -> impl IndexedParallelIterator<Item = Option<&Stretch>> {
        self.stretches.par_iter().map(|s| s.woven.then_some(s))
    }

    /// Whether a point lies on a line that is part of a surface.
    pub(super) fn is_woven(&self, point: u32) -> bool {
        self.stretch(point).is_some_and(|s| s.woven)
    }

    fn stretch(&self, point: u32) -> Option<&Stretch> {
        self.stretches.get(*self.at.get(point as usize)? as usize)
    }

    /// Where a stretch is.
    pub(super) fn place(&self, of: &Stretch) -> Point {
        self.points[of.point as usize]
    }

    /// From a point to the line on one side.
    pub(super) fn across(&self, from: &Stretch, side: usize) -> Point {
        sub(from.sides[side].foot, self.place(from))
    }

    /// The next points of a line, where it is that of both, each pair once.
    pub(super) fn pairs<'b>(&'b self, of: &'b Stretch) -> impl Iterator<Item = &'b Stretch> {
        let mine = |other: &Stretch| !other.woven || of.point < other.point;
        let nexts = of.followers.iter().filter_map(|&next| self.stretch(next));
        nexts.filter(move |other| other.followers.contains(&of.point) && mine(other))
    }

    /// The side of a stretch that lies in a direction.
    pub(super) fn onward(&self, from: &Stretch, direction: Point) -> usize {
        usize::from(dot(self.across(from, 0), direction) <= 0.0)
    }

    /// The line on one side, and on which side of that this one is.
    pub(super) fn opposite(&self, from: &Stretch, side: usize) -> Option<(&Stretch, usize)> {
        let other = self.stretch(from.sides[side].to)?;
        Some((other, 1 - self.onward(other, self.across(from, side))))
    }

    /// Finds the next points along the lines and the nearest beside them.
    fn find(&mut self) {
        let Self { points, tree, .. } = &*self;
        let found = |s: &Stretch| {
            let at = points[s.point as usize];
            let found = Beside { points, tree, at, along: s.along, spacing: s.spacing };
            ([1.0, -1.0].map(|way| found.follower(way)), found.sides())
        };
        let all: Vec<_> = self.stretches.par_iter().map(found).collect();
        for (stretch, (followers, sides)) in self.stretches.iter_mut().zip(all) {
            stretch.followers = followers;
            stretch.sides = sides.map(|to| Side { to, ..Side::none() });
        }
    }

    /// Finds the feet and the gaps.
    fn measure(&mut self) {
        let measured = |s: &Stretch| s.sides.map(|side| self.foot(s, side.to));
        let sides: Vec<[Side; 2]> = self.stretches.par_iter().map(measured).collect();
        for (stretch, sides) in self.stretches.iter_mut().zip(sides) {
            stretch.sides = sides;
            stretch.sound = (LEAST * stretch.spacing..f32::INFINITY).contains(&stretch.gap());
        }
    }

    /// The place beside a stretch on the line of the point `to`.
    fn foot(&self, of: &Stretch, to: u32) -> Side {
        let Some(&q) = self.points.get(to as usize) else { return Side::none() };
        let p = self.place(of);
        let ahead = |r: Point| dot(sub(r, p), of.along);
        let followers = self.stretch(to).map_or([NONE; 2], |s| s.followers);
        let nexts = followers.iter().filter_map(|&next| self.points.get(next as usize));
        let passed = nexts.map(|r| (*r, ahead(q), ahead(*r))).find(|(_, from, to)| from * to < 0.0);
        let foot = passed.map_or(q, |(r, from, to)| mix(q, r, from / (from - to)));
        Side { to, foot, gap: length(sub(foot, p)), bridged: false }
    }

    /// Finds the gaps that a surface bridges.
    fn bridge(&mut self) {
        let bridged = |near: &mut Walk, s: &Stretch| {
            if !s.sound {
                return [false; 2];
            }
            let widest = WIDER * self.usual_gap(s, near);
            [0, 1].map(|side| s.sides[side].gap <= widest && self.goes_on(s, side))
        };
        let all: Vec<[bool; 2]> = self.stretches.par_iter().map_init(Walk::default, bridged).collect();
        for (stretch, bridged) in self.stretches.iter_mut().zip(all) {
            stretch.sides.iter_mut().zip(bridged).for_each(|(side, bridged)| side.bridged = bridged);
        }
    }

    /// The gap that half of those about a sound stretch are narrower than.
    fn usual_gap(&self, of: &Stretch, near: &mut Walk) -> f32 {
        self.tree.nearest_next(self.place(of), NEAR, near);
        let sound = near.found.iter().filter_map(|n| self.stretch(n.index)).filter(|s| s.sound);
        let (mut gaps, mut count) = ([of.gap(); NEAR], 0);
        for s in sound {
            gaps[count] = s.gap();
            count += 1;
        }
        median(&mut gaps[..count.max(1)])
    }

    /// Whether the lines on both sides of a gap run side by side and are of one surface.
    fn goes_on(&self, from: &Stretch, side: usize) -> bool {
        let Some((other, back)) = self.opposite(from, side) else { return false };
        if !other.sound || dot(from.along, other.along).abs() <= PARALLEL {
            return false;
        }
        let bridge = self.across(from, side);
        let before = from.sides[1 - side].exists().then(|| self.across(from, 1 - side).map(|c| -c));
        let after = other.sides[1 - back].exists().then(|| self.across(other, 1 - back));
        let turns = [before, after].map(|gap| gap.map_or(1.0, |gap| cosine(gap, bridge)));
        let step = |before, after| cosine(before, after) > STEP && turns.iter().all(|turn| *turn < STEP);
        turns.iter().all(|turn| *turn >= SHARPEST)
            && !before.zip(after).is_some_and(|(before, after)| step(before, after))
    }

    /// Finds the lines that are a surface.
    fn weave(&mut self) {
        let certain: Vec<bool> = self.stretches.par_iter().map(|s| self.is_certain(s)).collect();
        let woven = self.in_company(&certain, |s| s.sound);
        self.stretches.iter_mut().zip(woven).for_each(|(stretch, woven)| stretch.woven = woven);
    }

    /// Which of the stretches `of` a kind have enough about them that are `certain`.
    fn in_company(&self, certain: &[bool], of: impl Fn(&Stretch) -> bool + Sync) -> Vec<bool> {
        let in_company = |near: &mut Walk, s: &Stretch| {
            if !of(s) {
                return false;
            }
            self.tree.nearest_next(self.place(s), COMPANY, near);
            let places = near.found.iter().map(|n| self.at[n.index as usize] as usize);
            let count = places.filter(|&place| certain.get(place) == Some(&true)).count();
            count as f32 > SHARE * COMPANY as f32
        };
        self.stretches.par_iter().map_init(Walk::default, in_company).collect()
    }

    /// Whether a line is one of [`RUN`] or more, one after the other.
    fn is_certain(&self, of: &Stretch) -> bool {
        of.certain && of.sound && 1 + self.run(of, 0) + self.run(of, 1) >= RUN
    }

    /// How many lines follow on one side, up to what is needed.
    fn run(&self, of: &Stretch, mut side: usize) -> usize {
        let (mut from, mut count) = (of, 0);
        while count + 1 < RUN && from.sides[side].bridged {
            let Some((other, back)) = self.opposite(from, side) else { break };
            (from, side) = (other, 1 - back);
            count += 1;
        }
        count
    }
}

impl Stretch {
    /// The narrower of both gaps.
    fn gap(&self) -> f32 {
        self.sides[0].gap.min(self.sides[1].gap)
    }
}

impl Side {
    fn none() -> Self {
        Self { to: NONE, foot: [0.0; 3], gap: f32::INFINITY, bridged: false }
    }

    fn exists(&self) -> bool {
        self.to != NONE
    }
}

/// All points that may lie on a line.
fn stretches(points: &[Point], tree: &KdTree) -> Vec<Stretch> {
    let links = links(points, tree);
    let stretch = |walk: &mut Walk, &i: &u32| {
        tree.nearest_next(points[i as usize], NEAR, walk);
        let near: [u32; NEAR] = std::array::from_fn(|k| walk.found[k].index);
        stretch(points, &links, i, &near)
    };
    tree.order().par_iter().map_init(Walk::default, stretch).flatten_iter().collect()
}

/// For each point the two nearest others.
fn links(points: &[Point], tree: &KdTree) -> Vec<[u32; 2]> {
    let find = |walk: &mut Walk, i: u32| {
        tree.nearest_next(points[i as usize], 3, walk);
        // Where squared distances vanish in `f32`, the point itself need not come first.
        let mut others = walk.found.iter().map(|n| n.index).filter(|&j| j != i);
        std::array::from_fn(|_| others.next().unwrap_or(i))
    };
    indices(points.len()).into_par_iter().map_init(Walk::default, find).collect()
}

/// A point, of which these are the nearest, on its line.
fn stretch(points: &[Point], links: &[[u32; 2]], i: u32, near: &[u32]) -> Option<Stretch> {
    let offsets = |near: &[u32]| -> Vec<Point> {
        let of = |&j: &u32| links[j as usize].map(|k| sub(points[k as usize], points[j as usize]));
        near.iter().flat_map(of).collect()
    };
    let all = offsets(near);
    let units = |offsets: &[Point]| common_axis(offsets.iter().copied().map(unit));
    if units(&all[..2 * NEAREST]).0 <= ALONG {
        return None;
    }
    let (share, along) = units(&all);
    let spacing = median(&mut all.iter().map(|o| length(*o)).collect::<Vec<f32>>());
    Some(Stretch {
        point: i,
        along,
        certain: share > CERTAIN,
        spacing,
        followers: [NONE; 2],
        sides: [Side::none(); 2],
        sound: false,
        woven: false,
    })
}

/// What lies along a line and beside it, seen from one of its points.
struct Beside<'a> {
    points: &'a [Point],
    tree: &'a KdTree,
    at: Point,
    along: Point,
    spacing: f32,
}

impl Beside<'_> {
    /// The next point of the line, one way or the other, or [`NONE`].
    fn follower(&self, way: f32) -> u32 {
        self.nearest(FOLLOWS, |offset| way * dot(offset, self.along) > AHEAD * length(offset))
    }

    /// The nearest points on both sides of the line, or [`NONE`].
    fn sides(&self) -> [u32; 2] {
        let off = |offset: Point| {
            let ahead = dot(offset, self.along);
            let off: Point = std::array::from_fn(|a| offset[a] - ahead * self.along[a]);
            let reach = length(off);
            (reach > 0.0 && ahead.abs() <= BESIDE * reach).then_some((off, reach))
        };
        let one = self.nearest(MOST, |offset| off(offset).is_some());
        let Some((towards, reach)) = self.points.get(one as usize).and_then(|q| off(sub(*q, self.at))) else {
            return [NONE; 2];
        };
        let opposite = |(off, far): (Point, f32)| dot(off, towards) < -OPPOSITE * far * reach;
        let other = AS_FAR * length(sub(self.points[one as usize], self.at)) / self.spacing;
        [one, self.nearest(other.min(MOST), |offset| off(offset).is_some_and(opposite))]
    }

    /// The nearest point whose offset is `accepted`, within so many spacings, or [`NONE`].
    fn nearest(&self, reach: f32, accepted: impl Fn(Point) -> bool) -> u32 {
        let accepted = |j: u32| accepted(sub(self.points[j as usize], self.at));
        self.tree.nearest_that(self.at, reach * self.spacing, accepted).map_or(NONE, |n| n.index)
    }
}

fn median(values: &mut [f32]) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::{Rng, farthest_point_sampling};

    /// So many lines one apart, each of so many points, of which so many are as long as a gap is wide.
    fn scanned(lines: usize, each: usize, dense: f32, height: impl Fn(f32) -> f32) -> Vec<Point> {
        let mut random = Rng::new(7);
        let mut points = Vec::new();
        for line in 0..lines {
            let phase = random.f64() as f32;
            let x = |k: usize, random: &mut Rng| (k as f32 + phase + 0.3 * random.f64() as f32) / dense;
            let y = line as f32;
            points.extend((0..each).map(|k| [x(k, &mut random), y, height(y)]));
        }
        points
    }

    fn share_woven(points: &[Point]) -> f32 {
        let Some(lines) = Lines::of(points) else { return 0.0 };
        indices(points.len()).filter(|&i| lines.is_woven(i)).count() as f32 / points.len() as f32
    }

    /// The bridges by the heights at their ends.
    fn bridges(points: &[Point]) -> Vec<[f32; 2]> {
        let lines = Lines::of(points).expect("lines");
        let woven = lines.stretches.iter().filter(|s| s.woven);
        let of = |s: &Stretch| {
            let from = lines.place(s)[2];
            s.sides.iter().filter(|side| side.bridged).map(|side| [from, side.foot[2]]).collect::<Vec<_>>()
        };
        woven.flat_map(of).collect()
    }

    #[test]
    fn lines_are_found_however_dense_they_are() {
        for (lines, each, dense) in [(40, 100, 2.0), (20, 200, 4.0), (12, 400, 30.0), (8, 2000, 1500.0)] {
            let points = scanned(lines, each, dense, |_| 0.0);
            let share = share_woven(&points);
            assert!(share > 0.97, "{share} at {dense} points a gap");
            // Each point is bridged to both sides, those of the outermost lines to one, but for ends of lines.
            let most = 2 * points.len() - 2 * each;
            let count = bridges(&points).len();
            assert!((most * 9 / 10..=most).contains(&count), "{count} of {most} at {dense}");
        }
    }

    #[test]
    fn surfaces_that_were_sampled_in_other_ways_have_none() {
        for seed in 0..4 {
            let mut random = Rng::new(seed);
            let mut square = |n: usize, rough: f32| -> Vec<Point> {
                (0..n)
                    .map(|_| [random.f64() as f32, random.f64() as f32, rough * random.normal() as f32])
                    .collect()
            };
            let (random, rough, volume) = (square(2000, 0.0), square(2000, 0.03), square(2000, 1.0));
            let many = square(16_000, 0.0);
            let even: Vec<Point> =
                farthest_point_sampling(&many, 2000, 0).iter().map(|&i| many[i as usize]).collect();
            let grid: Vec<Point> = (0..2500).map(|i| [(i % 50) as f32, (i / 50) as f32, 0.0]).collect();
            for (name, points) in
                [("random", random), ("rough", rough), ("volume", volume), ("even", even), ("grid", grid)]
            {
                assert!(Lines::of(&points).is_none(), "{name}, seed {seed}");
            }
        }
    }

    #[test]
    fn a_few_wires_are_no_surface() {
        for wires in 1..RUN {
            assert!(Lines::of(&scanned(wires, 500, 10.0, |_| 0.0)).is_none(), "{wires} wires");
        }
        // The edge of a blade: two rows, and a surface that ends there.
        let mut blade = scanned(2, 400, 4.0, |_| 0.0);
        let mut random = Rng::new(3);
        blade.extend((0..4000).map(|_| [100.0 * random.f64() as f32, 0.5, -3.0 * random.f64() as f32]));
        assert!(Lines::of(&blade).is_none());
    }

    #[test]
    fn what_climbs_a_step_or_crosses_a_wide_gap_is_open() {
        let step = |height: f32| bridges(&scanned(16, 200, 8.0, |y| if y > 7.5 { height } else { 0.0 }));
        for height in [0.7, 1.0, 2.0, 30.0] {
            let found = step(height);
            assert!(found.len() > 4000, "{} at {height}", found.len());
            assert!(found.iter().all(|[from, to]| from == to), "{height}");
        }
        // A slope goes on, and a bend of half a right angle.
        let slope = bridges(&scanned(16, 200, 8.0, |y| 2.0 * y));
        assert!(slope.len() > 5000, "{}", slope.len());
        let roof = bridges(&scanned(16, 200, 8.0, |y| (y - 7.0).max(0.0)));
        assert!(roof.iter().any(|[from, to]| *from == 0.0 && *to == 1.0));
        // Two floors, further apart than a few gaps.
        let mut floors = scanned(8, 200, 8.0, |_| 0.0);
        floors.extend(scanned(8, 200, 8.0, |_| 0.0).iter().map(|p| [p[0], p[1] + 11.5, 0.0]));
        let lines = Lines::of(&floors).expect("lines");
        let across = lines.stretches.iter().flat_map(|s| s.sides.iter().filter(|side| side.bridged));
        assert!(across.clone().count() > 5000);
        assert!(across.map(|side| side.gap).fold(0.0, f32::max) < 2.0);
    }

    #[test]
    fn a_bridge_goes_straight_across() {
        let points = scanned(10, 300, 12.0, |_| 0.0);
        let lines = Lines::of(&points).expect("lines");
        for stretch in lines.stretches.iter().filter(|s| s.woven) {
            for side in stretch.sides.iter().filter(|side| side.bridged) {
                let off = sub(side.foot, lines.place(stretch));
                assert!((off[1].abs() - 1.0).abs() < 1e-4, "{off:?}");
                // Past the end of a line its last point has to do.
                assert!(off[0].abs() < 0.2, "{off:?}");
            }
        }
    }
}
