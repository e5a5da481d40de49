//! Reading.

use super::super::axes::axes_among;
use super::super::columns::MAX_COLUMNS;
use super::super::names::Apart;
use super::super::numbers::CRS;
use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::source::Source;
use super::super::text::{next_token, push_number, shown};
use super::super::{Format, FormatError, Header, Limits, Place, Scalar};
use super::PcdEncoding;
use densecloud_cloud::{Crs, Kind, Origin, Values};

/// More bytes than any header has.
const MAX_HEADER: usize = 1 << 20;

/// LZF makes at most 264 bytes of 3; a claim above that is none.
const MAX_EXPANSION: u64 = 90;

/// A file whose header is read.
pub(super) struct PcdPoints {
    fields: Vec<Field>,
    /// By name, and where each comes from.
    attributes: Vec<(String, Column)>,
    points: u64,
    data: PcdEncoding,
    /// Places of `x`, `y` and `z` among the fields.
    axes: [usize; 3],
    origin: Origin,
    /// Points read.
    row: u64,
}

struct Field {
    name: String,
    /// None where no number of ours is like it.
    kind: Option<Kind>,
    size: usize,
    count: usize,
    /// Bytes from the beginning of a row.
    offset: usize,
}

/// Where an attribute comes from.
struct Column {
    /// The field's place.
    field: usize,
    kind: Kind,
    /// The byte of a colour, by the bits below it.
    shift: Option<u32>,
}

impl Field {
    fn bytes(&self) -> usize {
        self.size * self.count
    }

    /// `rgb` and `rgba` hold three or four bytes in one number.
    fn is_colour(&self) -> bool {
        let is_packed = ["rgb", "rgba"].iter().any(|name| self.name.eq_ignore_ascii_case(name));
        is_packed && self.size == 4 && self.count == 1
    }

    fn is_kept(&self) -> bool {
        self.name != "_" && self.kind.is_some() && self.count == 1
    }
}

impl PcdPoints {
    /// Reads the header and leaves `source` at the first byte of data.
    pub(super) fn open(source: &mut Source<'_>, limits: Limits) -> Result<(Self, Header), FormatError> {
        let mut lines: Vec<(String, Vec<String>)> = Vec::new();
        let mut origin = Origin::default();
        let mut left = MAX_HEADER;
        while let Some(range) = source.next_line()? {
            let line = String::from_utf8_lossy(source.bytes(range)).into_owned();
            let Some(rest) = left.checked_sub(line.len() + 1) else { break };
            left = rest;
            if let Some(comment) = line.strip_prefix('#') {
                note(comment.trim(), &mut origin);
                continue;
            }
            let line = line.split('#').next().unwrap_or_default();
            let mut words = line.split_ascii_whitespace().map(str::to_owned);
            if let Some(key) = words.next() {
                let key = key.to_ascii_uppercase();
                let last = key == "DATA";
                lines.push((key, words.collect()));
                if last {
                    let mut header =
                        Self::parse(&lines).map_err(|why| FormatError::malformed(source.line(), why))?;
                    let Origin { sensor, orientation, .. } = header.origin;
                    header.origin = Origin { sensor, orientation, ..origin };
                    limits.check_points(header.points)?;
                    let told = header.told();
                    return Ok((header, told));
                }
            }
        }
        Err(FormatError::truncated(source.line(), "the PCD header has no `DATA` line"))
    }

    fn parse(lines: &[(String, Vec<String>)]) -> Result<Self, String> {
        let find = |key: &str| lines.iter().find(|(k, _)| k == key).map(|(_, words)| words.as_slice());
        let need = |key: &str| find(key).ok_or_else(|| format!("the PCD header has no `{key}` line"));
        let whole =
            |word: &String| word.parse::<u64>().map_err(|_| format!("`{word}` is not a whole number"));
        let names = find("FIELDS").or(find("COLUMNS")).ok_or("the PCD header has no `FIELDS` line")?;
        if names.len() > MAX_COLUMNS {
            return Err(format!("{} fields; more than {MAX_COLUMNS} are not read", names.len()));
        }
        let (sizes, types) = (need("SIZE")?, need("TYPE")?);
        let ones = vec!["1".to_owned(); names.len()];
        let counts = find("COUNT").unwrap_or(&ones);
        if sizes.len() != names.len() || types.len() != names.len() || counts.len() != names.len() {
            return Err("FIELDS, SIZE, TYPE and COUNT do not have the same number of words".into());
        }
        let mut fields = Vec::with_capacity(names.len());
        let mut offset = 0;
        for (i, name) in names.iter().enumerate() {
            let (size, count) = (whole(&sizes[i])?, whole(&counts[i])?);
            if !matches!(size, 1 | 2 | 4 | 8) || count > 1 << 20 {
                return Err(format!("the field `{name}` has {count} numbers of {size} bytes"));
            }
            let kind = match (types[i].to_ascii_uppercase().as_str(), size) {
                ("I", 1) => Some(Kind::I8),
                ("I", 2) => Some(Kind::I16),
                ("I", 4) => Some(Kind::I32),
                ("I", 8) => Some(Kind::I64),
                ("U", 1) => Some(Kind::U8),
                ("U", 2) => Some(Kind::U16),
                ("U", 4) => Some(Kind::U32),
                ("U", 8) => Some(Kind::U64),
                ("F", 4) => Some(Kind::F32),
                ("F", 8) => Some(Kind::F64),
                _ => None,
            };
            let field =
                Field { name: name.clone(), kind, size: size as usize, count: count as usize, offset };
            offset += field.bytes();
            fields.push(field);
        }
        let numbers: Vec<&str> =
            fields.iter().map(|f| if f.is_kept() { f.name.as_str() } else { "" }).collect();
        let axes = axes_among(&numbers, "the fields have")?;
        let size = |key: &str| find(key).and_then(<[String]>::first).map(whole).transpose();
        let points = match (size("POINTS")?, size("WIDTH")?, size("HEIGHT")?) {
            (Some(points), _, _) => points,
            (None, Some(width), height) => width.saturating_mul(height.unwrap_or(1)),
            (None, None, _) => return Err("the PCD header has neither `POINTS` nor `WIDTH`".into()),
        };
        let data = need("DATA")?.first().map(|word| word.to_ascii_lowercase()).unwrap_or_default();
        let data = match data.as_str() {
            "ascii" => PcdEncoding::Ascii,
            "binary" => PcdEncoding::Binary,
            "binary_compressed" => PcdEncoding::Compressed,
            other => return Err(format!("`DATA {other}` is not known")),
        };
        let origin = find("VIEWPOINT").map(viewpoint).unwrap_or_default();
        let attributes = Self::attributes(&fields, axes);
        Ok(Self { fields, attributes, points, data, axes, origin, row: 0 })
    }

    fn scalar(&self) -> Scalar {
        let fits = self.axes.iter().all(|i| self.fields[*i].kind.is_some_and(Kind::fits_f32));
        if fits { Scalar::F32 } else { Scalar::F64 }
    }

    fn told(&self) -> Header {
        let others =
            || self.fields.iter().enumerate().filter(|(i, f)| !self.axes.contains(i) && f.name != "_");
        Header {
            format: Format::Pcd { encoding: self.data, scalar: self.scalar() },
            points: Some(self.points),
            attributes: others().filter(|(_, f)| f.is_kept()).map(|(_, f)| f.name.clone()).collect(),
            dropped_properties: others().filter(|(_, f)| !f.is_kept()).map(|(_, f)| f.name.clone()).collect(),
        }
    }

    /// The attributes, and where each comes from.
    fn attributes(fields: &[Field], axes: [usize; 3]) -> Vec<(String, Column)> {
        let (mut names, mut columns) = (Vec::new(), Vec::new());
        for (place, field) in fields.iter().enumerate() {
            let Some(kind) = field.kind.filter(|_| field.is_kept() && !axes.contains(&place)) else {
                continue;
            };
            if !field.is_colour() {
                names.push(field.name.as_str());
                columns.push(Column { field: place, kind, shift: None });
                continue;
            }
            let alpha = field.name.eq_ignore_ascii_case("rgba").then_some(("alpha", 24));
            for (name, shift) in [("red", 16), ("green", 8), ("blue", 0)].into_iter().chain(alpha) {
                names.push(name);
                columns.push(Column { field: place, kind: Kind::U8, shift: Some(shift) });
            }
        }
        Apart::all(&names).into_iter().zip(columns).collect()
    }

    /// What was done about fields that have a name which another has.
    fn notes(&self) -> Vec<String> {
        let renamed = self.attributes.iter().filter_map(|(name, column)| {
            let own = &self.fields[column.field].name;
            let is_other = column.shift.is_none() && name != own;
            is_other.then(|| format!("`{own}` is the name of several fields; a later one is called `{name}`"))
        });
        renamed.collect()
    }

    fn missing(&self, at: Place, found: u64) -> FormatError {
        FormatError::truncated(at, format!("the header counts {} points, and {found} are there", self.points))
    }

    /// Reads at most `rows` lines.
    fn read_text(
        &self,
        source: &mut Source<'_>,
        rows: usize,
        columns: &mut [Option<Values>],
    ) -> Result<u64, FormatError> {
        let end = self.points.min(self.row.saturating_add(rows as u64));
        let mut row = self.row;
        while row < end {
            let Some(range) = source.next_line()? else { return Err(self.missing(source.line(), row)) };
            let mut rest = source.bytes(range);
            if rest.iter().all(u8::is_ascii_whitespace) {
                continue;
            }
            for (field, column) in self.fields.iter().zip(columns.iter_mut()) {
                for _ in 0..field.count {
                    let token = next_token(&mut rest).unwrap_or_default();
                    let Some(column) = column else { continue };
                    push_text(column, token, field.is_colour()).ok_or_else(|| {
                        let why = format!("{} is not a number of the field `{}`", shown(token), field.name);
                        FormatError::malformed(source.line(), why)
                    })?;
                }
            }
            if let Some(surplus) = next_token(&mut rest) {
                let why = format!("{} stands behind the numbers of all fields", shown(surplus));
                return Err(FormatError::malformed(source.line(), why));
            }
            row += 1;
        }
        Ok(row)
    }

    /// Reads the rows in the buffer, at most `rows` of them.
    fn read_rows(
        &self,
        source: &mut Source<'_>,
        rows: usize,
        columns: &mut [Option<Values>],
    ) -> Result<u64, FormatError> {
        let stride: usize = self.fields.iter().map(Field::bytes).sum();
        if !source.ensure(stride)? {
            return Err(self.missing(source.offset(), self.row));
        }
        let left = usize::try_from(self.points - self.row).unwrap_or(usize::MAX);
        let rows = left.min(rows).min(source.buffered().len() / stride);
        let block = &source.buffered()[..rows * stride];
        for (field, column) in self.fields.iter().zip(columns.iter_mut()) {
            if let Some(column) = column {
                column.extend_from_bytes(block.chunks_exact(stride).map(|r| &r[field.offset..]), false);
            }
        }
        source.consume(rows * stride);
        Ok(self.row + rows as u64)
    }

    /// One LZF block that holds the fields one after another.
    fn read_compressed(
        &self,
        source: &mut Source<'_>,
        columns: &mut [Option<Values>],
    ) -> Result<u64, FormatError> {
        let at = source.offset();
        let Some(sizes) = source.take(8)? else { return Err(self.missing(at, 0)) };
        let word = |i: usize| u32::from_le_bytes([sizes[i], sizes[i + 1], sizes[i + 2], sizes[i + 3]]);
        let (packed, unpacked) = (word(0) as usize, word(4) as usize);
        let stride: usize = self.fields.iter().map(Field::bytes).sum();
        if self.points.checked_mul(stride as u64) != Some(unpacked as u64) {
            let why = format!("{unpacked} bytes for {} points of {stride} bytes", self.points);
            return Err(FormatError::malformed(at, why));
        }
        let mut bytes = Vec::new();
        while bytes.len() < packed && source.ensure(1)? {
            let part = source.buffered();
            let part = &part[..part.len().min(packed - bytes.len())];
            bytes.extend_from_slice(part);
            let length = part.len();
            source.consume(length);
        }
        if bytes.len() < packed {
            return Err(self.missing(source.offset(), 0));
        }
        if unpacked as u64 > packed as u64 * MAX_EXPANSION {
            return Err(FormatError::malformed(at, "more bytes than can be compressed into what is there"));
        }
        let bytes = lzf::decompress(&bytes, unpacked).ok().filter(|b| b.len() == unpacked);
        let bytes = bytes.ok_or_else(|| FormatError::malformed(at, "the compressed data are damaged"))?;
        let mut rest = bytes.as_slice();
        for (field, column) in self.fields.iter().zip(columns.iter_mut()) {
            // The product of both is within the length, as checked.
            let (own, after) = rest.split_at(field.bytes() * self.points as usize);
            if let Some(column) = column {
                column.extend_from_bytes(own.chunks_exact(field.size), false);
            }
            rest = after;
        }
        Ok(self.points)
    }
}

impl Points for PcdPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if to.columns.is_empty() {
            to.columns = self.attributes.iter().map(|(_, column)| Values::new(column.kind)).collect();
        }
        if self.row == self.points {
            return Ok(());
        }
        let mut columns: Vec<Option<Values>> =
            self.fields.iter().map(|f| f.kind.filter(|_| f.is_kept()).map(Values::new)).collect();
        self.row = match self.data {
            PcdEncoding::Ascii => self.read_text(source, rows, &mut columns)?,
            PcdEncoding::Binary => self.read_rows(source, rows, &mut columns)?,
            PcdEncoding::Compressed => self.read_compressed(source, &mut columns)?,
        };
        let [x, y, z] = self.axes.map(|i| columns[i].take().unwrap_or(Values::new(Kind::F64)));
        to.positions.extend((0..x.len()).map(|i| [x.get(i), y.get(i), z.get(i)]));
        for ((_, column), values) in self.attributes.iter().zip(&mut to.columns) {
            let Some(field) = &columns[column.field] else { continue };
            match (column.shift, values) {
                (Some(shift), Values::U8(bytes)) => {
                    bytes.extend(packed(field).map(|rgb| (rgb >> shift) as u8))
                }
                (_, values) => values.extend_from(field),
            }
        }
        Ok(())
    }

    fn finish(self: Box<Self>, source: &mut Source<'_>) -> Result<Ending, FormatError> {
        if self.data == PcdEncoding::Ascii {
            source.expect_end("the points that the header counts")?;
        }
        let notes = self.notes();
        let columns = self.attributes.into_iter();
        let columns = columns.map(|(name, column)| Some(ColumnName { name, kind: column.kind })).collect();
        Ok(Ending { columns, dropped_properties: Vec::new(), notes, origin: self.origin })
    }
}

/// A comment of the header: the coordinate system, as it is written here, or a line about the file.
fn note(comment: &str, origin: &mut Origin) {
    if let Some(crs) = comment.strip_prefix(CRS) {
        origin.crs = crs.parse::<Crs>().ok();
    } else if !comment.is_empty() && !comment.starts_with(".PCD") {
        origin.comments.push(comment.to_owned());
    }
}

/// Where the sensor stood and how it was turned: a translation, then a quaternion. What every program
/// writes that does not know is taken for nothing.
fn viewpoint(words: &[String]) -> Origin {
    let numbers: Vec<f64> = words.iter().map_while(|word| word.parse().ok()).collect();
    match <[f64; 7]>::try_from(numbers) {
        Ok([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) | Err(_) => Origin::default(),
        Ok([x, y, z, turn @ ..]) => {
            // Nothing is lost of one that was not turned.
            let orientation = Some(turn).filter(|turn| *turn != [1.0, 0.0, 0.0, 0.0]);
            Origin { sensor: Some([x, y, z]), orientation, ..Origin::default() }
        }
    }
}

/// The bits of a colour, in whatever type it comes.
fn packed(values: &Values) -> Box<dyn Iterator<Item = u32> + '_> {
    match values {
        Values::F32(column) => Box::new(column.iter().map(|v| v.to_bits())),
        Values::U32(column) => Box::new(column.iter().copied()),
        other => Box::new((0..other.len()).map(|i| other.get(i) as i64 as u32)),
    }
}

/// Appends a number in text. A colour's bits may be written as the float or as the whole number that
/// they are.
fn push_text(values: &mut Values, token: &[u8], colour: bool) -> Option<()> {
    if let (true, Values::F32(column)) = (colour, &mut *values)
        && let Some(bits) = std::str::from_utf8(token).ok().and_then(|t| t.parse().ok())
    {
        column.push(f32::from_bits(bits));
        return Some(());
    }
    push_number(values, token)
}
