//! Numbers to bytes and to text, for every format that stores rows.

use std::io::Write;

use super::{FormatError, Scalar};
use densecloud_cloud::{Attribute, Position, Values, each_kind};

/// How rows of numbers are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Storage {
    /// A line a row, with this between two numbers.
    Text(&'static str),
    LittleEndian,
    BigEndian,
}

impl Storage {
    /// Bytes that a row of text takes, about, and mostly less, where in memory the position takes `position` and the
    /// attributes take `attributes`: what takes one byte there is four characters with what parts it from the next,
    /// `255 ` or `-128`; what takes eight is 24 at most, but for numbers such as 1e-300.
    pub(super) fn text_bytes(position: u64, attributes: u64) -> u64 {
        3 * position + 4 * attributes
    }
}

/// What begins the comment that tells the coordinate system.
pub(super) const CRS: &str = "crs: ";

/// Appends a row a point: the position as `scalar`, then the attributes. The first point's attributes are at row `from`.
///
/// # Errors
/// A finite coordinate is beyond the range of [`Scalar::F32`].
pub(super) fn put_rows(
    bytes: &mut Vec<u8>,
    positions: &[Position],
    attributes: &[Attribute],
    from: usize,
    storage: Storage,
    scalar: Scalar,
) -> Result<(), FormatError> {
    match (storage, scalar) {
        (Storage::Text(between), Scalar::F32) => {
            put_text(bytes, positions, attributes, from, between, narrow)
        }
        (Storage::Text(between), Scalar::F64) => put_text(bytes, positions, attributes, from, between, Ok),
        (Storage::LittleEndian, Scalar::F32) => {
            put_binary(bytes, positions, attributes, from, false, |v| narrow(v).map(f32::to_le_bytes))
        }
        (Storage::BigEndian, Scalar::F32) => {
            put_binary(bytes, positions, attributes, from, true, |v| narrow(v).map(f32::to_be_bytes))
        }
        (Storage::LittleEndian, Scalar::F64) => {
            put_binary(bytes, positions, attributes, from, false, |v| Ok(v.to_le_bytes()))
        }
        (Storage::BigEndian, Scalar::F64) => {
            put_binary(bytes, positions, attributes, from, true, |v| Ok(v.to_be_bytes()))
        }
    }
}

/// Appends rows of the coordinates and attributes, all in the type of the coordinates.
///
/// # Errors
/// As [`put_rows`].
pub(super) fn put_table(
    bytes: &mut Vec<u8>,
    positions: &[Position],
    attributes: &[Attribute],
    from: usize,
    scalar: Scalar,
) -> Result<(), FormatError> {
    for (i, position) in positions.iter().enumerate() {
        let others = attributes.iter().map(|attribute| attribute.values.get(from + i));
        for number in position.iter().copied().chain(others) {
            match scalar {
                Scalar::F32 => bytes.extend_from_slice(&narrow(number)?.to_le_bytes()),
                Scalar::F64 => bytes.extend_from_slice(&number.to_le_bytes()),
            }
        }
    }
    Ok(())
}

/// Appends one number of a column, and in text what stands between two.
pub(super) fn put_number(
    bytes: &mut Vec<u8>,
    storage: Storage,
    values: &Values,
    index: usize,
) -> Result<(), FormatError> {
    each_kind!(values, column => match storage {
        Storage::Text(between) => write!(bytes, "{:?}{between}", column[index])?,
        Storage::LittleEndian => bytes.extend_from_slice(&column[index].to_le_bytes()),
        Storage::BigEndian => bytes.extend_from_slice(&column[index].to_be_bytes()),
    });
    Ok(())
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

/// `Debug` prints the shortest decimals that read back the same, as `Display` does, but with an
/// exponent where that is shorter than hundreds of zeros.
fn put_text<T: std::fmt::Debug>(
    bytes: &mut Vec<u8>,
    positions: &[Position],
    attributes: &[Attribute],
    from: usize,
    between: &str,
    convert: impl Fn(f64) -> Result<T, FormatError>,
) -> Result<(), FormatError> {
    for (i, [x, y, z]) in positions.iter().enumerate() {
        write!(bytes, "{:?}{between}{:?}{between}{:?}", convert(*x)?, convert(*y)?, convert(*z)?)?;
        for attribute in attributes {
            each_kind!(&attribute.values, column => write!(bytes, "{between}{:?}", column[from + i])?);
        }
        bytes.push(b'\n');
    }
    Ok(())
}

fn put_binary<const N: usize>(
    out: &mut Vec<u8>,
    positions: &[Position],
    attributes: &[Attribute],
    from: usize,
    big: bool,
    convert: impl Fn(f64) -> Result<[u8; N], FormatError>,
) -> Result<(), FormatError> {
    if attributes.is_empty() {
        for coordinate in positions.as_flattened() {
            out.extend_from_slice(&convert(*coordinate)?);
        }
        return Ok(());
    }
    // A column at a time, into rows.
    let stride = 3 * N + attributes.iter().map(|a| a.values.kind().size()).sum::<usize>();
    let begin = out.len();
    out.resize(begin + positions.len() * stride, 0);
    let out = &mut out[begin..];
    for (row, position) in out.chunks_exact_mut(stride).zip(positions) {
        for (bytes, coordinate) in row.chunks_exact_mut(N).zip(position) {
            bytes.copy_from_slice(&convert(*coordinate)?);
        }
    }
    let mut offset = 3 * N;
    for attribute in attributes {
        let size = attribute.values.kind().size();
        each_kind!(&attribute.values, column => {
            let numbers = &column[from..from + positions.len()];
            for (row, number) in out.chunks_exact_mut(stride).zip(numbers) {
                let bytes = if big { number.to_be_bytes() } else { number.to_le_bytes() };
                row[offset..offset + size].copy_from_slice(&bytes);
            }
        });
        offset += size;
    }
    Ok(())
}
