//! Where the points of a level take skip features from.

use rayon::prelude::*;

use crate::session::SKIP_NEIGHBOURS;
use crate::sites::Sites;
use crate::{CascadeError, filled};
use densecloud_cloud::Point;
use densecloud_geometry::Walk;

/// For each point of a level, its [`SKIP_NEIGHBOURS`] nearest points of the previous level's input.
#[derive(Debug)]
pub struct SkipNeighbours {
    /// `[n, 5]` rows of the previous feature table.
    rows: Vec<u32>,
    /// `[n, 5]` squared distances.
    distances: Vec<f32>,
}

impl SkipNeighbours {
    /// Finds them for each of `points`; `previous_rows` holds the row of each of `previous`. O(n log n).
    pub(crate) fn find(
        previous: &Sites,
        previous_rows: &[u32],
        points: &[Point],
    ) -> Result<Self, CascadeError> {
        let mut rows = filled(0, points.len() * SKIP_NEIGHBOURS)?;
        let mut distances = filled(0.0, points.len() * SKIP_NEIGHBOURS)?;
        rows.par_chunks_exact_mut(SKIP_NEIGHBOURS)
            .zip(distances.par_chunks_exact_mut(SKIP_NEIGHBOURS))
            .zip(points)
            .for_each_init(Walk::default, |walk, ((rows, distances), &point)| {
                previous.tree.nearest_next(point, SKIP_NEIGHBOURS, walk);
                for (k, neighbour) in walk.found.iter().enumerate() {
                    rows[k] = previous_rows[neighbour.index as usize];
                    distances[k] = neighbour.distance_squared;
                }
            });
        Ok(Self { rows, distances })
    }

    /// Rows of the previous feature table for point `i`, nearest first.
    #[must_use]
    pub fn rows(&self, i: usize) -> &[u32] {
        &self.rows[i * SKIP_NEIGHBOURS..][..SKIP_NEIGHBOURS]
    }

    /// Squared distances of those points from point `i`, in local units.
    #[must_use]
    pub fn distances(&self, i: usize) -> &[f32] {
        &self.distances[i * SKIP_NEIGHBOURS..][..SKIP_NEIGHBOURS]
    }
}
