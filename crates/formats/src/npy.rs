//! NumPy's `.npy`: a header that is a Python literal, then one array.

use std::io::Read;

use half::f16;

use super::source::Source;
use super::text::shown;
use super::xyz::{MAX_COLUMNS, are_bytes, guess_names, named_axes};
use super::{Format, FormatError, Header, Limits, Place, Scalar};
use densecloud_cloud::{Attribute, Cloud, Kind, Position, Values};

/// What every file begins with.
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";

/// More bytes than any real header has; bounds what a hostile one costs.
const MAX_HEADER: usize = 1 << 20;

/// An array of points, read up to its data.
#[derive(Debug)]
pub(super) struct NpyHeader {
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

impl NpyHeader {
    /// Reads the header.
    pub(super) fn open<R: Read>(
        source: &mut Source<R>,
        limits: Limits,
    ) -> Result<(Self, Header), FormatError> {
        let at = source.offset();
        let text = header_text(source)?;
        let (npy, dropped_properties) = Self::parse(&text).map_err(|why| FormatError::malformed(at, why))?;
        if let Some(limit) = limits.max_points
            && npy.points > limit
        {
            return Err(FormatError::TooManyPoints { points: npy.points, limit });
        }
        let bytes = npy.points.saturating_mul(npy.stride as u64);
        if let Some(limit) = limits.max_bytes
            && bytes > limit
        {
            return Err(FormatError::TooLarge { bytes, limit });
        }
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

    /// From the literal; also the names of fields that are no numbers.
    fn parse(text: &str) -> Result<(Self, Vec<String>), String> {
        let literal = Parser { rest: text }.whole()?;
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
        let product = |sizes: &[u64]| sizes.iter().fold(1, |points: u64, size| points.saturating_mul(*size));
        match kind {
            Literal::Str(code) => {
                let number = number(code)?.ok_or_else(|| format!("numbers of the type {}", quoted(code)))?;
                let [points @ .., columns] = shape.as_slice() else {
                    return Err("one number alone is no cloud".into());
                };
                if points.is_empty() || *columns < 3 || (points.len() > 1 && *fortran) {
                    return Err(format!(
                        "an array of shape {shape:?}; a cloud has the shape [points, 3 or more]"
                    ));
                }
                if *columns > MAX_COLUMNS as u64 {
                    return Err(format!(
                        "an array of {columns} columns; more than {MAX_COLUMNS} are not read"
                    ));
                }
                let size = number.size();
                let fields = (0..*columns as usize)
                    .map(|i| Field { name: format!("column {}", i + 1), number, offset: i * size })
                    .collect();
                let (points, stride) = (product(points), *columns as usize * size);
                let npy = Self { points, fields, stride, by_column: *fortran, named: false, axes: [0, 1, 2] };
                Ok((npy, Vec::new()))
            }
            Literal::List(entries) => {
                let mut dropped = Vec::new();
                let (fields, stride) = structure(entries, &mut dropped)?;
                let names: Vec<String> = fields.iter().map(|field| field.name.clone()).collect();
                let axes = named_axes(&names).ok_or("the fields have no numbers `x`, `y` and `z`")?;
                let points = product(&shape);
                Ok((Self { points, fields, stride, by_column: false, named: true, axes }, dropped))
            }
            _ => Err("the type of the numbers is neither a name nor a list of fields".into()),
        }
    }

    fn others(&self) -> impl Iterator<Item = &Field> {
        self.fields.iter().enumerate().filter(|(i, _)| !self.axes.contains(i)).map(|(_, field)| field)
    }

    /// Reads the points.
    pub(super) fn read<R: Read>(self, source: &mut Source<R>) -> Result<Cloud, FormatError> {
        let mut columns: Vec<Values> = self
            .fields
            .iter()
            .map(|field| Values::new(if field.number.half { Kind::U16 } else { field.number.kind }))
            .collect();
        if self.by_column {
            for (field, column) in self.fields.iter().zip(&mut columns) {
                let only = [(field.number.big, 0)];
                self.read_rows(source, field.number.size(), &only, std::slice::from_mut(column))?;
            }
        } else {
            let places: Vec<_> = self.fields.iter().map(|field| (field.number.big, field.offset)).collect();
            self.read_rows(source, self.stride, &places, &mut columns)?;
        }
        source.expect_end("the points that the header counts")?;
        for (field, column) in self.fields.iter().zip(&mut columns) {
            if let (true, Values::U16(bits)) = (field.number.half, &*column) {
                *column = Values::F32(bits.iter().map(|bits| f16::from_bits(*bits).to_f32()).collect());
            }
        }
        let [x, y, z] = self.axes.map(|axis| &columns[axis]);
        let positions: Vec<Position> = (0..x.len()).map(|i| [x.get(i), y.get(i), z.get(i)]).collect();
        let mut attributes = Vec::new();
        for (i, (field, values)) in self.fields.into_iter().zip(columns).enumerate() {
            if !self.axes.contains(&i) {
                attributes.push(Attribute { name: field.name, values });
            }
        }
        if !self.named {
            // Arrays hold bytes as floats, too.
            guess_names(&mut attributes, |columns| are_bytes(columns) || columns.iter().all(holds_bytes));
        }
        Ok(Cloud { positions, attributes, ..Cloud::default() })
    }

    /// Rows of `stride` bytes, one a point; of each column the byte order and the place in a row.
    fn read_rows<R: Read>(
        &self,
        source: &mut Source<R>,
        stride: usize,
        places: &[(bool, usize)],
        columns: &mut [Values],
    ) -> Result<(), FormatError> {
        let mut row = 0;
        while row < self.points {
            if !source.ensure(stride)? {
                let why = format!("the header counts {} points, and {row} are there", self.points);
                return Err(FormatError::truncated(source.offset(), why));
            }
            let left = usize::try_from(self.points - row).unwrap_or(usize::MAX);
            let rows = left.min(source.buffered().len() / stride);
            let block = &source.buffered()[..rows * stride];
            for ((big, offset), column) in places.iter().zip(columns.iter_mut()) {
                column.extend_from_bytes(block.chunks_exact(stride).map(|row| &row[*offset..]), *big);
            }
            source.consume(rows * stride);
            row += rows as u64;
        }
        Ok(())
    }
}

impl Number {
    /// Bytes in the file.
    fn size(self) -> usize {
        if self.half { 2 } else { self.kind.size() }
    }
}

/// Whether all are whole numbers from 0 to 255.
fn holds_bytes(column: &Attribute) -> bool {
    let values = &column.values;
    (0..values.len()).map(|i| values.get(i)).all(|v| (0.0..=255.0).contains(&v) && v.fract() == 0.0)
}

/// The literal between the magic bytes and the data.
fn header_text<R: Read>(source: &mut Source<R>) -> Result<String, FormatError> {
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

/// Bytes of a type.
fn code_size(code: &str) -> Result<usize, String> {
    let digits: String = code.chars().skip(2).take_while(char::is_ascii_digit).collect();
    let size = digits.parse::<usize>().ok();
    // Text is counted in characters of four bytes.
    let unit = if code.chars().nth(1) == Some('U') { 4 } else { 1 };
    size.and_then(|size| size.checked_mul(unit))
        .ok_or_else(|| format!("the type {} is not known", quoted(code)))
}

fn quoted(text: &str) -> String {
    shown(text.as_bytes())
}

/// What a header is made of.
#[derive(Debug, PartialEq)]
enum Literal {
    Str(String),
    Int(u64),
    Bool(bool),
    /// A list or a tuple.
    List(Vec<Literal>),
    Dict(Vec<(String, Literal)>),
}

/// As deep as types of types go.
const MAX_DEPTH: usize = 16;

struct Parser<'a> {
    rest: &'a str,
}

impl Parser<'_> {
    fn whole(mut self) -> Result<Literal, String> {
        let literal = self.literal(0)?;
        match self.next() {
            None => Ok(literal),
            Some(c) => Err(format!("`{c}` after the header's end")),
        }
    }

    /// The next character that is no white space; it is not consumed.
    fn next(&mut self) -> Option<char> {
        self.rest = self.rest.trim_start();
        self.rest.chars().next()
    }

    /// Consumes a character if it is the next.
    fn take(&mut self, c: char) -> bool {
        let taken = self.next() == Some(c);
        if taken {
            self.rest = &self.rest[c.len_utf8()..];
        }
        taken
    }

    fn literal(&mut self, depth: usize) -> Result<Literal, String> {
        if depth > MAX_DEPTH {
            return Err("the header is nested too deep".into());
        }
        match self.next() {
            Some('{') => {
                self.take('{');
                let mut entries = Vec::new();
                while !self.take('}') {
                    let key = self.string()?;
                    if !self.take(':') {
                        return Err("a `:` is missing in the header".into());
                    }
                    entries.push((key, self.literal(depth + 1)?));
                    self.comma('}')?;
                }
                Ok(Literal::Dict(entries))
            }
            Some(open @ ('(' | '[')) => {
                let close = if open == '(' { ')' } else { ']' };
                self.take(open);
                let mut items = Vec::new();
                while !self.take(close) {
                    items.push(self.literal(depth + 1)?);
                    self.comma(close)?;
                }
                Ok(Literal::List(items))
            }
            Some('\'' | '"') => Ok(Literal::Str(self.string()?)),
            _ => {
                let end = self.rest.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(self.rest.len());
                let (word, rest) = self.rest.split_at(end);
                self.rest = rest;
                match word {
                    "True" => Ok(Literal::Bool(true)),
                    "False" => Ok(Literal::Bool(false)),
                    // Python 2 wrote `L` behind long numbers.
                    _ => (word.trim_end_matches('L').parse().map(Literal::Int))
                        .map_err(|_| format!("{} means nothing in a NumPy header", quoted(word))),
                }
            }
        }
    }

    /// What stands between two entries; before `close` it may be missing.
    fn comma(&mut self, close: char) -> Result<(), String> {
        if self.take(',') || self.next() == Some(close) {
            Ok(())
        } else {
            Err(format!("no `{close}` in the header"))
        }
    }

    fn string(&mut self) -> Result<String, String> {
        let quote = self
            .next()
            .filter(|c| matches!(c, '\'' | '"'))
            .ok_or("a name in quotes is missing in the header")?;
        self.take(quote);
        let mut text = String::new();
        let mut chars = self.rest.char_indices();
        while let Some((i, c)) = chars.next() {
            match c {
                _ if c == quote => {
                    self.rest = &self.rest[i + c.len_utf8()..];
                    return Ok(text);
                }
                '\\' => text.extend(chars.next().map(|(_, escaped)| escaped)),
                _ => text.push(c),
            }
        }
        Err("the header ends within quotes".into())
    }
}

/// The bytes before the data of a file of these attributes: as fields of their own types and names, or,
/// without `fields`, as further columns of one table.
pub fn header(scalar: Scalar, fields: bool, points: u64, attributes: &[Attribute]) -> Vec<u8> {
    let float = match scalar {
        Scalar::F32 => "<f4",
        Scalar::F64 => "<f8",
    };
    let (kind, shape) = if is_table(fields, attributes) {
        (format!("'{float}'"), format!("({points}, {})", 3 + attributes.len()))
    } else {
        let mut names = ["x", "y", "z"].map(str::to_owned).to_vec();
        let mut list = names.iter().map(|axis| format!("('{axis}', '{float}')")).collect::<Vec<_>>();
        for attribute in attributes {
            let mut name = attribute.name.replace(char::is_control, "_");
            // Each name is another, and none is empty.
            while name.is_empty() || names.contains(&name) {
                name.push('_');
            }
            let literal = name.replace('\\', "\\\\").replace('\'', "\\'");
            list.push(format!("('{literal}', '{}')", code(attribute.values.kind())));
            names.push(name);
        }
        (format!("[{}]", list.join(", ")), format!("({points},)"))
    };
    let mut text = format!("{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}").into_bytes();
    let version = match text.len() {
        _ if !text.is_ascii() => 3,
        // Room for the padding.
        0..=65_000 => 1,
        _ => 2,
    };
    let fixed = MAGIC.len() + 2 + if version == 1 { 2 } else { 4 };
    // The data begin at a multiple of 64.
    let padding = 63 - (fixed + text.len()) % 64;
    text.resize(text.len() + padding, b' ');
    text.push(b'\n');
    let mut bytes = [MAGIC, &[version, 0]].concat();
    if version == 1 {
        bytes.extend((text.len() as u16).to_le_bytes());
    } else {
        bytes.extend((text.len() as u32).to_le_bytes());
    }
    bytes.extend(text);
    bytes
}

/// Whether all is written as one table of floats, and not as fields.
pub(super) fn is_table(fields: bool, attributes: &[Attribute]) -> bool {
    !fields || attributes.is_empty()
}

fn code(kind: Kind) -> &'static str {
    match kind {
        Kind::I8 => "|i1",
        Kind::U8 => "|u1",
        Kind::I16 => "<i2",
        Kind::U16 => "<u2",
        Kind::I32 => "<i4",
        Kind::U32 => "<u4",
        Kind::I64 => "<i8",
        Kind::U64 => "<u8",
        Kind::F32 => "<f4",
        Kind::F64 => "<f8",
    }
}
