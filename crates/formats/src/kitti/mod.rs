//! Sweeps of a lidar as bare numbers, 32-bit floats in little-endian order, as KITTI and nuScenes have them: nothing in a
//! file tells how many make a point, so they are read where the caller says it.

mod read;

use std::fmt;

use super::kind::{Choices, Kind, Mark, Opened, Rows};
use super::ply::Ply;
use super::source::Source;
use super::{Format, FormatError, Limits, Reading, Scalar};
use densecloud_cloud::{Attribute, Origin};

/// A sweep with its choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Kitti {
    pub(crate) ring: bool,
}

impl Kind for Kitti {
    const MARK: Mark = Mark::None;
    const NAMES: &'static [&'static str] = &["kitti", "nuscenes"];
    const BEGINNING: Option<&'static str> = None;
    const MEDIA_TYPES: &'static [&'static str] = &[];
    const EXTENSIONS: &'static [&'static str] = &[];

    fn from_extension(_extension: &str) -> Option<Self> {
        None
    }

    fn from_media_type(_media_type: &str) -> Option<Self> {
        None
    }

    fn open(source: &mut Source<'_>, limits: Limits, reading: &Reading) -> Result<Opened, FormatError> {
        let ring = reading.format.is_some_and(|format| format.name() == "nuscenes");
        let (points, header) = read::KittiPoints::open(source, limits, Self { ring })?;
        Ok(Opened { header, points: Box::new(points) })
    }
}

impl Choices for Kitti {
    fn media_type(&self) -> &'static str {
        "application/octet-stream"
    }

    fn of_result(&self, input: Format, _names: bool) -> Format {
        input.written()
    }

    fn written(&self) -> Option<Format> {
        Some(Ply { scalar: Scalar::F32, ..Ply::EXACT }.into())
    }

    fn scalar(&self) -> Scalar {
        Scalar::F32
    }

    fn holds_comments(&self) -> bool {
        false
    }

    fn is_streamed(&self) -> bool {
        false
    }

    fn begin(
        &self,
        _points: u64,
        _attributes: &[Attribute],
        _origin: &Origin,
    ) -> Result<(Vec<u8>, Box<dyn Rows>), FormatError> {
        Err(FormatError::read_only(self))
    }
}

impl fmt::Display for Kitti {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.ring { "nuScenes (x y z intensity ring)" } else { "KITTI (x y z intensity)" })
    }
}
