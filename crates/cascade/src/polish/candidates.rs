//! What a polish chooses from: the midpoints of a sample, and what of the input these fall short of.

use rayon::prelude::*;

use super::rings::{Ring, middle, midpoints, nearest_rings, surroundings};
use crate::CascadeError;
use crate::border::Borders;
use crate::globals::{PolishGlobals, once};
use crate::measured::Measured;
use crate::part::Within;
use crate::share::Neighbourhoods;
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Neighbour, Reach, Walk, cell_area, indices};

/// A noisy input point further than this from every midpoint, in its own spacing, is a tip that they
/// fall short of. A clean one is a candidate wherever it lies: no midpoint is as exact.
const SHORT: f32 = 0.5;
/// Points of the sample around an input point whose midpoints are compared with it.
const AROUND: usize = 16;
/// How far the surface is taken to reach beyond the points that the units made, in the input's spacing, if they are as
/// many as the input's; it shrinks as they become denser.
const REACH: f32 = 0.9;
/// Points that the units made lie in one sheet if they are no further from its tangent plane than this, in the input's
/// spacing.
const FLAT: f32 = 0.2;

/// What the result is chosen from.
pub(super) struct Candidates {
    /// Midpoints of the sample, and the input points that they fall short of: the more of these, the more the input is
    /// trusted.
    pub(super) points: Vec<Point>,
    /// For each the spacing of the input there; none where the whole is to be equally dense.
    pub(super) local: Option<Vec<f32>>,
    /// For each input point, the area of the surface that is nearest to it; where a local spacing is given, in squares of
    /// that.
    pub(super) areas: Vec<f32>,
}

impl Candidates {
    /// Keeps those that a part may choose.
    pub(super) fn keep_wanted(&mut self, part: &Within<'_>) -> Result<(), CascadeError> {
        let spacing = self.local.as_deref();
        let wanted: Vec<bool> = self
            .points
            .par_iter()
            .enumerate()
            .map(|(i, p)| part.may_choose(*p, spacing.map(|s| s[i])))
            .collect();
        let mut of = wanted.iter();
        self.points.retain(|_| *of.next().expect("one each"));
        if let Some(local) = &mut self.local {
            let mut of = wanted.iter();
            local.retain(|_| *of.next().expect("one each"));
        }
        part.suffices(self.points.len())
    }

    pub(super) fn of(
        sample: Sample<'_>,
        size: usize,
        Surface { input, borders, trust }: Surface<'_>,
        neighbourhoods: Option<Neighbourhoods>,
        globals: &mut PolishGlobals,
    ) -> Self {
        let Sample { tree, points: made, nearest } = sample;
        let density = once(&mut globals.input_a_sample, || input.points.len() as f32 / made.len() as f32);
        let reach = REACH * density.sqrt();
        let cell = |i: usize, near: &[Neighbour], normal| {
            let nearest = nearest[i];
            let spacing = input.spacing[nearest as usize];
            let radius = reach * spacing;
            let reach = Reach { radius, past: borders.past(nearest) * radius, flat: FLAT * spacing };
            cell_area(made, i, near, normal, reach)
        };
        let (rings, cells) = surroundings(tree, made, cell);
        let mut areas = vec![0.0; input.points.len()];
        nearest.iter().zip(&cells).for_each(|(&nearest, area)| areas[nearest as usize] += area);
        drop(cells);
        let local = neighbourhoods.map(|n| n.spacing_of(&areas, &mut globals.usual_point));
        if let Some(local) = &local {
            areas.iter_mut().zip(local).for_each(|(area, spacing)| *area /= spacing * spacing);
        }
        let of_sample =
            local.as_ref().map(|local| nearest.iter().map(|&i| local[i as usize]).collect::<Vec<_>>());
        let (mut points, mut spacings) = midpoints(made, &rings, of_sample.as_deref());
        let midpoints_made = once(&mut globals.midpoints, || points.len());
        let reached_by = if midpoints_made < size { ReachedBy::SampleToo } else { ReachedBy::Midpoints };
        if reached_by == ReachedBy::SampleToo {
            points.extend_from_slice(made);
            spacings.extend(of_sample.iter().flatten());
        }
        let short = SHORT * (1.0 - trust);
        for i in fallen_short_of(sample, &rings, reached_by, input, short) {
            points.push(input.points[i as usize]);
            spacings.extend(local.as_ref().map(|local| local[i as usize]));
        }
        if points.len() < size {
            // All is rough: whatever lies between neighbours, which is at least 3.5 times the sample.
            let (more, their) = midpoints(made, &nearest_rings(tree, made), of_sample.as_deref());
            points.extend(more);
            spacings.extend(their);
        }
        Self { points, local: local.map(|_| spacings), areas }
    }
}

/// A sample of what the unit made.
#[derive(Clone, Copy)]
pub(super) struct Sample<'a> {
    /// Built from the points.
    pub(super) tree: &'a KdTree,
    pub(super) points: &'a [Point],
    /// For each the nearest input point.
    pub(super) nearest: &'a [u32],
}

/// What the input tells of the surface.
#[derive(Clone, Copy)]
pub(super) struct Surface<'a> {
    pub(super) input: &'a Measured,
    pub(super) borders: &'a Borders,
    /// How clean the input is, from 0 to 1.
    pub(super) trust: f32,
}

/// The candidates that may come near an input point.
#[derive(Clone, Copy, PartialEq, Eq)]
enum ReachedBy {
    /// Midpoints alone.
    Midpoints,
    /// Midpoints, and the points of the sample, which are candidates, too.
    SampleToo,
}

/// The input points that no candidate comes nearer to than `short` of their spacing: what was measured must not vanish.
/// Looks at the candidates around the nearest points of the sample only.
fn fallen_short_of(
    Sample { tree, points, .. }: Sample<'_>,
    rings: &[Ring],
    by: ReachedBy,
    input: &Measured,
    short: f32,
) -> Vec<u32> {
    let far = |walk: &mut Walk, ((p, spacing), i): ((&Point, &f32), u32)| {
        let limit = (short * spacing).powi(2);
        let near = |q: Point| (0..3).map(|a| (q[a] - p[a]).powi(2)).sum::<f32>() <= limit;
        tree.nearest_next(*p, AROUND, walk);
        let reached = walk.found.iter().any(|n| {
            let q = points[n.index as usize];
            by == ReachedBy::SampleToo && near(q)
                || rings[n.index as usize].others().iter().any(|&j| near(middle(q, points[j as usize])))
        });
        (!reached).then_some(i)
    };
    let all = input.points.par_iter().zip(&input.spacing).zip(indices(input.points.len()).into_par_iter());
    all.map_init(Walk::default, far).flatten_iter().collect()
}
