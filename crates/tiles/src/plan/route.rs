//! The second pass: each point goes to the tile that it is in, and to those that it is near.

use densecloud_cloud::{Position, Values};
use densecloud_formats::{Block, ColumnName};
use densecloud_geometry::Partition;
use rayon::prelude::*;

use super::sample::Spacings;
use crate::chunk;
use crate::input::kept;
use crate::{Folder, TilesError};

/// Points that wait for their files at most.
const HELD: usize = 1 << 19;

/// Points on their way to tiles.
pub(super) struct Router<'a> {
    folder: &'a Folder,
    partition: &'a Partition,
    columns: &'a [Option<ColumnName>],
    spacings: &'a Spacings,
    /// How many spacings a point is from a tile at most, if it is around it.
    halo: f64,
    /// Of each tile those of its own and those around it, as far as they are not written.
    waiting: Vec<[Block; 2]>,
    held: usize,
    /// How many points each tile has of its own, and around it.
    pub(super) counts: Vec<[u64; 2]>,
}

impl<'a> Router<'a> {
    pub(super) fn new(
        folder: &'a Folder,
        partition: &'a Partition,
        columns: &'a [Option<ColumnName>],
        spacings: &'a Spacings,
        halo: f64,
    ) -> Self {
        let (waiting, counts) = (vec![Default::default(); partition.len()], vec![[0; 2]; partition.len()]);
        Self { folder, partition, columns, spacings, halo, waiting, held: 0, counts }
    }

    /// Takes further points as they were read; `first` is the row of the first one. Those that are not finite are left out.
    pub(super) fn add(&mut self, first: u64, block: Block) -> Result<(), TilesError> {
        let Block { positions, columns } = block;
        let mut columns = kept(columns, self.columns);
        // Rows are counted in 32 bits: a cloud of more points was refused.
        columns.push(Values::U32((0..positions.len()).map(|i| (first + i as u64) as u32).collect()));
        let mut rows: Vec<[Vec<u32>; 2]> = vec![Default::default(); self.partition.len()];
        let mut touched: Vec<u32> = Vec::new();
        let homes: Vec<Option<(u32, Vec<u32>)>> =
            positions.par_iter().map_init(Vec::new, |near, p| self.homes(*p, near)).collect();
        for (row, (own, around)) in homes.into_iter().enumerate().filter_map(|(row, of)| Some((row, of?))) {
            rows[own as usize][0].push(row as u32);
            touched.push(own);
            for tile in around {
                rows[tile as usize][1].push(row as u32);
                touched.push(tile);
            }
        }
        touched.sort_unstable();
        touched.dedup();
        let block = Block { positions, columns };
        for tile in touched.iter().map(|tile| *tile as usize) {
            for (side, rows) in rows[tile].iter().enumerate() {
                self.put(tile, side, block.gather(rows));
            }
        }
        if self.held > HELD { self.flush(HELD / 2) } else { Ok(()) }
    }

    /// The tile that a point is in, and those that it is around; none where it is not finite.
    fn homes(&self, p: Position, near: &mut Vec<u32>) -> Option<(u32, Vec<u32>)> {
        if p.iter().any(|c| !c.is_finite()) {
            return None;
        }
        let own = self.partition.cell_of(p);
        let mut around = Vec::new();
        // Most points are far from any border, however sparse the cloud were there.
        if self.partition.border_distance(p) <= self.halo * self.spacings.largest {
            self.partition.near(p, self.halo * self.spacings.at(p), near);
            around.extend(near.iter().copied().filter(|tile| *tile != own));
        }
        Some((own, around))
    }

    fn put(&mut self, tile: usize, side: usize, mut block: Block) {
        let count = block.positions.len();
        if count == 0 {
            return;
        }
        self.counts[tile][side] += count as u64;
        self.held += count;
        let waiting = &mut self.waiting[tile][side];
        if waiting.positions.is_empty() {
            *waiting = block;
            return;
        }
        waiting.positions.append(&mut block.positions);
        waiting.columns.iter_mut().zip(&mut block.columns).for_each(|(column, more)| column.append(more));
    }

    /// Writes points, of those tiles first of which most wait, until no more than so many are left.
    fn flush(&mut self, most: usize) -> Result<(), TilesError> {
        let mut order: Vec<(usize, usize)> =
            (0..self.waiting.len()).flat_map(|tile| [(tile, 0), (tile, 1)]).collect();
        order.sort_by_key(|&(tile, side)| std::cmp::Reverse(self.waiting[tile][side].positions.len()));
        for (tile, side) in order {
            let block = std::mem::take(&mut self.waiting[tile][side]);
            if self.held <= most || block.positions.is_empty() {
                self.waiting[tile][side] = block;
                break;
            }
            self.held -= block.positions.len();
            let path = if side == 0 { self.folder.own(tile as u32) } else { self.folder.around(tile as u32) };
            chunk::append(&path, &block)?;
        }
        Ok(())
    }

    /// Writes all that is left.
    pub(super) fn finish(mut self) -> Result<Vec<[u64; 2]>, TilesError> {
        self.flush(0)?;
        Ok(self.counts)
    }
}
