//! Meshes: which format, and polygons to triangles.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::source::{Around, Input, Source};
use super::text::{next_token, shown, strip_comment};
use super::{FormatError, Limits, Place, off, ply};
use densecloud_cloud::Position;
use densecloud_geometry::Mesh;

/// Reads a triangle mesh from a PLY or OFF file. See [`read_mesh`].
///
/// # Errors
/// As [`read_mesh`], or the file cannot be opened.
pub fn read_mesh_file(path: &Path) -> Result<Mesh, FormatError> {
    read_mesh(File::open(path)?)
}

/// Reads a triangle mesh; the content tells whether it is PLY (any encoding) or OFF.
///
/// A polygon of more than three corners becomes a fan of triangles about its first corner: exact for
/// convex and planar ones. Fewer than three corners have no area and are skipped. Vertices that no
/// face uses are kept.
///
/// # Errors
/// The content is neither, is malformed, has a triangle with a NaN or infinite corner, refers to a
/// vertex that is not there, or holds no triangle.
pub fn read_mesh<R: Read>(reader: R) -> Result<Mesh, FormatError> {
    let mut source = Source::new(Input::Stream(Box::new(reader)), Limits::default(), Around::Utf8)?;
    let head = source.peek(4096)?;
    if head.starts_with(b"ply") {
        return ply::read_mesh(&mut source);
    }
    let mut lines = head.split(|b| *b == b'\n' || *b == b'\r');
    let first = lines.find_map(|line| next_token(&mut strip_comment(line)));
    match first {
        Some(token) if off::is_keyword(token) => off::read_mesh(&mut source),
        Some(token) => {
            let found = format!("a mesh begins with `ply` or `OFF`, this with {}", shown(token));
            Err(FormatError::Unrecognised { found })
        }
        None => Err(FormatError::Empty("triangles")),
    }
}

/// Faces as they are read. Corners are checked at the end, since faces may come before vertices.
#[derive(Debug, Default)]
pub(super) struct Polygons {
    triangles: Vec<[u32; 3]>,
    /// The largest corner so far, and where it was read.
    largest: Option<(u32, Place)>,
}

impl Polygons {
    /// Adds a face.
    pub(super) fn push(&mut self, corners: &[u32], at: Place) {
        if let Some(largest) = corners.iter().max()
            && self.largest.is_none_or(|(seen, _)| *largest > seen)
        {
            self.largest = Some((*largest, at));
        }
        if let [first, rest @ ..] = corners {
            self.triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
        }
    }

    /// Checks all corners and vertices.
    pub(super) fn into_mesh(self, vertices: Vec<Position>) -> Result<Mesh, FormatError> {
        if let Some((corner, at)) = self.largest
            && u64::from(corner) >= vertices.len() as u64
        {
            let why = format!("a face refers to vertex {corner}, but there are {}", vertices.len());
            return Err(FormatError::malformed(at, why));
        }
        if self.triangles.is_empty() {
            return Err(FormatError::Empty("triangles"));
        }
        let mesh = Mesh { vertices, triangles: self.triangles };
        mesh.validate()?;
        Ok(mesh)
    }
}
