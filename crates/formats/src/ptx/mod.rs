//! PTX, in which Leica's programs exchange scans: text, one scan after another. Each has a header of ten lines, then a
//! line for every direction that the scanner looked in, with zeros where nothing came back.

mod read;

use std::fmt;

use super::kind::{FormatKind, Mark, Opened, ReadOnly};
use super::source::Source;
use super::text::{next_token, parse_f64};
use super::{FormatError, Limits, Reading};

/// PTX, which has no choices.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ptx;

/// How many numbers stand in each line of a scan's header: its columns and rows, the scanner's place and axes, the pose.
const HEADER: [usize; 10] = [1, 1, 3, 3, 3, 3, 4, 4, 4, 4];

impl FormatKind for Ptx {
    const MARK: Mark = Mark::Lines(is_header);
    const NAMES: &'static [&'static str] = &["ptx"];
    const BEGINNING: Option<&'static str> =
        Some("a scan's header (two counts, 4 lines of 3 numbers, 4 lines of 4)");
    const MEDIA_TYPES: &'static [&'static str] = &[];
    const EXTENSIONS: &'static [&'static str] = &[];

    fn from_extension(extension: &str) -> Option<Self> {
        (extension == "ptx").then_some(Self)
    }

    fn from_media_type(_media_type: &str) -> Option<Self> {
        None
    }

    fn open(source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        let (points, header) = read::PtxPoints::open(source, limits)?;
        Ok(Opened { header, points: Box::new(points) })
    }
}

impl ReadOnly for Ptx {
    fn media_type(&self) -> &'static str {
        "text/plain; charset=utf-8"
    }
}

impl fmt::Display for Ptx {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PTX")
    }
}

/// Whether text begins as a scan does. No other text has two whole numbers on lines of their own before its points; what is
/// wrong behind the scanner's axes, the reader tells.
fn is_header(head: &[u8]) -> bool {
    let lines = head.split(|b| matches!(b, b'\n' | b'\r'));
    let lines = lines.filter(|line| !line.iter().all(u8::is_ascii_whitespace));
    let widths: Vec<Option<usize>> =
        lines.take(HEADER.len()).enumerate().map(|(i, line)| width(line, i < 2)).collect();
    let (sure, pose) = widths.split_at(widths.len().min(6));
    let begins = sure.len() > 3 && sure.iter().zip(HEADER).all(|(found, wanted)| *found == Some(wanted));
    begins && (pose.is_empty() || pose.contains(&Some(4)))
}

/// How many numbers a line holds, if it holds nothing else.
fn width(mut line: &[u8], is_count: bool) -> Option<usize> {
    let is_whole = |token: &[u8]| std::str::from_utf8(token).is_ok_and(|text| text.parse::<u64>().is_ok());
    let mut width = 0;
    while let Some(token) = next_token(&mut line) {
        let is_right = if is_count { is_whole(token) } else { parse_f64(token).is_some() };
        if !is_right {
            return None;
        }
        width += 1;
    }
    Some(width)
}
