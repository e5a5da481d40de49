//! How a file is read: how its lines are cut, what the columns are called, where the points begin.

use super::super::columns::MAX_COLUMNS;
use super::super::reading::{DECIMAL, SEPARATOR};
use super::super::text::shown;
use super::super::{FormatError, Place, Reading};
use super::comments;
use super::cuts;
use super::dialect::Dialect;
use super::fit::best;
use super::head::Head;
use super::heading::Style;
use super::leading;
use super::sample::{Line, Sample, is_comment};
use super::{Decimal, Separator};

/// How a file is read, decided once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) dialect: Dialect,
    /// Columns of each line.
    pub(super) width: usize,
    /// Whether a separator with nothing behind it ends each line.
    pub(super) trailing: bool,
    /// The columns of x, y and z.
    pub(super) axes: [usize; 3],
    /// The names of all columns, no two the same.
    pub(super) names: Option<Vec<String>>,
    /// How these names stand in the file.
    pub(super) style: Option<Style>,
    /// The line of the first point.
    pub(super) from: u64,
    /// The line before the points that counts them, and the count.
    pub(super) counted: Option<(u64, u64)>,
    /// What a person should know about it, a sentence each.
    pub(super) notes: Vec<String>,
}

impl Layout {
    /// Decides by the first lines, and by `reading` where it says more; none where no line holds a point.
    ///
    /// # Errors
    /// The lines can be read in several ways, or do not go together.
    pub(super) fn of(sample: &Sample, reading: &Reading) -> Result<Option<Self>, FormatError> {
        let mut lines: Vec<&Line> = sample.lines().collect();
        let told = lines.first().and_then(|line| told_separator(&line.bytes));
        if told.is_some() {
            lines.remove(0);
        }
        let separator = reading.separator.or(told);
        if separator == Some(Separator::Comma) && reading.decimal == Some(Decimal::Comma) {
            let why = format!("a comma cannot be both {SEPARATOR} and {DECIMAL}");
            return Err(FormatError::malformed(Place::Line(1), why));
        }
        let Some(fit) = best(&lines, separator, reading.decimal) else {
            nothing(&lines)?;
            if separator.is_some() || reading.decimal.is_some() {
                return Err(none_as_told(&lines, separator, reading.decimal));
            }
            return Ok(None);
        };
        cuts::without_blanks(&lines, &fit)?;
        let mut layout = Head::of(&lines, fit)?.layout(reading)?;
        if layout.names.is_none() && separator.is_none() && reading.decimal.is_none() {
            cuts::unambiguous(&lines, &layout)?;
        }
        if layout.names.is_none() && reading.axes.is_none() {
            leading::is_coordinate(&lines, &layout)?;
        }
        layout.notes.dedup();
        layout.notes.extend(comments::behind_points(&lines, &layout));
        Ok(Some(layout))
    }
}

/// The separator that a first line `sep=;` names, as spreadsheets read it.
fn told_separator(line: &[u8]) -> Option<Separator> {
    let text = std::str::from_utf8(line).ok()?.trim_matches(['"', ' ', '\r', '\u{feff}']);
    let (word, separator) = text.split_at_checked(4)?;
    if word.eq_ignore_ascii_case("sep=") { separator.parse().ok() } else { None }
}

/// Lines without a point: an error where they seem to be meant as points.
fn nothing(lines: &[&Line]) -> Result<(), FormatError> {
    for line in lines.iter().filter(|line| !is_comment(&line.bytes)) {
        let begun = line.bytes.trim_ascii_start();
        if begun.first().is_some_and(|b| b.is_ascii_digit() || b"-+.\"".contains(b))
            && let Some(why) = no_point(&line.bytes, lines.len())
        {
            return Err(FormatError::malformed(Place::Line(line.number), why));
        }
    }
    Ok(())
}

/// No line is a point by these marks.
fn none_as_told(lines: &[&Line], separator: Option<Separator>, decimal: Option<Decimal>) -> FormatError {
    let told = [
        separator.map(|separator| format!("{SEPARATOR} {separator}")),
        decimal.map(|decimal| format!("{DECIMAL} {decimal}")),
    ];
    let told: Vec<String> = told.into_iter().flatten().collect();
    let line = lines.iter().find(|line| !is_comment(&line.bytes));
    let (number, begins) = line.map_or((1, String::new()), |line| (line.number, shown(&line.bytes)));
    let why = format!("no line has three numbers by {}; this one is {begins}", told.join(" and "));
    FormatError::malformed(Place::Line(number), why)
}

/// Why a line that begins like a number is no point, where that can be told.
fn no_point(line: &[u8], lines: usize) -> Option<String> {
    let mut places = Vec::new();
    for separator in Separator::ALL {
        let dialect = Dialect { separator, decimal: Decimal::Point, quoted: line.contains(&b'"') };
        match dialect.split(line, &mut places) {
            Err(why) if places.len() > MAX_COLUMNS => return Some(why),
            Err(_) => continue,
            Ok(()) => {}
        }
        let fields = || places.iter().map(|place| &line[place.clone()]);
        let foreign = fields().position(|field| dialect.is_foreign(field));
        if let Some(column) = foreign.filter(|_| fields().len() >= 3) {
            return Some(format!(
                "column {}: {}",
                column + 1,
                dialect.no_number(&line[places[column].clone()])
            ));
        }
        let are_numbers = fields().all(|field| !field.is_empty() && dialect.number(field).is_some());
        if are_numbers && places.len() < 3 && lines > 1 {
            let columns =
                if places.len() == 1 { "1 column".to_owned() } else { format!("{} columns", places.len()) };
            return Some(format!("{columns} where a point needs 3"));
        }
    }
    None
}
