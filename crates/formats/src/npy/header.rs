//! The header: how an array lies in its file.

use super::super::axes::axes_among;
use super::super::columns::MAX_COLUMNS;
use super::super::source::Source;
use super::super::{FormatError, Place};
use super::MAGIC;
use super::literal::{self, Literal, quoted};
use super::number::{Number, code_size, no_number};
use super::shape::{list, table};

/// More bytes than any real header has; bounds what a hostile one costs.
const MAX_HEADER: usize = 1 << 20;

/// A number of each point.
#[derive(Debug)]
pub(super) struct Field {
    pub(super) name: String,
    pub(super) number: Number,
    pub(super) offset: usize,
}

/// An array of points, as its header tells of it.
pub(super) struct Array {
    /// A claim.
    pub(super) points: u64,
    /// Of a point, without padding.
    pub(super) fields: Vec<Field>,
    /// Bytes a point.
    pub(super) stride: usize,
    /// Whether all numbers of a field are in one run, and not all of a point.
    pub(super) by_column: bool,
    /// Whether the file names the fields.
    pub(super) named: bool,
    pub(super) axes: [usize; 3],
}

impl Array {
    /// Reads the header; also the names of fields that are no numbers.
    pub(super) fn read(source: &mut Source<'_>) -> Result<(Self, Vec<String>), FormatError> {
        let at = source.offset();
        let text = header_text(source)?;
        Self::parse(&text).map_err(|why| FormatError::malformed(at, why))
    }

    fn parse(text: &str) -> Result<(Self, Vec<String>), String> {
        let literal = literal::parse(text)?;
        let find = |key: &str| match &literal {
            Literal::Dict(entries) => entries.iter().find(|(k, _)| k == key).map(|(_, value)| value),
            _ => None,
        };
        let (Some(kind), Some(Literal::Bool(fortran)), Some(Literal::List(shape))) =
            (find("descr"), find("fortran_order"), find("shape"))
        else {
            return Err("the header has no `descr`, `fortran_order` or `shape`".into());
        };
        let shape: Option<Vec<u64>> =
            shape.iter().map(|n| if let Literal::Int(n) = n { Some(*n) } else { None }).collect();
        let shape = shape.ok_or("the shape is not of whole numbers")?;
        match kind {
            Literal::Str(code) => Ok((Self::of_numbers(code, &shape, *fortran)?, Vec::new())),
            Literal::List(entries) => Self::of_structures(entries, &shape),
            _ => Err("the type of the numbers is neither a name nor a list of fields".into()),
        }
    }

    /// A table, whose first three columns are the position.
    fn of_numbers(code: &str, shape: &[u64], by_column: bool) -> Result<Self, String> {
        let number = Number::of(code)?.ok_or_else(|| no_number(code))?;
        let (points, columns) = table(shape)?;
        let size = number.size();
        let field = |i| Field { name: format!("column {}", i + 1), number, offset: i * size };
        let (fields, stride) = ((0..columns).map(field).collect(), columns * size);
        Ok(Self { points, fields, stride, by_column, named: false, axes: [0, 1, 2] })
    }

    fn of_structures(entries: &[Literal], shape: &[u64]) -> Result<(Self, Vec<String>), String> {
        let mut dropped = Vec::new();
        let (fields, stride) = structure(entries, &mut dropped)?;
        if fields.len() > MAX_COLUMNS {
            let found = fields.len();
            return Err(format!("a structure of {found} fields; more than {MAX_COLUMNS} are not read"));
        }
        let names: Vec<String> = fields.iter().map(|field| field.name.clone()).collect();
        let axes = axes_among(&names, "the fields have")?;
        let points = list(shape)?;
        Ok((Self { points, fields, stride, by_column: false, named: true, axes }, dropped))
    }

    /// The fields that are not the position.
    pub(super) fn others(&self) -> impl Iterator<Item = &Field> {
        self.fields.iter().enumerate().filter(|(i, _)| !self.axes.contains(i)).map(|(_, field)| field)
    }
}

/// The literal between the magic bytes and the data.
fn header_text(source: &mut Source<'_>) -> Result<String, FormatError> {
    let short = || FormatError::truncated(Place::Byte(0), "the NumPy header is incomplete");
    let major = source.take(MAGIC.len() + 2)?.ok_or_else(short)?[MAGIC.len()];
    let length = match major {
        1 => {
            let bytes = source.take(2)?.ok_or_else(short)?;
            usize::from(u16::from_le_bytes([bytes[0], bytes[1]]))
        }
        2 | 3 => {
            let bytes = source.take(4)?.ok_or_else(short)?;
            u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) as usize
        }
        _ => {
            let why = format!("version {major} of NumPy's format; 1 to 3 are known");
            return Err(FormatError::malformed(Place::Byte(6), why));
        }
    };
    if length > MAX_HEADER {
        let why = format!("the header is longer than {MAX_HEADER} bytes");
        return Err(FormatError::malformed(Place::Byte(8), why));
    }
    let bytes = source.take(length)?.ok_or_else(short)?;
    // Versions 1 and 2 are in Latin-1.
    Ok(match std::str::from_utf8(bytes) {
        Ok(text) if major == 3 => text.to_owned(),
        _ => bytes.iter().map(|b| char::from(*b)).collect(),
    })
}

/// The fields of a structure, and its length. What is no single number is skipped and named, but for
/// padding, which has no name.
fn structure(entries: &[Literal], dropped: &mut Vec<String>) -> Result<(Vec<Field>, usize), String> {
    let mut fields = Vec::new();
    let mut offset = 0_usize;
    for entry in entries {
        let Literal::List(parts) = entry else { return Err("a field is not a name and a type".into()) };
        let name = match parts.first() {
            Some(Literal::Str(name)) => name.clone(),
            // A title and a name.
            Some(Literal::List(names)) => match names.last() {
                Some(Literal::Str(name)) => name.clone(),
                _ => return Err("a field has no name".into()),
            },
            _ => return Err("a field has no name".into()),
        };
        let (number, size) = match parts.get(1) {
            Some(Literal::Str(code)) => (Number::of(code)?, code_size(code)?),
            Some(Literal::List(inner)) => (None, structure(inner, &mut Vec::new())?.1),
            _ => return Err(format!("the field {} has no type", quoted(&name))),
        };
        let count = match parts.get(2) {
            None => Some(1),
            Some(Literal::Int(count)) => usize::try_from(*count).ok(),
            Some(Literal::List(shape)) => shape.iter().try_fold(1_usize, |product, n| match n {
                Literal::Int(n) => product.checked_mul(usize::try_from(*n).ok()?),
                _ => None,
            }),
            Some(_) => None,
        };
        let end = count.and_then(|count| size.checked_mul(count)?.checked_add(offset));
        // A row is held in memory.
        let end = end.filter(|end| *end <= MAX_HEADER).ok_or("the fields take too many bytes a point")?;
        match number {
            Some(number) if parts.len() == 2 => fields.push(Field { name, number, offset }),
            _ if name.is_empty() => {}
            _ => dropped.push(name),
        }
        offset = end;
    }
    Ok((fields, offset))
}
