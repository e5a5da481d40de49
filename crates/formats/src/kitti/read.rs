//! Reading.

use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::source::Source;
use super::super::{FormatError, Header, Limits, Place};
use super::Sweep;
use densecloud_cloud::{Kind, Origin, Values};

/// Bytes of a number.
const NUMBER: usize = 4;

/// What a point has beside its position.
const NAMES: [&str; 2] = ["intensity", "ring"];

/// More lasers than any sensor has.
const RINGS: f32 = 1024.0;

/// The points of a sweep.
pub(super) struct KittiPoints {
    names: &'static [&'static str],
    format: Sweep,
    limits: Limits,
    /// Points given.
    given: u64,
}

impl KittiPoints {
    /// There is nothing before the points.
    pub(super) fn open(
        source: &mut Source<'_>,
        limits: Limits,
        format: Sweep,
    ) -> Result<(Self, Header), FormatError> {
        if source.peek(1)?.is_empty() {
            return Err(FormatError::Empty("points"));
        }
        let names = if format.ring { &NAMES[..] } else { &NAMES[..1] };
        let header = Header {
            format: format.into(),
            points: None,
            attributes: names.iter().map(|name| (*name).to_owned()).collect(),
            dropped_properties: Vec::new(),
        };
        Ok((Self { names, format, limits, given: 0 }, header))
    }

    /// Bytes of a point.
    fn stride(&self) -> usize {
        NUMBER * (3 + self.names.len())
    }

    /// Where a point stands.
    fn place(&self, point: u64) -> Place {
        Place::Byte(point * self.stride() as u64)
    }

    /// Refuses numbers that no such sweep has: with another number of them a point, nearly every one would be in the place
    /// of another. `from` is the number of the first.
    fn check(&self, columns: &[Values], rows: usize, from: u64) -> Result<(), FormatError> {
        for (name, column) in self.names.iter().zip(columns) {
            let Values::F32(numbers) = column else { continue };
            let is_wrong = |v: &f32| match *name {
                "ring" => !v.is_nan() && (v.fract() != 0.0 || !(0.0..RINGS).contains(v)),
                _ => *v < 0.0,
            };
            let new = &numbers[numbers.len() - rows..];
            if let Some(row) = new.iter().position(is_wrong) {
                let (format, number) = (self.format, new[row]);
                let why = format!("{name} {number}: these are not the points of {format}");
                return Err(FormatError::malformed(self.place(from + row as u64), why));
            }
        }
        Ok(())
    }
}

impl Points for KittiPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if to.columns.is_empty() {
            to.columns = self.names.iter().map(|_| Values::new(Kind::F32)).collect();
        }
        let stride = self.stride();
        if !source.ensure(stride)? {
            let left = source.buffered().len();
            if left > 0 {
                let (format, given) = (self.format, self.given);
                let why =
                    format!("{left} bytes behind {given} points of {stride} bytes: this is not {format}");
                return Err(FormatError::truncated(self.place(given), why));
            }
            return Ok(());
        }
        let rows = rows.min(source.buffered().len() / stride);
        let block = &source.buffered()[..rows * stride];
        let number = |row: &[u8], at: usize| {
            let at = at * NUMBER;
            f64::from(f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]))
        };
        to.positions.extend(block.chunks_exact(stride).map(|row| [0, 1, 2].map(|axis| number(row, axis))));
        for (i, column) in to.columns.iter_mut().enumerate() {
            column.extend_from_bytes(block.chunks_exact(stride).map(|row| &row[NUMBER * (3 + i)..]), false);
        }
        source.consume(rows * stride);
        self.check(&to.columns, rows, self.given)?;
        self.given += rows as u64;
        self.limits.check_points(self.given)
    }

    fn finish(self: Box<Self>, _source: &mut Source<'_>) -> Result<Ending, FormatError> {
        let named = |name: &&str| Some(ColumnName { name: (*name).to_owned(), kind: Kind::F32 });
        let columns = self.names.iter().map(named).collect();
        Ok(Ending { columns, dropped_properties: Vec::new(), notes: Vec::new(), origin: Origin::default() })
    }
}
