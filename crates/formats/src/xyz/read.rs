//! Reading lines of numbers.

use super::super::columns::{Guess, MAX_COLUMNS, TextColumn, named_axes};
use super::super::reader::{Block, Ending, Points};
use super::super::source::Source;
use super::super::text::{next_field, parse_f64, shown, strip_comment};
use super::super::{Format, FormatError, Header, Limits};
use super::Separator;
use densecloud_cloud::{Kind, Position, Values};

/// A text cloud, read up to its first point.
///
/// Columns are separated by white space, a comma or a semicolon; `#` and `//` begin comments; blank
/// lines are skipped. A first line that does not begin with a number names the columns: if `x`, `y`
/// and `z` are among the names, these columns are the position, and there are as many columns as names or more;
/// else the first three are, and the names count where there are as many as columns. A line with
/// one whole number before the first point counts the points (`.pts`). Every other column of the first
/// point is an attribute; where nothing names them, three columns of bytes are `red`, `green` and
/// `blue` (one before them `intensity`), and three that make unit vectors `nx`, `ny` and `nz`.
pub(super) struct XyzPoints {
    columns: [usize; 3],
    claimed: Option<u64>,
    max_points: Option<u64>,
    /// The first point, until it is given.
    first: Option<Block>,
    /// Points read.
    count: u64,
    /// The other columns, and their places in a line.
    others: Vec<(usize, TextColumn)>,
    /// What they may be called, where nothing names them.
    guess: Guess,
    names: Option<Vec<String>>,
    /// The line before the points, where it has no number and does not name `x`, `y` and `z` either.
    title: Option<String>,
}

impl XyzPoints {
    /// Reads up to the first point.
    pub(super) fn open(source: &mut Source<'_>, limits: Limits) -> Result<(Self, Header), FormatError> {
        let mut reader = Self {
            columns: [0, 1, 2],
            claimed: None,
            max_points: limits.max_points,
            first: None,
            count: 0,
            others: Vec::new(),
            guess: Guess::default(),
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
                reader.others = (0..width)
                    .filter(|i| !reader.columns.contains(i))
                    .map(|i| (i, TextColumn::new()))
                    .collect();
                let mut block = reader.empty();
                let first = row(reader.columns, &mut reader.others, source, line, &mut block.columns);
                block.positions.push(first.map_err(|error| reader.no_table(error))?);
                reader.first = Some(block);
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

    /// A block without rows.
    fn empty(&self) -> Block {
        let columns = self.others.iter().map(|(_, column)| column.empty()).collect();
        Block { positions: Vec::new(), columns }
    }

    /// Whether nothing names the columns, and none is text.
    fn is_guessed(&self) -> bool {
        self.names.is_none() && self.others.iter().all(|(_, column)| *column != TextColumn::Text)
    }

    /// Reads the next line that is a point; false at the end.
    fn next(&mut self, source: &mut Source<'_>, to: &mut Block) -> Result<bool, FormatError> {
        let line = loop {
            let Some(range) = source.next_line()? else { return Ok(false) };
            let line = strip_comment(source.bytes(range));
            if !line.iter().all(u8::is_ascii_whitespace) {
                break line;
            }
        };
        if let Some(claimed) = self.claimed
            && self.count >= claimed
        {
            let why = format!("a point after the {claimed} that the file counts");
            return Err(FormatError::malformed(source.line(), why));
        }
        to.positions.push(row(self.columns, &mut self.others, source, line, &mut to.columns)?);
        self.count += 1;
        match self.max_points {
            Some(limit) if self.count > limit => {
                Err(FormatError::TooManyPoints { points: self.count, limit })
            }
            _ => Ok(true),
        }
    }
}

impl Points for XyzPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        let from = to.positions.len();
        match (self.first.take(), &self.title) {
            // The first call.
            (Some(first), _) => {
                *to = first;
                self.count = 1;
            }
            (None, Some(title)) if self.count == 0 => {
                let found = format!("text without a line of numbers, which begins with {title}");
                return Err(FormatError::Unrecognised { found });
            }
            (None, _) if to.columns.is_empty() => to.columns = self.empty().columns,
            (None, _) => {}
        }
        while to.positions.len() - from < rows && self.next(source, to)? {}
        if self.is_guessed() {
            self.guess.see(&to.columns, from);
        }
        Ok(())
    }

    fn finish(self: Box<Self>, source: &mut Source<'_>) -> Result<Ending, FormatError> {
        if let Some(claimed) = self.claimed
            && self.count != claimed
        {
            let why = format!("the file counts {claimed} points, and {} are there", self.count);
            return Err(FormatError::truncated(source.line(), why));
        }
        let mut names: Vec<String> = self.others.iter().map(|(place, _)| self.name(*place)).collect();
        if self.is_guessed() {
            self.guess.name(&mut names, |column| self.others[column].1.kind() == Some(Kind::U8));
        }
        Ok(Ending::of_text(names.into_iter().zip(self.others.iter().map(|(_, column)| column))))
    }
}

/// Returns the position in a line, and appends the other fields to their columns.
fn row(
    axes: [usize; 3],
    others: &mut [(usize, TextColumn)],
    source: &Source<'_>,
    line: &[u8],
    columns: &mut [Values],
) -> Result<Position, FormatError> {
    let mut position = [0.0; 3];
    let mut rest = line;
    let mut found = 0;
    let mut others = others.iter_mut().zip(columns).peekable();
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
        } else if let Some(((_, other), numbers)) = others.next_if(|((place, _), _)| *place == column) {
            other.push(numbers, field);
        }
        column += 1;
    }
    // A shorter line than the first.
    for ((_, other), numbers) in others {
        other.push(numbers, b"");
    }
    Ok(position)
}

fn as_count(field: &[u8]) -> Option<u64> {
    std::str::from_utf8(field).ok()?.parse().ok()
}

fn column_name(field: &[u8]) -> String {
    String::from_utf8_lossy(field).trim_matches(['"', '\'']).to_owned()
}
