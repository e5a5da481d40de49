//! Text with a point a line.

mod marks;
mod read;

use std::fmt;

use super::kind::{Choices, Kind, Mark, Opened, Rows};
use super::numbers::{Storage, one_word, put_rows};
use super::source::Source;
use super::{Format, FormatError, Limits, Reading, Scalar};
use densecloud_cloud::{Attribute, Origin, Position};

pub use marks::{Decimal, Separator};

/// Text with its choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Xyz {
    pub(crate) names: bool,
    pub(crate) separator: Separator,
}

impl Format {
    /// Text without names, with spaces.
    pub const TEXT: Self = Self::Xyz { names: false, separator: Separator::Space };
}

impl Kind for Xyz {
    /// Whatever is text, and nothing else.
    const MARK: Mark = Mark::Lines(|_| true);
    const NAMES: &'static [&'static str] = &["text"];
    const BEGINNING: Option<&'static str> = None;
    const MEDIA_TYPES: &'static [&'static str] = &["text/plain", "text/csv"];
    const EXTENSIONS: &'static [&'static str] = &["xyz", "txt", "asc", "pts", "pwn", "csv"];

    fn from_extension(extension: &str) -> Option<Self> {
        let separator = match extension {
            "xyz" | "txt" | "asc" | "pts" | "pwn" => Separator::Space,
            "csv" => Separator::Comma,
            _ => return None,
        };
        Some(Self { names: false, separator })
    }

    fn from_media_type(media_type: &str) -> Option<Self> {
        match media_type {
            "text/plain" => Self::from_extension("xyz"),
            "text/csv" => Self::from_extension("csv"),
            _ => None,
        }
    }

    fn open(source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        let (points, header) = read::XyzPoints::open(source, limits)?;
        Ok(Opened { header, points: Box::new(points) })
    }
}

impl Choices for Xyz {
    fn media_type(&self) -> &'static str {
        match self.separator {
            Separator::Comma => "text/csv; charset=utf-8",
            _ => "text/plain; charset=utf-8",
        }
    }

    fn of_result(&self, input: Format, names: bool) -> Format {
        match input {
            // `.xyz` says nothing of commas; `.csv` does.
            Format::Xyz { names, separator } if self.separator == Separator::Space => {
                Format::Xyz { names, separator }
            }
            Format::Xyz { names, .. } => Format::Xyz { names, separator: self.separator },
            _ => Format::Xyz { names, separator: self.separator },
        }
    }

    fn holds_comments(&self) -> bool {
        false
    }

    fn holds_crs(&self) -> bool {
        false
    }

    fn is_streamed(&self) -> bool {
        true
    }

    fn bytes_a_point(&self, position: u64, attributes: u64) -> u64 {
        Storage::text_bytes(position, attributes)
    }

    fn begin(
        &self,
        _points: u64,
        attributes: &[Attribute],
        _origin: &Origin,
    ) -> Result<(Vec<u8>, Box<dyn Rows>), FormatError> {
        let header = if self.names { names_line(attributes, self.separator) } else { String::new() };
        Ok((header.into_bytes(), Box::new(XyzRows(self.separator))))
    }
}

impl fmt::Display for Xyz {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.separator {
            Separator::Comma => "text (commas)",
            Separator::Semicolon => "text (semicolons)",
            Separator::Space => "text",
            Separator::Tab => "text (tabs)",
            Separator::Bar => "text (vertical bars)",
        })
    }
}

/// Lines of numbers.
#[derive(Debug)]
struct XyzRows(Separator);

impl Rows for XyzRows {
    fn put(
        &self,
        bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        put_rows(bytes, positions, attributes, from, Storage::Text(self.0.as_str()), Scalar::F64)
    }
}

/// The line that names the columns of a text file.
fn names_line(attributes: &[Attribute], separator: Separator) -> String {
    let mut names = ["x", "y", "z"].map(str::to_owned).to_vec();
    names.extend(attributes.iter().map(|a| one_word(&a.name)));
    names.join(separator.as_str()) + "\n"
}
