//! Writing a cloud.

use std::io::Write;
use std::sync::Arc;

use super::ply::kind_name;
use super::{Format, FormatError, PcdEncoding, PlyEncoding, Scalar, Separator, e57, las, npy, pcd};
use densecloud_cloud::{Attribute, Column, Kind, Origin, Position, Table, Values, each_kind};

/// Points encoded between two writes to the sink.
const BLOCK: usize = 4096;

/// Bytes of a table gathered between two writes to the sink.
const FLUSH: usize = 64 * 1024;

/// Writes one cloud in parts: the header at once, then any number of [`write`](Self::write)s, then
/// [`finish`](Self::finish), which writes the tables of a PLY file.
///
/// Text holds the shortest decimals that read back as the same number. The output depends on what is
/// given alone: no date, no name of a machine.
#[derive(Debug)]
pub struct CloudWriter<W: Write> {
    sink: W,
    format: Format,
    /// Of each attribute.
    kinds: Vec<Kind>,
    /// Written after the points.
    tables: Arc<Vec<Table>>,
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
        Format::E57 => e57::encode(positions, attributes, origin)?,
        // `with` refuses what is not written.
        Format::Off
        | Format::Obj
        | Format::Ply { .. }
        | Format::Xyz { .. }
        | Format::Npy { .. }
        | Format::Pcd { .. } => {
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
            Format::Npy { scalar, fields } => {
                sink.write_all(&npy::header(scalar, fields, points, attributes))?;
            }
            Format::Pcd { encoding: encoding @ (PcdEncoding::Ascii | PcdEncoding::Binary), scalar } => {
                sink.write_all(pcd::header(encoding, scalar, points, attributes, origin).as_bytes())?;
            }
            Format::Off | Format::Obj => {
                return Err(FormatError::NotWritten("OFF and OBJ are read only".into()));
            }
            Format::Las { .. } | Format::Pcd { .. } | Format::E57 => {
                let why = "LAS, LAZ, E57 and compressed PCD are made as a whole, not in parts";
                return Err(FormatError::NotWritten(why.into()));
            }
        }
        let kinds = attributes.iter().map(|a| a.values.kind()).collect();
        let tables = Arc::clone(&origin.tables);
        Ok(Self { sink, format, kinds, tables, promised: points, written: 0, scratch: Vec::new() })
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
                Format::Las { .. } | Format::E57 | Format::Off | Format::Obj => {}
                Format::Xyz { separator, .. } => write_text(scratch, block, attributes, from, separator, Ok)?,
                Format::Npy { scalar: Scalar::F32, fields } => {
                    write_npy(scratch, block, attributes, from, fields, |v| narrow(v).map(f32::to_le_bytes))?;
                }
                Format::Npy { scalar: Scalar::F64, fields } => {
                    write_npy(scratch, block, attributes, from, fields, |v| Ok(v.to_le_bytes()))?;
                }
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

    /// Writes what follows the points, flushes, and gives the sink back.
    ///
    /// # Errors
    /// The sink fails, or fewer points were written than promised.
    pub fn finish(mut self) -> Result<W, FormatError> {
        if self.written != self.promised {
            return Err(FormatError::WrongCount { promised: self.promised, written: self.written });
        }
        if let Format::Ply { encoding, .. } = self.format {
            for table in self.tables.iter() {
                write_table(&mut self.sink, &mut self.scratch, encoding, table)?;
            }
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
    let encoding = encoding.name();
    let scalar = match scalar {
        Scalar::F32 => "float",
        Scalar::F64 => "double",
    };
    let mut header = format!("ply\nformat {encoding} 1.0\n");
    if let Some(crs) = &origin.crs {
        header += &format!("comment {CRS}{crs}\n");
    }
    for comment in &origin.comments {
        header += &format!("comment {}\n", comment.replace(char::is_control, " "));
    }
    header += &format!("element vertex {points}\n");
    for axis in ["x", "y", "z"] {
        header += &format!("property {scalar} {axis}\n");
    }
    for attribute in attributes {
        let kind = kind_name(attribute.values.kind());
        header += &format!("property {kind} {}\n", one_word(&attribute.name));
    }
    for table in origin.tables.iter() {
        header += &format!("element {} {}\n", one_word(&table.name), table.rows);
        for (name, column) in &table.columns {
            let kind = match column {
                Column::Scalar(values) => kind_name(values.kind()).to_owned(),
                Column::List { lengths, items } => {
                    format!("list {} {}", kind_name(lengths.kind()), kind_name(items.kind()))
                }
            };
            header += &format!("property {kind} {}\n", one_word(name));
        }
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

/// Rows of a NumPy array: as fields, or all numbers in the type of the coordinates.
fn write_npy<const N: usize>(
    scratch: &mut Vec<u8>,
    block: &[Position],
    attributes: &[Attribute],
    from: usize,
    fields: bool,
    convert: impl Fn(f64) -> Result<[u8; N], FormatError>,
) -> Result<(), FormatError> {
    if fields {
        return write_binary(scratch, block, attributes, from, false, convert);
    }
    for (i, position) in block.iter().enumerate() {
        let others = attributes.iter().map(|attribute| attribute.values.get(from + i));
        for number in position.iter().copied().chain(others) {
            scratch.extend_from_slice(&convert(number)?);
        }
    }
    Ok(())
}

/// Writes an element of a PLY file row by row.
fn write_table<W: Write>(
    sink: &mut W,
    scratch: &mut Vec<u8>,
    encoding: PlyEncoding,
    table: &Table,
) -> Result<(), FormatError> {
    // Where the next row's items begin, in each list.
    let mut starts = vec![0; table.columns.len()];
    scratch.clear();
    for row in 0..table.rows {
        for ((_, column), start) in table.columns.iter().zip(&mut starts) {
            match column {
                Column::Scalar(values) => write_number(scratch, encoding, values, row)?,
                Column::List { lengths, items } => {
                    write_number(scratch, encoding, lengths, row)?;
                    let end = *start + lengths.get(row) as usize;
                    for item in *start..end {
                        write_number(scratch, encoding, items, item)?;
                    }
                    *start = end;
                }
            }
        }
        if encoding == PlyEncoding::Ascii {
            // In place of the last space.
            scratch.pop();
            scratch.push(b'\n');
        }
        if scratch.len() >= FLUSH {
            sink.write_all(scratch)?;
            scratch.clear();
        }
    }
    sink.write_all(scratch)?;
    Ok(())
}

/// Writes one number of a column, and in text a space after it.
fn write_number(
    scratch: &mut Vec<u8>,
    encoding: PlyEncoding,
    values: &Values,
    index: usize,
) -> Result<(), FormatError> {
    each_kind!(values, column => match encoding {
        PlyEncoding::Ascii => write!(scratch, "{:?} ", column[index])?,
        PlyEncoding::BinaryLittleEndian => scratch.extend_from_slice(&column[index].to_le_bytes()),
        PlyEncoding::BinaryBigEndian => scratch.extend_from_slice(&column[index].to_be_bytes()),
    });
    Ok(())
}
