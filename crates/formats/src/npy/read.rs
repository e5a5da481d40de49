//! Reading.

use half::f16;

use super::super::axes::axes_among;
use super::super::columns::{Guess, MAX_COLUMNS};
use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::source::Source;
use super::super::{Format, FormatError, Header, Limits, Place, Scalar};
use super::MAGIC;
use super::literal::{self, Literal, quoted};
use densecloud_cloud::{Kind, Origin, Position, Values};

/// More bytes than any real header has; bounds what a hostile one costs.
const MAX_HEADER: usize = 1 << 20;

/// An array of points, read up to its data.
pub(super) struct NpyPoints {
    /// A claim.
    points: u64,
    /// Of a point, without padding.
    fields: Vec<Field>,
    /// Bytes a point.
    stride: usize,
    /// Whether all numbers of a field are in one run, and not all of a point.
    by_column: bool,
    /// Whether the file names the fields.
    named: bool,
    axes: [usize; 3],
    /// Points read.
    row: u64,
    /// What the other fields may be called, where nothing names them.
    guess: Guess,
}

/// A number of each point.
#[derive(Debug)]
struct Field {
    name: String,
    number: Number,
    offset: usize,
}

/// How a number is stored.
#[derive(Debug, Clone, Copy)]
struct Number {
    /// In memory, and in the file but for `half`.
    kind: Kind,
    big: bool,
    /// 16-bit floats, which are made 32-bit ones.
    half: bool,
}

impl NpyPoints {
    /// Reads the header.
    pub(super) fn open(source: &mut Source<'_>, limits: Limits) -> Result<(Self, Header), FormatError> {
        let at = source.offset();
        let text = header_text(source)?;
        let (npy, dropped_properties) = Self::parse(&text).map_err(|why| FormatError::malformed(at, why))?;
        limits.check_points(npy.points)?;
        let bytes = npy.points.saturating_mul(npy.stride as u64);
        limits.check_bytes(bytes)?;
        let narrow = npy.axes.iter().all(|axis| npy.fields[*axis].number.kind.fits_f32());
        let scalar = if narrow { Scalar::F32 } else { Scalar::F64 };
        let header = Header {
            format: Format::Npy { scalar, fields: npy.named },
            points: Some(npy.points),
            attributes: npy.others().map(|field| field.name.clone()).collect(),
            dropped_properties,
        };
        Ok((npy, header))
    }

    /// Of fields that the file names, `axes` are the position.
    fn new(
        points: u64,
        fields: Vec<Field>,
        stride: usize,
        by_column: bool,
        axes: Option<[usize; 3]>,
    ) -> Self {
        let named = axes.is_some();
        let axes = axes.unwrap_or([0, 1, 2]);
        Self { points, fields, stride, by_column, named, axes, row: 0, guess: Guess::default() }
    }

    /// From the literal; also the names of fields that are no numbers.
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
            Literal::Str(code) => {
                let number = number(code)?.ok_or_else(|| no_number(code))?;
                let (points, columns) = table(&shape)?;
                let size = number.size();
                let fields = (0..columns)
                    .map(|i| Field { name: format!("column {}", i + 1), number, offset: i * size })
                    .collect();
                let stride = columns * size;
                let npy = Self::new(points, fields, stride, *fortran, None);
                Ok((npy, Vec::new()))
            }
            Literal::List(entries) => {
                let mut dropped = Vec::new();
                let (fields, stride) = structure(entries, &mut dropped)?;
                if fields.len() > MAX_COLUMNS {
                    let found = fields.len();
                    return Err(format!(
                        "a structure of {found} fields; more than {MAX_COLUMNS} are not read"
                    ));
                }
                let names: Vec<String> = fields.iter().map(|field| field.name.clone()).collect();
                let axes = axes_among(&names, "the fields have")?;
                let points = list(&shape)?;
                Ok((Self::new(points, fields, stride, false, Some(axes)), dropped))
            }
            _ => Err("the type of the numbers is neither a name nor a list of fields".into()),
        }
    }

    fn others(&self) -> impl Iterator<Item = &Field> {
        self.fields.iter().enumerate().filter(|(i, _)| !self.axes.contains(i)).map(|(_, field)| field)
    }

    /// An empty column for each field but the position.
    fn columns(&self) -> Vec<Values> {
        self.others().map(|field| Values::new(field.number.kind)).collect()
    }

    fn missing(&self, source: &Source<'_>, row: u64) -> FormatError {
        let why = format!("the header counts {} points, and {row} are there", self.points);
        FormatError::truncated(source.offset(), why)
    }

    /// Reads the rows in the buffer, at most `rows` of them.
    fn append_rows(
        &mut self,
        source: &mut Source<'_>,
        rows: usize,
        to: &mut Block,
    ) -> Result<(), FormatError> {
        if self.row == self.points {
            return Ok(());
        }
        if !source.ensure(self.stride)? {
            return Err(self.missing(source, self.row));
        }
        let left = usize::try_from(self.points - self.row).unwrap_or(usize::MAX);
        let rows = left.min(rows).min(source.buffered().len() / self.stride);
        let block = &source.buffered()[..rows * self.stride];
        let stride = self.stride;
        let bytes = |offset: usize| block.chunks_exact(stride).map(move |row| &row[offset..]);
        let axes = self.axes.map(|axis| {
            let field = &self.fields[axis];
            let mut numbers = Values::new(field.number.kind);
            field.number.extend(&mut numbers, bytes(field.offset));
            numbers
        });
        to.positions.extend(positions(&axes));
        for (field, column) in self.others().zip(&mut to.columns) {
            field.number.extend(column, bytes(field.offset));
        }
        source.consume(rows * self.stride);
        self.row += rows as u64;
        Ok(())
    }

    /// All points of an array that has its columns one after another.
    fn append_columns(&mut self, source: &mut Source<'_>, to: &mut Block) -> Result<(), FormatError> {
        if self.row == self.points {
            return Ok(());
        }
        let mut columns: Vec<Values> = Vec::with_capacity(self.fields.len());
        for field in &self.fields {
            let (size, mut column) = (field.number.size(), Values::new(field.number.kind));
            let mut row = 0;
            while row < self.points {
                if !source.ensure(size)? {
                    return Err(self.missing(source, row));
                }
                let left = usize::try_from(self.points - row).unwrap_or(usize::MAX);
                let rows = left.min(source.buffered().len() / size);
                field.number.extend(&mut column, source.buffered()[..rows * size].chunks_exact(size));
                source.consume(rows * size);
                row += rows as u64;
            }
            columns.push(column);
        }
        // The first three are the position.
        let others = columns.split_off(3);
        if let Ok(axes) = <[Values; 3]>::try_from(columns) {
            to.positions.extend(positions(&axes));
        }
        to.columns = others;
        self.row = self.points;
        Ok(())
    }
}

impl Points for NpyPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        let from = to.positions.len();
        if to.columns.is_empty() {
            to.columns = self.columns();
        }
        if self.by_column {
            self.append_columns(source, to)?;
        } else {
            self.append_rows(source, rows, to)?;
        }
        if !self.named {
            self.guess.see(&to.columns, from);
        }
        Ok(())
    }

    fn finish(self: Box<Self>, source: &mut Source<'_>) -> Result<Ending, FormatError> {
        source.expect_end("the points that the header counts")?;
        let mut names: Vec<String> = self.others().map(|field| field.name.clone()).collect();
        if !self.named {
            // Arrays hold bytes as floats, too.
            self.guess.name(&mut names, |column| self.guess.is_bytes(column));
        }
        let columns = names.into_iter().zip(self.others());
        let columns =
            columns.map(|(name, field)| Some(ColumnName { name, kind: field.number.kind })).collect();
        Ok(Ending { columns, dropped_properties: Vec::new(), notes: Vec::new(), origin: Origin::default() })
    }
}

fn positions([x, y, z]: &[Values; 3]) -> impl Iterator<Item = Position> {
    (0..x.len()).map(move |i| [x.get(i), y.get(i), z.get(i)])
}

impl Number {
    /// Bytes in the file.
    fn size(self) -> usize {
        if self.half { 2 } else { self.kind.size() }
    }

    /// Appends the number at the beginning of each of `rows`.
    fn extend<'a>(self, column: &mut Values, rows: impl Iterator<Item = &'a [u8]>) {
        match column {
            Values::F32(floats) if self.half => {
                let word = |row: &[u8]| if self.big { [row[1], row[0]] } else { [row[0], row[1]] };
                floats.extend(rows.map(|row| f16::from_le_bytes(word(row)).to_f32()));
            }
            column => column.extend_from_bytes(rows, self.big),
        }
    }
}

/// How many points a table of this shape holds, and how many columns. Dimensions of one entry hold one table.
///
/// # Errors
/// What else it holds, and what to do.
fn table(shape: &[u64]) -> Result<(u64, usize), String> {
    let shown = shown(shape);
    let [before @ .., columns] = shape else { return Err("one number alone is no cloud".into()) };
    let many: Vec<u64> = before.iter().copied().filter(|size| *size != 1).collect();
    if before.is_empty() || *columns < 3 {
        return Err(format!("an array of shape {shown}; a cloud has the shape (points, 3 or more)"));
    }
    let points = match many.as_slice() {
        [] => 1,
        [points] => *points,
        [clouds, ..] => {
            return Err(format!(
                "an array of shape {shown} holds {clouds} clouds, or the rows of a picture; save one as a[0], or all as one: \
                 a.reshape(-1, {columns})"
            ));
        }
    };
    // A point has few columns, and a cloud many points.
    let is_turned = *columns > points && (points == 3 || points > 3 && *columns > 16);
    if is_turned {
        return Err(format!("an array of shape {shown} has its points side by side; transpose it: a.T"));
    }
    if *columns > MAX_COLUMNS as u64 {
        return Err(format!("an array of {columns} columns; more than {MAX_COLUMNS} are not read"));
    }
    Ok((points, *columns as usize))
}

/// How many points an array of structures holds.
///
/// # Errors
/// What else it holds, and what to do.
fn list(shape: &[u64]) -> Result<u64, String> {
    let many: Vec<u64> = shape.iter().copied().filter(|size| *size != 1).collect();
    match many.as_slice() {
        [] => Ok(1),
        [points] => Ok(*points),
        _ => Err(format!(
            "an array of shape {} holds several clouds, or the rows of a picture; save one as a[0], or all as one: a.ravel()",
            shown(shape)
        )),
    }
}

/// As Python shows a shape.
fn shown(shape: &[u64]) -> String {
    let sizes: Vec<String> = shape.iter().map(u64::to_string).collect();
    if let [one] = sizes.as_slice() { format!("({one},)") } else { format!("({})", sizes.join(", ")) }
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
            Some(Literal::Str(code)) => (number(code)?, code_size(code)?),
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

/// The number of a type such as `<f8`; none for text, times, complex numbers and so on.
fn number(code: &str) -> Result<Option<Number>, String> {
    let kind = match code.get(1..) {
        Some("i1") => Kind::I8,
        Some("u1" | "b1") => Kind::U8,
        Some("i2") => Kind::I16,
        Some("u2") => Kind::U16,
        Some("i4") => Kind::I32,
        Some("u4") => Kind::U32,
        Some("i8") => Kind::I64,
        Some("u8") => Kind::U64,
        Some("f2" | "f4") => Kind::F32,
        Some("f8") => Kind::F64,
        Some("O") => return Err("the array holds Python objects, not numbers".into()),
        _ => return Ok(None),
    };
    Ok(Some(Number { kind, big: code.starts_with('>'), half: code.ends_with("f2") }))
}

/// Of what an array is that holds no numbers of ours.
fn no_number(code: &str) -> String {
    let what = match code.chars().nth(1) {
        Some('U' | 'S' | 'a') => "text",
        Some('M' | 'm') => "times",
        Some('c') => "complex numbers",
        _ => "what is no number",
    };
    format!("the array holds {what} ({}); points are integers or floats", quoted(code))
}

/// Bytes of a type.
fn code_size(code: &str) -> Result<usize, String> {
    let digits: String = code.chars().skip(2).take_while(char::is_ascii_digit).collect();
    let size = digits.parse::<usize>().ok();
    // Text is counted in characters of four bytes.
    let unit = if code.chars().nth(1) == Some('U') { 4 } else { 1 };
    size.and_then(|size| size.checked_mul(unit))
        .ok_or_else(|| format!("the type {} is not known", quoted(code)))
}
