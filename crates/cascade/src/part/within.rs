//! What of a part's results is wanted: the points of its cell, those along the border by the common rule.

use std::borrow::Cow;
use std::collections::HashSet;

use super::Part;
use super::darts::{BAND, Dart, Sparing, darts};
use crate::CascadeError;
use crate::apart::joined;
use crate::globals::Globals;
use crate::strays::Kept;
use densecloud_cloud::{Frame, Point};
use densecloud_geometry::{KdTree, Partition, farthest_point_sampling_beside};
use rayon::prelude::*;

/// The radius of darts, in the spacing of the result: so they are as dense as what farthest point sampling chooses.
const RADIUS: f32 = 0.84;
/// Other points lie no nearer to the border than this many radii: those of the other side do not either.
const CLEAR: f32 = 0.5;
/// Between darts other points find less room than among themselves: at equal distances they would be denser, so they are
/// chosen this much further apart, as a share; within so many radii of the darts that fades out.
const WIDER: f32 = 0.12;
const FADES: f32 = 2.0;
/// The radius of a patch, in the spacing of its points, and some.
const PATCH: f32 = 12.0;
/// Points that a patch sees as neighbours must be right to this depth, in the same unit.
const AROUND: f32 = 8.0;
/// What the last step looks at around a point, in the spacing of the input.
const POLISHED: f32 = 4.0;
/// The mean distance to the eight nearest others, where points are even, in the root of the area that each has.
const EIGHT: f32 = 1.2;

/// How far beyond its cell the input of a level is needed, in the spacing of the cascade's input. `level` may be one past
/// the last: what comes out of that.
pub(super) fn margin(level: usize, levels: usize) -> f32 {
    let spacing = |level: usize| 0.5_f32.powi(level as i32).sqrt();
    match levels - level {
        0 => POLISHED,
        1 => POLISHED + PATCH * spacing(level),
        _ => margin(level + 1, levels) + AROUND * spacing(level),
    }
}

/// A part's cell, and the points of the result that are settled along its border.
pub(crate) struct Within<'a> {
    partition: &'a Partition,
    cell: u32,
    frame: Frame,
    levels: usize,
    ratio: f64,
    sparing: Sparing,
    /// The spacing of the input where all of the result is to be equally dense.
    usual: f32,
    /// Points of the result in the cell.
    size: usize,
    /// Darts in the cell.
    inside: Vec<Point>,
    /// Darts just outside.
    outside: Vec<Point>,
}

impl<'a> Within<'a> {
    /// `size` points are wanted in the cell, `ratio` for each of its points. `input`: all points of the part, and the spacing
    /// at each, where the result is not to be equally dense.
    pub(super) fn new(
        part: &Part<'a>,
        globals: &Globals,
        ratio: f64,
        size: usize,
        (points, local): (&[Point], Option<&[f32]>),
    ) -> Self {
        let usual = (0.5 * globals.usual_point.unwrap_or_default()).exp();
        let even = || vec![usual; points.len()];
        let spacing = local.map_or_else(|| Cow::Owned(even()), Cow::Borrowed);
        let sparing = Sparing { ratio: part.whole.ratio(), radius: RADIUS };
        let mut within = Self {
            partition: part.partition,
            cell: part.cell,
            frame: globals.frame,
            levels: part.whole.levels(),
            ratio,
            sparing,
            usual,
            size,
            inside: Vec::new(),
            outside: Vec::new(),
        };
        let border = |p: Point| within.border(p);
        let found = darts(points, &spacing, sparing, &border);
        let near = |dart: &Dart| within.distance(dart.at) <= 2.0 * BAND * sparing.radius_at(dart.spacing);
        let (inside, outside): (Vec<Dart>, Vec<Dart>) =
            found.into_iter().filter(near).partition(|dart| within.belongs(dart.at));
        within.inside = inside.iter().map(|dart| dart.at).take(size).collect();
        within.outside = outside.iter().map(|dart| dart.at).collect();
        within
    }

    pub(crate) fn belongs(&self, p: Point) -> bool {
        self.partition.cell_of(self.frame.to_world(p)) == self.cell
    }

    /// How far a point is from the border of the cell that it is in.
    fn border(&self, p: Point) -> f32 {
        (self.partition.border_distance(self.frame.to_world(p)) / self.frame.scale()) as f32
    }

    /// How far a point is from the part's cell.
    fn distance(&self, p: Point) -> f32 {
        (self.partition.distance(self.cell, self.frame.to_world(p)) / self.frame.scale()) as f32
    }

    /// Points after a level whose input has `points`.
    pub(crate) fn size_of_level(&self, points: usize, level: usize, last: bool) -> usize {
        if last {
            (self.ratio * points as f64 / 2_f64.powi(level as i32)).round() as usize
        } else {
            2 * points
        }
    }

    /// Points of the result that are not settled.
    pub(crate) fn unsettled(&self) -> usize {
        self.size - self.inside.len()
    }

    /// The darts: those in the cell, then those outside.
    pub(crate) fn settled(&self) -> Vec<Point> {
        [self.inside.as_slice(), &self.outside].concat()
    }

    /// The darts in the cell.
    pub(crate) fn settled_inside(&self) -> &[Point] {
        &self.inside
    }

    /// Leaves what a level needs; `spacing`: of the input, as a mean distance to the nearest others.
    pub(crate) fn trim(&self, kept: &mut Kept, spacing: &[f32], level: usize) {
        let mut all: Vec<u32> = (0..kept.points.len() as u32).collect();
        self.keep_near(&mut all, kept, spacing, level);
        kept.points = all.iter().map(|&i| kept.points[i as usize]).collect();
        kept.nearest = all.iter().map(|&i| kept.nearest[i as usize]).collect();
    }

    /// As [`trim`](Self::trim), for indices of the points.
    pub(crate) fn keep_near(&self, indices: &mut Vec<u32>, merged: &Kept, spacing: &[f32], level: usize) {
        let margin = margin(level, self.levels) / EIGHT;
        let is_near = |&i: &u32| {
            let spacing = spacing[merged.nearest[i as usize] as usize];
            self.distance(merged.points[i as usize]) <= margin * spacing
        };
        let near: Vec<bool> = indices.par_iter().map(is_near).collect();
        let mut of = near.into_iter();
        indices.retain(|_| of.next().expect("one each"));
    }

    /// Whether a point may be chosen beside the darts, where the input has this spacing.
    pub(crate) fn may_choose(&self, p: Point, spacing: Option<f32>) -> bool {
        self.belongs(p) && self.border(p) >= CLEAR * self.sparing.radius_at(spacing.unwrap_or(self.usual))
    }

    /// Farthest point sampling of `points`, all of which may be chosen, beside the darts where they have come to lie.
    pub(crate) fn sample(
        &self,
        points: &[Point],
        local: Option<&[f32]>,
        count: usize,
        settled: &[Point],
    ) -> Vec<u32> {
        let spacing = |(i, p): (usize, &Point)| {
            let spacing = local.map_or(self.usual, |local| local[i]);
            let radii = self.border(*p) / self.sparing.radius_at(spacing);
            let near = ((BAND + FADES - radii) / FADES).clamp(0.0, 1.0);
            spacing * (1.0 + WIDER * near)
        };
        let spacing: Vec<f32> = points.par_iter().enumerate().map(spacing).collect();
        farthest_point_sampling_beside(points, &spacing, count, settled)
    }

    /// Whether so many candidates are enough.
    pub(crate) fn suffices(&self, candidates: usize) -> Result<(), CascadeError> {
        room(candidates, self.unsettled())
    }

    /// The result: `chosen` points with the darts of the cell strewn among them; and the darts outside. `settled`: all darts,
    /// where they have come to lie.
    pub(crate) fn joined(&self, chosen: Vec<Point>, mut settled: Vec<Point>) -> (Vec<Point>, Vec<Point>) {
        let outside = settled.split_off(self.inside.len());
        (joined(chosen, &settled), outside)
    }

    /// Chooses the result among what the last unit made: the points nearest to the darts, and others beside them.
    pub(crate) fn choose(
        &self,
        made: &[Point],
        local: Option<Vec<f32>>,
    ) -> Result<(Vec<Point>, Vec<Point>), CascadeError> {
        let tree = KdTree::new(made);
        let (mut taken, mut inside, mut outside) = (HashSet::new(), Vec::new(), Vec::new());
        for (i, dart) in self.inside.iter().chain(&self.outside).enumerate() {
            let nearest = tree.nearest_one(*dart).map(|n| n.index).filter(|i| taken.insert(*i));
            let snapped = nearest.map(|i| made[i as usize]);
            if i < self.inside.len() { inside.extend(snapped) } else { outside.extend(snapped) }
        }
        let free = |i: &usize| {
            !taken.contains(&(*i as u32)) && self.may_choose(made[*i], local.as_ref().map(|l| l[*i]))
        };
        let free: Vec<usize> = (0..made.len()).filter(free).collect();
        let missing = self.size - inside.len();
        room(free.len(), missing)?;
        let points: Vec<Point> = free.iter().map(|&i| made[i]).collect();
        let local: Option<Vec<f32>> = local.map(|local| free.iter().map(|&i| local[i]).collect());
        let settled = [inside.as_slice(), &outside].concat();
        let chosen = self.sample(&points, local.as_deref(), missing, &settled);
        Ok((joined(chosen.iter().map(|&i| points[i as usize]).collect(), &inside), outside))
    }
}

fn room(places: usize, wanted: usize) -> Result<(), CascadeError> {
    if places < wanted { Err(CascadeError::NoRoom { places, wanted }) } else { Ok(()) }
}
