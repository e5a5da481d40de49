//! Points compressed into chunks, several at a time, in a file that their table ends.

use std::io::{self, Cursor, Seek, SeekFrom, Write};

use laz::laszip::{ChunkTable, ChunkTableEntry};
use laz::record::{LayeredPointRecordCompressor, RecordCompressor, SequentialPointRecordCompressor};
use laz::{LazItem, LazVlr};
use rayon::prelude::*;

use super::super::spool::Spool;

/// Bytes of points that are compressed at once, so that memory does not grow with the number of threads.
const AT_ONCE: usize = 32 << 20;

/// The most memory that compressing points of so many bytes takes: theirs, and what becomes of them.
pub(super) fn most_held(bytes: u64) -> u64 {
    2 * bytes.min(AT_ONCE as u64)
}

/// A file from its beginning to the table of its chunks.
pub(super) struct Packed {
    file: Spool,
    items: Vec<LazItem>,
    how: LazVlr,
    /// Where the points begin.
    from: u64,
    table: ChunkTable,
    /// Chunks that are not compressed yet.
    waiting: Vec<Vec<u8>>,
}

impl Packed {
    /// A file that has `before` in front of its points.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn new(mut file: Spool, before: &[u8], how: LazVlr) -> io::Result<Self> {
        file.write_all(before)?;
        // Where the table begins is known at the end.
        file.write_all(&[0; ChunkTable::OFFSET_SIZE])?;
        let (items, from) = (how.items().clone(), before.len() as u64);
        Ok(Self { file, items, how, from, table: ChunkTable::default(), waiting: Vec::new() })
    }

    /// Appends a chunk of whole rows.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn add(&mut self, rows: Vec<u8>) -> io::Result<()> {
        self.waiting.push(rows);
        let bytes: usize = self.waiting.iter().map(Vec::len).sum();
        if bytes < AT_ONCE { Ok(()) } else { self.compress() }
    }

    /// Compresses what waits, on the threads of the current pool.
    fn compress(&mut self) -> io::Result<()> {
        let (items, stride) = (&self.items, self.how.items_size());
        let chunk = |rows: &Vec<u8>| Ok((rows.len() as u64 / stride, compressed(rows, items)?));
        let made: Vec<io::Result<(u64, Vec<u8>)>> = self.waiting.par_iter().map(chunk).collect();
        self.waiting.clear();
        for chunk in made {
            let (point_count, bytes) = chunk?;
            self.file.write_all(&bytes)?;
            self.table.push(ChunkTableEntry { point_count, byte_count: bytes.len() as u64 });
        }
        Ok(())
    }

    /// Writes the table. Gives the file, at its end, and what the table has.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(super) fn end(mut self) -> io::Result<(Spool, ChunkTable)> {
        self.compress()?;
        let mut end = Vec::new();
        self.table.write_to(&mut end, &self.how)?;
        let at = self.file.len();
        self.file.write_all(&end)?;
        self.file.seek(SeekFrom::Start(self.from))?;
        self.file.write_all(&at.to_le_bytes())?;
        self.file.seek(SeekFrom::End(0))?;
        Ok((self.file, self.table))
    }
}

/// The bytes of one chunk.
fn compressed(rows: &[u8], items: &Vec<LazItem>) -> io::Result<Vec<u8>> {
    /// Versions from which on the fields of points lie in layers.
    const LAYERED: u16 = 3;
    let mut bytes = Cursor::new(Vec::new());
    let is_layered = items.first().is_some_and(|item| item.version() >= LAYERED);
    let mut compressor: Box<dyn RecordCompressor<&mut Cursor<Vec<u8>>>> = match is_layered {
        true => Box::new(LayeredPointRecordCompressor::new(&mut bytes)),
        false => Box::new(SequentialPointRecordCompressor::new(&mut bytes)),
    };
    compressor.set_fields_from(items).map_err(io::Error::other)?;
    compressor.compress_many(rows)?;
    compressor.done()?;
    drop(compressor);
    Ok(bytes.into_inner())
}
