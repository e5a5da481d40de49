//! How dense the whole is, coarsely: what a part cannot see beyond its halo.

use super::darts::number;
use crate::share::{COARSER, REGION, coarse_logarithms};
use crate::{CascadeError, filled};
use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Walk};
use rayon::prelude::*;

/// Points of the field that tell what is usual about a point.
const NEAREST: usize = 4;

/// The density about some points that are spread over the whole in proportion to its own.
#[derive(Debug, Clone)]
pub(crate) struct Field {
    points: Vec<Point>,
    /// The logarithm of the area that a point has about each of these, beside what is usual in the whole.
    relative: Vec<f32>,
    tree: KdTree,
}

impl PartialEq for Field {
    fn eq(&self, other: &Self) -> bool {
        self.points == other.points && self.relative == other.relative
    }
}

impl Field {
    /// The field of a `sample`, and the logarithm of the area that a point of it usually has. None where it is no larger
    /// than a neighbourhood. O(n log n).
    pub(super) fn of(sample: &[Point]) -> Result<Option<(Self, f32)>, CascadeError> {
        if sample.len() < REGION {
            return Ok(None);
        }
        let (logarithms, usual) = coarse_logarithms(sample)?;
        let relative = logarithms.iter().map(|l| l - usual).collect();
        Ok(Some((Self::from_parts(sample.to_vec(), relative), usual)))
    }

    pub(super) fn from_parts(points: Vec<Point>, relative: Vec<f32>) -> Self {
        Self { tree: KdTree::new(&points), points, relative }
    }

    pub(super) fn parts(&self) -> (&[Point], &[f32]) {
        (&self.points, &self.relative)
    }

    /// The field at each of `points`.
    pub(crate) fn at(&self, points: &[Point]) -> Result<Vec<f32>, CascadeError> {
        let mut found = filled(0.0, points.len())?;
        found.par_iter_mut().zip(points).for_each_init(Walk::default, |walk, (at, p)| {
            self.tree.nearest_next(*p, NEAREST, walk);
            let sum: f32 = walk.found.iter().map(|n| self.relative[n.index as usize]).sum();
            *at = sum / walk.found.len() as f32;
        });
        Ok(found)
    }
}

/// Whether a point stands for those around it on the coarser scale of a part: the same points do in every part that has
/// them.
pub(crate) fn stands_for_others(p: Point) -> bool {
    number(p).is_multiple_of(COARSER as u64)
}
