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

mod beside;
mod stretch;

use rayon::prelude::*;

use crate::globals::nth;
use crate::vector::{cosine, dot, length, mix, sub};
use beside::Beside;
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Walk};
use stretch::{NEAR, NONE, Side, stretches};

pub(super) use stretch::Stretch;

/// The next line is further off than this, in the spacing along the line.
const LEAST: f32 = 1.5;
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

/// A cloud's lines.
pub(super) struct Lines<'a> {
    pub(super) points: &'a [Point],
    pub(super) tree: KdTree,
    /// For each point its stretch, or [`NONE`].
    at: Vec<u32>,
    stretches: Vec<Stretch>,
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
        let count = count.max(1);
        nth(&mut gaps[..count], count / 2)
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

#[cfg(test)]
mod tests;
