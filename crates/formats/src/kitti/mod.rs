//! Sweeps of a lidar as bare numbers, 32-bit floats in little-endian order, as KITTI and nuScenes have them: nothing in a
//! file tells how many make a point, so they are read where the caller says it.

mod read;

use std::fmt;

use super::kind::{FormatKind, Mark, Opened, ReadOnly};
use super::source::Source;
use super::{FormatError, Limits, Reading, Scalar};

/// A sweep with its choices made.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sweep {
    pub(crate) ring: bool,
}

impl FormatKind for Sweep {
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

impl ReadOnly for Sweep {
    fn media_type(&self) -> &'static str {
        "application/octet-stream"
    }

    fn scalar(&self) -> Scalar {
        Scalar::F32
    }
}

impl fmt::Display for Sweep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.ring { "nuScenes (x y z intensity ring)" } else { "KITTI (x y z intensity)" })
    }
}
