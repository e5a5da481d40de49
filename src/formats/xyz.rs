//! Text with a point a line.

use std::io::Read;

use super::source::Source;
use super::text::{next_field, parse_f64, shown, strip_comment};
use super::{Format, FormatError, Header, Limits};
use crate::cloud::Position;

/// More columns than any real table of points has; bounds what a hostile line costs.
const MAX_COLUMNS: usize = 1000;

/// A text cloud, read up to its first point.
///
/// Columns are separated by white space, a comma or a semicolon; `#` and `//` begin comments; blank
/// lines are skipped. A first line that does not begin with a number names the columns: if `x`, `y`
/// and `z` are among the names, these columns are the position, else the first three are. A line with
/// one whole number before the first point counts the points (`.pts`).
pub(super) struct XyzReader {
    columns: [usize; 3],
    claimed: Option<u64>,
    first: Option<Position>,
}

impl XyzReader {
    /// Reads up to the first point.
    pub(super) fn open<R: Read>(
        source: &mut Source<R>,
        limits: Limits,
    ) -> Result<(Self, Header), FormatError> {
        let mut reader = Self { columns: [0, 1, 2], claimed: None, first: None };
        let mut names: Option<Vec<String>> = None;
        let mut width = 3;
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
                reader.columns = named_axes(&found).unwrap_or(reader.columns);
                names = Some(found);
            } else if let (1, None, Some(count)) = (fields.len(), reader.claimed, as_count(first)) {
                reader.claimed = Some(count);
            } else {
                reader.first = Some(reader.row(source, line)?);
                width = fields.len();
                break;
            }
        }
        if let (Some(limit), Some(points)) = (limits.max_points, reader.claimed)
            && points > limit
        {
            return Err(FormatError::TooManyPoints { points, limit });
        }
        let names = names.filter(|n| n.len() == width);
        let dropped_properties = (0..width)
            .filter(|i| !reader.columns.contains(i))
            .map(|i| names.as_ref().map_or_else(|| format!("column {}", i + 1), |n| n[i].clone()))
            .collect();
        let header = Header { format: Format::Xyz, points: reader.claimed, dropped_properties };
        Ok((reader, header))
    }

    /// Reads the rest.
    pub(super) fn read<R: Read>(
        self,
        source: &mut Source<R>,
        limits: Limits,
    ) -> Result<Vec<Position>, FormatError> {
        let mut positions: Vec<Position> = Vec::from_iter(self.first);
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
            positions.push(self.row(source, line)?);
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
        Ok(positions)
    }

    /// The position in a line.
    fn row<R: Read>(&self, source: &Source<R>, line: &[u8]) -> Result<Position, FormatError> {
        let mut position = [0.0; 3];
        let mut rest = line;
        let mut found = 0;
        let mut column = 0;
        while found < 3 {
            let Some(field) = next_field(&mut rest) else {
                let why = format!(
                    "{column} column{} where a point needs {}",
                    if column == 1 { "" } else { "s" },
                    self.columns.iter().max().map_or(3, |c| c + 1)
                );
                return Err(FormatError::malformed(source.line(), why));
            };
            if let Some(axis) = self.columns.iter().position(|c| *c == column) {
                position[axis] = parse_f64(field).ok_or_else(|| {
                    let why = format!("{} is not a number", shown(field));
                    FormatError::malformed(source.line(), why)
                })?;
                found += 1;
            }
            column += 1;
        }
        Ok(position)
    }
}

fn as_count(field: &[u8]) -> Option<u64> {
    std::str::from_utf8(field).ok()?.parse().ok()
}

fn column_name(field: &[u8]) -> String {
    String::from_utf8_lossy(field).trim_matches(['"', '\'']).to_owned()
}

/// Where the names `x`, `y` and `z` stand, if each stands once.
fn named_axes(names: &[String]) -> Option<[usize; 3]> {
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
