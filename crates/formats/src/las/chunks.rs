//! Compressed points, chunk by chunk: each is decompressed alone, so that several are at once.

use std::io::{self, Seek, SeekFrom};

use laz::laszip::{ChunkTable, ChunkTableEntry};
use laz::{DecompressionSelection, LasZipError, LazVlr, par_decompress_selective};

use super::super::FormatError;
use super::super::spool::Spool;
use super::check::table_of_chunks;
use super::head::Head;
use super::records::number;

/// Bytes of points that are decompressed at once, so that memory does not grow with the number of threads.
const AT_ONCE: u64 = 32 << 20;

/// Most bytes of points in a chunk that is decompressed whole; longer ones are read point by point.
const LONGEST: u64 = 16 << 20;

/// A stretch of a file that can be decompressed alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Chunk {
    /// Its first byte.
    pub(super) at: u64,
    pub(super) bytes: u64,
    pub(super) points: u64,
}

/// The points of consecutive or chosen chunks, in their order.
pub(super) struct Chunks {
    file: Spool,
    how: LazVlr,
    /// Those that are not decompressed yet.
    left: std::vec::IntoIter<Chunk>,
    /// Points that are, and how many bytes of them were given.
    rows: Vec<u8>,
    given: usize,
    packed: Vec<u8>,
}

/// All chunks of a file of `points` points, as its table tells; none where the points are not in chunks, where a chunk is too
/// long to be decompressed whole, or where the table is not that of these points: reading on tells more.
pub(super) fn chunks_of(
    file: &mut Spool,
    head: &Head,
    compression: &[u8],
    points: u64,
) -> Result<Option<Vec<Chunk>>, FormatError> {
    /// Chunks that hold their points one after another, and in layers.
    const CHUNKED: [u64; 2] = [2, 3];
    let Ok(how) = LazVlr::from_buffer(compression) else { return Ok(None) };
    let stride = length(&how);
    if !CHUNKED.contains(&number::<2>(compression, 0)) || stride != head.number::<2>(105) {
        return Ok(None);
    }
    let table_at = table_of_chunks(file, head.data())?;
    file.seek(SeekFrom::Start(table_at))?;
    let varies = how.uses_variable_size_chunks();
    let Ok(table) = ChunkTable::read(file, varies) else { return Ok(None) };
    let fixed = (!varies).then(|| u64::from(how.chunk_size()));
    let chunks = placed(table.as_ref(), fixed, head.data() + 8..table_at, points);
    Ok(chunks.filter(|chunks| are_short(chunks, &how)))
}

/// Whether each chunk may be decompressed whole.
pub(super) fn are_short(chunks: &[Chunk], how: &LazVlr) -> bool {
    chunks.iter().all(|chunk| chunk.points.saturating_mul(length(how)) <= LONGEST)
}

/// Whether each chunk counts as many points as are said to be in it. Those in layers do: after their first point.
pub(super) fn count_so(file: &mut Spool, chunks: &[Chunk], how: &LazVlr) -> io::Result<bool> {
    for chunk in chunks {
        if file.number::<4>(chunk.at.saturating_add(length(how)))? != Some(chunk.points) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Where the chunks of a table lie, if they lie in `room` and have at least `points` points.
fn placed(
    table: &[ChunkTableEntry],
    fixed: Option<u64>,
    room: std::ops::Range<u64>,
    points: u64,
) -> Option<Vec<Chunk>> {
    let (mut at, mut left, mut chunks) = (room.start, points, Vec::new());
    for entry in table {
        if left == 0 {
            break;
        }
        let points = fixed.unwrap_or(entry.point_count).min(left);
        chunks.push(Chunk { at, bytes: entry.byte_count, points });
        left -= points;
        at = at.checked_add(entry.byte_count).filter(|end| *end <= room.end)?;
    }
    (left == 0).then_some(chunks)
}

/// Bytes of a point. The crate's own sum may be more than it has room for.
fn length(how: &LazVlr) -> u64 {
    how.items().iter().map(|item| u64::from(item.size())).sum()
}

impl Chunks {
    /// The points of chunks that lie inside of the file and have no more than [`LONGEST`] bytes of points.
    pub(super) fn new(file: Spool, how: LazVlr, chunks: Vec<Chunk>) -> Self {
        let left = chunks.into_iter();
        Self { file, how, left, rows: Vec::new(), given: 0, packed: Vec::new() }
    }

    /// The next points, at most `most` of them and at least one; none after the last.
    ///
    /// # Errors
    /// A chunk cannot be decompressed.
    pub(super) fn next(&mut self, most: u64) -> Result<&[u8], LasZipError> {
        if self.given == self.rows.len() {
            self.decompress()?;
        }
        let most = most.saturating_mul(length(&self.how));
        let count = most.min((self.rows.len() - self.given) as u64) as usize;
        self.given += count;
        Ok(&self.rows[self.given - count..self.given])
    }

    /// Decompresses further chunks, on the threads of the current pool.
    fn decompress(&mut self) -> Result<(), LasZipError> {
        let stride = length(&self.how);
        let (mut now, mut bytes) = (Vec::new(), 0);
        while let Some(chunk) = self.left.as_slice().first().copied()
            && (now.is_empty() || bytes + chunk.points * stride <= AT_ONCE)
        {
            bytes += chunk.points * stride;
            now.push(chunk);
            self.left.next();
        }
        self.packed.clear();
        for chunk in &now {
            let from = self.packed.len();
            // What is read lies within the file.
            self.packed.resize(from + chunk.bytes as usize, 0);
            if !self.file.read_at(chunk.at, &mut self.packed[from..])? {
                return Err(io::Error::from(io::ErrorKind::UnexpectedEof).into());
            }
        }
        self.rows.clear();
        self.rows.resize(bytes as usize, 0);
        self.given = 0;
        let entry = |chunk: &Chunk| ChunkTableEntry { point_count: chunk.points, byte_count: chunk.bytes };
        let table: Vec<ChunkTableEntry> = now.iter().map(entry).collect();
        par_decompress_selective(
            &self.packed,
            &mut self.rows,
            &self.how,
            &table,
            DecompressionSelection::all(),
        )
    }
}
