//! Names of formats, what a header says, and limits.

use std::path::Path;

use super::writer::ply_header;
use crate::cloud::{Attribute, bytes_a_point};

/// A file format and the choices within it. A reader reports it and a writer takes it, so that a
/// cloud goes back in the form it came in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Stanford PLY.
    Ply {
        /// How numbers are stored.
        encoding: PlyEncoding,
        /// The type of the coordinates.
        scalar: Scalar,
    },
    /// Text, a point a line: `.xyz`, `.txt`, `.asc`, `.pts`, `.pwn`, `.csv`. Written with spaces,
    /// the position first.
    Xyz {
        /// Whether a first line names the columns.
        names: bool,
    },
    /// LAS, LAZ and COPC. Read, not written: see [`Format::written`].
    Las,
    /// The Point Cloud Library's PCD. Read, not written: see [`Format::written`].
    Pcd,
}

/// How a PLY file stores numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlyEncoding {
    /// `format ascii 1.0`
    Ascii,
    /// `format binary_little_endian 1.0`
    BinaryLittleEndian,
    /// `format binary_big_endian 1.0`
    BinaryBigEndian,
}

/// The type of written coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scalar {
    /// 32-bit floats.
    F32,
    /// 64-bit floats.
    F64,
}

/// What is known of a cloud before its points are read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// The format, as a writer needs it. A PLY file whose coordinates are 32-bit integers or wider
    /// counts as [`Scalar::F64`], narrower ones as [`Scalar::F32`]: no dense cloud is integer.
    pub format: Format,
    /// The number of points that the header claims. A claim: the data may end earlier.
    pub points: Option<u64>,
    /// What the file tells of each point beside its position, by name, in the file's order.
    pub attributes: Vec<String>,
    /// What the file holds and will be dropped: lists of vertices, and other elements by their names
    /// (`face`), in the file's order.
    pub dropped_properties: Vec<String>,
}

/// How much a reader takes. The default sets no limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Limits {
    /// Most bytes of input, the header included.
    pub max_bytes: Option<u64>,
    /// Most points.
    pub max_points: Option<u64>,
}

impl Format {
    /// The format that a file's extension asks for: `ply` is binary, little-endian, with 32-bit
    /// floats; `xyz`, `txt`, `asc`, `pts`, `pwn` and `csv` are [`Format::Xyz`] without names; `las` and `laz` are [`Format::Las`]. Case is ignored.
    #[must_use]
    pub fn from_extension(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "ply" => Some(Self::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F32 }),
            "xyz" | "txt" | "asc" | "pts" | "pwn" | "csv" => Some(Self::Xyz { names: false }),
            "las" | "laz" => Some(Self::Las),
            "pcd" => Some(Self::Pcd),
            _ => None,
        }
    }

    /// The format that a cloud of this one is written in where nobody says which: itself, or, for what
    /// is read only, binary PLY in 64-bit floats, which holds all that was read.
    #[must_use]
    pub fn written(self) -> Self {
        match self {
            Self::Las | Self::Pcd => {
                Self::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F64 }
            }
            other => other,
        }
    }

    /// The media type for HTTP. PLY has no registered one.
    #[must_use]
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Ply { .. } => "application/x-ply",
            Self::Xyz { .. } => "text/plain; charset=utf-8",
            Self::Las => "application/vnd.las",
            Self::Pcd => "application/x-pcd",
        }
    }

    /// The exact length in bytes of a file of `points` points with these attributes as
    /// [`CloudWriter`](super::CloudWriter) writes it, where it depends on nothing else: binary PLY.
    #[must_use]
    pub fn encoded_len(self, points: u64, attributes: &[Attribute]) -> Option<u64> {
        match self {
            Self::Ply { encoding: PlyEncoding::Ascii, .. } | Self::Xyz { .. } | Self::Las | Self::Pcd => None,
            Self::Ply { encoding, scalar } => {
                let header = ply_header(encoding, scalar, points, attributes).len() as u64;
                points.checked_mul(3 * scalar.size() + bytes_a_point(attributes))?.checked_add(header)
            }
        }
    }
}

impl Scalar {
    /// Bytes a number.
    pub(super) fn size(self) -> u64 {
        match self {
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}
