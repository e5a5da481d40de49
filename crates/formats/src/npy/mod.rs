//! NumPy's `.npy`: a header that is a Python literal, then one array.

mod header;
mod literal;
mod number;
mod read;
mod shape;

use std::fmt;

use super::kind::{Begun, Choices, FormatKind, Mark, Opened, Rows};
use super::names::{NameRule, changes};
use super::numbers::{Storage, put_rows, put_table};
use super::source::Source;
use super::{Format, FormatError, Limits, Reading, Scalar};
use densecloud_cloud::{Attribute, Kind, Origin, Position, bytes_a_point};

/// What every file begins with.
const MAGIC: &[u8] = b"\x93NUMPY";

/// Any text names a field.
const RULE: NameRule = NameRule { most: usize::MAX, allows: |c| !c.is_control(), is_taken: &|_| false };

/// NumPy's format with its choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Npy {
    pub(crate) scalar: Scalar,
    pub(crate) fields: bool,
}

impl FormatKind for Npy {
    const MARK: Mark = Mark::Bytes(|head| head.starts_with(MAGIC));
    const NAMES: &'static [&'static str] = &["npy"];
    const BEGINNING: Option<&'static str> = Some("`\\x93NUMPY`");
    const MEDIA_TYPES: &'static [&'static str] = &["application/x-npy"];
    const EXTENSIONS: &'static [&'static str] = &["npy"];

    fn from_extension(extension: &str) -> Option<Self> {
        (extension == "npy").then_some(Self { scalar: Scalar::F64, fields: true })
    }

    fn from_media_type(media_type: &str) -> Option<Self> {
        if media_type == "application/x-npy" { Self::from_extension("npy") } else { None }
    }

    fn open(source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        let (points, header) = read::NpyPoints::open(source, limits)?;
        Ok(Opened { header, points: Box::new(points) })
    }
}

impl Choices for Npy {
    fn media_type(&self) -> &'static str {
        "application/x-npy"
    }

    fn of_result(&self, input: Format, _names: bool) -> Format {
        match input {
            Format::Npy { .. } => input,
            other => Format::Npy { scalar: other.scalar(), fields: self.fields },
        }
    }

    fn scalar(&self) -> Scalar {
        self.scalar
    }

    fn finer(&self) -> Option<Format> {
        Some(Format::Npy { scalar: Scalar::F64, fields: self.fields })
    }

    fn holds_comments(&self) -> bool {
        false
    }

    fn holds_crs(&self) -> bool {
        false
    }

    fn renamed(&self, attributes: &[Attribute], _origin: &Origin) -> Vec<(String, String)> {
        if is_table(self.fields, attributes) {
            return Vec::new();
        }
        changes(attributes, &vec![None; attributes.len()], names(attributes))
    }

    fn is_streamed(&self) -> bool {
        true
    }

    fn encoded_len(&self, points: u64, attributes: &[Attribute], _origin: &Origin) -> Option<u64> {
        let header = npy_header(self.scalar, self.fields, points, attributes).len() as u64;
        let others = if is_table(self.fields, attributes) {
            attributes.len() as u64 * self.scalar.size()
        } else {
            bytes_a_point(attributes)
        };
        points.checked_mul(3 * self.scalar.size() + others)?.checked_add(header)
    }

    fn begin(&self, points: u64, attributes: &[Attribute], _origin: &Origin) -> Result<Begun, FormatError> {
        Ok((npy_header(self.scalar, self.fields, points, attributes), Box::new(NpyRows(*self))))
    }
}

impl fmt::Display for Npy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fields = if self.fields { ", fields" } else { "" };
        write!(f, "NumPy ({}-bit{fields})", 8 * self.scalar.size())
    }
}

/// Rows of an array: as fields, or all numbers in the type of the coordinates.
#[derive(Debug)]
struct NpyRows(Npy);

impl Rows for NpyRows {
    fn put(
        &mut self,
        bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        if self.0.fields || attributes.is_empty() {
            put_rows(bytes, positions, attributes, from, Storage::LittleEndian, self.0.scalar)
        } else {
            put_table(bytes, positions, attributes, from, self.0.scalar)
        }
    }
}

/// The bytes before the data of a file of these attributes: as fields of their own types and names, or,
/// without `fields`, as further columns of one table.
pub fn npy_header(scalar: Scalar, fields: bool, points: u64, attributes: &[Attribute]) -> Vec<u8> {
    let float = match scalar {
        Scalar::F32 => "<f4",
        Scalar::F64 => "<f8",
    };
    let (kind, shape) = if is_table(fields, attributes) {
        (format!("'{float}'"), format!("({points}, {})", 3 + attributes.len()))
    } else {
        let mut list = ["x", "y", "z"].map(|axis| format!("('{axis}', '{float}')")).to_vec();
        for (attribute, name) in attributes.iter().zip(names(attributes)) {
            let literal = name.replace('\\', "\\\\").replace('\'', "\\'");
            list.push(format!("('{literal}', '{}')", code(attribute.values.kind())));
        }
        (format!("[{}]", list.join(", ")), format!("({points},)"))
    };
    let mut text = format!("{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}").into_bytes();
    let version = match text.len() {
        _ if !text.is_ascii() => 3,
        // Room for the padding.
        0..=65_000 => 1,
        _ => 2,
    };
    let fixed = MAGIC.len() + 2 + if version == 1 { 2 } else { 4 };
    // The data begin at a multiple of 64.
    let padding = 63 - (fixed + text.len()) % 64;
    text.resize(text.len() + padding, b' ');
    text.push(b'\n');
    let mut bytes = [MAGIC, &[version, 0]].concat();
    if version == 1 {
        bytes.extend((text.len() as u16).to_le_bytes());
    } else {
        bytes.extend((text.len() as u32).to_le_bytes());
    }
    bytes.extend(text);
    bytes
}

/// The names of the fields that attributes become.
fn names(attributes: &[Attribute]) -> Vec<String> {
    RULE.apply(&attributes.iter().map(|attribute| attribute.name.as_str()).collect::<Vec<_>>())
}

/// Whether all is written as one table of floats, and not as fields.
fn is_table(fields: bool, attributes: &[Attribute]) -> bool {
    !fields || attributes.is_empty()
}

fn code(kind: Kind) -> &'static str {
    match kind {
        Kind::I8 => "|i1",
        Kind::U8 => "|u1",
        Kind::I16 => "<i2",
        Kind::U16 => "<u2",
        Kind::I32 => "<i4",
        Kind::U32 => "<u4",
        Kind::I64 => "<i8",
        Kind::U64 => "<u8",
        Kind::F32 => "<f4",
        Kind::F64 => "<f8",
    }
}
