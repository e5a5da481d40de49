//! The positions and attributes of a PLY file's vertices.

use std::ops::Range;
use std::sync::Arc;

use super::super::axes::axes_among;
use super::super::columns::MAX_COLUMNS;
use super::super::numbers::CRS;
use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::source::Source;
use super::super::{Format, FormatError, Header, Limits, PlyEncoding, Scalar};
use super::header::{Element, PlyHeader, Shape};
use super::rows::{Rows, decode, truncated};
use densecloud_cloud::{self as table, Kind, Origin, Position, Table, Values};

/// What a PLY header says of the cloud, checked against the limits. `source` is where the data begin.
pub(super) fn describe(
    source: &Source<'_>,
    header: &PlyHeader,
    limits: Limits,
) -> Result<Header, FormatError> {
    let Some((at, vertex)) = header.element("vertex") else {
        return Err(FormatError::malformed(source.line(), "the PLY header declares no element `vertex`"));
    };
    if vertex.properties.len() > MAX_COLUMNS {
        let found = vertex.properties.len();
        let why = format!("vertices of {found} properties; more than {MAX_COLUMNS} are not read");
        return Err(FormatError::malformed(source.line(), why));
    }
    let axes = axes(source, vertex)?;
    limits.check_points(vertex.count)?;
    limits.check_bytes(header.min_len())?;
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

/// The vertices, with the other elements as tables before and after them.
pub(super) struct PlyPoints {
    header: PlyHeader,
    /// The vertices' place among the elements.
    at: usize,
    vertices: VertexReader,
    tables: Vec<Table>,
    /// Whether the elements before the vertices are read.
    has_begun: bool,
}

impl PlyPoints {
    pub(super) fn new(source: &Source<'_>, header: PlyHeader) -> Result<Self, FormatError> {
        let Some((at, vertex)) = header.element("vertex") else {
            return Err(FormatError::malformed(source.line(), "the PLY header declares no element `vertex`"));
        };
        let vertices = VertexReader::new(source, header.encoding, vertex, true)?;
        Ok(Self { header, at, vertices, tables: Vec::new(), has_begun: false })
    }

    fn read_tables(&mut self, source: &mut Source<'_>, elements: Range<usize>) -> Result<(), FormatError> {
        for element in self.header.elements[elements].iter().filter(|e| !e.properties.is_empty()) {
            self.tables.push(read_table(source, self.header.encoding, element)?);
        }
        Ok(())
    }
}

impl Points for PlyPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if !self.has_begun {
            self.read_tables(source, 0..self.at)?;
            self.has_begun = true;
        }
        self.vertices.append(source, &self.header.elements[self.at], rows, to)
    }

    fn finish(mut self: Box<Self>, source: &mut Source<'_>) -> Result<Ending, FormatError> {
        self.read_tables(source, self.at + 1..self.header.elements.len())?;
        source.expect_end("the elements that the header counts")?;
        let mut origin = Origin { tables: Arc::new(self.tables), ..Origin::default() };
        for comment in &self.header.comments {
            match comment.trim_start().strip_prefix(CRS) {
                Some(crs) if origin.crs.is_none() && !crs.trim().is_empty() => {
                    // Parsing cannot fail.
                    origin.crs = crs.parse().ok();
                }
                _ => origin.comment(comment),
            }
        }
        let properties = &self.header.elements[self.at].properties;
        let columns = self.vertices.columns.iter();
        let columns =
            columns.map(|c| Some(ColumnName { name: properties[c.property].name.clone(), kind: c.kind }));
        let (columns, notes) = (columns.collect(), self.header.notes);
        Ok(Ending { columns, dropped_properties: Vec::new(), notes, origin })
    }
}

/// Reads an element with properties.
fn read_table(
    source: &mut Source<'_>,
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

/// Reads the element `vertex` block by block.
pub(super) struct VertexReader {
    encoding: PlyEncoding,
    axes: [usize; 3],
    /// Every scalar property but `x`, `y` and `z`, in the file's order.
    columns: Vec<Column>,
    /// Rows read.
    row: u64,
}

/// An attribute.
struct Column {
    /// Its place among the properties.
    property: usize,
    /// Bytes from the beginning of a binary row, where rows are of equal length.
    offset: usize,
    kind: Kind,
}

impl VertexReader {
    /// A reader from the first row on, of attributes too if they are to be kept.
    pub(super) fn new(
        source: &Source<'_>,
        encoding: PlyEncoding,
        vertex: &Element,
        keep: bool,
    ) -> Result<Self, FormatError> {
        let axes = axes(source, vertex)?;
        let mut columns = Vec::new();
        let mut offset = 0;
        for (i, property) in vertex.properties.iter().enumerate() {
            if let Shape::Scalar(kind) = property.shape {
                if keep && !axes.contains(&i) {
                    columns.push(Column { property: i, offset, kind });
                }
                offset += kind.size();
            }
        }
        Ok(Self { encoding, axes, columns, row: 0 })
    }

    /// As [`Points::append`].
    pub(super) fn append(
        &mut self,
        source: &mut Source<'_>,
        vertex: &Element,
        rows: usize,
        to: &mut Block,
    ) -> Result<(), FormatError> {
        if to.columns.is_empty() {
            to.columns = self.columns.iter().map(|column| Values::new(column.kind)).collect();
        }
        match (self.encoding, vertex.stride()) {
            (PlyEncoding::BinaryLittleEndian, Some(stride)) => {
                self.append_stride::<false>(source, vertex, stride, rows, to)
            }
            (PlyEncoding::BinaryBigEndian, Some(stride)) => {
                self.append_stride::<true>(source, vertex, stride, rows, to)
            }
            _ => self.append_rows(source, vertex, rows, to),
        }
    }

    /// Reads the rows in the buffer, at most `rows` of them; all are of equal length.
    fn append_stride<const BIG: bool>(
        &mut self,
        source: &mut Source<'_>,
        vertex: &Element,
        stride: usize,
        rows: usize,
        to: &mut Block,
    ) -> Result<(), FormatError> {
        if self.row == vertex.count {
            return Ok(());
        }
        if !source.ensure(stride)? {
            return Err(truncated(source.offset(), vertex, self.row));
        }
        let left = usize::try_from(vertex.count - self.row).unwrap_or(usize::MAX);
        let rows = left.min(rows).min(source.buffered().len() / stride);
        let block = &source.buffered()[..rows * stride];
        decode_block::<BIG>(block, stride, self.places(vertex), &mut to.positions);
        for (column, values) in self.columns.iter().zip(&mut to.columns) {
            values.extend_from_bytes(block.chunks_exact(stride).map(|row| &row[column.offset..]), BIG);
        }
        source.consume(rows * stride);
        self.row += rows as u64;
        Ok(())
    }

    /// Where a binary row has the coordinates, and in what type.
    fn places(&self, vertex: &Element) -> [(usize, Kind); 3] {
        let scalar = |shape: Shape| match shape {
            Shape::Scalar(kind) | Shape::List { item: kind, .. } => kind,
        };
        self.axes.map(|axis| {
            let before = vertex.properties[..axis].iter().map(|property| scalar(property.shape).size());
            (before.sum(), scalar(vertex.properties[axis].shape))
        })
    }

    /// Text, and rows with lists in them.
    fn append_rows(
        &mut self,
        source: &mut Source<'_>,
        vertex: &Element,
        count: usize,
        to: &mut Block,
    ) -> Result<(), FormatError> {
        let places: Vec<(Shape, Option<usize>)> = (vertex.properties.iter().enumerate())
            .map(|(i, property)| (property.shape, self.axes.iter().position(|axis| *axis == i)))
            .collect();
        let mut rows = Rows::from(source, self.encoding, vertex, self.row);
        let end = to.positions.len().saturating_add(count);
        while to.positions.len() < end && rows.begin()? {
            let mut position = [0.0; 3];
            let mut kept = self.columns.iter().zip(&mut to.columns).peekable();
            for (i, (shape, axis)) in places.iter().enumerate() {
                match (shape, axis) {
                    (Shape::Scalar(kind), Some(axis)) => position[*axis] = rows.number(*kind)?,
                    _ => match kept.next_if(|(column, _)| column.property == i) {
                        Some((_, values)) => rows.push(values)?,
                        None => rows.skip(*shape)?,
                    },
                }
            }
            rows.end()?;
            to.positions.push(position);
        }
        self.row = rows.row();
        Ok(())
    }
}

/// Where the coordinates stand among the properties.
fn axes(source: &Source<'_>, vertex: &Element) -> Result<[usize; 3], FormatError> {
    let names = vertex.properties.iter().map(|property| match property.shape {
        Shape::Scalar(_) => property.declared.as_str(),
        Shape::List { .. } => "",
    });
    let names: Vec<&str> = names.collect();
    axes_among(&names, "the vertices have").map_err(|why| FormatError::malformed(source.line(), why))
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
