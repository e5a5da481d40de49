//! The triangles of a PLY file.

use super::super::mesh::Polygons;
use super::super::reader::Block;
use super::super::source::Source;
use super::super::{FormatError, PlyEncoding};
use super::cloud::VertexReader;
use super::header::{Element, Shape, parse};
use super::rows::Rows;
use densecloud_cloud::Position;
use densecloud_geometry::Mesh;

/// Reads a PLY file with the elements `vertex` and `face`; the faces' list is named `vertex_indices`
/// or `vertex_index`. Everything else is skipped.
pub(in super::super) fn read_mesh(source: &mut Source<'_>) -> Result<Mesh, FormatError> {
    let header = parse(source)?;
    for (name, what) in [("vertex", "vertices"), ("face", "faces: it is a cloud, not a mesh")] {
        if header.element(name).is_none() {
            return Err(FormatError::malformed(source.line(), format!("the file has no {what}")));
        }
    }
    let mut vertices = Vec::new();
    let mut polygons = Polygons::default();
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => vertices = read_vertices(source, header.encoding, element)?,
            "face" => read_faces(source, header.encoding, element, &mut polygons)?,
            _ => Rows::new(source, header.encoding, element).skip_all()?,
        }
    }
    source.expect_end("the elements that the header counts")?;
    polygons.into_mesh(vertices)
}

fn read_vertices(
    source: &mut Source<'_>,
    encoding: PlyEncoding,
    vertex: &Element,
) -> Result<Vec<Position>, FormatError> {
    let mut reader = VertexReader::new(source, encoding, vertex, false)?;
    let mut block = Block::default();
    let mut before = None;
    while before != Some(block.positions.len()) {
        before = Some(block.positions.len());
        reader.append(source, vertex, usize::MAX, &mut block)?;
    }
    Ok(block.positions)
}

fn read_faces(
    source: &mut Source<'_>,
    encoding: PlyEncoding,
    face: &Element,
    polygons: &mut Polygons,
) -> Result<(), FormatError> {
    let is_corners = |name: &str| matches!(name, "vertex_indices" | "vertex_index");
    let listed = |shape: Shape| matches!(shape, Shape::List { .. });
    if !face.properties.iter().any(|p| is_corners(&p.name) && listed(p.shape)) {
        return Err(FormatError::malformed(source.line(), "the faces have no list `vertex_indices`"));
    }
    let mut corners = Vec::new();
    let mut rows = Rows::new(source, encoding, face);
    while rows.begin()? {
        for property in &face.properties {
            match property.shape {
                Shape::List { length, item } if is_corners(&property.name) => {
                    corners.clear();
                    for _ in 0..rows.whole(length, "the length of a list")? {
                        corners.push(rows.whole(item, "the index of a vertex")?);
                    }
                    polygons.push(&corners, rows.place());
                }
                shape => rows.skip(shape)?,
            }
        }
        rows.end()?;
    }
    Ok(())
}
