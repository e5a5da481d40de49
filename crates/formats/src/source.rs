//! The buffered bytes behind every reader: lines and blocks without copying, with a byte limit.

use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::ops::Range;

use super::first_bytes::ENOUGH;
use super::layers::Layers;
use super::registry;
use super::spool::Spool;
use super::{FormatError, Limits, Place};

/// Bytes of a first read; the buffer grows beyond only for a longer line or row.
const BLOCK: usize = 256 * 1024;

/// The byte order mark of UTF-8.
pub(super) const BOM: &[u8] = b"\xEF\xBB\xBF";

/// A longer line is refused: without a bound, a file without line ends would be held in memory whole.
const MAX_LINE: usize = 1 << 20;

/// What may lie about a file's bytes, gzip aside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Around {
    /// UTF-16, or the byte order mark of UTF-8.
    Utf16,
    /// That mark alone: numbers may begin like UTF-16.
    Utf8,
    /// Nothing: numbers may begin like anything.
    Nothing,
}

/// Where the bytes come from.
pub(super) enum Input<'r> {
    /// In order, and once.
    Stream(Box<dyn Read + 'r>),
    /// A file that can be read again, from its beginning.
    File(File),
}

impl Input<'_> {
    /// What is left of a file, pipe or device.
    pub(super) fn of_file(mut file: File) -> io::Result<Self> {
        let is_whole = file.metadata()?.is_file() && file.stream_position()? == 0;
        Ok(if is_whole { Self::File(file) } else { Self::Stream(Box::new(file)) })
    }
}

impl Read for Input<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Stream(reader) => reader.read(bytes),
            Self::File(file) => file.read(bytes),
        }
    }
}

/// Reads ahead into one buffer, hands out parts of it, and counts bytes and lines.
///
/// A `BufReader` is not enough: sniffing needs to see further than the first bytes that a socket
/// delivers, and rows and lines that straddle two blocks should not need a copy of their own.
pub(super) struct Source<'r> {
    layers: Layers<'r>,
    buffer: Vec<u8>,
    start: usize,
    end: usize,
    ended: bool,
    /// Bytes that came into the buffer, without what lay about them.
    filled: u64,
    line: u64,
    newline: u8,
}

impl<'r> Source<'r> {
    /// Takes off what may lie about the bytes and finds out what ends a line.
    pub(super) fn new(input: Input<'r>, limits: Limits, around: Around) -> Result<Self, FormatError> {
        let is_known = |head: &[u8]| registry::by_bytes(head).is_some();
        let mut source = Self {
            layers: Layers::new(input, limits, around == Around::Utf16, is_known)?,
            buffer: vec![0; BLOCK],
            start: 0,
            end: 0,
            ended: false,
            filled: 0,
            line: 0,
            newline: b'\n',
        };
        let head = source.peek(ENOUGH)?;
        if around != Around::Nothing && head.starts_with(BOM) && !is_known(head) {
            source.consume(BOM.len());
        }
        let head = source.peek(4096)?;
        // A return that no line feed follows ends lines by itself (as on old Macs).
        if let Some(i) = head.iter().position(|b| matches!(b, b'\n' | b'\r'))
            && head[i] == b'\r'
            && head.get(i + 1) != Some(&b'\n')
        {
            source.newline = b'\r';
        }
        Ok(source)
    }

    /// The next `count` bytes without consuming them; fewer at the end of the data.
    pub(super) fn peek(&mut self, count: usize) -> Result<&[u8], FormatError> {
        self.ensure(count)?;
        Ok(&self.buffer[self.start..self.end.min(self.start + count)])
    }

    /// Buffers at least `count` bytes; false when the data end before.
    pub(super) fn ensure(&mut self, count: usize) -> Result<bool, FormatError> {
        while self.end - self.start < count {
            if self.fill()? == 0 {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// All that is buffered and not yet consumed.
    pub(super) fn buffered(&self) -> &[u8] {
        &self.buffer[self.start..self.end]
    }

    /// Marks buffered bytes as read.
    pub(super) fn consume(&mut self, count: usize) {
        self.start = self.end.min(self.start + count);
    }

    /// Consumes and returns a number's bytes; `None` at the end of the data.
    pub(super) fn take(&mut self, count: usize) -> Result<Option<&[u8]>, FormatError> {
        if !self.ensure(count)? {
            return Ok(None);
        }
        self.start += count;
        Ok(Some(&self.buffer[self.start - count..self.start]))
    }

    /// Consumes all that is left, to be sought in: a file as it lies, anything else as a copy.
    pub(super) fn stored(&mut self) -> Result<Spool, FormatError> {
        if let (Place::Byte(0), Some(file)) = (self.offset(), self.layers.file()) {
            let file = file.try_clone()?;
            self.drain()?;
            // The bytes that the hash is of, even if the file has grown since.
            return Ok(Spool::of_file(file, self.layers.pulled()));
        }
        let mut spool = Spool::new();
        while self.ensure(1)? {
            spool.write_all(self.buffered())?;
            self.consume(self.buffered().len());
        }
        spool.rewind()?;
        Ok(spool)
    }

    /// Consumes `count` bytes; false when the data end before.
    pub(super) fn skip(&mut self, mut count: u64) -> Result<bool, FormatError> {
        loop {
            let part = count.min((self.end - self.start) as u64);
            // `part` is at most the length of the buffer.
            self.start += part as usize;
            count -= part;
            if count == 0 {
                return Ok(true);
            }
            if self.fill()? == 0 {
                return Ok(false);
            }
        }
    }

    /// Consumes a line and says where it lies ([`Source::bytes`]), without its end; valid until the
    /// next call that reads. A `\r` before the line feed is left in place: it counts as white space.
    pub(super) fn next_line(&mut self) -> Result<Option<Range<usize>>, FormatError> {
        let mut scanned = 0;
        loop {
            let unseen = &self.buffer[self.start + scanned..self.end];
            if let Some(i) = unseen.iter().position(|b| *b == self.newline) {
                let line = self.start..self.start + scanned + i;
                self.start = line.end + 1;
                self.line += 1;
                return Ok(Some(line));
            }
            scanned = self.end - self.start;
            if scanned > MAX_LINE {
                let why = format!("the line is longer than {MAX_LINE} bytes");
                return Err(FormatError::malformed(Place::Line(self.line + 1), why));
            }
            if self.fill()? == 0 {
                if scanned == 0 {
                    return Ok(None);
                }
                let line = self.start..self.end;
                self.start = self.end;
                self.line += 1;
                return Ok(Some(line));
            }
        }
    }

    /// A range that [`Source::next_line`] gave.
    pub(super) fn bytes(&self, range: Range<usize>) -> &[u8] {
        &self.buffer[range]
    }

    /// The line last read.
    pub(super) fn line(&self) -> Place {
        Place::Line(self.line)
    }

    /// The number of the line last read, from 1.
    pub(super) fn line_number(&self) -> u64 {
        self.line
    }

    /// The offset of the next byte.
    pub(super) fn offset(&self) -> Place {
        Place::Byte(self.filled - (self.end - self.start) as u64)
    }

    /// Reads to the end and refuses anything but padding (white space, NUL, Ctrl-Z): whatever else
    /// follows means that the counts before it were wrong, and points would be lost without a word.
    pub(super) fn expect_end(&mut self, after: &str) -> Result<(), FormatError> {
        loop {
            let padding = |b: &u8| b.is_ascii_whitespace() || matches!(b, 0 | 0x1A);
            if let Some(i) = self.buffered().iter().position(|b| !padding(b)) {
                self.consume(i);
                let why = format!("data go on after {after}, which should be the last");
                return Err(FormatError::malformed(self.offset(), why));
            }
            self.start = self.end;
            if self.fill()? == 0 {
                return Ok(());
            }
        }
    }

    /// Reads to the end, for the hash and the limit.
    fn drain(&mut self) -> Result<(), FormatError> {
        loop {
            self.start = self.end;
            if self.fill()? == 0 {
                return Ok(());
            }
        }
    }

    /// SHA-256 over all bytes of the data, those after what was consumed among them.
    pub(super) fn sha256(mut self) -> Result<[u8; 32], FormatError> {
        self.drain()?;
        Ok(self.layers.sha256())
    }

    /// Reads once more; 0 at the end of the data.
    fn fill(&mut self) -> Result<usize, FormatError> {
        if self.ended {
            return Ok(0);
        }
        if self.start == self.end {
            (self.start, self.end) = (0, 0);
        }
        if self.end == self.buffer.len() {
            if self.start > 0 {
                self.buffer.copy_within(self.start..self.end, 0);
                (self.start, self.end) = (0, self.end - self.start);
            } else {
                self.buffer.resize(self.buffer.len() * 2, 0);
            }
        }
        match self.layers.read(&mut self.buffer[self.end..]) {
            Ok(got) => {
                self.end += got;
                self.ended = got == 0;
                self.filled += got as u64;
                Ok(got)
            }
            Err(error) => {
                // Later calls must not take an excess for data.
                self.ended = true;
                Err(error)
            }
        }
    }
}
