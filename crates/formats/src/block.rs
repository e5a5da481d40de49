//! Points that are read at a time, and those of them that are wanted.

use super::{Bounds, FormatError, Limits};
use densecloud_cloud::{Position, Values};

/// Consecutive points of a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Block {
    /// One entry a point, in the file's order and units; NaN and infinite coordinates as they are.
    pub positions: Vec<Position>,
    /// The other columns, one number a point each; [`Ending::columns`](super::Ending::columns) says which attribute each is. All blocks have
    /// the same columns. A text file declares no types: its columns hold 64-bit integers, without a sign from the first
    /// one beyond 2^63 on, until a fraction is met, doubles from that block on, and nothing from the block on in which
    /// a field is no number.
    pub columns: Vec<Values>,
}

impl Block {
    /// The points of these rows; of a column that has fewer rows, those that it has. `rows` ascend.
    #[must_use]
    pub fn gather(&self, rows: &[u32]) -> Self {
        let of = |column: &Values| {
            let there = rows.partition_point(|row| (*row as usize) < column.len());
            column.gather(&rows[..there])
        };
        Self {
            positions: rows.iter().map(|&row| self.positions[row as usize]).collect(),
            columns: self.columns.iter().map(of).collect(),
        }
    }
}

/// What is read of a file of which not all is wanted.
pub(crate) struct Within {
    bounds: Bounds,
    limits: Limits,
    /// Whether a point was left out.
    pub(crate) has_others: bool,
}

impl Within {
    /// What lies inside of some bounds, and no more points of it than the limits allow.
    pub(crate) fn new(bounds: Bounds, limits: Limits) -> Self {
        Self { bounds, limits, has_others: false }
    }

    /// Leaves the points of a block that are wanted, of which there were `given` before.
    ///
    /// # Errors
    /// There are too many.
    pub(crate) fn keep(&mut self, block: &mut Block, given: u64) -> Result<(), FormatError> {
        let is_inside = |row: &u32| self.bounds.contains(&block.positions[*row as usize]);
        let rows: Vec<u32> = densecloud_geometry::indices(block.positions.len()).filter(is_inside).collect();
        if rows.len() < block.positions.len() {
            self.has_others = true;
            *block = block.gather(&rows);
        }
        self.limits.check_points(given + rows.len() as u64)
    }
}
