//! Rows of an element, in any encoding, a number at a time.

use std::ops::Range;

use super::super::source::Source;
use super::super::text::{next_token, parse_f32, parse_f64, push_number, shown};
use super::super::{FormatError, Place, PlyEncoding};
use super::header::{Element, Shape, kind_name};
use densecloud_cloud::{Kind, Values};

/// A cursor over the rows of one element. Binary rows are bytes without gaps; a text row is exactly
/// one line, because a row that took numbers from the next line would shift all that follow it.
pub(super) struct Rows<'a, 'r> {
    source: &'a mut Source<'r>,
    encoding: PlyEncoding,
    element: &'a Element,
    row: u64,
    /// What is left of the line, in the source's buffer.
    line: Range<usize>,
}

impl<'a, 'r> Rows<'a, 'r> {
    pub(super) fn new(source: &'a mut Source<'r>, encoding: PlyEncoding, element: &'a Element) -> Self {
        Self::from(source, encoding, element, 0)
    }

    /// A cursor before the row of that number.
    pub(super) fn from(
        source: &'a mut Source<'r>,
        encoding: PlyEncoding,
        element: &'a Element,
        row: u64,
    ) -> Self {
        Self { source, encoding, element, row, line: 0..0 }
    }

    /// The number of the next row.
    pub(super) fn row(&self) -> u64 {
        self.row
    }

    /// Starts the next row; false when all rows are read. Blank lines are skipped.
    pub(super) fn begin(&mut self) -> Result<bool, FormatError> {
        if self.row == self.element.count {
            return Ok(false);
        }
        if self.encoding == PlyEncoding::Ascii {
            loop {
                let Some(line) = self.source.next_line()? else { return Err(self.truncated()) };
                if !self.source.bytes(line.clone()).iter().all(u8::is_ascii_whitespace) {
                    self.line = line;
                    break;
                }
            }
        }
        Ok(true)
    }

    /// Ends the row.
    pub(super) fn end(&mut self) -> Result<(), FormatError> {
        self.row += 1;
        if self.encoding == PlyEncoding::Ascii
            && let Some(token) = next_token(&mut self.source.bytes(self.line.clone()))
        {
            let why = format!("{} is more than a `{}` row has", shown(token), self.element.name);
            return Err(FormatError::malformed(self.source.line(), why));
        }
        Ok(())
    }

    /// The next number of the row.
    pub(super) fn number(&mut self, kind: Kind) -> Result<f64, FormatError> {
        let big = match self.encoding {
            PlyEncoding::Ascii => {
                let range = self.token()?;
                let token = self.source.bytes(range);
                // Rounded to the declared type, so that the same cloud reads the same in every encoding.
                let value =
                    if kind == Kind::F32 { parse_f32(token).map(f64::from) } else { parse_f64(token) };
                return value.ok_or_else(|| {
                    let why = format!("{} is not a number", shown(token));
                    FormatError::malformed(self.source.line(), why)
                });
            }
            PlyEncoding::BinaryLittleEndian => false,
            PlyEncoding::BinaryBigEndian => true,
        };
        let Some(bytes) = self.source.take(kind.size())? else { return Err(self.truncated()) };
        Ok(decode(kind, big, bytes))
    }

    /// Appends the next number of the row to a column, exactly: by way of [`Rows::number`] 64-bit
    /// integers would be rounded.
    pub(super) fn push(&mut self, values: &mut Values) -> Result<(), FormatError> {
        if self.encoding == PlyEncoding::Ascii {
            let range = self.token()?;
            let token = self.source.bytes(range);
            return push_number(values, token).ok_or_else(|| {
                let why = format!("{} is not a number of type {}", shown(token), kind_name(values.kind()));
                FormatError::malformed(self.source.line(), why)
            });
        }
        let big = self.encoding == PlyEncoding::BinaryBigEndian;
        let Some(bytes) = self.source.take(values.kind().size())? else { return Err(self.truncated()) };
        values.extend_from_bytes(std::iter::once(bytes), big);
        Ok(())
    }

    /// The next whole number, none negative and none beyond `u32`: a list's length or an index.
    pub(super) fn whole(&mut self, kind: Kind, what: &str) -> Result<u32, FormatError> {
        let value = self.number(kind)?;
        if value.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&value) {
            return Ok(value as u32);
        }
        Err(FormatError::malformed(self.place(), format!("{value} is not {what}")))
    }

    /// Skips a column of the row.
    pub(super) fn skip(&mut self, shape: Shape) -> Result<(), FormatError> {
        let (count, kind) = match shape {
            Shape::Scalar(kind) => (1, kind),
            Shape::List { length, item } => (self.whole(length, "the length of a list")?, item),
        };
        if self.encoding == PlyEncoding::Ascii {
            for _ in 0..count {
                self.token()?;
            }
        } else if !self.source.skip(u64::from(count) * kind.size() as u64)? {
            return Err(self.truncated());
        }
        Ok(())
    }

    /// Skips all rows.
    pub(super) fn skip_all(mut self) -> Result<(), FormatError> {
        // Without properties there is nothing to read, however many rows are claimed.
        if self.element.properties.is_empty() {
            return Ok(());
        }
        match self.element.stride() {
            Some(stride) if self.encoding != PlyEncoding::Ascii => {
                if self.source.skip(self.element.count.saturating_mul(stride as u64))? {
                    return Ok(());
                }
                Err(FormatError::truncated(
                    self.source.offset(),
                    format!("the header counts {} `{}` elements", self.element.count, self.element.name),
                ))
            }
            _ => {
                while self.begin()? {
                    for property in &self.element.properties {
                        self.skip(property.shape)?;
                    }
                    self.end()?;
                }
                Ok(())
            }
        }
    }

    /// Where the cursor is, for errors.
    pub(super) fn place(&self) -> Place {
        if self.encoding == PlyEncoding::Ascii { self.source.line() } else { self.source.offset() }
    }

    fn truncated(&self) -> FormatError {
        truncated(self.place(), self.element, self.row)
    }

    fn token(&mut self) -> Result<Range<usize>, FormatError> {
        let mut rest = self.source.bytes(self.line.clone());
        let Some(token) = next_token(&mut rest) else {
            let why = format!("the line is too short for a `{}` row", self.element.name);
            return Err(FormatError::malformed(self.source.line(), why));
        };
        let end = self.line.end - rest.len();
        let range = end - token.len()..end;
        self.line.start = end;
        Ok(range)
    }
}

/// The data end in row `row`.
pub(super) fn truncated(at: Place, element: &Element, row: u64) -> FormatError {
    let why = format!("the header counts {} `{}` elements, and {row} are there", element.count, element.name);
    FormatError::truncated(at, why)
}

/// The number in exactly `kind.size()` bytes.
pub(super) fn decode(kind: Kind, big: bool, bytes: &[u8]) -> f64 {
    let mut word = [0_u8; 8];
    let size = kind.size();
    word[..size].copy_from_slice(&bytes[..size]);
    if big {
        word[..size].reverse();
    }
    let bits = u64::from_le_bytes(word);
    match kind {
        Kind::I8 => f64::from(bits as i8),
        Kind::U8 => f64::from(bits as u8),
        Kind::I16 => f64::from(bits as i16),
        Kind::U16 => f64::from(bits as u16),
        Kind::I32 => f64::from(bits as i32),
        Kind::U32 => f64::from(bits as u32),
        Kind::I64 => bits as i64 as f64,
        Kind::U64 => bits as f64,
        Kind::F32 => f64::from(f32::from_bits(bits as u32)),
        Kind::F64 => f64::from_bits(bits),
    }
}
