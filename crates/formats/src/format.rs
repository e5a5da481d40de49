//! Names of formats, what a header says, and limits.

use std::fmt;
use std::path::Path;

use super::writer::ply_header;
use super::{e57, npy, pcd};
use densecloud_cloud::{Attribute, Origin, Position, Table, bytes_a_point};

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
    /// OFF, read only: the vertices of a mesh.
    Off,
    /// Wavefront OBJ, read only: the vertices of a mesh.
    Obj,
    /// ASTM E57, written with 64-bit floats for coordinates.
    E57,
    /// NumPy's `.npy`, written little-endian, a point a row.
    Npy {
        /// The type of the coordinates.
        scalar: Scalar,
        /// Whether attributes are fields with names and types of their own; without, they are further
        /// columns of the table that the coordinates are in, of the same type.
        fields: bool,
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
    /// What the file holds and will be dropped: lists of vertices, fields of several numbers, elements
    /// without properties, in the file's order.
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
    /// commas; `las`, `laz`, `e57`, `pcd` (binary) and `npy` (64-bit floats, attributes as fields) are what they say.
    /// Case is ignored.
    #[must_use]
    pub fn from_extension(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        match extension.as_str() {
            "ply" => Some(Self::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F32 }),
            "xyz" | "txt" | "asc" | "pts" | "pwn" => Some(Self::TEXT),
            "csv" => Some(Self::Xyz { names: false, separator: Separator::Comma }),
            "las" => Some(Self::Las { compressed: false }),
            "laz" => Some(Self::Las { compressed: true }),
            "npy" => Some(Self::Npy { scalar: Scalar::F64, fields: true }),
            "e57" => Some(Self::E57),
            "off" => Some(Self::Off),
            "obj" => Some(Self::Obj),
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

    /// The format that a cloud of this one is written in where nobody says which: itself, or, for what
    /// is read only, binary PLY in 64-bit floats, which holds all that was read.
    #[must_use]
    pub fn written(self) -> Self {
        match self {
            Self::Off | Self::Obj => {
                Self::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F64 }
            }
            other => other,
        }
    }

    /// The type that holds all that coordinates of this format can tell.
    fn scalar(self) -> Scalar {
        match self {
            Self::Ply { scalar, .. } | Self::Pcd { scalar, .. } | Self::Npy { scalar, .. } => scalar,
            Self::Xyz { .. } | Self::Las { .. } | Self::E57 | Self::Off | Self::Obj => Scalar::F64,
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
            (Some(wanted @ (Self::Las { .. } | Self::E57)), _) => wanted,
            (Some(Self::Off | Self::Obj), _) => input.written(),
            (Some(wanted), input) if wanted.is_like(input) => input,
            (Some(Self::Ply { encoding, .. }), _) => Self::Ply { encoding, scalar: input.scalar() },
            (Some(Self::Npy { fields, .. }), _) => Self::Npy { scalar: input.scalar(), fields },
            // Much that reads PCD knows no others; see `fine_enough`.
            (Some(Self::Pcd { encoding, .. }), _) => Self::Pcd { encoding, scalar: Scalar::F32 },
        }
    }

    /// This format with 64-bit coordinates where 32-bit ones would move points of `bounds` by more than a
    /// hundredth of `spacing`: a cloud in UTM coordinates, say.
    #[must_use]
    pub fn fine_enough(self, bounds: [Position; 2], spacing: f64) -> Self {
        let largest = bounds.as_flattened().iter().fold(0.0_f64, |most, c| most.max(c.abs()));
        // Rounding moves a coordinate by half of the step between two floats at most.
        let coarse = 0.5 * largest * f64::from(f32::EPSILON) > 0.01 * spacing;
        match self {
            Self::Ply { encoding, scalar: Scalar::F32 } if coarse => {
                Self::Ply { encoding, scalar: Scalar::F64 }
            }
            Self::Pcd { encoding, scalar: Scalar::F32 } if coarse => {
                Self::Pcd { encoding, scalar: Scalar::F64 }
            }
            Self::Npy { scalar: Scalar::F32, fields } if coarse => Self::Npy { scalar: Scalar::F64, fields },
            other => other,
        }
    }

    /// Whether it has a place for comments, and so for provenance.
    #[must_use]
    pub fn holds_comments(self) -> bool {
        match self {
            Self::Ply { .. } | Self::Las { .. } | Self::Pcd { .. } | Self::E57 => true,
            Self::Xyz { .. } | Self::Npy { .. } | Self::Off | Self::Obj => false,
        }
    }

    /// Whether files are compressed in themselves, so that compressing them once more is in vain.
    #[must_use]
    pub fn is_packed(self) -> bool {
        matches!(
            self,
            Self::Las { compressed: true } | Self::E57 | Self::Pcd { encoding: PcdEncoding::Compressed, .. }
        )
    }

    /// Whether [`CloudWriter`](super::CloudWriter) writes it in parts; if not, only
    /// [`encode`](super::encode) writes it, as a whole.
    #[must_use]
    pub fn is_streamed(self) -> bool {
        match self {
            Self::Pcd { encoding: PcdEncoding::Compressed, .. } => false,
            Self::Ply { .. } | Self::Xyz { .. } | Self::Npy { .. } | Self::Pcd { .. } => true,
            Self::Las { .. } | Self::E57 | Self::Off | Self::Obj => false,
        }
    }

    /// What a file of this format has no place for, a phrase each: of the attributes and of what else is
    /// known of the cloud.
    #[must_use]
    pub fn cannot_hold(self, attributes: &[Attribute], origin: &Origin) -> Vec<String> {
        let mut lost = Vec::new();
        if let Self::E57 = self {
            lost.extend(e57::not_held(attributes));
        }
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
        if let (Self::Xyz { .. } | Self::Npy { .. }, Some(crs)) = (self, &origin.crs) {
            lost.push(format!("the coordinate system ({})", crs.name()));
        }
        if !matches!(self, Self::Ply { .. }) {
            lost.extend(origin.tables.iter().map(|table| table.name.clone()));
        }
        lost
    }

    /// The media types of all that is written; see [`Format::media_type`].
    pub const MEDIA_TYPES: [&str; 8] = [
        "application/x-ply",
        "application/vnd.las",
        "application/vnd.laszip",
        "application/x-pcd",
        "application/x-npy",
        "model/e57",
        "text/plain",
        "text/csv",
    ];

    /// The format that a media type asks for, without parameters, in lower case; as
    /// [`Format::from_extension`] has it.
    #[must_use]
    pub fn from_media_type(media_type: &str) -> Option<Self> {
        let extension = match media_type {
            "application/x-ply" | "application/ply" | "model/ply" => "ply",
            "text/plain" => "xyz",
            "text/csv" => "csv",
            "application/vnd.las" => "las",
            "application/vnd.laszip" => "laz",
            "application/x-pcd" => "pcd",
            "application/x-npy" => "npy",
            "model/e57" => "e57",
            _ => return None,
        };
        Self::from_extension(Path::new(&format!("cloud.{extension}")))
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
            Self::Npy { .. } => "application/x-npy",
            Self::E57 => "model/e57",
            Self::Off => "model/vnd.off",
            Self::Obj => "model/obj",
        }
    }

    /// The exact length in bytes of a file of `points` points with these attributes as
    /// [`CloudWriter`](super::CloudWriter) writes it, where it depends on nothing else: binary PLY and
    /// PCD, and NumPy.
    #[must_use]
    pub fn encoded_len(self, points: u64, attributes: &[Attribute], origin: &Origin) -> Option<u64> {
        match self {
            Self::Ply { encoding: PlyEncoding::Ascii, .. } => None,
            Self::Ply { encoding, scalar } => {
                let header = ply_header(encoding, scalar, points, attributes, origin).len() as u64;
                let tables = origin.tables.iter().map(Table::bytes).sum::<u64>();
                let rows = points.checked_mul(3 * scalar.size() + bytes_a_point(attributes))?;
                rows.checked_add(header)?.checked_add(tables)
            }
            Self::Npy { scalar, fields } => {
                let header = npy::header(scalar, fields, points, attributes).len() as u64;
                let others = if npy::is_table(fields, attributes) {
                    attributes.len() as u64 * scalar.size()
                } else {
                    bytes_a_point(attributes)
                };
                points.checked_mul(3 * scalar.size() + others)?.checked_add(header)
            }
            Self::Pcd { encoding: PcdEncoding::Binary, scalar } => {
                let header =
                    pcd::header(PcdEncoding::Binary, scalar, points, attributes, origin).len() as u64;
                let fields = pcd::columns(attributes, PcdEncoding::Binary, 0..0);
                points.checked_mul(3 * scalar.size() + bytes_a_point(&fields))?.checked_add(header)
            }
            Self::Xyz { .. } | Self::Las { .. } | Self::Pcd { .. } | Self::E57 | Self::Off | Self::Obj => {
                None
            }
        }
    }
}

/// For people: `PLY (binary_little_endian, 32-bit)`.
impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ply { encoding, scalar } => {
                write!(f, "PLY ({}, {}-bit)", encoding.name(), 8 * scalar.size())
            }
            Self::Xyz { separator: Separator::Comma, .. } => f.write_str("text (commas)"),
            Self::Xyz { separator: Separator::Semicolon, .. } => f.write_str("text (semicolons)"),
            Self::Xyz { separator: Separator::Space, .. } => f.write_str("text"),
            Self::Npy { scalar, fields } => {
                let fields = if *fields { ", fields" } else { "" };
                write!(f, "NumPy ({}-bit{fields})", 8 * scalar.size())
            }
            Self::E57 => f.write_str("E57"),
            Self::Off => f.write_str("OFF"),
            Self::Obj => f.write_str("OBJ"),
            Self::Las { compressed: false } => f.write_str("LAS"),
            Self::Las { compressed: true } => f.write_str("LAZ"),
            Self::Pcd { encoding, scalar } => {
                write!(f, "PCD ({}, {}-bit)", encoding.name(), 8 * scalar.size())
            }
        }
    }
}

impl PcdEncoding {
    /// As in a header.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::Binary => "binary",
            Self::Compressed => "binary_compressed",
        }
    }
}

impl PlyEncoding {
    /// As in a header.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::BinaryLittleEndian => "binary_little_endian",
            Self::BinaryBigEndian => "binary_big_endian",
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
