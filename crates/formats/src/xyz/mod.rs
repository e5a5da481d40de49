//! Text with a point a line.

mod comments;
mod cuts;
mod dialect;
mod fit;
mod head;
mod heading;
mod layout;
mod leading;
mod marks;
mod names;
mod read;
mod sample;
mod thousands;

use std::fmt;

use super::kind::{Begun, Choices, FormatKind, Mark, Opened, Rows};
use super::numbers::{Storage, put_rows};
use super::reading::{AXES, DECIMAL, SEPARATOR};
use super::source::Source;
use super::{Format, FormatError, Limits, Reading, Scalar};
use densecloud_cloud::{Attribute, Origin, Position};
use names::Line;

pub use marks::{Decimal, Separator};

/// Text with its choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Xyz {
    pub(crate) names: bool,
    pub(crate) separator: Separator,
    pub(crate) decimal: Decimal,
}

impl Format {
    /// Text without names, with spaces.
    pub const TEXT: Self = Self::text(Separator::Space);

    /// Text without names, with decimal points.
    #[must_use]
    pub const fn text(separator: Separator) -> Self {
        Self::Xyz { names: false, separator, decimal: Decimal::Point }
    }
}

impl FormatKind for Xyz {
    /// Whatever is text, and nothing else.
    const MARK: Mark = Mark::Lines(|_| true);
    const NAMES: &'static [&'static str] = &["text"];
    const HEEDS: &'static [&'static str] = &[AXES, SEPARATOR, DECIMAL];
    const BEGINNING: Option<&'static str> = None;
    const MEDIA_TYPES: &'static [&'static str] = &["text/plain", "text/csv"];
    const EXTENSIONS: &'static [&'static str] = &["xyz", "txt", "asc", "pts", "pwn", "csv"];

    fn from_extension(extension: &str) -> Option<Self> {
        let separator = match extension {
            "xyz" | "txt" | "asc" | "pts" | "pwn" => Separator::Space,
            "csv" => Separator::Comma,
            _ => return None,
        };
        Some(Self { names: false, separator, decimal: Decimal::Point })
    }

    fn from_media_type(media_type: &str) -> Option<Self> {
        match media_type {
            "text/plain" => Self::from_extension("xyz"),
            "text/csv" => Self::from_extension("csv"),
            _ => None,
        }
    }

    fn open(source: &mut Source<'_>, limits: Limits, reading: &Reading) -> Result<Opened, FormatError> {
        let (points, header) = read::XyzPoints::open(source, limits, reading)?;
        Ok(Opened { header, points: Box::new(points) })
    }
}

impl Choices for Xyz {
    fn media_type(&self) -> &'static str {
        match (self.separator, self.decimal) {
            // Where commas are decimal marks, semicolons separate what is called comma-separated.
            (Separator::Comma, _) | (Separator::Semicolon, Decimal::Comma) => "text/csv; charset=utf-8",
            _ => "text/plain; charset=utf-8",
        }
    }

    fn of_result(&self, input: Format, names: bool) -> Format {
        let Self { separator: wanted, .. } = *self;
        match input {
            // `.csv` says commas, and semicolons where these are decimal marks; `.xyz` says nothing of either.
            Format::Xyz { names, decimal: Decimal::Comma, .. } if wanted == Separator::Comma => {
                Format::Xyz { names, separator: Separator::Semicolon, decimal: Decimal::Comma }
            }
            Format::Xyz { names, separator, decimal } => {
                let separator = if wanted == Separator::Space { separator } else { wanted };
                Format::Xyz { names, separator, decimal }
            }
            _ => Format::Xyz { names, separator: wanted, decimal: self.decimal },
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

    fn begin(&self, _points: u64, attributes: &[Attribute], origin: &Origin) -> Result<Begun, FormatError> {
        let header =
            if self.names { Line::of(attributes, origin, self.separator).text } else { String::new() };
        Ok((header.into_bytes(), Box::new(XyzRows(*self))))
    }

    fn renamed(&self, attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
        if self.names { Line::of(attributes, origin, self.separator).renamed } else { Vec::new() }
    }
}

impl fmt::Display for Xyz {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match (self.separator, self.decimal) {
            (Separator::Comma, _) => "text (commas)",
            (Separator::Semicolon, Decimal::Point) => "text (semicolons)",
            (Separator::Space, Decimal::Point) => "text",
            (Separator::Tab, Decimal::Point) => "text (tabs)",
            (Separator::Bar, Decimal::Point) => "text (vertical bars)",
            (Separator::Semicolon, Decimal::Comma) => "text (semicolons, decimal commas)",
            (Separator::Space, Decimal::Comma) => "text (decimal commas)",
            (Separator::Tab, Decimal::Comma) => "text (tabs, decimal commas)",
            (Separator::Bar, Decimal::Comma) => "text (vertical bars, decimal commas)",
        })
    }
}

/// Lines of numbers.
#[derive(Debug)]
struct XyzRows(Xyz);

impl Rows for XyzRows {
    fn put(
        &mut self,
        bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        let Xyz { separator, decimal, .. } = self.0;
        let begin = bytes.len();
        put_rows(bytes, positions, attributes, from, Storage::Text(separator.as_str()), Scalar::F64)?;
        if decimal == Decimal::Comma && separator != Separator::Comma {
            // Nothing but numbers has points.
            bytes[begin..].iter_mut().filter(|byte| **byte == b'.').for_each(|byte| *byte = b',');
        }
        Ok(())
    }
}
