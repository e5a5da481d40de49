//! The cascade's input: new points are measured against it.

use std::ops::Deref;
use std::sync::Arc;

use rayon::prelude::*;

use super::border::Borders;
use super::globals::Globals;
use super::runner::MadePoint;
use super::share::Neighbourhoods;
use super::sites::{AROUND, Sites, mean_distance};
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Neighbour, Walk};

/// New points are measured against this: the cascade's input, and where its surface ends.
pub(super) struct Reference {
    pub(super) input: Measured,
    pub(super) borders: Borders,
    /// How dense the input is about each of its points; none where the whole is to be equally dense.
    pub(super) neighbourhoods: Option<Neighbourhoods>,
}

impl Reference {
    pub(super) fn new(
        input: Measured,
        neighbourhoods: Option<Neighbourhoods>,
        globals: &mut Globals,
    ) -> Self {
        let borders = Borders::of(&input, &mut globals.evenness);
        Self { input, borders, neighbourhoods }
    }

    /// The local spacing at the input points `nearest` to others; none where the whole is to be equally dense.
    pub(super) fn local(&self, nearest: &[u32]) -> Option<Vec<f32>> {
        self.neighbourhoods.as_ref().map(|of| of.spacing_at(nearest))
    }
}

/// The cascade's input, its points with their surroundings.
///
/// A limit on displacement alone lets strays through: a stray is far from everything, so the next
/// level grants it a wide spacing and lets its copies stray further.
pub(super) struct Measured {
    pub(super) sites: Arc<Sites>,
    /// One row for each point: see [`Measured::around`].
    neighbours: Vec<u32>,
}

impl Deref for Measured {
    type Target = Sites;

    fn deref(&self) -> &Sites {
        &self.sites
    }
}

impl Measured {
    /// Puts the points into the order of their tree: neighbours in space are neighbours in memory. O(n log n).
    pub(super) fn of(points: &[Point]) -> Self {
        let (tree, points) = KdTree::in_order(points);
        let row = AROUND.min(points.len().saturating_sub(1));
        let (mut neighbours, mut spacing) = (vec![0; row * points.len()], vec![f32::NAN; points.len()]);
        if row > 0 {
            let find = |walk: &mut Walk, ((i, row), spacing): ((usize, &mut [u32]), &mut f32)| {
                tree.nearest_next(points[i], row.len() + 1, walk);
                // Of points that coincide, the point itself need not come first.
                let others = walk.found.iter().map(|n| n.index).filter(|&j| j as usize != i);
                row.iter_mut().zip(others).for_each(|(place, j)| *place = j);
                *spacing = mean_distance(walk);
            };
            let rows = neighbours.par_chunks_exact_mut(row).enumerate();
            rows.zip(&mut spacing).for_each_init(Walk::default, find);
        }
        Self { sites: Arc::new(Sites { points, tree, spacing }), neighbours }
    }

    /// As [`Self::of`], as if the points had this `spacing`.
    #[cfg(test)]
    pub(super) fn new(points: &[Point], spacing: f32) -> Self {
        let Self { sites, neighbours } = Self::of(points);
        let mut sites = Arc::into_inner(sites).expect("the only one");
        sites.spacing.fill(spacing);
        Self { sites: Arc::new(sites), neighbours }
    }

    /// An input point's nearest others, nearest first; fewer than [`AROUND`] where there are no more.
    pub(super) fn around(&self, i: u32) -> &[u32] {
        let row = self.neighbours.len() / self.points.len();
        &self.neighbours[i as usize * row..][..row]
    }

    /// How far `p` lies beyond the input points nearest to it, seen from their centroid, in the spacing of
    /// `i`, the nearest: negative among them, positive past an open border or a tip. It is the lesser of two distances:
    /// beyond the points around `i`, which are known already and suffice where `p` is beyond by no more than is
    /// `allowed`; and beyond the points nearest to `p` itself, some of which lie on the far side of a wide gap.
    pub(super) fn beyond(&self, p: Point, i: u32, allowed: f32, found: &mut Vec<Neighbour>) -> f32 {
        let ring = [i].into_iter().chain(self.around(i).iter().copied());
        let beyond = self.beyond_all(p, ring) / self.spacing[i as usize];
        if beyond <= allowed {
            return beyond;
        }
        self.tree.nearest(p, AROUND, found);
        beyond.min(self.beyond_all(p, found.iter().map(|n| n.index)) / self.spacing[i as usize])
    }

    /// How far `p` lies beyond all of some input points, seen from their centroid.
    fn beyond_all(&self, p: Point, near: impl Iterator<Item = u32> + Clone) -> f32 {
        let near = near.map(|j| self.points[j as usize]);
        let (sum, count) = near.clone().fold(([0.0; 3], 0.0), |(sum, count): (Point, f32), q| {
            (std::array::from_fn(|a| sum[a] + q[a]), count + 1.0)
        });
        let outwards: Point = std::array::from_fn(|a| p[a] - sum[a] / count);
        let past = |q: Point| (0..3).map(|a| (p[a] - q[a]) * outwards[a]).sum::<f32>();
        let length = outwards.iter().map(|c| c * c).sum::<f32>().sqrt();
        near.map(past).fold(f32::INFINITY, f32::min) / length.max(f32::MIN_POSITIVE)
    }

    /// For each point its distance to the nearest input point, in that one's spacing, and that one; NaN
    /// where the point is not finite.
    pub(super) fn distances(&self, made: &[MadePoint]) -> Vec<(f32, u32)> {
        let measure = |walk: &mut Walk, m: &MadePoint| {
            if !m.at.iter().all(|c| c.is_finite()) {
                return (f32::NAN, 0);
            }
            self.tree.nearest_next(m.at, 1, walk);
            let distance = |n: &Neighbour| n.distance_squared.sqrt() / self.spacing[n.index as usize];
            walk.found.first().map_or((f32::NAN, 0), |n| (distance(n), n.index))
        };
        made.par_iter().map_init(Walk::default, measure).collect()
    }
}
