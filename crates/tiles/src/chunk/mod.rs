//! Points in files of our own, which no other program reads: chunks one after another, each with its types and checksum.
//!
//! A chunk is, little-endian: a mark, the number of points and of columns (32 bits each); of each column its type (a byte)
//! and how many numbers it has (32 bits); the CRC-32 of what follows; the coordinates, then the columns.

mod kinds;

pub(crate) use kinds::{KindName, kind_named, name_of};

use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use crate::TilesError;
use densecloud_cloud::{Kind, Position, Values, each_kind};
use densecloud_formats::Block;
use kinds::KINDS;

/// What a chunk begins with.
const MARK: [u8; 4] = *b"chk1";

/// Most points of a chunk that is written at once.
pub(crate) const ROWS: usize = 1 << 16;

/// Most columns, and most points: more is no chunk of ours.
const MOST: usize = 1 << 26;

/// Appends a chunk of points; the columns may have fewer numbers than there are points.
pub(crate) fn write(sink: &mut impl Write, block: &Block) -> io::Result<()> {
    let mut bytes = Vec::new();
    bytes.extend(MARK);
    bytes.extend((block.positions.len() as u32).to_le_bytes());
    bytes.extend((block.columns.len() as u32).to_le_bytes());
    for column in &block.columns {
        bytes.push(KINDS.iter().position(|(kind, _)| *kind == column.kind()).unwrap_or_default() as u8);
        bytes.extend((column.len() as u32).to_le_bytes());
    }
    let at = bytes.len();
    bytes.extend([0; 4]);
    for number in block.positions.as_flattened() {
        bytes.extend(number.to_le_bytes());
    }
    for column in &block.columns {
        each_kind!(column, column => column.iter().for_each(|number| bytes.extend(number.to_le_bytes())));
    }
    let sum = crc32fast::hash(&bytes[at + 4..]);
    bytes[at..at + 4].copy_from_slice(&sum.to_le_bytes());
    sink.write_all(&bytes)
}

/// Appends the points to a file in chunks of at most [`ROWS`]; the file need not be there.
pub(crate) fn append(path: &Path, block: &Block) -> Result<(), TilesError> {
    let failed = |why| TilesError::File { path: path.to_owned(), why };
    let mut file = File::options().append(true).create(true).open(path).map_err(failed)?;
    write(&mut file, block).map_err(failed)
}

/// The chunks of a file.
pub(crate) struct Chunks {
    path: PathBuf,
    file: BufReader<Box<dyn Read + Send>>,
}

impl Chunks {
    pub(crate) fn open(path: &Path) -> Result<Self, TilesError> {
        let file = File::open(path).map_err(TilesError::file(path))?;
        Ok(Self::of(path, Box::new(file)))
    }

    /// Of a file that is read from elsewhere.
    pub(crate) fn of(path: &Path, file: Box<dyn Read + Send>) -> Self {
        Self { path: path.to_owned(), file: BufReader::with_capacity(1 << 18, file) }
    }

    /// The next one; none at the end of the file.
    pub(crate) fn next(&mut self) -> Result<Option<Block>, TilesError> {
        let mut head = [0; 12];
        match self.file.read(&mut head[..1]) {
            Ok(0) => return Ok(None),
            Ok(_) => self.fill(1, &mut head)?,
            Err(why) => return Err(TilesError::File { path: self.path.clone(), why }),
        }
        let number =
            |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]) as usize;
        let (rows, count) = (number(4), number(8));
        if head[..4] != MARK || rows > MOST || count > MOST {
            return Err(self.broken("no chunk of points where one should be"));
        }
        let mut columns: Vec<(Kind, usize)> = Vec::new();
        for _ in 0..count {
            let mut column = [0; 5];
            self.fill(0, &mut column)?;
            let length = u32::from_le_bytes([column[1], column[2], column[3], column[4]]) as usize;
            let kind = KINDS.get(usize::from(column[0])).filter(|_| length <= rows);
            columns
                .push((kind.ok_or_else(|| self.broken("no chunk of points where one should be"))?.0, length));
        }
        let mut sum = [0; 4];
        self.fill(0, &mut sum)?;
        let bytes = columns.iter().map(|(kind, length)| kind.size() * length).sum::<usize>();
        let mut payload = vec![0; rows * size_of::<Position>() + bytes];
        self.fill(0, &mut payload)?;
        if crc32fast::hash(&payload) != u32::from_le_bytes(sum) {
            return Err(self.broken("points are not as they were written"));
        }
        Ok(Some(parsed(&payload, rows, &columns)))
    }

    /// Reads exactly as many bytes as there is room from `from` on.
    fn fill(&mut self, from: usize, bytes: &mut [u8]) -> Result<(), TilesError> {
        self.file.read_exact(&mut bytes[from..]).map_err(|why| match why.kind() {
            io::ErrorKind::UnexpectedEof => self.broken("the file ends within points"),
            _ => TilesError::File { path: self.path.clone(), why },
        })
    }

    fn broken(&self, why: &str) -> TilesError {
        TilesError::broken(&self.path, why)
    }
}

fn parsed(payload: &[u8], rows: usize, columns: &[(Kind, usize)]) -> Block {
    let (coordinates, mut rest) = payload.split_at(rows * size_of::<Position>());
    let mut numbers = coordinates.as_chunks::<8>().0.iter().map(|word| f64::from_le_bytes(*word));
    // There are three for each point.
    let mut number = || numbers.next().unwrap_or_default();
    let positions = (0..rows).map(|_| [number(), number(), number()]).collect();
    let mut column = |&(kind, length): &(Kind, usize)| {
        let (bytes, after) = rest.split_at(kind.size() * length);
        rest = after;
        let mut values = Values::new(kind);
        values.extend_from_bytes(bytes.chunks_exact(kind.size()), false);
        values
    };
    Block { positions, columns: columns.iter().map(&mut column).collect() }
}

/// All points of a file of chunks, whose columns have one type each; none where there is no such file.
pub(crate) fn read_all(path: &Path) -> Result<Option<Block>, TilesError> {
    if !path.try_exists().map_err(TilesError::file(path))? {
        return Ok(None);
    }
    let mut chunks = Chunks::open(path)?;
    let Some(mut all) = chunks.next()? else { return Ok(None) };
    while let Some(mut block) = chunks.next()? {
        all.positions.append(&mut block.positions);
        let kinds = |block: &Block| block.columns.iter().map(Values::kind).collect::<Vec<_>>();
        if kinds(&all) != kinds(&block) {
            return Err(TilesError::broken(path, "columns change their types"));
        }
        all.columns.iter_mut().zip(&mut block.columns).for_each(|(column, more)| column.append(more));
    }
    Ok(Some(all))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(from: u32, rows: u32) -> Block {
        let numbers = || (from..from + rows).map(f64::from);
        Block {
            positions: numbers().map(|n| [n, -n, f64::NAN]).collect(),
            columns: vec![
                Values::U32((from..from + rows).collect()),
                Values::from_f64(Kind::U8, numbers()),
                Values::F64(Vec::new()),
            ],
        }
    }

    #[test]
    fn what_is_appended_is_read_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("points");
        assert_eq!(read_all(&path).expect("no file"), None);
        append(&path, &block(0, 3)).expect("a chunk");
        append(&path, &block(3, 2)).expect("a chunk");
        let mut chunks = Chunks::open(&path).expect("a file");
        let first = chunks.next().expect("a chunk").expect("points");
        assert_eq!((first.positions[2][1], &first.columns), (-2.0, &block(0, 3).columns));
        assert_eq!(
            chunks.next().expect("a chunk").map(|b| b.columns[0].clone()),
            Some(Values::U32(vec![3, 4]))
        );
        assert_eq!(chunks.next().expect("the end"), None);
        assert_eq!(read_all(&path).expect("points").map(|b| b.columns), Some(block(0, 5).columns));
    }

    #[test]
    fn damage_is_noticed() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("points");
        append(&path, &block(0, 9)).expect("a chunk");
        let whole = std::fs::read(&path).expect("a file");
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x55;
            std::fs::write(&path, &bytes).expect("a file");
            assert!(matches!(read_all(&path), Err(TilesError::Broken { .. })), "byte {at}");
            std::fs::write(&path, &whole[..at]).expect("a file");
            assert!(at == 0 || read_all(&path).is_err(), "cut at {at}");
        }
    }
}
