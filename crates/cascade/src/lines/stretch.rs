//! Points that may lie on a line, each told by those about it.

use rayon::prelude::*;

use crate::globals::nth;
use crate::vector::{length, sub, unit};
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Walk, common_axis, indices};

/// Points whose nearest two tell the direction of a line, and of how many of them it may be less clear.
pub(super) const NEAR: usize = 16;
const NEAREST: usize = 8;
/// The share of those directions along the line, by the nearest ones, and by all where a line is certain. Without lines
/// it is about 0.5, below 0.7 for 99 in 100 points of a random sample, and 0.85 to 1 on lines.
const ALONG: f64 = 0.6;
const CERTAIN: f64 = 0.7;

/// No point.
pub(super) const NONE: u32 = u32::MAX;

/// A point that may lie on a line.
#[derive(Clone)]
pub(crate) struct Stretch {
    pub(crate) point: u32,
    /// The line's direction, of unit length; either of the two.
    pub(super) along: Point,
    pub(super) certain: bool,
    /// The usual distance between the points of the line.
    pub(crate) spacing: f32,
    /// The next points of the line, or [`NONE`].
    pub(super) followers: [u32; 2],
    pub(crate) sides: [Side; 2],
    /// Whether a gap is as wide as between lines.
    pub(super) sound: bool,
    /// Whether the line and those beside it are a surface.
    pub(super) woven: bool,
}

/// The next line on one side.
#[derive(Clone, Copy)]
pub(crate) struct Side {
    /// The nearest point on that side, or [`NONE`].
    pub(super) to: u32,
    /// The place on that line right beside.
    pub(crate) foot: Point,
    /// How far off it is; infinite where there is none.
    pub(super) gap: f32,
    pub(crate) bridged: bool,
}

impl Stretch {
    /// The narrower of both gaps.
    pub(super) fn gap(&self) -> f32 {
        self.sides[0].gap.min(self.sides[1].gap)
    }
}

impl Side {
    pub(super) fn none() -> Self {
        Self { to: NONE, foot: [0.0; 3], gap: f32::INFINITY, bridged: false }
    }

    pub(super) fn exists(&self) -> bool {
        self.to != NONE
    }
}

/// All points that may lie on a line.
pub(super) fn stretches(points: &[Point], tree: &KdTree) -> Vec<Stretch> {
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
    let mut lengths: Vec<f32> = all.iter().map(|o| length(*o)).collect();
    let spacing = nth(&mut lengths, all.len() / 2);
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
