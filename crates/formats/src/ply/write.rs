//! Writing: the header, the vertices, and the tables after them.

use std::io::Write;
use std::sync::Arc;

use super::super::FormatError;
use super::super::Scalar;
use super::super::kind::Rows;
use super::super::names::{NameRule, changes, meant, own_names};
use super::super::numbers::{CRS, Storage, one_word, put_number, put_rows};
use super::Ply;
use super::header::kind_name;
use densecloud_cloud::{Attribute, Column, Origin, Position, Role, Table};

/// The names that viewers show as colours and normals.
const OWN: [(Role, &str); 7] = [
    (Role::Red, "red"),
    (Role::Green, "green"),
    (Role::Blue, "blue"),
    (Role::Alpha, "alpha"),
    (Role::NormalX, "nx"),
    (Role::NormalY, "ny"),
    (Role::NormalZ, "nz"),
];

/// A header is ASCII, and some readers have 256 bytes for a word.
const RULE: NameRule =
    NameRule { most: 255, allows: |c| c.is_ascii_graphic(), is_taken: &|name| name == "end_header" };

/// Bytes of a table gathered between two writes to the sink.
const FLUSH: usize = 64 * 1024;

/// Vertices, then tables.
#[derive(Debug)]
pub(super) struct PlyRows {
    ply: Ply,
    tables: Arc<Vec<Table>>,
}

impl PlyRows {
    pub(super) fn new(ply: Ply, origin: &Origin) -> Self {
        Self { ply, tables: Arc::clone(&origin.tables) }
    }
}

impl Rows for PlyRows {
    fn put(
        &mut self,
        bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        put_rows(bytes, positions, attributes, from, self.ply.encoding.storage(), self.ply.scalar)
    }

    fn end(&mut self, sink: &mut dyn Write) -> Result<(), FormatError> {
        let storage = self.ply.encoding.storage();
        self.tables.iter().try_for_each(|table| write_table(sink, storage, table))
    }
}

/// The header before the points.
pub(super) fn header(ply: Ply, points: u64, attributes: &[Attribute], origin: &Origin) -> String {
    let encoding = ply.encoding.name();
    let scalar = match ply.scalar {
        Scalar::F32 => "float",
        Scalar::F64 => "double",
    };
    let mut header = format!("ply\nformat {encoding} 1.0\n");
    if let Some(crs) = &origin.crs {
        header += &format!("comment {CRS}{crs}\n");
    }
    for comment in &origin.comments {
        header += &format!("comment {}\n", comment.replace(char::is_control, " "));
    }
    header += &format!("element vertex {points}\n");
    for axis in ["x", "y", "z"] {
        header += &format!("property {scalar} {axis}\n");
    }
    for (attribute, name) in attributes.iter().zip(names(attributes, origin)) {
        header += &format!("property {} {name}\n", kind_name(attribute.values.kind()));
    }
    for table in origin.tables.iter() {
        header += &format!("element {} {}\n", one_word(&table.name), table.rows);
        for (name, column) in &table.columns {
            let kind = match column {
                Column::Scalar(values) => kind_name(values.kind()).to_owned(),
                Column::List { lengths, items } => {
                    format!("list {} {}", kind_name(lengths.kind()), kind_name(items.kind()))
                }
            };
            header += &format!("property {kind} {}\n", one_word(name));
        }
    }
    header + "end_header\n"
}

/// The names of the properties that attributes become.
fn names(attributes: &[Attribute], origin: &Origin) -> Vec<String> {
    RULE.apply(&meant(attributes, &own_names(attributes, origin, "ply", &OWN)))
}

/// As [`Choices::renamed`](super::super::kind::Choices::renamed).
pub(super) fn renamed(attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
    let own = own_names(attributes, origin, "ply", &OWN);
    changes(attributes, &own, RULE.apply(&meant(attributes, &own)))
}

/// Writes an element of a PLY file row by row.
fn write_table(sink: &mut dyn Write, storage: Storage, table: &Table) -> Result<(), FormatError> {
    let mut scratch = Vec::new();
    // Where the next row's items begin, in each list.
    let mut starts = vec![0; table.columns.len()];
    for row in 0..table.rows {
        for ((_, column), start) in table.columns.iter().zip(&mut starts) {
            match column {
                Column::Scalar(values) => put_number(&mut scratch, storage, values, row)?,
                Column::List { lengths, items } => {
                    put_number(&mut scratch, storage, lengths, row)?;
                    let end = *start + lengths.get(row) as usize;
                    for item in *start..end {
                        put_number(&mut scratch, storage, items, item)?;
                    }
                    *start = end;
                }
            }
        }
        if let Storage::Text(_) = storage {
            // In place of the last space.
            scratch.pop();
            scratch.push(b'\n');
        }
        if scratch.len() >= FLUSH {
            sink.write_all(&scratch)?;
            scratch.clear();
        }
    }
    sink.write_all(&scratch)?;
    Ok(())
}
