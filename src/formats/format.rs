//! Names of formats, what a header says, and limits.

use std::path::Path;

use super::pcd;
use super::writer::ply_header;
use crate::cloud::{Attribute, Origin, Position, bytes_a_point};

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
    /// Text, a point a line: `.xyz`, `.txt`, `.asc`, `.pts`, `.pwn`, `.csv`. Written with the
    /// position first.
    Xyz {
        /// Whether a first line names the columns.
        names: bool,
        /// What stands between two numbers.
        separator: Separator,
    },
    /// LAS, and LAZ, which is LAS compressed; COPC is read as the LAZ that it is.
    Las {
        /// LAZ.
        compressed: bool,
    },
    /// The Point Cloud Library's PCD.
    Pcd {
        /// How numbers are stored.
        encoding: PcdEncoding,
        /// The type of the coordinates; PCL's own points have 32-bit floats.
        scalar: Scalar,
    },
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

/// What stands between two columns of text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Separator {
    /// A space; read, any white space.
    Space,
    /// A comma.
    Comma,
    /// A semicolon.
    Semicolon,
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
    /// floats; `xyz`, `txt`, `asc`, `pts` and `pwn` are text without names, with spaces, and `csv` with
    /// commas; `las`, `laz`, and `pcd` (binary) are what they say. Case is ignored.
    #[must_use]
    pub fn from_extension(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "ply" => Some(Self::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F32 }),
            "xyz" | "txt" | "asc" | "pts" | "pwn" => Some(Self::TEXT),
            "csv" => Some(Self::Xyz { names: false, separator: Separator::Comma }),
            "las" => Some(Self::Las { compressed: false }),
            "laz" => Some(Self::Las { compressed: true }),
            "pcd" => Some(Self::Pcd { encoding: PcdEncoding::Binary, scalar: Scalar::F32 }),
            _ => None,
        }
    }

    /// Text without names, with spaces.
    pub const TEXT: Self = Self::Xyz { names: false, separator: Separator::Space };

    /// Whether both are of one kind, whatever the choices within it.
    #[must_use]
    pub fn is_like(self, other: Self) -> bool {
        std::mem::discriminant(&self) == std::mem::discriminant(&other)
    }

    /// The format that a cloud of this one is written in where nobody says which: itself.
    #[must_use]
    pub fn written(self) -> Self {
        self
    }

    /// The type that holds all that coordinates of this format can tell.
    fn scalar(self) -> Scalar {
        match self {
            Self::Ply { scalar, .. } | Self::Pcd { scalar, .. } => scalar,
            Self::Xyz { .. } | Self::Las { .. } => Scalar::F64,
        }
    }

    /// The format of a result: the kind that is `wanted` (by an extension, say), with the encoding of the
    /// input where both are of one kind; the [written](Self::written) one of the input where none is.
    ///
    /// `names` is whether text of another kind of input should begin with a line of names, without which
    /// those of its attributes would be lost.
    #[must_use]
    pub fn of_result(wanted: Option<Self>, input: Self, names: bool) -> Self {
        match (wanted, input) {
            (None, _) => input.written(),
            (Some(Self::Xyz { separator, .. }), Self::Xyz { names, separator: own }) => {
                // `.xyz` says nothing of commas; `.csv` does.
                Self::Xyz { names, separator: if separator == Separator::Space { own } else { separator } }
            }
            (Some(Self::Xyz { separator, .. }), _) => Self::Xyz { names, separator },
            (Some(wanted @ Self::Las { .. }), _) => wanted,
            (Some(wanted), input) if wanted.is_like(input) => input,
            (Some(Self::Ply { encoding, .. }), _) => Self::Ply { encoding, scalar: input.scalar() },
            (Some(Self::Pcd { encoding, .. }), _) => Self::Pcd { encoding, scalar: input.scalar() },
        }
    }

    /// PCD with coordinates of 32 bits in place of 64 where that moves no point by more than a thousandth
    /// of the points' distance (the extent over the root of their number): much that reads PCD knows no
    /// others. All else as it is.
    #[must_use]
    pub fn narrowed(self, positions: &[Position]) -> Self {
        let Self::Pcd { encoding, scalar: Scalar::F64 } = self else { return self };
        let (mut farthest, mut extent) = (0.0_f64, 0.0_f64);
        for axis in 0..3 {
            let along = || positions.iter().map(|p| p[axis]);
            let (min, max) =
                (along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max));
            farthest = farthest.max(-min).max(max);
            extent = extent.max(max - min);
        }
        let fits =
            farthest * f64::from(f32::EPSILON) / 2.0 <= 1e-3 * extent / (positions.len() as f64).sqrt();
        let scalar = if fits && farthest < f64::from(f32::MAX) { Scalar::F32 } else { Scalar::F64 };
        Self::Pcd { encoding, scalar }
    }

    /// Whether [`CloudWriter`](super::CloudWriter) writes it in parts; if not, only
    /// [`encode`](super::encode) writes it, as a whole.
    #[must_use]
    pub fn is_streamed(self) -> bool {
        match self {
            Self::Pcd { encoding: PcdEncoding::Compressed, .. } | Self::Las { .. } => false,
            Self::Ply { .. } | Self::Xyz { .. } | Self::Pcd { .. } => true,
        }
    }

    /// What a file of this format has no place for, a phrase each: of the attributes and of what else is
    /// known of the cloud.
    #[must_use]
    pub fn cannot_hold(self, attributes: &[Attribute], origin: &Origin) -> Vec<String> {
        let _ = attributes;
        let mut lost = Vec::new();
        let las = origin.las.as_deref();
        if let Self::Las { .. } = self {
            if las.is_some_and(|las| las.is_indexed) {
                lost.push("the index of the points (COPC or LAX)".to_owned());
            }
            if origin.sensor.is_some() {
                lost.push("the sensor's place".to_owned());
            }
        } else if let Some(las) = las {
            // Those of the coordinate system say what `crs` does.
            let others = las.records.iter().filter(|record| !record.is_crs());
            let named: Vec<String> = others.map(|r| format!("{} {}", r.user_id, r.id)).collect();
            if !named.is_empty() {
                lost.push(format!("LAS records ({})", named.join(", ")));
            }
        }
        if let (Self::Xyz { .. }, Some(crs)) = (self, &origin.crs) {
            lost.push(format!("the coordinate system ({})", crs.name()));
        }
        if !matches!(self, Self::Ply { .. }) {
            lost.extend(origin.tables.iter().map(|table| table.name.clone()));
        }
        lost
    }

    /// The media type for HTTP. PLY and PCD have no registered one.
    #[must_use]
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Ply { .. } => "application/x-ply",
            Self::Xyz { separator: Separator::Comma, .. } => "text/csv; charset=utf-8",
            Self::Xyz { .. } => "text/plain; charset=utf-8",
            Self::Las { compressed: false } => "application/vnd.las",
            Self::Las { compressed: true } => "application/vnd.laszip",
            Self::Pcd { .. } => "application/x-pcd",
        }
    }

    /// The exact length in bytes of a file of `points` points with these attributes as
    /// [`CloudWriter`](super::CloudWriter) writes it, where it depends on nothing else: binary PLY and PCD.
    #[must_use]
    pub fn encoded_len(self, points: u64, attributes: &[Attribute], origin: &Origin) -> Option<u64> {
        match self {
            Self::Ply { encoding: PlyEncoding::Ascii, .. } => None,
            Self::Ply { encoding, scalar } => {
                let header = ply_header(encoding, scalar, points, attributes, origin).len() as u64;
                points.checked_mul(3 * scalar.size() + bytes_a_point(attributes))?.checked_add(header)
            }
            Self::Pcd { encoding: PcdEncoding::Binary, scalar } => {
                let header =
                    pcd::header(PcdEncoding::Binary, scalar, points, attributes, origin).len() as u64;
                let fields = pcd::columns(attributes, PcdEncoding::Binary, 0..0);
                points.checked_mul(3 * scalar.size() + bytes_a_point(&fields))?.checked_add(header)
            }
            Self::Xyz { .. } | Self::Las { .. } | Self::Pcd { .. } => None,
        }
    }
}

impl Separator {
    /// What is written.
    pub(super) fn as_str(self) -> &'static str {
        match self {
            Self::Space => " ",
            Self::Comma => ",",
            Self::Semicolon => ";",
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
