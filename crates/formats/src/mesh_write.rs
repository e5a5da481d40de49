//! Meshes out: PLY, OBJ, STL and binary glTF.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use densecloud_cloud::{Attribute, Column, Origin, Position, Table, Values};
use densecloud_geometry::Mesh;

use super::{Format, FormatError, PlyEncoding, Scalar, encode};

/// How much of a triangle's side rounding to 32 bits may take.
const COARSEST_ROUNDING: f64 = 0.01;

/// A format that meshes are written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum MeshFormat {
    /// Binary PLY, coordinates in 64 bits, colours as `red`, `green` and `blue`.
    Ply,
    /// Wavefront OBJ: text, coordinates in full, colours after them as most programs read them.
    Obj,
    /// Binary STL: triangles of 32-bit coordinates, no colours.
    Stl,
    /// Binary glTF 2.0: 32-bit coordinates about a translation that keeps 64, colours, normals left to the viewer.
    Glb,
}

impl MeshFormat {
    /// The format that a file's name asks for.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "ply" => Some(Self::Ply),
            "obj" => Some(Self::Obj),
            "stl" => Some(Self::Stl),
            "glb" => Some(Self::Glb),
            _ => None,
        }
    }

    /// Whether it has a place for colours.
    #[must_use]
    pub fn has_colours(self) -> bool {
        self != Self::Stl
    }

    /// Whether its numbers are too coarse for a mesh whose triangles' sides are about so long.
    #[must_use]
    pub fn is_too_coarse(self, mesh: &Mesh, side: f64) -> bool {
        let largest = mesh.vertices.as_flattened().iter().fold(0.0_f64, |most, c| most.max(c.abs()));
        self == Self::Stl && largest * f64::from(f32::EPSILON) > COARSEST_ROUNDING * side
    }
}

/// Writes a mesh with a colour for each vertex, or without. `origin`'s comments and coordinate system go into PLY.
///
/// # Errors
/// The sink's, or a mesh of more bytes than the format can count.
pub fn write_mesh(
    sink: &mut dyn Write,
    format: MeshFormat,
    mesh: &Mesh,
    colours: Option<&[[u8; 3]]>,
    origin: &Origin,
) -> Result<(), FormatError> {
    match format {
        MeshFormat::Ply => ply(sink, mesh, colours, origin),
        MeshFormat::Obj => Ok(obj(sink, mesh, colours)?),
        MeshFormat::Stl => Ok(stl(sink, mesh)?),
        MeshFormat::Glb => Ok(glb(sink, mesh, colours)?),
    }
}

fn ply(
    sink: &mut dyn Write,
    mesh: &Mesh,
    colours: Option<&[[u8; 3]]>,
    origin: &Origin,
) -> Result<(), FormatError> {
    let lists = Column::List {
        lengths: Values::U8(vec![3; mesh.triangles.len()]),
        items: Values::U32(mesh.triangles.as_flattened().to_vec()),
    };
    let columns = vec![("vertex_indices".to_owned(), lists)];
    let faces = Table { name: "face".to_owned(), rows: mesh.triangles.len(), columns };
    let origin = Origin {
        tables: Arc::new(vec![faces]),
        crs: origin.crs.clone(),
        comments: origin.comments.clone(),
        ..Origin::default()
    };
    let part = |(a, name): (usize, &str)| Attribute {
        name: name.to_owned(),
        values: Values::U8(colours.unwrap_or_default().iter().map(|c| c[a]).collect()),
    };
    let attributes: Vec<Attribute> = match colours {
        Some(_) => ["red", "green", "blue"].into_iter().enumerate().map(part).collect(),
        None => Vec::new(),
    };
    let format = Format::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F64 };
    encode(sink, format, &mesh.vertices, &attributes, &origin)?;
    Ok(())
}

fn obj(sink: &mut dyn Write, mesh: &Mesh, colours: Option<&[[u8; 3]]>) -> std::io::Result<()> {
    for (i, [x, y, z]) in mesh.vertices.iter().enumerate() {
        match colours.map(|all| all[i].map(|c| f32::from(c) / 255.0)) {
            Some([r, g, b]) => writeln!(sink, "v {x} {y} {z} {r:.4} {g:.4} {b:.4}")?,
            None => writeln!(sink, "v {x} {y} {z}")?,
        }
    }
    for [a, b, c] in mesh.triangles.iter().map(|t| t.map(|v| u64::from(v) + 1)) {
        writeln!(sink, "f {a} {b} {c}")?;
    }
    Ok(())
}

fn stl(sink: &mut dyn Write, mesh: &Mesh) -> std::io::Result<()> {
    let mut header = [b' '; 80];
    header[..10].copy_from_slice(b"densecloud");
    sink.write_all(&header)?;
    sink.write_all(&counted(mesh.triangles.len())?.to_le_bytes())?;
    for corners in &mesh.triangles {
        let corners = corners.map(|v| mesh.vertices[v as usize]);
        let normal = unit_normal(corners);
        for number in [normal, corners[0], corners[1], corners[2]].as_flattened() {
            sink.write_all(&(*number as f32).to_le_bytes())?;
        }
        sink.write_all(&[0; 2])?;
    }
    Ok(())
}

fn unit_normal([a, b, c]: [Position; 3]) -> Position {
    let (u, v): (Position, Position) =
        (std::array::from_fn(|i| b[i] - a[i]), std::array::from_fn(|i| c[i] - a[i]));
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let length = n.iter().map(|c| c * c).sum::<f64>().sqrt();
    if length > 0.0 { n.map(|c| c / length) } else { [0.0; 3] }
}

fn counted(bytes: usize) -> std::io::Result<u32> {
    let too_large = || std::io::Error::other("the mesh has more than the format can count; take PLY");
    u32::try_from(bytes).map_err(|_| too_large())
}

/// A file of two chunks: a description, and positions, colours and corners one after another.
fn glb(sink: &mut dyn Write, mesh: &Mesh, colours: Option<&[[u8; 3]]>) -> std::io::Result<()> {
    let (low, high) = mesh.bounds().unwrap_or_default();
    let middle: Position = std::array::from_fn(|a| low[a] + (high[a] - low[a]) / 2.0);
    let mut bytes = Vec::new();
    let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    for v in &mesh.vertices {
        for a in 0..3 {
            let c = (v[a] - middle[a]) as f32;
            bounds = [0, 1].map(|end| {
                let mut bound = bounds[end];
                bound[a] = if end == 0 { bound[a].min(c) } else { bound[a].max(c) };
                bound
            });
            bytes.extend(c.to_le_bytes());
        }
    }
    // A fourth byte, since each entry must begin at a multiple of four.
    bytes.extend(
        colours.unwrap_or_default().iter().flat_map(|c| [linear(c[0]), linear(c[1]), linear(c[2]), 255]),
    );
    bytes.extend(mesh.triangles.as_flattened().iter().flat_map(|v| v.to_le_bytes()));
    let mut json = description(mesh, colours.is_some(), middle, bounds).into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let total = counted(28 + json.len() + bytes.len())?;
    sink.write_all(b"glTF")?;
    for number in [2, total, counted(json.len())?] {
        sink.write_all(&number.to_le_bytes())?;
    }
    sink.write_all(b"JSON")?;
    sink.write_all(&json)?;
    sink.write_all(&counted(bytes.len())?.to_le_bytes())?;
    sink.write_all(b"BIN\0")?;
    sink.write_all(&bytes)
}

/// A part of a colour in linear light, which glTF has where pictures have sRGB.
fn linear(c: u8) -> u8 {
    let c = f64::from(c) / 255.0;
    let light = if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    (light * 255.0).round() as u8
}

/// glTF's description. Its y points up, so the mesh is turned: its own z does.
fn description(mesh: &Mesh, coloured: bool, [x, y, z]: Position, [low, high]: [[f32; 3]; 2]) -> String {
    let (n, corners) = (mesh.vertices.len(), 3 * mesh.triangles.len());
    let (places, tints) = (12 * n, if coloured { 4 * n } else { 0 });
    let (views, accessor, attribute) = if coloured {
        (
            format!(
                "{{\"buffer\":0,\"byteOffset\":{places},\"byteLength\":{tints},\"byteStride\":4,\"target\":34962}},"
            ),
            format!(
                "{{\"bufferView\":1,\"componentType\":5121,\"normalized\":true,\"count\":{n},\"type\":\"VEC4\"}},"
            ),
            ",\"COLOR_0\":1",
        )
    } else {
        Default::default()
    };
    let last = if coloured { 2 } else { 1 };
    // Turned by -90 degrees about x: (x, y, z) becomes (x, z, -y).
    format!(
        "{{\"asset\":{{\"version\":\"2.0\",\"generator\":\"densecloud\"}},\"scene\":0,\"scenes\":[{{\"nodes\":[0]}}],\
         \"nodes\":[{{\"mesh\":0,\"translation\":[{x:?},{z:?},{:?}],\"rotation\":[-0.7071067811865476,0,0,0.7071067811865476]}}],\
         \"meshes\":[{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0{attribute}}},\"indices\":{last},\"material\":0}}]}}],\
         \"materials\":[{{\"doubleSided\":true,\"pbrMetallicRoughness\":{{\"metallicFactor\":0,\"roughnessFactor\":0.8}}}}],\
         \"accessors\":[{{\"bufferView\":0,\"componentType\":5126,\"count\":{n},\"type\":\"VEC3\",\"min\":{low:?},\"max\":{high:?}}},\
         {accessor}{{\"bufferView\":{last},\"componentType\":5125,\"count\":{corners},\"type\":\"SCALAR\"}}],\
         \"bufferViews\":[{{\"buffer\":0,\"byteOffset\":0,\"byteLength\":{places},\"target\":34962}},\
         {views}{{\"buffer\":0,\"byteOffset\":{},\"byteLength\":{},\"target\":34963}}],\
         \"buffers\":[{{\"byteLength\":{}}}]}}",
        -y,
        places + tints,
        4 * corners,
        places + tints + 4 * corners,
    )
}
