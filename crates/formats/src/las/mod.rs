//! LAS and LAZ, by the `las` crate: every point format, extra bytes, and COPC as the LAZ that it is.
//!
//! The crate reads and writes headers and compressed blocks; the fields of a point are taken from its
//! bytes and put there by [`layout`], and the records are read by [`records`], since the crate knows only
//! the first of those after the points.

mod check;
mod crs;
mod extra;
mod head;
mod layout;
mod origin;
mod plan;
mod read;
mod records;
mod seen;
mod write;

use std::fmt;

use super::kind::{Begun, Choices, FirstPass, FormatKind, Mark, Opened, encoded};
use super::source::Source;
use super::spool::Spool;
use super::{Format, FormatError, Limits, Reading};
use densecloud_cloud::{Attribute, Origin, Position, Role};
use seen::Seen;

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

    fn open(source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        Ok(Opened { header: read::open(source, limits)?, points: Box::new(read::LasPoints::default()) })
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
        let mut seen = Seen::new(*self, attributes, origin);
        seen.see_numbers(attributes, 0..attributes.first().map_or(0, |first| first.values.len()));
        seen.renamed().unwrap_or_default()
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

    /// Each record has fields that the cloud need not have.
    fn bytes_a_point(&self, position: u64, attributes: u64) -> u64 {
        position + attributes + 24
    }

    fn begin(&self, _points: u64, _attributes: &[Attribute], _origin: &Origin) -> Result<Begun, FormatError> {
        Err(FormatError::NotWritten(format!("the header of {self} depends on all points: see them first")))
    }

    fn first_pass(&self, attributes: &[Attribute], origin: &Origin) -> Option<Box<dyn FirstPass>> {
        Some(Box::new(Seen::new(*self, attributes, origin)))
    }

    fn spooled(
        &self,
        positions: &[Position],
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<Spool, FormatError> {
        if self.compressed {
            return write::packed(*self, positions, attributes, origin);
        }
        encoded(self, positions, attributes, origin)
    }
}

impl fmt::Display for Las {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.compressed { "LAZ" } else { "LAS" })
    }
}
