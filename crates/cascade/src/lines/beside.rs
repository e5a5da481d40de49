//! The neighbours of a point along its line and beside it.

use super::stretch::NONE;
use crate::vector::{dot, length, sub};
use densecloud_cloud::Point;
use densecloud_geometry::KdTree;

/// The next line is nearer than this, in the spacing along the line.
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

/// What lies along a line and beside it, seen from one of its points.
pub(super) struct Beside<'a> {
    pub(super) points: &'a [Point],
    pub(super) tree: &'a KdTree,
    pub(super) at: Point,
    pub(super) along: Point,
    pub(super) spacing: f32,
}

impl Beside<'_> {
    /// The next point of the line, one way or the other, or [`NONE`].
    pub(super) fn follower(&self, way: f32) -> u32 {
        self.nearest(FOLLOWS, |offset| way * dot(offset, self.along) > AHEAD * length(offset))
    }

    /// The nearest points on both sides of the line, or [`NONE`].
    pub(super) fn sides(&self) -> [u32; 2] {
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
