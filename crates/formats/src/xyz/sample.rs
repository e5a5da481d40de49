//! The first lines of a file: they decide how all are read.

use std::collections::VecDeque;

use super::super::FormatError;
use super::super::source::Source;
use super::super::text::is_space;

/// Lines that decide, those of comments and empty ones aside.
const LINES: usize = 1000;

/// Bytes that they may have together, but for the last of them.
const BYTES: usize = 256 * 1024;

/// Bytes of comments that are kept, the last ones.
const COMMENTS: usize = 64 * 1024;

/// A line and its number, from 1.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Line {
    pub(super) number: u64,
    pub(super) bytes: Vec<u8>,
}

/// The first lines, to be read once more.
#[derive(Debug, Default)]
pub(super) struct Sample(VecDeque<Line>);

impl Sample {
    /// Reads lines that are not empty until there are enough.
    pub(super) fn read(source: &mut Source<'_>) -> Result<Self, FormatError> {
        let mut sample = Self::default();
        let (mut lines, mut bytes, mut comments) = (0, 0, 0);
        while lines < LINES && bytes < BYTES {
            let Some(range) = source.next_line()? else { break };
            let number = source.line_number();
            let line = Line { number, bytes: without_end(source.bytes(range)).to_vec() };
            if is_blank(&line.bytes) {
                continue;
            }
            if is_comment(&line.bytes) {
                comments += line.bytes.len();
            } else {
                lines += 1;
                bytes += line.bytes.len();
            }
            sample.0.push_back(line);
            while comments > COMMENTS && sample.drop_comment(&mut comments) {}
        }
        Ok(sample)
    }

    /// Forgets the first comment, so that no more than the last are held.
    fn drop_comment(&mut self, bytes: &mut usize) -> bool {
        let Some(at) = self.0.iter().position(|line| is_comment(&line.bytes)) else { return false };
        *bytes -= self.0.remove(at).map_or(0, |line| line.bytes.len());
        true
    }

    pub(super) fn lines(&self) -> impl DoubleEndedIterator<Item = &Line> + Clone {
        self.0.iter()
    }

    /// Forgets the lines before this one.
    pub(super) fn forget_before(&mut self, number: u64) {
        self.0.retain(|line| line.number >= number);
    }

    /// The next line of the sample, to be read.
    pub(super) fn next(&mut self) -> Option<Line> {
        self.0.pop_front()
    }
}

/// A line without the mark that some old programs write at the end of all (Ctrl-Z), and without a return.
pub(super) fn without_end(line: &[u8]) -> &[u8] {
    let end = line.iter().rposition(|b| !matches!(b, b'\r' | b' ' | 0x1A)).map_or(0, |last| last + 1);
    &line[..end]
}

/// Whether nothing stands in a line.
pub(super) fn is_blank(line: &[u8]) -> bool {
    line.iter().all(|b| is_space(*b))
}

/// Whether a line is a comment: it begins with `#`, `//` or `%`.
pub(super) fn is_comment(line: &[u8]) -> bool {
    let begun = line.trim_ascii_start();
    begun.starts_with(b"#") || begun.starts_with(b"//") || begun.starts_with(b"%")
}
