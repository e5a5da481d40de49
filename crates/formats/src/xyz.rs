//! Text with a point a line.

use std::io::Read;

use super::source::Source;
use super::text::{next_field, parse_f64, shown, strip_comment};
use super::{Format, FormatError, Header, Limits, Separator};
use densecloud_cloud::{Attribute, Cloud, Kind, Origin, Position, Values};

/// More columns than any real table of points has; bounds what a hostile line costs.
pub(super) const MAX_COLUMNS: usize = 1000;

/// A text cloud, read up to its first point.
///
/// Columns are separated by white space, a comma or a semicolon; `#` and `//` begin comments; blank
/// lines are skipped. A first line that does not begin with a number names the columns: if `x`, `y`
/// and `z` are among the names, these columns are the position, and there are as many columns as names or more;
/// else the first three are, and the names count where there are as many as columns. A line with
/// one whole number before the first point counts the points (`.pts`). Every other column of the first
/// point is an attribute; where nothing names them, three columns of bytes are `red`, `green` and
/// `blue` (one before them `intensity`), and three that make unit vectors `nx`, `ny` and `nz`.
pub(super) struct XyzReader {
    columns: [usize; 3],
    claimed: Option<u64>,
    first: Option<Position>,
    /// By their places in a line.
    others: Vec<(usize, Column)>,
    names: Option<Vec<String>>,
    /// The line before the points, where it has no number and does not name `x`, `y` and `z` either.
    title: Option<String>,
}

/// A column as it is read: whole numbers for as long as there is nothing else.
#[derive(Debug)]
pub(super) enum Column {
    Whole(Vec<i64>),
    Real(Vec<f64>),
    /// Something in it is no number.
    Text,
}

impl XyzReader {
    /// Reads up to the first point.
    pub(super) fn open<R: Read>(
        source: &mut Source<R>,
        limits: Limits,
    ) -> Result<(Self, Header), FormatError> {
        let mut reader = Self {
            columns: [0, 1, 2],
            claimed: None,
            first: None,
            others: Vec::new(),
            names: None,
            title: None,
        };
        let mut names: Option<Vec<String>> = None;
        let mut width = 3;
        let mut separator = Separator::Space;
        while let Some(range) = source.next_line()? {
            let line = strip_comment(source.bytes(range));
            let mut rest = line;
            let mut fields = Vec::new();
            while let Some(field) = next_field(&mut rest) {
                if fields.len() == MAX_COLUMNS {
                    let why = format!("the line has more than {MAX_COLUMNS} columns");
                    return Err(FormatError::malformed(source.line(), why));
                }
                fields.push(field);
            }
            let Some(first) = fields.first() else { continue };
            if names.is_none() && parse_f64(first).is_none() {
                let found: Vec<String> = fields.iter().map(|f| column_name(f)).collect();
                match named_axes(&found) {
                    Some(columns) => reader.columns = columns,
                    None => reader.title = Some(shown(line.trim_ascii())),
                }
                names = Some(found);
            } else if let (1, None, Some(count)) = (fields.len(), reader.claimed, as_count(first)) {
                reader.claimed = Some(count);
            } else {
                // Behind the last separator there may be nothing, for a field that is empty.
                width = match &names {
                    Some(names) if reader.title.is_none() => names.len().max(fields.len()),
                    _ => fields.len(),
                };
                separator = match line {
                    _ if line.contains(&b',') => Separator::Comma,
                    _ if line.contains(&b';') => Separator::Semicolon,
                    _ => Separator::Space,
                };
                reader.others =
                    (0..width).filter(|i| !reader.columns.contains(i)).map(|i| (i, Column::new())).collect();
                let first = row(reader.columns, &mut reader.others, source, line);
                reader.first = Some(first.map_err(|error| reader.no_table(error))?);
                break;
            }
        }
        if let (Some(limit), Some(points)) = (limits.max_points, reader.claimed)
            && points > limit
        {
            return Err(FormatError::TooManyPoints { points, limit });
        }
        reader.names = names.filter(|n| reader.title.is_none() || n.len() == width);
        let header = Header {
            format: Format::Xyz { names: reader.names.is_some(), separator },
            points: reader.claimed,
            attributes: reader.others.iter().map(|(i, _)| reader.name(*i)).collect(),
            dropped_properties: Vec::new(),
        };
        Ok((reader, header))
    }

    /// A first point that is none, where the line before it speaks of no points either: likely a page, a log, or a
    /// program's settings.
    fn no_table(&self, error: FormatError) -> FormatError {
        match (error, &self.title) {
            (FormatError::Malformed { at, why }, Some(title)) => {
                let why = format!("{why}, and {title} before it does not name columns x, y and z");
                FormatError::Malformed { at, why }
            }
            (error, _) => error,
        }
    }

    fn name(&self, column: usize) -> String {
        let name = self.names.as_ref().and_then(|names| names.get(column));
        name.cloned().unwrap_or_else(|| format!("column {}", column + 1))
    }

    /// Reads the rest.
    pub(super) fn read<R: Read>(
        mut self,
        source: &mut Source<R>,
        limits: Limits,
    ) -> Result<Cloud, FormatError> {
        let mut positions: Vec<Position> = Vec::from_iter(self.first);
        if let (None, Some(title)) = (self.first, &self.title) {
            let found = format!("text without a line of numbers, which begins with {title}");
            return Err(FormatError::Unrecognised { found });
        }
        while let Some(range) = source.next_line()? {
            let line = strip_comment(source.bytes(range));
            if line.iter().all(u8::is_ascii_whitespace) {
                continue;
            }
            if let Some(claimed) = self.claimed
                && positions.len() as u64 >= claimed
            {
                let why = format!("a point after the {claimed} that the file counts");
                return Err(FormatError::malformed(source.line(), why));
            }
            positions.push(row(self.columns, &mut self.others, source, line)?);
            if let Some(limit) = limits.max_points
                && positions.len() as u64 > limit
            {
                return Err(FormatError::TooManyPoints { points: positions.len() as u64, limit });
            }
        }
        if let Some(claimed) = self.claimed
            && (positions.len() as u64) != claimed
        {
            let why = format!("the file counts {claimed} points, and {} are there", positions.len());
            return Err(FormatError::truncated(source.line(), why));
        }
        let (mut attributes, mut text) = (Vec::new(), Vec::new());
        for (i, column) in std::mem::take(&mut self.others) {
            match column.into_values() {
                Some(values) => attributes.push(Attribute { name: self.name(i), values }),
                None => text.push(format!("{} (text)", self.name(i))),
            }
        }
        if self.names.is_none() && text.is_empty() {
            guess_names(&mut attributes, are_bytes);
        }
        Ok(Cloud { positions, attributes, dropped_properties: text, origin: Origin::default() })
    }
}

/// The position in a line; the other columns take what is theirs.
fn row<R: Read>(
    axes: [usize; 3],
    others: &mut [(usize, Column)],
    source: &Source<R>,
    line: &[u8],
) -> Result<Position, FormatError> {
    let mut position = [0.0; 3];
    let mut rest = line;
    let mut found = 0;
    let mut others = others.iter_mut().peekable();
    let mut column = 0;
    while found < 3 || others.peek().is_some() {
        let Some(field) = next_field(&mut rest) else {
            if found == 3 {
                break;
            }
            let why = format!(
                "{column} column{} where a point needs {}",
                if column == 1 { "" } else { "s" },
                axes.iter().max().map_or(3, |c| c + 1)
            );
            return Err(FormatError::malformed(source.line(), why));
        };
        if let Some(axis) = axes.iter().position(|c| *c == column) {
            position[axis] = parse_f64(field).ok_or_else(|| {
                let why = format!("{} is not a number", shown(field));
                FormatError::malformed(source.line(), why)
            })?;
            found += 1;
        } else if let Some((_, other)) = others.next_if(|(place, _)| *place == column) {
            other.push(field);
        }
        column += 1;
    }
    // A shorter line than the first.
    for (_, other) in others {
        other.push(b"");
    }
    Ok(position)
}

impl Column {
    pub(super) fn new() -> Self {
        Self::Whole(Vec::new())
    }

    /// Appends a field; an empty one is a NaN.
    pub(super) fn push(&mut self, field: &[u8]) {
        if let Self::Whole(numbers) = self {
            if let Some(number) = std::str::from_utf8(field).ok().and_then(|f| f.parse().ok()) {
                numbers.push(number);
                return;
            }
            *self = Self::Real(numbers.iter().map(|&n| n as f64).collect());
        }
        if let Self::Real(numbers) = self {
            match if field.is_empty() { Some(f64::NAN) } else { parse_f64(field) } {
                Some(number) => numbers.push(number),
                None => *self = Self::Text,
            }
        }
    }

    /// The numbers in the smallest usual type that holds them: bytes, 32-bit and 64-bit integers, doubles.
    pub(super) fn into_values(self) -> Option<Values> {
        let all = |numbers: &[i64], lo: i64, hi: i64| numbers.iter().all(|n| (lo..=hi).contains(n));
        match self {
            Self::Whole(n) if all(&n, 0, 255) => Some(Values::U8(n.iter().map(|&v| v as u8).collect())),
            Self::Whole(n) if all(&n, i32::MIN.into(), i32::MAX.into()) => {
                Some(Values::I32(n.iter().map(|&v| v as i32).collect()))
            }
            Self::Whole(n) => Some(Values::I64(n)),
            Self::Real(n) => Some(Values::F64(n)),
            Self::Text => None,
        }
    }
}

/// Names for columns that have none, where their values tell what they are; `are_bytes` says whether
/// three can be a colour.
pub(super) fn guess_names(attributes: &mut [Attribute], are_bytes: impl Fn(&[Attribute]) -> bool) {
    let mut i = 0;
    while i < attributes.len() {
        let next = |from: usize| attributes.get(from..from + 3);
        let (names, from): (&[&str], usize) = if next(i).is_some_and(&are_bytes) {
            (&["red", "green", "blue"], i)
        } else if next(i).is_some_and(are_unit) {
            (&["nx", "ny", "nz"], i)
        } else if i == 0 && next(1).is_some_and(&are_bytes) {
            (&["intensity", "red", "green", "blue"], 0)
        } else {
            i += 1;
            continue;
        };
        let taken = names.iter().any(|n| attributes.iter().any(|a| a.name == *n));
        if !taken {
            for (attribute, name) in attributes[from..].iter_mut().zip(names) {
                attribute.name = (*name).to_owned();
            }
        }
        i += names.len();
    }
}

pub(super) fn are_bytes(columns: &[Attribute]) -> bool {
    columns.iter().all(|c| c.values.kind() == Kind::U8)
}

/// Whether nearly all rows are vectors of length 1 to the digits that text usually has.
fn are_unit(columns: &[Attribute]) -> bool {
    let rows = columns[0].values.len();
    let length = |row: usize| columns.iter().map(|c| c.values.get(row).powi(2)).sum::<f64>().sqrt();
    let unit = (0..rows).filter(|&row| (length(row) - 1.0).abs() < 0.01).count();
    unit * 20 >= rows * 19
}

fn as_count(field: &[u8]) -> Option<u64> {
    std::str::from_utf8(field).ok()?.parse().ok()
}

fn column_name(field: &[u8]) -> String {
    String::from_utf8_lossy(field).trim_matches(['"', '\'']).to_owned()
}

/// Where the names `x`, `y` and `z` stand, if each stands once.
pub(super) fn named_axes(names: &[String]) -> Option<[usize; 3]> {
    let mut axes = [0; 3];
    for (axis, wanted) in axes.iter_mut().zip(["x", "y", "z"]) {
        let mut places = (0..names.len()).filter(|i| names[*i].eq_ignore_ascii_case(wanted));
        *axis = places.next()?;
        if places.next().is_some() {
            return None;
        }
    }
    Some(axes)
}
