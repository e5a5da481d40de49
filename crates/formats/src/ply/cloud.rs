//! The positions and attributes of a PLY file's vertices.

use std::io::Read;
use std::sync::Arc;

use super::super::source::Source;
use super::super::writer::CRS;
use super::super::{Format, FormatError, Header, Limits, PlyEncoding, Scalar};
use super::header::{Element, PlyHeader, Shape};
use super::rows::{Rows, decode, truncated};
use densecloud_cloud::{self as table, Attribute, Cloud, Kind, Origin, Position, Table, Values};

/// What a PLY header says of the cloud, checked against the limits. `source` is where the data begin.
pub(in super::super) fn describe<R: Read>(
    source: &Source<R>,
    header: &PlyHeader,
    limits: Limits,
) -> Result<Header, FormatError> {
    let Some((at, vertex)) = header.element("vertex") else {
        return Err(FormatError::malformed(source.line(), "the PLY header declares no element `vertex`"));
    };
    let axes = axes(source, vertex)?;
    if let Some(limit) = limits.max_points
        && vertex.count > limit
    {
        return Err(FormatError::TooManyPoints { points: vertex.count, limit });
    }
    if let Some(limit) = limits.max_bytes
        && header.min_len() > limit
    {
        return Err(FormatError::TooLarge { bytes: header.min_len(), limit });
    }
    let (mut attributes, mut dropped_properties) = (Vec::new(), Vec::new());
    for (i, element) in header.elements.iter().enumerate() {
        if i == at {
            for (_, property) in vertex.properties.iter().enumerate().filter(|(i, _)| !axes.contains(i)) {
                match property.shape {
                    Shape::Scalar(_) => attributes.push(property.name.clone()),
                    Shape::List { .. } => dropped_properties.push(property.name.clone()),
                }
            }
        } else if element.properties.is_empty() {
            dropped_properties.push(element.name.clone());
        }
    }
    let narrow = axes.iter().all(|a| match vertex.properties[*a].shape {
        Shape::Scalar(kind) | Shape::List { item: kind, .. } => kind.fits_f32(),
    });
    let scalar = if narrow { Scalar::F32 } else { Scalar::F64 };
    let format = Format::Ply { encoding: header.encoding, scalar };
    Ok(Header { format, points: Some(vertex.count), attributes, dropped_properties })
}

/// Reads the vertices, and the other elements as tables.
pub(in super::super) fn read_cloud<R: Read>(
    source: &mut Source<R>,
    header: &PlyHeader,
) -> Result<Cloud, FormatError> {
    let mut vertices = Vertices::default();
    let mut tables = Vec::new();
    for element in &header.elements {
        if element.name == "vertex" {
            vertices = read_vertices(source, header.encoding, element, true)?;
        } else if !element.properties.is_empty() {
            tables.push(read_table(source, header.encoding, element)?);
        }
    }
    source.expect_end("the elements that the header counts")?;
    let Vertices { positions, attributes } = vertices;
    let mut origin = Origin { tables: Arc::new(tables), ..Origin::default() };
    for comment in &header.comments {
        match comment.trim_start().strip_prefix(CRS) {
            Some(crs) if origin.crs.is_none() && !crs.trim().is_empty() => {
                // Parsing cannot fail.
                origin.crs = crs.parse().ok();
            }
            _ => origin.comment(comment),
        }
    }
    Ok(Cloud { positions, attributes, dropped_properties: Vec::new(), origin })
}

/// Reads an element with properties.
fn read_table<R: Read>(
    source: &mut Source<R>,
    encoding: PlyEncoding,
    element: &Element,
) -> Result<Table, FormatError> {
    let mut columns: Vec<_> = (element.properties.iter())
        .map(|property| match property.shape {
            Shape::Scalar(kind) | Shape::List { item: kind, .. } => (Vec::new(), Values::new(kind)),
        })
        .collect();
    let mut count = 0;
    let mut rows = Rows::new(source, encoding, element);
    while rows.begin()? {
        for (property, (lengths, values)) in element.properties.iter().zip(&mut columns) {
            match property.shape {
                Shape::Scalar(_) => rows.push(values)?,
                Shape::List { length, .. } => {
                    let items = rows.whole(length, "the length of a list")?;
                    lengths.push(items);
                    for _ in 0..items {
                        rows.push(values)?;
                    }
                }
            }
        }
        rows.end()?;
        count += 1;
    }
    let columns = element.properties.iter().zip(columns).map(|(property, (lengths, values))| {
        let column = match property.shape {
            Shape::Scalar(_) => table::Column::Scalar(values),
            Shape::List { length, .. } => table::Column::List {
                lengths: Values::from_f64(length, lengths.into_iter().map(f64::from)),
                items: values,
            },
        };
        (property.name.clone(), column)
    });
    Ok(Table { name: element.name.clone(), rows: count, columns: columns.collect() })
}

/// What the element `vertex` holds.
#[derive(Default)]
pub(super) struct Vertices {
    pub(super) positions: Vec<Position>,
    /// Every scalar property but `x`, `y` and `z`, in the file's order.
    pub(super) attributes: Vec<Attribute>,
}

/// Reads the element `vertex`, with its attributes or without.
pub(super) fn read_vertices<R: Read>(
    source: &mut Source<R>,
    encoding: PlyEncoding,
    vertex: &Element,
    keep: bool,
) -> Result<Vertices, FormatError> {
    let axes = axes(source, vertex)?;
    let mut columns = Vec::new();
    let mut offset = 0;
    for (i, property) in vertex.properties.iter().enumerate() {
        if let Shape::Scalar(kind) = property.shape {
            if keep && !axes.contains(&i) {
                let attribute = Attribute { name: property.name.clone(), values: Values::new(kind) };
                columns.push(Column { property: i, offset, attribute });
            }
            offset += kind.size();
        }
    }
    let positions = match (encoding, vertex.stride()) {
        (PlyEncoding::BinaryLittleEndian, Some(_)) => {
            read_stride::<R, false>(source, vertex, axes, &mut columns)
        }
        (PlyEncoding::BinaryBigEndian, Some(_)) => read_stride::<R, true>(source, vertex, axes, &mut columns),
        _ => read_rows(source, encoding, vertex, axes, &mut columns),
    }?;
    Ok(Vertices { positions, attributes: columns.into_iter().map(|c| c.attribute).collect() })
}

/// An attribute as it is read.
struct Column {
    /// Its place among the properties.
    property: usize,
    /// Bytes from the beginning of a binary row, where rows are of equal length.
    offset: usize,
    attribute: Attribute,
}

/// Where `x`, `y` and `z` stand among the properties.
fn axes<R: Read>(source: &Source<R>, vertex: &Element) -> Result<[usize; 3], FormatError> {
    let mut axes = [0; 3];
    for (axis, name) in axes.iter_mut().zip(["x", "y", "z"]) {
        let found = vertex.properties.iter().position(|p| p.name == name);
        *axis =
            found.filter(|i| matches!(vertex.properties[*i].shape, Shape::Scalar(_))).ok_or_else(|| {
                FormatError::malformed(source.line(), format!("the vertices have no number `{name}`"))
            })?;
    }
    Ok(axes)
}

/// Rows of equal length: whole blocks at a time, from the buffer.
fn read_stride<R: Read, const BIG: bool>(
    source: &mut Source<R>,
    vertex: &Element,
    axes: [usize; 3],
    others: &mut [Column],
) -> Result<Vec<Position>, FormatError> {
    let mut offsets = Vec::with_capacity(vertex.properties.len());
    let mut stride = 0;
    for property in &vertex.properties {
        offsets.push(stride);
        if let Shape::Scalar(kind) = property.shape {
            stride += kind.size();
        }
    }
    let columns = axes.map(|a| {
        let kind = match vertex.properties[a].shape {
            Shape::Scalar(kind) | Shape::List { item: kind, .. } => kind,
        };
        (offsets[a], kind)
    });
    let mut positions: Vec<Position> = Vec::new();
    while (positions.len() as u64) < vertex.count {
        if !source.ensure(stride)? {
            return Err(truncated(source.offset(), vertex, positions.len() as u64));
        }
        let left = usize::try_from(vertex.count - positions.len() as u64).unwrap_or(usize::MAX);
        let rows = left.min(source.buffered().len() / stride);
        let block = &source.buffered()[..rows * stride];
        decode_block::<BIG>(block, stride, columns, &mut positions);
        for column in others.iter_mut() {
            let rows = block.chunks_exact(stride).map(|row| &row[column.offset..]);
            column.attribute.values.extend_from_bytes(rows, BIG);
        }
        source.consume(rows * stride);
    }
    Ok(positions)
}

/// Appends the positions of whole rows. The usual types have loops of their own, so that no type is
/// looked at a point.
fn decode_block<const BIG: bool>(
    block: &[u8],
    stride: usize,
    columns: [(usize, Kind); 3],
    positions: &mut Vec<Position>,
) {
    let offsets = columns.map(|(offset, _)| offset);
    let rows = block.chunks_exact(stride);
    match columns.map(|(_, kind)| kind) {
        [Kind::F32, Kind::F32, Kind::F32] => positions.extend(rows.map(|row| {
            offsets.map(|o| {
                let word = [row[o], row[o + 1], row[o + 2], row[o + 3]];
                f64::from(if BIG { f32::from_be_bytes(word) } else { f32::from_le_bytes(word) })
            })
        })),
        [Kind::F64, Kind::F64, Kind::F64] => positions.extend(rows.map(|row| {
            offsets.map(|o| {
                let mut word = [0; 8];
                word.copy_from_slice(&row[o..o + 8]);
                if BIG { f64::from_be_bytes(word) } else { f64::from_le_bytes(word) }
            })
        })),
        _ => positions.extend(rows.map(|row| columns.map(|(o, kind)| decode(kind, BIG, &row[o..])))),
    }
}

/// Text, and rows with lists in them.
fn read_rows<R: Read>(
    source: &mut Source<R>,
    encoding: PlyEncoding,
    vertex: &Element,
    axes: [usize; 3],
    others: &mut [Column],
) -> Result<Vec<Position>, FormatError> {
    let columns: Vec<(Shape, Option<usize>)> = (vertex.properties.iter().enumerate())
        .map(|(i, property)| (property.shape, axes.iter().position(|a| *a == i)))
        .collect();
    let mut positions = Vec::new();
    let mut rows = Rows::new(source, encoding, vertex);
    while rows.begin()? {
        let mut position = [0.0; 3];
        let mut kept = others.iter_mut().peekable();
        for (i, (shape, axis)) in columns.iter().enumerate() {
            match (shape, axis) {
                (Shape::Scalar(kind), Some(axis)) => position[*axis] = rows.number(*kind)?,
                _ => match kept.next_if(|column| column.property == i) {
                    Some(column) => rows.push(&mut column.attribute.values)?,
                    None => rows.skip(*shape)?,
                },
            }
        }
        rows.end()?;
        positions.push(position);
    }
    Ok(positions)
}
