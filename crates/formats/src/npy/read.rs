//! Reading.

use super::super::columns::Guess;
use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::source::Source;
use super::super::{Format, FormatError, Header, Limits, Scalar};
use super::header::Array;
use densecloud_cloud::{Origin, Position, Values};

/// An array of points, read up to its data.
pub(super) struct NpyPoints {
    array: Array,
    /// Points read.
    row: u64,
    /// What the other fields may be called, where nothing names them.
    guess: Guess,
}

impl NpyPoints {
    /// Reads the header.
    pub(super) fn open(source: &mut Source<'_>, limits: Limits) -> Result<(Self, Header), FormatError> {
        let (array, dropped_properties) = Array::read(source)?;
        limits.check_points(array.points)?;
        let bytes = array.points.saturating_mul(array.stride as u64);
        limits.check_bytes(bytes)?;
        let narrow = array.axes.iter().all(|axis| array.fields[*axis].number.kind.fits_f32());
        let scalar = if narrow { Scalar::F32 } else { Scalar::F64 };
        let header = Header {
            format: Format::Npy { scalar, fields: array.named },
            points: Some(array.points),
            attributes: array.others().map(|field| field.name.clone()).collect(),
            dropped_properties,
        };
        Ok((Self { array, row: 0, guess: Guess::default() }, header))
    }

    /// An empty column for each field but the position.
    fn columns(&self) -> Vec<Values> {
        self.array.others().map(|field| Values::new(field.number.kind)).collect()
    }

    fn missing(&self, source: &Source<'_>, row: u64) -> FormatError {
        let why = format!("the header counts {} points, and {row} are there", self.array.points);
        FormatError::truncated(source.offset(), why)
    }

    /// Reads the rows in the buffer, at most `rows` of them.
    fn append_rows(
        &mut self,
        source: &mut Source<'_>,
        rows: usize,
        to: &mut Block,
    ) -> Result<(), FormatError> {
        if self.row == self.array.points {
            return Ok(());
        }
        let stride = self.array.stride;
        if !source.ensure(stride)? {
            return Err(self.missing(source, self.row));
        }
        let left = usize::try_from(self.array.points - self.row).unwrap_or(usize::MAX);
        let rows = left.min(rows).min(source.buffered().len() / stride);
        let block = &source.buffered()[..rows * stride];
        let bytes = |offset: usize| block.chunks_exact(stride).map(move |row| &row[offset..]);
        let axes = self.array.axes.map(|axis| {
            let field = &self.array.fields[axis];
            let mut numbers = Values::new(field.number.kind);
            field.number.extend(&mut numbers, bytes(field.offset));
            numbers
        });
        to.positions.extend(positions(&axes));
        for (field, column) in self.array.others().zip(&mut to.columns) {
            field.number.extend(column, bytes(field.offset));
        }
        source.consume(rows * stride);
        self.row += rows as u64;
        Ok(())
    }

    /// All points of an array that has its columns one after another.
    fn append_columns(&mut self, source: &mut Source<'_>, to: &mut Block) -> Result<(), FormatError> {
        if self.row == self.array.points {
            return Ok(());
        }
        let mut columns: Vec<Values> = Vec::with_capacity(self.array.fields.len());
        for field in &self.array.fields {
            let (size, mut column) = (field.number.size(), Values::new(field.number.kind));
            let mut row = 0;
            while row < self.array.points {
                if !source.ensure(size)? {
                    return Err(self.missing(source, row));
                }
                let left = usize::try_from(self.array.points - row).unwrap_or(usize::MAX);
                let rows = left.min(source.buffered().len() / size);
                field.number.extend(&mut column, source.buffered()[..rows * size].chunks_exact(size));
                source.consume(rows * size);
                row += rows as u64;
            }
            columns.push(column);
        }
        // The first three are the position.
        let others = columns.split_off(3);
        if let Ok(axes) = <[Values; 3]>::try_from(columns) {
            to.positions.extend(positions(&axes));
        }
        to.columns = others;
        self.row = self.array.points;
        Ok(())
    }
}

impl Points for NpyPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        let from = to.positions.len();
        if to.columns.is_empty() {
            to.columns = self.columns();
        }
        if self.array.by_column {
            self.append_columns(source, to)?;
        } else {
            self.append_rows(source, rows, to)?;
        }
        if !self.array.named {
            self.guess.see(&to.columns, from);
        }
        Ok(())
    }

    fn finish(self: Box<Self>, source: &mut Source<'_>) -> Result<Ending, FormatError> {
        source.expect_end("the points that the header counts")?;
        let mut names: Vec<String> = self.array.others().map(|field| field.name.clone()).collect();
        if !self.array.named {
            // Arrays hold bytes as floats, too.
            self.guess.name(&mut names, |column| self.guess.is_bytes(column));
        }
        let columns = names.into_iter().zip(self.array.others());
        let columns =
            columns.map(|(name, field)| Some(ColumnName { name, kind: field.number.kind })).collect();
        Ok(Ending { columns, dropped_properties: Vec::new(), notes: Vec::new(), origin: Origin::default() })
    }
}

fn positions([x, y, z]: &[Values; 3]) -> impl Iterator<Item = Position> {
    (0..x.len()).map(move |i| [x.get(i), y.get(i), z.get(i)])
}
