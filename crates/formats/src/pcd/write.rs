//! Writing, in the forms that PCL reads.

use std::ops::Range;

use super::super::kind::{Choices, Rows};
use super::super::numbers::{CRS, one_word, put_rows};
use super::super::writer::write_streamed;
use super::super::{FormatError, Scalar};
use super::{Pcd, PcdEncoding};
use densecloud_cloud::{Attribute, Kind, Origin, Position, Values};

/// Rows of fields.
#[derive(Debug)]
pub(super) struct PcdRows(pub(super) Pcd);

impl Rows for PcdRows {
    fn put(
        &self,
        bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        let fields = columns(attributes, self.0.encoding, from..from + positions.len());
        put_rows(bytes, positions, &fields, 0, self.0.encoding.storage(), self.0.scalar)
    }
}

/// The header before the data.
pub(super) fn header(pcd: Pcd, points: u64, attributes: &[Attribute], origin: &Origin) -> String {
    let Pcd { encoding, scalar } = pcd;
    let mut text = "# .PCD v0.7 - Point Cloud Data file format\n".to_owned();
    if let Some(crs) = &origin.crs {
        text += &format!("# {CRS}{crs}\n");
    }
    for comment in &origin.comments {
        text += &format!("# {}\n", comment.replace(char::is_control, " "));
    }
    let [mut names, mut sizes, mut types, mut counts] =
        ["FIELDS x y z", "SIZE", "TYPE F F F", "COUNT 1 1 1"].map(str::to_owned);
    sizes += &format!(" {}", scalar.size()).repeat(3);
    for column in columns(attributes, encoding, 0..0) {
        let kind = column.values.kind();
        names += &format!(" {}", one_word(&column.name).replace('#', "_"));
        sizes += &format!(" {}", kind.size());
        types += match kind {
            Kind::F32 | Kind::F64 => " F",
            Kind::I8 | Kind::I16 | Kind::I32 | Kind::I64 => " I",
            Kind::U8 | Kind::U16 | Kind::U32 | Kind::U64 => " U",
        };
        counts += " 1";
    }
    let [x, y, z] = origin.sensor.unwrap_or_default();
    let [w, i, j, k] = origin.orientation.unwrap_or([1.0, 0.0, 0.0, 0.0]);
    let data = encoding.name();
    text += &format!(
        "VERSION 0.7\n{names}\n{sizes}\n{types}\n{counts}\nWIDTH {points}\nHEIGHT 1\n\
         VIEWPOINT {x} {y} {z} {w} {i} {j} {k}\nPOINTS {points}\nDATA {data}\n"
    );
    text
}

/// The fields of some rows beside the position: as the attributes, but colours of 8 bits are packed into
/// one number, `rgb` or, with `alpha`, `rgba`, and normals have the names and the type that PCL looks for.
pub(super) fn columns(attributes: &[Attribute], encoding: PcdEncoding, rows: Range<usize>) -> Vec<Attribute> {
    // Clouds are counted in 32 bits everywhere.
    let rows: Vec<u32> = rows.map(|row| row as u32).collect();
    let find = |name: &str| attributes.iter().find(|a| a.name == name);
    let bytes = |name: &str| match find(name).map(|a| &a.values) {
        Some(Values::U8(column)) => Some(column.as_slice()),
        _ => None,
    };
    let has_normals = ["nx", "ny", "nz"].iter().all(|name| find(name).is_some());
    let colour = match [bytes("red"), bytes("green"), bytes("blue")] {
        [Some(red), Some(green), Some(blue)] => Some([red, green, blue]),
        _ => None,
    };
    let alpha = bytes("alpha");
    let mut columns = Vec::with_capacity(attributes.len());
    for attribute in attributes {
        let name = attribute.name.as_str();
        match (name, colour) {
            ("red", Some([red, green, blue])) => {
                let packed = rows.iter().map(|row| {
                    let row = *row as usize;
                    u32::from_be_bytes([alpha.map_or(0, |a| a[row]), red[row], green[row], blue[row]])
                });
                // PCL calls the bits of `rgb` a float, but writes them as the whole number in text.
                let (name, values) = match (alpha, encoding) {
                    (Some(_), _) => ("rgba", Values::U32(packed.collect())),
                    (None, PcdEncoding::Ascii) => ("rgb", Values::U32(packed.collect())),
                    (None, _) => ("rgb", Values::F32(packed.map(f32::from_bits).collect())),
                };
                columns.push(Attribute { name: name.to_owned(), values });
            }
            ("green" | "blue", Some(_)) => {}
            ("alpha", Some(_)) if alpha.is_some() => {}
            _ => {
                let values = attribute.values.gather(&rows);
                columns.push(match name {
                    "nx" | "ny" | "nz" if has_normals => {
                        let numbers = (0..values.len()).map(|i| values.get(i));
                        let values = Values::from_f64(Kind::F32, numbers);
                        Attribute { name: format!("normal_{}", &name[1..]), values }
                    }
                    _ => Attribute { name: name.to_owned(), values },
                });
            }
        }
    }
    columns
}

/// A cloud as a file of one compressed block; as plain binary where compression gains nothing, or where
/// the block's length takes more than its field has room for.
pub(super) fn encode_compressed(
    scalar: Scalar,
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<Vec<u8>, FormatError> {
    // Rows at first: they are turned into columns below, as every encoding's numbers are made in one place.
    let plain = Pcd { encoding: PcdEncoding::Binary, scalar };
    let points = positions.len() as u64;
    let begun = plain.begin(points, attributes, origin)?;
    let begin = begun.0.len();
    let mut rows = Vec::new();
    write_streamed(&mut rows, begun, positions, attributes)?;
    let mut sizes = vec![scalar.size() as usize; 3];
    let fields = columns(attributes, PcdEncoding::Compressed, 0..0);
    sizes.extend(fields.iter().map(|field| field.values.kind().size()));
    let stride: usize = sizes.iter().sum();
    let mut block = Vec::with_capacity(rows.len() - begin);
    let mut from = 0;
    for size in sizes {
        for row in rows[begin..].chunks_exact(stride) {
            block.extend_from_slice(&row[from..from + size]);
        }
        from += size;
    }
    let packed = if i32::try_from(block.len()).is_ok() { lzf::compress(&block).ok() } else { None };
    let Some(packed) = packed else { return Ok(rows) };
    let packed_pcd = Pcd { encoding: PcdEncoding::Compressed, scalar };
    let mut bytes = header(packed_pcd, points, attributes, origin).into_bytes();
    // Both are less than 2^31.
    bytes.extend_from_slice(&(packed.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&(block.len() as u32).to_le_bytes());
    bytes.extend_from_slice(&packed);
    Ok(bytes)
}
