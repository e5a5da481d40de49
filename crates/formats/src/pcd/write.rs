//! Writing, in the forms that PCL reads.

use std::ops::Range;

use super::super::kind::{Choices, Rows};
use super::super::names::{NameRule, changes, meant, own_names};
use super::super::numbers::{CRS, put_rows};
use super::super::writer::write_streamed;
use super::super::{FormatError, Scalar};
use super::{Pcd, PcdEncoding};
use densecloud_cloud::{Attribute, Kind, Origin, Position, Role, Values};

/// The names that PCL knows, but those of coordinates and of packed colours.
const OWN: [(Role, &str); 8] = [
    (Role::Red, "red"),
    (Role::Green, "green"),
    (Role::Blue, "blue"),
    (Role::Alpha, "alpha"),
    (Role::NormalX, "normal_x"),
    (Role::NormalY, "normal_y"),
    (Role::NormalZ, "normal_z"),
    (Role::Intensity, "intensity"),
];

/// Names are words, and some readers take no other characters for parts of one. A field `_` is none, and `rgb` holds
/// three numbers in one.
const RULE: NameRule = NameRule {
    most: usize::MAX,
    allows: |c| c.is_ascii_alphanumeric() || c == '_',
    is_taken: &|name| matches!(name, "_" | "rgb" | "rgba"),
};

/// What an attribute becomes.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Field {
    /// A field of this name, in 32-bit floats where those are what PCL looks for.
    Named { name: String, is_narrow: bool },
    /// Colours of 8 bits in one number; the places of red, green, blue, and of alpha if it is there.
    Packed { colour: [usize; 3], alpha: Option<usize> },
    /// Part of such a number.
    Part,
}

/// Rows of fields.
#[derive(Debug)]
pub(super) struct PcdRows {
    pcd: Pcd,
    fields: Vec<Field>,
}

impl PcdRows {
    pub(super) fn new(pcd: Pcd, attributes: &[Attribute], origin: &Origin) -> Self {
        Self { pcd, fields: fields(attributes, origin) }
    }
}

impl Rows for PcdRows {
    fn put(
        &mut self,
        bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        let Pcd { encoding, scalar } = self.pcd;
        let columns = columns(attributes, &self.fields, encoding, from..from + positions.len());
        put_rows(bytes, positions, &columns, 0, encoding.storage(), scalar)
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
    for column in columns(attributes, &fields(attributes, origin), encoding, 0..0) {
        let kind = column.values.kind();
        names += &format!(" {}", column.name);
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

/// What attributes become: as they are, where they are from PCD; else colours of 8 bits are packed into one number,
/// `rgb` or, with `alpha`, `rgba`, and normals have the names and the type that PCL looks for.
pub(super) fn fields(attributes: &[Attribute], origin: &Origin) -> Vec<Field> {
    let own = own_names(attributes, origin, "pcd", &OWN);
    let place = |name: &str| own.iter().position(|own| *own == Some(name));
    let bytes = |name: &str| place(name).filter(|place| attributes[*place].values.kind() == Kind::U8);
    let colour = match ["red", "green", "blue"].map(bytes) {
        [Some(red), Some(green), Some(blue)] => Some([red, green, blue]),
        _ => None,
    };
    let alpha = bytes("alpha");
    let names = RULE.apply(&meant(attributes, &own));
    let is_normal = |own: &str| own.starts_with("normal_");
    let named = origin.named_in.as_ref().filter(|named| named.kind == "pcd");
    let is_from_pcd = |name: &str| named.is_some_and(|named| named.names.iter().any(|own| own == name));
    let fields = names.into_iter().enumerate().map(|(i, name)| match colour {
        Some(colour) if colour[0] == i => Field::Packed { colour, alpha },
        Some(colour) if colour.contains(&i) || alpha == Some(i) => Field::Part,
        _ => Field::Named {
            name,
            is_narrow: own[i].is_some_and(is_normal) && !is_from_pcd(&attributes[i].name),
        },
    });
    fields.collect()
}

/// As [`Choices::renamed`](super::super::kind::Choices::renamed).
pub(super) fn renamed(attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
    let own = own_names(attributes, origin, "pcd", &OWN);
    let names =
        fields(attributes, origin).into_iter().zip(attributes).map(|(field, attribute)| match field {
            Field::Named { name, .. } => name,
            Field::Packed { .. } | Field::Part => attribute.name.clone(),
        });
    changes(attributes, &own, names.collect())
}

/// The fields of some rows beside the position.
pub(super) fn columns(
    attributes: &[Attribute],
    fields: &[Field],
    encoding: PcdEncoding,
    rows: Range<usize>,
) -> Vec<Attribute> {
    // Clouds are counted in 32 bits everywhere.
    let rows: Vec<u32> = rows.map(|row| row as u32).collect();
    let bytes = |place: usize| match &attributes[place].values {
        Values::U8(column) => column.as_slice(),
        _ => &[],
    };
    let column = |(attribute, field): (&Attribute, &Field)| match field {
        Field::Part => None,
        Field::Packed { colour: [red, green, blue], alpha } => {
            let [red, green, blue] = [*red, *green, *blue].map(bytes);
            let opacity = alpha.map(bytes);
            let packed = rows.iter().map(|row| {
                let row = *row as usize;
                u32::from_be_bytes([opacity.map_or(0, |a| a[row]), red[row], green[row], blue[row]])
            });
            // PCL calls the bits of `rgb` a float, but writes them as the whole number in text.
            let (name, values) = match (alpha, encoding) {
                (Some(_), _) => ("rgba", Values::U32(packed.collect())),
                (None, PcdEncoding::Ascii) => ("rgb", Values::U32(packed.collect())),
                (None, _) => ("rgb", Values::F32(packed.map(f32::from_bits).collect())),
            };
            Some(Attribute { name: name.to_owned(), values })
        }
        Field::Named { name, is_narrow } => {
            let mut values = attribute.values.gather(&rows);
            if *is_narrow {
                values = Values::from_f64(Kind::F32, (0..values.len()).map(|i| values.get(i)));
            }
            Some(Attribute { name: name.clone(), values })
        }
    };
    attributes.iter().zip(fields).filter_map(column).collect()
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
    let columns = columns(attributes, &fields(attributes, origin), PcdEncoding::Compressed, 0..0);
    sizes.extend(columns.iter().map(|column| column.values.kind().size()));
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
