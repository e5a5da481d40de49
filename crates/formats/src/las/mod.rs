//! LAS, LAZ and COPC, by the `las` and `laz` crates: every point format and extra bytes.
//!
//! The crates read and write headers and compressed chunks; the fields of a point are taken from its
//! bytes and put there by [`layout`], and the records are read by [`records`], since the crate knows only
//! the first of those after the points. COPC is LAZ whose chunks are the nodes of an octree.

mod check;
mod chunks;
mod copc;
mod crs;
mod extra;
mod head;
mod hierarchy;
mod layout;
mod octree;
mod origin;
mod pack;
mod plan;
mod read;
mod records;
mod seen;
mod wkt;
mod write;

use std::fmt;

use super::kind::{Begun, Choices, FirstPass, FormatKind, Mark, Opened, encoded};
use super::source::Source;
use super::spool::Spool;
use super::{Format, FormatError, Limits, Reading};
use densecloud_cloud::{Attribute, Origin, Position, Role};
use seen::Seen;

pub(crate) use copc::Copc;
pub(super) use origin::{LasExtra, LasOrigin, LasRecord};

/// What fields hold in whole numbers.
const WHOLE: &[Role] = &[
    Role::Red,
    Role::Green,
    Role::Blue,
    Role::NearInfrared,
    Role::Intensity,
    Role::ReturnNumber,
    Role::NumberOfReturns,
    Role::Classification,
    Role::UserData,
    Role::PointSource,
    Role::ScanDirection,
    Role::EdgeOfFlightLine,
    Role::Synthetic,
    Role::KeyPoint,
    Role::Withheld,
    Role::Overlap,
    Role::ScannerChannel,
];

/// How the points of a file lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// As they are.
    Plain,
    /// Compressed, in chunks of as many each.
    Packed,
    /// Compressed, in the nodes of an octree.
    Indexed,
}

/// LAS with its choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Las {
    pub(crate) compressed: bool,
}

impl FormatKind for Las {
    const MARK: Mark = Mark::Bytes(|head| head.starts_with(b"LASF"));
    const NAMES: &'static [&'static str] = &["las", "laz"];
    const BEGINNING: Option<&'static str> = Some("`LASF`");
    const MEDIA_TYPES: &'static [&'static str] = &["application/vnd.las", "application/vnd.laszip"];
    const EXTENSIONS: &'static [&'static str] = &["las", "laz"];

    fn from_extension(extension: &str) -> Option<Self> {
        matches!(extension, "las" | "laz").then_some(Self { compressed: extension == "laz" })
    }

    fn from_media_type(media_type: &str) -> Option<Self> {
        match media_type {
            "application/vnd.las" => Self::from_extension("las"),
            "application/vnd.laszip" => Self::from_extension("laz"),
            _ => None,
        }
    }

    fn open(source: &mut Source<'_>, limits: Limits, reading: &Reading) -> Result<Opened, FormatError> {
        read::open(source, limits, reading, |compressed| Self { compressed }.into())
    }
}

impl Las {
    fn form(self) -> Form {
        if self.compressed { Form::Packed } else { Form::Plain }
    }
}

impl Choices for Las {
    fn media_type(&self) -> &'static str {
        if self.compressed { "application/vnd.laszip" } else { "application/vnd.las" }
    }

    fn of_result(&self, _input: Format, _names: bool) -> Format {
        (*self).into()
    }

    fn not_held(&self, _attributes: &[Attribute], origin: &Origin) -> Vec<String> {
        let mut lost = Vec::new();
        if LasOrigin::of(origin).is_some_and(|las| las.is_indexed) {
            lost.push("the index of the points (COPC or LAX)".to_owned());
        }
        lost
    }

    fn renamed(&self, attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
        renamed(self.form(), attributes, origin)
    }

    fn whole_numbers(&self) -> &'static [Role] {
        WHOLE
    }

    fn is_packed(&self) -> bool {
        self.compressed
    }

    fn is_streamed(&self) -> bool {
        !self.compressed
    }

    fn bytes_a_point(&self, position: u64, attributes: u64) -> u64 {
        position + attributes + FIELDS
    }

    fn bytes_at_work(&self, file: u64) -> u64 {
        if self.compressed { Spool::most_held(file) + pack::most_held(file) } else { 0 }
    }

    /// It is some times smaller than its points.
    fn temporary_bytes(&self, file: u64) -> u64 {
        if self.compressed { file / 3 } else { 0 }
    }

    fn begin(&self, _points: u64, _attributes: &[Attribute], _origin: &Origin) -> Result<Begun, FormatError> {
        Err(unseen(self))
    }

    fn first_pass(&self, attributes: &[Attribute], origin: &Origin) -> Option<Box<dyn FirstPass>> {
        Some(Box::new(Seen::new(self.form(), attributes, origin)))
    }

    fn spooled(
        &self,
        positions: &[Position],
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<Spool, FormatError> {
        match self.form() {
            Form::Plain => encoded(self, positions, attributes, origin),
            form => write::whole(form, positions, attributes, origin),
        }
    }
}

/// Bytes of the fields that a point's record has and a cloud need not have.
const FIELDS: u64 = 24;

/// As [`Choices::renamed`].
fn renamed(form: Form, attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
    let mut seen = Seen::new(form, attributes, origin);
    seen.see_numbers(attributes, 0..attributes.first().map_or(0, |first| first.values.len()));
    seen.renamed().unwrap_or_default()
}

/// Nobody has seen the points.
fn unseen(format: impl fmt::Display) -> FormatError {
    FormatError::NotWritten(format!("the header of {format} depends on all points: see them first"))
}

impl fmt::Display for Las {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.compressed { "LAZ" } else { "LAS" })
    }
}
