//! Numbers that may be parts of one, cut at a mark of its own.

use super::super::reading::SEPARATOR;
use super::super::text::shown;
use super::super::{FormatError, Place};
use super::Separator;
use super::fit::Fit;
use super::layout::Layout;
use super::sample::{Line, is_comment};

/// Refuses blanks within numbers, between tabs: where white space separates, they would be columns.
pub(super) fn without_blanks(lines: &[&Line], fit: &Fit) -> Result<(), FormatError> {
    let line = lines[fit.first];
    if fit.dialect.separator != Separator::Space || !line.bytes.contains(&b'\t') {
        return Ok(());
    }
    for (column, field) in line.bytes.split(|b| *b == b'\t').map(<[u8]>::trim_ascii).enumerate() {
        if field.contains(&b' ') && fit.dialect.is_foreign(field) {
            let why = format!("column {}: {}", column + 1, fit.dialect.no_number(field));
            return Err(FormatError::malformed(Place::Line(line.number), why));
        }
    }
    Ok(())
}

/// Refuses numbers without names that may have been cut at a comma, or a blank, of their own.
pub(super) fn unambiguous(lines: &[&Line], layout: &Layout) -> Result<(), FormatError> {
    let dialect = layout.dialect;
    if dialect.quoted || !matches!(dialect.separator, Separator::Comma | Separator::Space) {
        return Ok(());
    }
    let mut pairs = Pairs::default();
    let mut places = Vec::new();
    for line in lines.iter().filter(|line| line.number >= layout.from && !is_comment(&line.bytes)) {
        if dialect.split(&line.bytes, &mut places).is_err() || places.len() < layout.width {
            continue;
        }
        let fields: Vec<&[u8]> =
            places[..layout.width].iter().map(|place| &line.bytes[place.clone()]).collect();
        if let Some(column) = padded(&fields, dialect.separator) {
            let why = format!(
                "column {}: {} begins with a zero, as the rest of a number does that was cut in two; are the marks before it \
                 decimal marks or separators of thousands? Neither is read here; if each of them separates columns, say \
                 {SEPARATOR} {}",
                column + 1,
                shown(fields[column]),
                dialect.separator
            );
            return Err(FormatError::malformed(Place::Line(line.number), why));
        }
        pairs.see(&fields);
    }
    if dialect.separator == Separator::Comma && pairs.are_all() {
        let why = format!(
            "{} columns of whole numbers, each second of the same length: do commas stand for decimal marks? These are read \
             where a semicolon, a tab or blanks separate; if each comma separates columns, say {SEPARATOR} comma",
            layout.width
        );
        return Err(FormatError::malformed(Place::Line(layout.from), why));
    }
    Ok(())
}

fn is_whole(field: &[u8]) -> bool {
    !field.is_empty() && field.iter().all(u8::is_ascii_digit)
}

/// The first field that looks like the end of the number before it: `042` after `21`.
fn padded(fields: &[&[u8]], separator: Separator) -> Option<usize> {
    (1..fields.len()).find(|i| {
        let before = fields[i - 1].strip_prefix(b"-").unwrap_or(fields[i - 1]);
        let field = fields[*i];
        let whole = field.split(|b| *b == b'.').next().unwrap_or_default();
        // Behind a decimal comma is any number of digits, between thousands there are three.
        let cut = whole.len() == 3 || separator == Separator::Comma && whole.len() == field.len();
        is_whole(before) && is_whole(whole) && whole.len() > 1 && whole[0] == b'0' && cut
    })
}

/// Whether all fields are whole numbers in pairs, of which the second could be a fraction.
#[derive(Debug, Default)]
struct Pairs {
    rows: usize,
    /// Digits of each second field, if always the same.
    digits: Option<usize>,
    broken: bool,
}

impl Pairs {
    fn see(&mut self, fields: &[&[u8]]) {
        self.rows += 1;
        let is_pair = |pair: &[&[u8]]| match pair {
            [whole, fraction] => is_whole(whole.strip_prefix(b"-").unwrap_or(whole)) && is_whole(fraction),
            _ => false,
        };
        let least = if fields.len() == 4 { 3 } else { 2 };
        self.broken = self.broken || !fields.chunks(2).all(is_pair);
        for fraction in fields.iter().skip(1).step_by(2) {
            let digits = *self.digits.get_or_insert(fraction.len());
            self.broken = self.broken || digits != fraction.len() || digits < least;
        }
    }

    fn are_all(&self) -> bool {
        self.rows > 0 && !self.broken
    }
}
