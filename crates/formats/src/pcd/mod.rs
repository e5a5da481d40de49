//! PCD, the Point Cloud Library's format: a text header that names fields, then rows, or compressed columns.

mod read;
mod write;

use std::fmt;
use std::io::Write;

use super::kind::{Choices, Kind, Mark, Opened, Rows};
use super::numbers::Storage;
use super::source::Source;
use super::writer::write_streamed;
use super::{Format, FormatError, Limits, Reading, Scalar};
use densecloud_cloud::{Attribute, Origin, Position, bytes_a_point};

/// PCD with its choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pcd {
    pub(crate) encoding: PcdEncoding,
    pub(crate) scalar: Scalar,
}

/// How a PCD file stores numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PcdEncoding {
    /// `DATA ascii`
    Ascii,
    /// `DATA binary`
    Binary,
    /// `DATA binary_compressed`
    Compressed,
}

impl PcdEncoding {
    /// As in a header.
    fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::Binary => "binary",
            Self::Compressed => "binary_compressed",
        }
    }

    fn storage(self) -> Storage {
        match self {
            Self::Ascii => Storage::Text(" "),
            Self::Binary | Self::Compressed => Storage::LittleEndian,
        }
    }
}

impl Kind for Pcd {
    /// The comment is usual; the line after it is not optional.
    const MARK: Mark = Mark::Bytes(|head| head.starts_with(b"# .PCD") || head.starts_with(b"VERSION "));
    const NAMES: &'static [&'static str] = &["pcd"];
    const BEGINNING: Option<&'static str> = Some("`# .PCD`");
    const MEDIA_TYPES: &'static [&'static str] = &["application/x-pcd"];

    fn from_extension(extension: &str) -> Option<Self> {
        (extension == "pcd").then_some(Self { encoding: PcdEncoding::Binary, scalar: Scalar::F32 })
    }

    fn from_media_type(media_type: &str) -> Option<Self> {
        if media_type == "application/x-pcd" { Self::from_extension("pcd") } else { None }
    }

    fn open(source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        let (points, header) = read::PcdPoints::open(source, limits)?;
        Ok(Opened { header, points: Box::new(points) })
    }
}

impl Choices for Pcd {
    fn media_type(&self) -> &'static str {
        "application/x-pcd"
    }

    fn of_result(&self, input: Format, _names: bool) -> Format {
        match input {
            Format::Pcd { .. } => input,
            // Much that reads PCD knows no others; see `finer`.
            _ => Format::Pcd { encoding: self.encoding, scalar: Scalar::F32 },
        }
    }

    fn scalar(&self) -> Scalar {
        self.scalar
    }

    fn finer(&self) -> Option<Format> {
        Some(Format::Pcd { encoding: self.encoding, scalar: Scalar::F64 })
    }

    fn is_packed(&self) -> bool {
        self.encoding == PcdEncoding::Compressed
    }

    fn is_streamed(&self) -> bool {
        self.encoding != PcdEncoding::Compressed
    }

    fn encoded_len(&self, points: u64, attributes: &[Attribute], origin: &Origin) -> Option<u64> {
        if self.encoding != PcdEncoding::Binary {
            return None;
        }
        let header = write::header(*self, points, attributes, origin).len() as u64;
        let fields = write::columns(attributes, self.encoding, 0..0);
        points.checked_mul(3 * self.scalar.size() + bytes_a_point(&fields))?.checked_add(header)
    }

    fn bytes_a_point(&self, position: u64, attributes: u64) -> u64 {
        match self.encoding.storage() {
            Storage::Text(_) => Storage::text_bytes(position, attributes),
            Storage::LittleEndian | Storage::BigEndian => position + attributes,
        }
    }

    fn begin(
        &self,
        points: u64,
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<(Vec<u8>, Box<dyn Rows>), FormatError> {
        if !self.is_streamed() {
            return Err(FormatError::not_streamed(self));
        }
        let header = write::header(*self, points, attributes, origin).into_bytes();
        Ok((header, Box::new(write::PcdRows(*self))))
    }

    fn encode(
        &self,
        sink: &mut dyn Write,
        positions: &[Position],
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<(), FormatError> {
        if self.is_streamed() {
            let begun = self.begin(positions.len() as u64, attributes, origin)?;
            return write_streamed(sink, begun, positions, attributes);
        }
        Ok(sink.write_all(&write::encode_compressed(self.scalar, positions, attributes, origin)?)?)
    }
}

impl fmt::Display for Pcd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PCD ({}, {}-bit)", self.encoding.name(), 8 * self.scalar.size())
    }
}
