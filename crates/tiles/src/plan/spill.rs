//! The first pass: a cloud goes to the disk as it is read, and all is counted that the plan needs.

use densecloud_cloud::{FactsSeen, Position};
use densecloud_formats::{Block, CloudReader, Ending, Header};
use densecloud_geometry::check_count;
use rayon::prelude::*;

use super::sample::{MOST, Sample};
use crate::chunk::{self, Chunks, ROWS};
use crate::input::Large;
use crate::{Folder, TilesError, Watch};
use densecloud::PrepareError;
use densecloud_cascade::CascadeError;

/// Bytes of a file after which the next one is begun, so that they can be removed one by one.
const FILE: u64 = 64 << 20;

/// Points that stand in the example of the input.
const EXAMPLE: usize = 100;

/// A cloud on the disk.
pub(super) struct Spilled {
    pub(super) header: Header,
    pub(super) ending: Ending,
    /// Points, those that are not finite included.
    pub(super) points: u64,
    pub(super) finite: u64,
    /// The lowest and the highest coordinates of finite points.
    pub(super) bounds: [Position; 2],
    pub(super) sample: Vec<Position>,
    /// What the numbers of each column are like, those of text that is not kept included.
    pub(super) facts: Vec<FactsSeen>,
    /// Its first points.
    pub(super) example: Block,
    files: u32,
    /// Bytes of the files.
    pub(super) bytes: u64,
}

impl Spilled {
    /// Reads a cloud to its end.
    pub(super) fn read(input: Large<'_>, folder: &Folder, watch: &dyn Watch) -> Result<Self, TilesError> {
        let Large { reader, header, first } = input;
        let mut spill = Spill::new(folder);
        for block in &first {
            spill.add(block)?;
        }
        drop(first);
        let ending = spill.add_all(reader, watch)?;
        let Spill { points, finite, bounds, sample, facts, example, files, bytes, .. } = spill;
        let sample = sample.positions();
        Ok(Self { header, ending, points, finite, bounds, sample, facts, example, files, bytes })
    }

    /// Gives all points to `take`, with the row of the first; files are removed behind it where `is_last`.
    pub(super) fn each(
        &self,
        folder: &Folder,
        is_last: bool,
        mut take: impl FnMut(u64, Block) -> Result<(), TilesError>,
    ) -> Result<(), TilesError> {
        let mut row = 0;
        for file in 0..self.files {
            let path = folder.spill(file);
            let mut chunks = Chunks::open(&path)?;
            while let Some(block) = chunks.next()? {
                let count = block.positions.len() as u64;
                take(row, block)?;
                row += count;
            }
            if is_last {
                std::fs::remove_file(&path).map_err(TilesError::file(&path))?;
            }
        }
        Ok(())
    }
}

/// A cloud on its way to the disk.
struct Spill<'a> {
    folder: &'a Folder,
    points: u64,
    finite: u64,
    bounds: [Position; 2],
    sample: Sample,
    facts: Vec<FactsSeen>,
    example: Block,
    files: u32,
    bytes: u64,
    /// Bytes of the last file.
    last: u64,
}

impl<'a> Spill<'a> {
    fn new(folder: &'a Folder) -> Self {
        Self {
            folder,
            points: 0,
            finite: 0,
            bounds: [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]],
            sample: Sample::new(MOST),
            facts: Vec::new(),
            example: Block::default(),
            files: 0,
            bytes: 0,
            last: FILE,
        }
    }

    fn add_all(&mut self, mut reader: CloudReader<'_>, watch: &dyn Watch) -> Result<Ending, TilesError> {
        let mut block = Block::default();
        while reader.next_block(ROWS, &mut block)? {
            if watch.cancelled() {
                return Err(CascadeError::Cancelled.into());
            }
            self.add(&block)?;
            watch.read(self.points);
        }
        Ok(reader.finish()?)
    }

    fn add(&mut self, block: &Block) -> Result<(), TilesError> {
        if self.points == 0 {
            self.example = head(block, EXAMPLE);
        }
        for p in block.positions.iter().filter(|p| p.iter().all(|c| c.is_finite())) {
            self.finite += 1;
            crate::tile::widen(&mut self.bounds, *p);
        }
        for (i, p) in block.positions.iter().enumerate() {
            if p.iter().all(|c| c.is_finite()) {
                self.sample.see(self.points + i as u64, *p);
            }
        }
        self.facts.resize_with(block.columns.len(), FactsSeen::default);
        self.facts.par_iter_mut().zip(&block.columns).for_each(|(facts, column)| facts.see(column));
        self.points += block.positions.len() as u64;
        check_count(usize::try_from(self.points).unwrap_or(usize::MAX)).map_err(PrepareError::from)?;
        self.write(block)
    }

    fn write(&mut self, block: &Block) -> Result<(), TilesError> {
        if self.last >= FILE {
            (self.files, self.last) = (self.files + 1, 0);
        }
        // There is one by now.
        let path = self.folder.spill(self.files - 1);
        chunk::append(&path, block)?;
        let columns = block.columns.iter().map(|column| column.len() * column.kind().size()).sum::<usize>();
        let bytes = (block.positions.len() * size_of::<Position>() + columns) as u64;
        (self.last, self.bytes) = (self.last + bytes, self.bytes + bytes);
        Ok(())
    }
}

/// The first points of a block.
fn head(block: &Block, rows: usize) -> Block {
    let rows: Vec<u32> = densecloud_geometry::indices(block.positions.len().min(rows)).collect();
    block.gather(&rows)
}
