//! COPC as a format of its own: LAZ with an octree, which any program for LAZ reads, too.

use std::fmt;

use super::super::kind::{Begun, Choices, FirstPass, FormatKind, Mark, Opened};
use super::super::source::Source;
use super::super::spool::Spool;
use super::super::{Format, FormatError, Limits, Reading};
use super::seen::Seen;
use super::{FIELDS, Form, LasOrigin, WHOLE, crs, pack, read, renamed, unseen, write};
use densecloud_cloud::{Attribute, Crs, Origin, Position, Role};

/// COPC, which has no choices.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Copc;

/// How names of its files end, in lower case.
const ENDING: &str = ".copc.laz";

/// Where the first record of a file has the name of who defined it.
const FIRST_USER: std::ops::Range<usize> = 377..382;

impl FormatKind for Copc {
    const MARK: Mark = Mark::Bytes(|head| {
        head.starts_with(b"LASF") && head.get(FIRST_USER).is_some_and(|user| user == b"copc\0")
    });
    const NAMES: &'static [&'static str] = &["copc"];
    const BEGINNING: Option<&'static str> = Some("`LASF`");
    const MEDIA_TYPES: &'static [&'static str] = &["application/vnd.laszip+copc"];
    const EXTENSIONS: &'static [&'static str] = &["copc.laz"];

    fn from_name(name: &str) -> Option<Self> {
        name.ends_with(ENDING).then_some(Self)
    }

    fn from_extension(_extension: &str) -> Option<Self> {
        None
    }

    fn from_media_type(media_type: &str) -> Option<Self> {
        Self::MEDIA_TYPES.contains(&media_type).then_some(Self)
    }

    fn open(source: &mut Source<'_>, limits: Limits, reading: &Reading) -> Result<Opened, FormatError> {
        read::open(source, limits, reading, |_| Self.into())
    }
}

impl Choices for Copc {
    fn media_type(&self) -> &'static str {
        "application/vnd.laszip+copc"
    }

    fn of_result(&self, _input: Format, _names: bool) -> Format {
        (*self).into()
    }

    fn not_held(&self, _attributes: &[Attribute], origin: &Origin) -> Vec<String> {
        let records = LasOrigin::of(origin).map(|las| &las.records[..]).unwrap_or_default();
        let without = origin.crs.iter().filter(|crs| !crs::is_wkt(&crs::as_text(crs, records)));
        let told = |crs: &Crs| {
            let name = crs.name();
            format!(
                "a coordinate system without well-known text ({name} is in GeoTIFF's keys, which not all viewers read)"
            )
        };
        without.map(told).collect()
    }

    fn renamed(&self, attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
        renamed(Form::Indexed, attributes, origin)
    }

    fn whole_numbers(&self) -> &'static [Role] {
        WHOLE
    }

    fn is_packed(&self) -> bool {
        true
    }

    fn is_streamed(&self) -> bool {
        false
    }

    fn bytes_a_point(&self, position: u64, attributes: u64) -> u64 {
        position + attributes + FIELDS
    }

    /// The points as they come, the parts that they are cut into, and the file.
    fn bytes_at_work(&self, file: u64) -> u64 {
        3 * Spool::most_held(file) + pack::most_held(file)
    }

    /// The points, all their parts, and the file, which is some times smaller.
    fn temporary_bytes(&self, file: u64) -> u64 {
        2 * file + file / 3
    }

    fn begin(&self, _points: u64, _attributes: &[Attribute], _origin: &Origin) -> Result<Begun, FormatError> {
        Err(unseen(self))
    }

    fn first_pass(&self, attributes: &[Attribute], origin: &Origin) -> Option<Box<dyn FirstPass>> {
        Some(Box::new(Seen::new(Form::Indexed, attributes, origin)))
    }

    fn spooled(
        &self,
        positions: &[Position],
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<Spool, FormatError> {
        write::whole(Form::Indexed, positions, attributes, origin)
    }
}

impl fmt::Display for Copc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("COPC")
    }
}
