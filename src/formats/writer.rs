//! Writing a cloud.

use std::io::Write;

use super::ply::kind_name;
use super::{Format, FormatError, PcdEncoding, PlyEncoding, Scalar, Separator, las, pcd};
use crate::cloud::{Attribute, Kind, Origin, Position, each_kind};

/// Points encoded between two writes to the sink.
const BLOCK: usize = 4096;

/// Writes one cloud in parts: the header at once, then any number of [`write`](Self::write)s.
///
/// Text holds the shortest decimals that read back as the same number. The output depends on what is
/// given alone: no date, no name of a machine.
#[derive(Debug)]
pub struct CloudWriter<W: Write> {
    sink: W,
    format: Format,
    /// Of each attribute.
    kinds: Vec<Kind>,
    promised: u64,
    written: u64,
    scratch: Vec<u8>,
}

/// Writes a whole cloud, in any format. `origin` is what its source told of the whole.
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
    let whole = match format {
        Format::Las { compressed } => las::encode(positions, attributes, origin, compressed)?,
        Format::Pcd { encoding: PcdEncoding::Compressed, scalar } => {
            pcd::encode_compressed(scalar, positions, attributes, origin)?
        }
        Format::Ply { .. } | Format::Xyz { .. } | Format::Pcd { .. } => {
            let mut writer = CloudWriter::with(sink, format, positions.len() as u64, attributes, origin)?;
            writer.write_rows(positions, attributes, 0)?;
            return writer.finish();
        }
    };
    sink.write_all(&whole)?;
    sink.flush()?;
    Ok(sink)
}

impl<W: Write> CloudWriter<W> {
    /// Writes the header of a cloud of exactly `points` points, of which nothing but positions is told.
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
        match format {
            Format::Ply { encoding, scalar } => {
                sink.write_all(ply_header(encoding, scalar, points, attributes, origin).as_bytes())?;
            }
            Format::Xyz { names: true, separator } => {
                sink.write_all(names_line(attributes, separator).as_bytes())?;
            }
            Format::Xyz { names: false, .. } => {}
            Format::Pcd { encoding: encoding @ (PcdEncoding::Ascii | PcdEncoding::Binary), scalar } => {
                sink.write_all(pcd::header(encoding, scalar, points, attributes, origin).as_bytes())?;
            }
            Format::Las { .. } | Format::Pcd { .. } => {
                let why = "LAS, LAZ and compressed PCD are made as a whole, not in parts";
                return Err(FormatError::NotWritten(why.into()));
            }
        }
        let kinds = attributes.iter().map(|a| a.values.kind()).collect();
        Ok(Self { sink, format, kinds, promised: points, written: 0, scratch: Vec::new() })
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
    /// finite coordinate is beyond the range of [`Scalar::F32`].
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
        for (i, block) in positions.chunks(BLOCK).enumerate() {
            let from = from + i * BLOCK;
            self.scratch.clear();
            let scratch = &mut self.scratch;
            match self.format {
                // `with` lets none of the others through.
                Format::Las { .. } => {}
                Format::Xyz { separator, .. } => write_text(scratch, block, attributes, from, separator, Ok)?,
                Format::Ply { encoding, scalar } => {
                    write_numbers(scratch, block, attributes, from, encoding, scalar)?;
                }
                Format::Pcd { encoding, scalar } => {
                    let fields = pcd::columns(attributes, encoding, from..from + block.len());
                    let encoding = match encoding {
                        PcdEncoding::Ascii => PlyEncoding::Ascii,
                        PcdEncoding::Binary | PcdEncoding::Compressed => PlyEncoding::BinaryLittleEndian,
                    };
                    write_numbers(scratch, block, &fields, 0, encoding, scalar)?;
                }
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

/// What begins the comment that tells the coordinate system.
pub(super) const CRS: &str = "crs: ";

/// The header that [`CloudWriter`] writes before the points of a PLY file.
pub(super) fn ply_header(
    encoding: PlyEncoding,
    scalar: Scalar,
    points: u64,
    attributes: &[Attribute],
    origin: &Origin,
) -> String {
    let encoding = match encoding {
        PlyEncoding::Ascii => "ascii",
        PlyEncoding::BinaryLittleEndian => "binary_little_endian",
        PlyEncoding::BinaryBigEndian => "binary_big_endian",
    };
    let scalar = match scalar {
        Scalar::F32 => "float",
        Scalar::F64 => "double",
    };
    let mut header = format!("ply\nformat {encoding} 1.0\n");
    if let Some(crs) = &origin.crs {
        header += &format!("comment {CRS}{crs}\n");
    }
    for comment in &origin.comments {
        header += &format!("comment {comment}\n");
    }
    header += &format!("element vertex {points}\n");
    for axis in ["x", "y", "z"] {
        header += &format!("property {scalar} {axis}\n");
    }
    for attribute in attributes {
        let kind = kind_name(attribute.values.kind());
        header += &format!("property {kind} {}\n", one_word(&attribute.name));
    }
    header + "end_header\n"
}

/// The line that names the columns of a text file.
fn names_line(attributes: &[Attribute], separator: Separator) -> String {
    let mut names = ["x", "y", "z"].map(str::to_owned).to_vec();
    names.extend(attributes.iter().map(|a| one_word(&a.name)));
    names.join(separator.as_str()) + "\n"
}

/// A name without what would end it in a header or a line of columns.
pub(super) fn one_word(name: &str) -> String {
    let ends = |c: char| c.is_whitespace() || c.is_control() || matches!(c, ',' | ';');
    name.replace(ends, "_")
}

fn narrow(value: f64) -> Result<f32, FormatError> {
    let narrowed = value as f32;
    if narrowed.is_infinite() && value.is_finite() {
        return Err(FormatError::Unrepresentable(value));
    }
    Ok(narrowed)
}

fn write_numbers(
    scratch: &mut Vec<u8>,
    block: &[Position],
    attributes: &[Attribute],
    from: usize,
    encoding: PlyEncoding,
    scalar: Scalar,
) -> Result<(), FormatError> {
    match (encoding, scalar) {
        (PlyEncoding::Ascii, Scalar::F32) => {
            write_text(scratch, block, attributes, from, Separator::Space, narrow)
        }
        (PlyEncoding::Ascii, Scalar::F64) => {
            write_text(scratch, block, attributes, from, Separator::Space, Ok)
        }
        (PlyEncoding::BinaryLittleEndian, Scalar::F32) => {
            write_binary(scratch, block, attributes, from, false, |v| narrow(v).map(f32::to_le_bytes))
        }
        (PlyEncoding::BinaryBigEndian, Scalar::F32) => {
            write_binary(scratch, block, attributes, from, true, |v| narrow(v).map(f32::to_be_bytes))
        }
        (PlyEncoding::BinaryLittleEndian, Scalar::F64) => {
            write_binary(scratch, block, attributes, from, false, |v| Ok(v.to_le_bytes()))
        }
        (PlyEncoding::BinaryBigEndian, Scalar::F64) => {
            write_binary(scratch, block, attributes, from, true, |v| Ok(v.to_be_bytes()))
        }
    }
}

/// `Debug` prints the shortest decimals that read back the same, as `Display` does, but with an
/// exponent where that is shorter than hundreds of zeros.
fn write_text<T: std::fmt::Debug>(
    scratch: &mut Vec<u8>,
    block: &[Position],
    attributes: &[Attribute],
    from: usize,
    separator: Separator,
    convert: impl Fn(f64) -> Result<T, FormatError>,
) -> Result<(), FormatError> {
    let s = separator.as_str();
    for (i, [x, y, z]) in block.iter().enumerate() {
        write!(scratch, "{:?}{s}{:?}{s}{:?}", convert(*x)?, convert(*y)?, convert(*z)?)?;
        for attribute in attributes {
            each_kind!(&attribute.values, column => write!(scratch, "{s}{:?}", column[from + i])?);
        }
        scratch.push(b'\n');
    }
    Ok(())
}

fn write_binary<const N: usize>(
    scratch: &mut Vec<u8>,
    block: &[Position],
    attributes: &[Attribute],
    from: usize,
    big: bool,
    convert: impl Fn(f64) -> Result<[u8; N], FormatError>,
) -> Result<(), FormatError> {
    if attributes.is_empty() {
        for coordinate in block.as_flattened() {
            scratch.extend_from_slice(&convert(*coordinate)?);
        }
        return Ok(());
    }
    // A column at a time, into rows.
    let stride = 3 * N + attributes.iter().map(|a| a.values.kind().size()).sum::<usize>();
    scratch.resize(block.len() * stride, 0);
    for (row, position) in scratch.chunks_exact_mut(stride).zip(block) {
        for (bytes, coordinate) in row.chunks_exact_mut(N).zip(position) {
            bytes.copy_from_slice(&convert(*coordinate)?);
        }
    }
    let mut offset = 3 * N;
    for attribute in attributes {
        let size = attribute.values.kind().size();
        each_kind!(&attribute.values, column => {
            let numbers = &column[from..from + block.len()];
            for (row, number) in scratch.chunks_exact_mut(stride).zip(numbers) {
                let bytes = if big { number.to_be_bytes() } else { number.to_le_bytes() };
                row[offset..offset + size].copy_from_slice(&bytes);
            }
        });
        offset += size;
    }
    Ok(())
}
