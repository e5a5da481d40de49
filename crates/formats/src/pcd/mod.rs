//! PCD, the Point Cloud Library's format: a text header that names fields, then rows, or compressed columns.

mod read;
mod write;

use std::fmt;
use std::io::Write;

use super::kind::{Begun, Choices, FormatKind, Mark, Opened};
use super::numbers::Storage;
use super::source::Source;
use super::writer::write_streamed;
use super::{Format, FormatError, Limits, Reading, Scalar};
use densecloud_cloud::{Attribute, Origin, Position, Role, bytes_a_point};

/// PCD with its choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pcd {
    pub(crate) encoding: PcdEncoding,
    pub(crate) scalar: Scalar,
}

/// How a PCD file stores numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
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

impl FormatKind for Pcd {
    const MARK: Mark = Mark::Bytes(is_pcd);
    const NAMES: &'static [&'static str] = &["pcd"];
    const BEGINNING: Option<&'static str> = Some("`# .PCD`");
    const MEDIA_TYPES: &'static [&'static str] = &["application/x-pcd"];
    const EXTENSIONS: &'static [&'static str] = &["pcd"];

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

    fn holds_sensor(&self) -> bool {
        true
    }

    fn holds_orientation(&self) -> bool {
        true
    }

    fn not_held(&self, _attributes: &[Attribute], origin: &Origin) -> Vec<String> {
        let mut lost = origin.extra.as_ref().map(|extra| extra.lost_elsewhere()).unwrap_or_default();
        // Its place is for one.
        if origin.sensors.is_some() {
            lost.push("the sensors' places".to_owned());
        }
        lost
    }

    fn renamed(&self, attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
        write::renamed(attributes, origin)
    }

    fn whole_numbers(&self) -> &'static [Role] {
        &[Role::Red, Role::Green, Role::Blue, Role::Alpha]
    }

    fn is_packed(&self) -> bool {
        self.encoding == PcdEncoding::Compressed
    }

    fn is_streamed(&self) -> bool {
        self.encoding != PcdEncoding::Compressed
    }

    fn is_made_in_parts(&self) -> bool {
        self.encoding != PcdEncoding::Compressed
    }

    fn encoded_len(&self, points: u64, attributes: &[Attribute], origin: &Origin) -> Option<u64> {
        if self.encoding != PcdEncoding::Binary {
            return None;
        }
        let header = write::header(*self, points, attributes, origin).len() as u64;
        let fields = write::fields(attributes, origin);
        let columns = write::columns(attributes, &fields, self.encoding, 0..0);
        points.checked_mul(3 * self.scalar.size() + bytes_a_point(&columns))?.checked_add(header)
    }

    fn bytes_a_point(&self, position: u64, attributes: u64) -> u64 {
        match self.encoding.storage() {
            Storage::Text(_) => Storage::text_bytes(position, attributes),
            Storage::LittleEndian | Storage::BigEndian => position + attributes,
        }
    }

    /// Rows, columns and what they are compressed to are in memory at a time.
    fn bytes_at_work(&self, file: u64) -> u64 {
        if self.is_streamed() { 0 } else { file.saturating_mul(3) }
    }

    fn begin(&self, points: u64, attributes: &[Attribute], origin: &Origin) -> Result<Begun, FormatError> {
        if !self.is_streamed() {
            return Err(FormatError::not_streamed(self));
        }
        let header = write::header(*self, points, attributes, origin).into_bytes();
        Ok((header, Box::new(write::PcdRows::new(*self, attributes, origin))))
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

/// Whether a file begins as PCD does, behind other comments and blank lines: with its comment, or, since that is optional,
/// with its first keyword. Some programs write keywords in lower case, and are believed where there are two of them.
fn is_pcd(head: &[u8]) -> bool {
    let lines = || head.split(|b| matches!(b, b'\n' | b'\r')).map(<[u8]>::trim_ascii);
    let mut begins = lines().filter(|line| !line.is_empty());
    let Some(first) = begins.find(|line| !line.starts_with(b"#") || is_title(line)) else { return false };
    let is_key = |line: &[u8], keys: &[&str]| {
        let word = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
        keys.iter().any(|key| word.eq_ignore_ascii_case(key.as_bytes()))
    };
    is_title(first)
        || first.starts_with(b"VERSION ")
        || is_key(first, &["VERSION", "FIELDS", "COLUMNS"]) && lines().any(|line| is_key(line, &["SIZE"]))
}

/// Whether a comment is the one of the format.
fn is_title(line: &[u8]) -> bool {
    line.strip_prefix(b"#").is_some_and(|comment| comment.trim_ascii_start().starts_with(b".PCD"))
}
