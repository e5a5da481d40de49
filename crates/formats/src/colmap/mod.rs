//! COLMAP's sparse points: `points3D.txt` and `points3D.bin`.

mod ids;
mod read;
mod write;

use std::fmt;

use super::kind::{Choices, FirstPass, FormatKind, Mark, Opened};
use super::numbers::Storage;
use super::source::Source;
use super::{Format, FormatError, Limits, Reading};
use densecloud_cloud::{Attribute, Origin, Role};

/// COLMAP's points with their choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Colmap {
    pub(crate) binary: bool,
}

/// The attribute that is a point's key.
const ID: &str = "point3d_id";
/// How far a point is from its sightings in the images, in pixels, in the mean; NaN where nobody knows.
const ERROR: &str = "error";
/// What files have where nobody knows.
const NO_ERROR: f64 = -1.0;
/// The other attributes.
const COLOUR: [&str; 3] = ["red", "green", "blue"];

/// What the comments have that COLMAP writes before its points.
const TITLE: &str = "POINT3D_ID";

/// Bytes of a point without its track: a key, the position, a colour, an error, and the length of the track.
const RECORD: usize = 8 + 24 + 3 + 8 + 8;

/// Bytes of an entry of a track: an image, and a point of it.
const SIGHTING: u64 = 8;

impl FormatKind for Colmap {
    const MARK: Mark = Mark::Bytes(|head| has_title(head) || read::are_records(head));
    const NAMES: &'static [&'static str] = &["colmap"];
    const BEGINNING: Option<&'static str> =
        Some("`# 3D point list`, or the count and records of a points3D.bin");
    const MEDIA_TYPES: &'static [&'static str] = &["text/x-colmap-points3d", "application/x-colmap-points3d"];
    const EXTENSIONS: &'static [&'static str] = &[];
    const FILES: &'static [&'static str] = &["points3D.txt", "points3D.bin"];

    fn from_name(name: &str) -> Option<Self> {
        match name {
            "points3d.txt" => Some(Self { binary: false }),
            "points3d.bin" => Some(Self { binary: true }),
            _ => None,
        }
    }

    fn from_extension(_extension: &str) -> Option<Self> {
        None
    }

    fn from_media_type(media_type: &str) -> Option<Self> {
        match media_type {
            "text/x-colmap-points3d" => Some(Self { binary: false }),
            "application/x-colmap-points3d" => Some(Self { binary: true }),
            _ => None,
        }
    }

    fn open(source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        let (points, header) = read::ColmapPoints::open(source, limits)?;
        Ok(Opened { header, points: Box::new(points) })
    }
}

impl Choices for Colmap {
    fn media_type(&self) -> &'static str {
        if self.binary { "application/x-colmap-points3d" } else { "text/x-colmap-points3d" }
    }

    fn of_result(&self, _input: Format, _names: bool) -> Format {
        (*self).into()
    }

    fn holds_comments(&self) -> bool {
        !self.binary
    }

    fn holds_crs(&self) -> bool {
        false
    }

    fn not_held(&self, attributes: &[Attribute], origin: &Origin) -> Vec<String> {
        let mut lost = write::not_held(attributes, origin);
        lost.extend(origin.extra.iter().flat_map(|extra| extra.lost_elsewhere()));
        lost
    }

    fn whole_numbers(&self) -> &'static [Role] {
        &[Role::Red, Role::Green, Role::Blue]
    }

    fn is_streamed(&self) -> bool {
        true
    }

    fn encoded_len(&self, points: u64, _attributes: &[Attribute], _origin: &Origin) -> Option<u64> {
        if self.binary { points.checked_mul(RECORD as u64)?.checked_add(8) } else { None }
    }

    fn bytes_a_point(&self, position: u64, _attributes: u64) -> u64 {
        if self.binary { RECORD as u64 } else { Storage::text_bytes(position, 20) }
    }

    fn first_pass(&self, attributes: &[Attribute], origin: &Origin) -> Option<Box<dyn FirstPass>> {
        Some(Box::new(write::Seen::new(self.binary, attributes, origin)))
    }
}

impl fmt::Display for Colmap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "COLMAP points3D ({})", if self.binary { "binary" } else { "text" })
    }
}

/// Whether the comments that a text begins with are those before points.
fn has_title(head: &[u8]) -> bool {
    let lines = head.split(|b| matches!(b, b'\n' | b'\r')).map(<[u8]>::trim_ascii);
    let mut comments = lines.take_while(|line| line.is_empty() || line.starts_with(b"#"));
    comments.any(|line| line.windows(TITLE.len()).any(|word| word == TITLE.as_bytes()))
}
