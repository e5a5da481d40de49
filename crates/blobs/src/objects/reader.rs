//! An object that is read in pieces, the next one fetched while one is used.

use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::sync::Arc;

use bytes::Bytes;
use object_store::{GetOptions, GetRange, ObjectMeta};

use super::Place;
use super::calls::Call;
use crate::blobs::BlobReader;

/// Bytes of the first piece after a leap: little is lost where the next leap follows.
const LEAST: u64 = 1 << 20;
/// Bytes of a piece of those that are read one after another.
const MOST: u64 = 8 << 20;

/// Reads an object from anywhere. Takes up to two pieces of memory.
pub(super) struct Reader {
    place: Arc<Place>,
    object: ObjectMeta,
    /// Where it is read next.
    at: u64,
    piece: Piece,
    /// The one after that, and its call.
    ahead: Option<(Range<u64>, Call<Bytes>)>,
}

/// Some bytes of an object.
#[derive(Default)]
struct Piece {
    start: u64,
    bytes: Bytes,
}

impl Piece {
    fn end(&self) -> u64 {
        self.start + self.bytes.len() as u64
    }

    fn from(&self, at: u64) -> Option<&[u8]> {
        let skipped = usize::try_from(at.checked_sub(self.start)?).ok()?;
        self.bytes.get(skipped..).filter(|left| !left.is_empty())
    }
}

impl Reader {
    pub(super) fn new(place: Arc<Place>, object: ObjectMeta) -> Self {
        Self { place, object, at: 0, piece: Piece::default(), ahead: None }
    }

    /// Fetches the piece that begins where it is read next.
    fn advance(&mut self) -> io::Result<()> {
        let follows = self.at == self.piece.end() && !self.piece.bytes.is_empty();
        let before = self.piece.bytes.len() as u64;
        let (range, call) = match self.ahead.take() {
            Some((range, call)) if range.start == self.at => (range, call),
            other => {
                if let Some((_, call)) = other {
                    call.cancel();
                }
                self.begin(self.at, if follows { 2 * before } else { LEAST })
            }
        };
        let bytes = call.wait()?;
        if bytes.len() as u64 != range.end - range.start {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        if follows && range.end < self.object.size {
            self.ahead = Some(self.begin(range.end, 2 * bytes.len() as u64));
        }
        self.piece = Piece { start: range.start, bytes };
        Ok(())
    }

    /// Begins to fetch about so many bytes.
    fn begin(&self, start: u64, bytes: u64) -> (Range<u64>, Call<Bytes>) {
        let range = start..self.object.size.min(start + bytes.clamp(LEAST, MOST));
        // Nothing of another object of that name.
        let options = GetOptions {
            range: Some(GetRange::Bounded(range.clone())),
            if_match: self.object.e_tag.clone(),
            ..GetOptions::default()
        };
        let (store, path) = (Arc::clone(&self.place.store), self.object.location.clone());
        let call = self.place.begin(self.object.location.as_ref(), async move {
            store.get_opts(&path, options).await?.bytes().await
        });
        (range, call)
    }
}

impl Read for Reader {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        if self.at >= self.object.size || into.is_empty() {
            return Ok(0);
        }
        if self.piece.from(self.at).is_none() {
            self.advance()?;
        }
        let bytes = self.piece.from(self.at).unwrap_or_default();
        let count = bytes.len().min(into.len());
        into[..count].copy_from_slice(&bytes[..count]);
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Reader {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::End(by) => self.object.size.checked_add_signed(by),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
        };
        self.at = at.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

impl BlobReader for Reader {
    fn length(&self) -> io::Result<u64> {
        Ok(self.object.size)
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        if let Some((_, call)) = self.ahead.take() {
            call.cancel();
        }
    }
}
