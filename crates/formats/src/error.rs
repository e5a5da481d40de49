//! What can go wrong between bytes and points.

use std::fmt;
use std::io;

use densecloud_geometry::MeshError;

/// Why a file could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The underlying reader or writer failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The content is in no format that is read here.
    #[error(
        "unknown format: {found}; convert it to PLY, LAS, LAZ, E57 or PCD, or to text with a point a line (XYZ)"
    )]
    Unrecognised {
        /// What the content looks like.
        found: String,
    },
    /// The content breaks its format's rules.
    #[error("{at}: {why}")]
    Malformed {
        /// Where.
        at: Place,
        /// What was found, and what was expected.
        why: String,
    },
    /// The content stops before what its header counts.
    #[error("the data end at {at}: {why}")]
    Truncated {
        /// Where the data end.
        at: Place,
        /// What was still missing.
        why: String,
    },
    /// More points than [`Limits::max_points`](super::Limits::max_points).
    #[error("{points} points, over the limit max_points = {limit}")]
    TooManyPoints {
        /// Points that the header counts, or points read until the limit was passed.
        points: u64,
        /// The limit.
        limit: u64,
    },
    /// More bytes than [`Limits::max_bytes`](super::Limits::max_bytes).
    #[error("at least {bytes} bytes, over the limit max_bytes = {limit}")]
    TooLarge {
        /// Bytes that the header implies, or bytes read until the limit was passed.
        bytes: u64,
        /// The limit.
        limit: u64,
    },
    /// Well-formed, but without a single point (or, for a mesh, without a triangle).
    #[error("the file holds no {0}")]
    Empty(&'static str),
    /// A mesh that nothing can be done with.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A writer was finished, or over-filled, with another number of points than it was made for.
    #[error("{written} points written to a file whose header promises {promised}")]
    WrongCount {
        /// Points promised to [`CloudWriter::new`](super::CloudWriter::new).
        promised: u64,
        /// Points written.
        written: u64,
    },
    /// A cloud that the format cannot hold, or a format that is not written in parts.
    #[error("cannot be written: {0}")]
    NotWritten(String),
    /// A coordinate is beyond the range of the file's scalar type.
    #[error("the coordinate {0:e} does not fit into 32-bit floats; write 64-bit ones")]
    Unrepresentable(f64),
}

/// A place in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// A line of text, counted from 1.
    Line(u64),
    /// An offset in bytes, counted from 0.
    Byte(u64),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, "line {line}"),
            Self::Byte(byte) => write!(f, "byte {byte}"),
        }
    }
}

impl FormatError {
    /// A file of this format cannot be begun before all of its points are known.
    pub(super) fn not_streamed(format: impl fmt::Display) -> Self {
        Self::NotWritten(format!("{format} is made as a whole, not in parts"))
    }

    /// Files of this format are read and not written.
    pub(super) fn read_only(format: impl fmt::Display) -> Self {
        Self::NotWritten(format!("{format} is read only"))
    }

    pub(super) fn malformed(at: Place, why: impl Into<String>) -> Self {
        Self::Malformed { at, why: why.into() }
    }

    pub(super) fn truncated(at: Place, why: impl Into<String>) -> Self {
        Self::Truncated { at, why: why.into() }
    }
}
