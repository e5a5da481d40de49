//! Writing a cloud.

use std::io::Write;

use super::kind::Rows;
use super::{Format, FormatError};
use densecloud_cloud::{Attribute, Kind, Origin, Position};

/// Points encoded between two writes to the sink.
const BLOCK: usize = 4096;

/// Writes one cloud in parts: the header at once, then any number of [`write`](Self::write)s, then
/// [`finish`](Self::finish), which writes the tables of a PLY file.
///
/// Text holds the shortest decimals that read back as the same number. The output depends on what is
/// given alone: no date, no name of a machine.
#[derive(Debug)]
pub struct CloudWriter<W: Write> {
    sink: W,
    rows: Box<dyn Rows>,
    /// Of each attribute.
    kinds: Vec<Kind>,
    promised: u64,
    written: u64,
    scratch: Vec<u8>,
}

/// Writes a whole cloud, in any format. `origin` is what its source told of the whole.
///
/// Points are encoded and written some thousand at a time. The header of a format that is not
/// [streamed](Format::is_streamed) depends on all points, so it costs a pass over the columns first. LAZ and E57 files are
/// made as a whole before they are written: in memory up to 64 MiB, in a temporary file beyond. Compressed PCD is made in
/// memory.
///
/// # Errors
/// The sink fails, a coordinate is beyond what the format holds, or a point's attributes are.
pub fn encode<W: Write>(
    mut sink: W,
    format: Format,
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<W, FormatError> {
    format.ask(|format| format.encode(&mut sink, positions, attributes, origin))?;
    sink.flush()?;
    Ok(sink)
}

/// Writes what [`Choices::begin`](super::kind::Choices::begin) has begun.
pub(super) fn write_streamed(
    sink: &mut dyn Write,
    (header, rows): (Vec<u8>, Box<dyn Rows>),
    positions: &[Position],
    attributes: &[Attribute],
) -> Result<(), FormatError> {
    sink.write_all(&header)?;
    write_blocks(sink, rows.as_ref(), &mut Vec::new(), positions, attributes, 0)?;
    rows.end(sink)
}

/// Writes points block by block. The first point's attributes are at row `from`.
fn write_blocks(
    sink: &mut dyn Write,
    rows: &dyn Rows,
    scratch: &mut Vec<u8>,
    positions: &[Position],
    attributes: &[Attribute],
    from: usize,
) -> Result<(), FormatError> {
    for (i, block) in positions.chunks(BLOCK).enumerate() {
        scratch.clear();
        rows.put(scratch, block, attributes, from + i * BLOCK)?;
        sink.write_all(scratch)?;
    }
    Ok(())
}

impl<W: Write> CloudWriter<W> {
    /// Writes the header of a cloud of exactly `points` points without attributes.
    ///
    /// # Errors
    /// As [`with`](Self::with).
    pub fn new(sink: W, format: Format, points: u64) -> Result<Self, FormatError> {
        Self::with(sink, format, points, &[], &Origin::default())
    }

    /// Writes the header of a cloud of exactly `points` points with attributes of these names and types.
    ///
    /// # Errors
    /// The sink fails, or the format is not [streamed](Format::is_streamed).
    pub fn with(
        mut sink: W,
        format: Format,
        points: u64,
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<Self, FormatError> {
        let (header, rows) = format.ask(|format| format.begin(points, attributes, origin))?;
        sink.write_all(&header)?;
        let kinds = attributes.iter().map(|a| a.values.kind()).collect();
        Ok(Self { sink, rows, kinds, promised: points, written: 0, scratch: Vec::new() })
    }

    /// Appends points of a cloud without attributes.
    ///
    /// # Errors
    /// As [`write_rows`](Self::write_rows).
    pub fn write(&mut self, positions: &[Position]) -> Result<(), FormatError> {
        self.write_rows(positions, &[], 0)
    }

    /// Appends points: the first of `positions` has the attributes' values at row `from`.
    ///
    /// # Errors
    /// The sink fails, there are more points than promised (then none of these is written), or a
    /// finite coordinate is beyond the range of [`Scalar::F32`](super::Scalar::F32).
    ///
    /// # Panics
    /// When the attributes are not of the promised types, or have too few rows.
    pub fn write_rows(
        &mut self,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        let written = self.written.saturating_add(positions.len() as u64);
        if written > self.promised {
            return Err(FormatError::WrongCount { promised: self.promised, written });
        }
        assert!(
            attributes.iter().map(|a| a.values.kind()).eq(self.kinds.iter().copied()),
            "other attributes than promised"
        );
        write_blocks(&mut self.sink, self.rows.as_ref(), &mut self.scratch, positions, attributes, from)?;
        self.written = written;
        Ok(())
    }

    /// Writes what follows the points, flushes, and gives the sink back.
    ///
    /// # Errors
    /// The sink fails, or fewer points were written than promised.
    pub fn finish(mut self) -> Result<W, FormatError> {
        if self.written != self.promised {
            return Err(FormatError::WrongCount { promised: self.promised, written: self.written });
        }
        self.rows.end(&mut self.sink)?;
        self.sink.flush()?;
        Ok(self.sink)
    }
}
