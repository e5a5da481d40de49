//! Writing a cloud.

use std::io::Write;

use super::{Format, FormatError, PlyEncoding, Scalar};
use crate::cloud::Position;

/// Points encoded between two writes to the sink.
const BLOCK: usize = 4096;

/// Writes one cloud in parts: the header at once, then any number of [`write`](Self::write)s.
///
/// Text holds the shortest decimals that read back as the same number. The output depends on the
/// points alone: no date, no version, no name of a machine.
#[derive(Debug)]
pub struct CloudWriter<W: Write> {
    sink: W,
    format: Format,
    promised: u64,
    written: u64,
    scratch: Vec<u8>,
}

impl<W: Write> CloudWriter<W> {
    /// Writes the header of a cloud of exactly `points` points.
    ///
    /// # Errors
    /// The sink fails.
    pub fn new(mut sink: W, format: Format, points: u64) -> Result<Self, FormatError> {
        if let Format::Ply { encoding, scalar } = format {
            sink.write_all(ply_header(encoding, scalar, points).as_bytes())?;
        }
        Ok(Self { sink, format, promised: points, written: 0, scratch: Vec::new() })
    }

    /// Appends positions.
    ///
    /// # Errors
    /// The sink fails, there are more points than promised (then none of these is written), or a
    /// finite coordinate is beyond the range of [`Scalar::F32`].
    pub fn write(&mut self, positions: &[Position]) -> Result<(), FormatError> {
        let written = self.written.saturating_add(positions.len() as u64);
        if written > self.promised {
            return Err(FormatError::WrongCount { promised: self.promised, written });
        }
        for block in positions.chunks(BLOCK) {
            self.scratch.clear();
            match self.format {
                Format::Xyz => write_text(&mut self.scratch, block, Ok)?,
                Format::Ply { encoding, scalar } => match (encoding, scalar) {
                    (PlyEncoding::Ascii, Scalar::F32) => write_text(&mut self.scratch, block, narrow)?,
                    (PlyEncoding::Ascii, Scalar::F64) => write_text(&mut self.scratch, block, Ok)?,
                    (PlyEncoding::BinaryLittleEndian, Scalar::F32) => {
                        write_binary(&mut self.scratch, block, |v| narrow(v).map(f32::to_le_bytes))?;
                    }
                    (PlyEncoding::BinaryBigEndian, Scalar::F32) => {
                        write_binary(&mut self.scratch, block, |v| narrow(v).map(f32::to_be_bytes))?;
                    }
                    (PlyEncoding::BinaryLittleEndian, Scalar::F64) => {
                        write_binary(&mut self.scratch, block, |v| Ok(v.to_le_bytes()))?;
                    }
                    (PlyEncoding::BinaryBigEndian, Scalar::F64) => {
                        write_binary(&mut self.scratch, block, |v| Ok(v.to_be_bytes()))?;
                    }
                },
            }
            self.sink.write_all(&self.scratch)?;
            self.written += block.len() as u64;
        }
        Ok(())
    }

    /// Flushes and gives the sink back.
    ///
    /// # Errors
    /// The sink fails, or fewer points were written than promised.
    pub fn finish(mut self) -> Result<W, FormatError> {
        if self.written != self.promised {
            return Err(FormatError::WrongCount { promised: self.promised, written: self.written });
        }
        self.sink.flush()?;
        Ok(self.sink)
    }
}

/// The header that [`CloudWriter`] writes before the points of a PLY file.
pub(super) fn ply_header(encoding: PlyEncoding, scalar: Scalar, points: u64) -> String {
    let encoding = match encoding {
        PlyEncoding::Ascii => "ascii",
        PlyEncoding::BinaryLittleEndian => "binary_little_endian",
        PlyEncoding::BinaryBigEndian => "binary_big_endian",
    };
    let scalar = match scalar {
        Scalar::F32 => "float",
        Scalar::F64 => "double",
    };
    format!(
        "ply\nformat {encoding} 1.0\ncomment densecloud\nelement vertex {points}\n\
         property {scalar} x\nproperty {scalar} y\nproperty {scalar} z\nend_header\n"
    )
}

fn narrow(value: f64) -> Result<f32, FormatError> {
    let narrowed = value as f32;
    if narrowed.is_infinite() && value.is_finite() {
        return Err(FormatError::Unrepresentable(value));
    }
    Ok(narrowed)
}

/// `Debug` prints the shortest decimals that read back the same, as `Display` does, but with an
/// exponent where that is shorter than hundreds of zeros.
fn write_text<T: std::fmt::Debug>(
    scratch: &mut Vec<u8>,
    block: &[Position],
    convert: impl Fn(f64) -> Result<T, FormatError>,
) -> Result<(), FormatError> {
    for [x, y, z] in block {
        writeln!(scratch, "{:?} {:?} {:?}", convert(*x)?, convert(*y)?, convert(*z)?)?;
    }
    Ok(())
}

fn write_binary<const N: usize>(
    scratch: &mut Vec<u8>,
    block: &[Position],
    convert: impl Fn(f64) -> Result<[u8; N], FormatError>,
) -> Result<(), FormatError> {
    for coordinate in block.as_flattened() {
        scratch.extend_from_slice(&convert(*coordinate)?);
    }
    Ok(())
}
