//! Stanford PLY: a text header that lists elements and their properties, then rows of numbers.

mod cloud;
mod header;
mod mesh;
mod rows;
mod write;

use std::fmt;

use super::kind::{Begun, Choices, FormatKind, Mark, Opened};
use super::numbers::Storage;
use super::source::Source;
use super::{Format, FormatError, Limits, Reading, Scalar};
use densecloud_cloud::{Attribute, Origin, Role, Table, bytes_a_point};

pub(super) use mesh::read_mesh;

/// PLY with its choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ply {
    pub(crate) encoding: PlyEncoding,
    pub(crate) scalar: Scalar,
}

/// How a PLY file stores numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum PlyEncoding {
    /// `format ascii 1.0`
    Ascii,
    /// `format binary_little_endian 1.0`
    BinaryLittleEndian,
    /// `format binary_big_endian 1.0`
    BinaryBigEndian,
}

impl PlyEncoding {
    /// As in a header.
    fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::BinaryLittleEndian => "binary_little_endian",
            Self::BinaryBigEndian => "binary_big_endian",
        }
    }

    fn storage(self) -> Storage {
        match self {
            Self::Ascii => Storage::Text(" "),
            Self::BinaryLittleEndian => Storage::LittleEndian,
            Self::BinaryBigEndian => Storage::BigEndian,
        }
    }
}

impl FormatKind for Ply {
    const MARK: Mark = Mark::Bytes(|head| {
        head.strip_prefix(b"ply").is_some_and(|rest| rest.first().is_none_or(u8::is_ascii_whitespace))
    });
    const NAMES: &'static [&'static str] = &["ply"];
    const BEGINNING: Option<&'static str> = Some("the line `ply`");
    const HEADER_END: Option<&'static [u8]> = Some(b"end_header");
    const MEDIA_TYPES: &'static [&'static str] = &["application/x-ply"];
    const EXTENSIONS: &'static [&'static str] = &["ply"];

    fn from_extension(extension: &str) -> Option<Self> {
        let usual = Self { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F32 };
        (extension == "ply").then_some(usual)
    }

    fn from_media_type(media_type: &str) -> Option<Self> {
        match media_type {
            "application/x-ply" | "application/ply" | "model/ply" => Self::from_extension("ply"),
            _ => None,
        }
    }

    fn open(source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        let ply = header::parse(source)?;
        let header = cloud::describe(source, &ply, limits)?;
        Ok(Opened { header, points: Box::new(cloud::PlyPoints::new(source, ply)?) })
    }
}

impl Choices for Ply {
    fn media_type(&self) -> &'static str {
        "application/x-ply"
    }

    fn of_result(&self, input: Format, _names: bool) -> Format {
        match input {
            Format::Ply { .. } => input,
            other => Format::Ply { encoding: self.encoding, scalar: other.scalar() },
        }
    }

    fn scalar(&self) -> Scalar {
        self.scalar
    }

    fn finer(&self) -> Option<Format> {
        Some(Format::Ply { encoding: self.encoding, scalar: Scalar::F64 })
    }

    fn holds_tables(&self) -> bool {
        true
    }

    fn renamed(&self, attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
        write::renamed(attributes, origin)
    }

    fn whole_numbers(&self) -> &'static [Role] {
        &[Role::Red, Role::Green, Role::Blue, Role::Alpha]
    }

    fn is_streamed(&self) -> bool {
        true
    }

    fn encoded_len(&self, points: u64, attributes: &[Attribute], origin: &Origin) -> Option<u64> {
        if self.encoding == PlyEncoding::Ascii {
            return None;
        }
        let header = write::header(*self, points, attributes, origin).len() as u64;
        let tables = origin.tables.iter().map(Table::bytes).sum::<u64>();
        let rows = points.checked_mul(3 * self.scalar.size() + bytes_a_point(attributes))?;
        rows.checked_add(header)?.checked_add(tables)
    }

    fn bytes_a_point(&self, position: u64, attributes: u64) -> u64 {
        match self.encoding.storage() {
            Storage::Text(_) => Storage::text_bytes(position, attributes),
            Storage::LittleEndian | Storage::BigEndian => position + attributes,
        }
    }

    fn begin(&self, points: u64, attributes: &[Attribute], origin: &Origin) -> Result<Begun, FormatError> {
        let header = write::header(*self, points, attributes, origin).into_bytes();
        Ok((header, Box::new(write::PlyRows::new(*self, origin))))
    }
}

impl fmt::Display for Ply {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PLY ({}, {}-bit)", self.encoding.name(), 8 * self.scalar.size())
    }
}
