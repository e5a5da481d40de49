//! Which dialect explains the first lines of a file best.

use std::cmp::Reverse;

use super::dialect::Dialect;
use super::heading::Heading;
use super::sample::{Line, is_comment};
use super::{Decimal, Separator};

/// A dialect, and what the lines are in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Fit {
    pub(super) dialect: Dialect,
    /// Fields of the lines that are points.
    pub(super) width: usize,
    /// What each line is.
    pub(super) lines: Vec<Seen>,
    /// The first line that is a point.
    pub(super) first: usize,
}

/// What a line is in a dialect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Seen {
    pub(super) fields: usize,
    /// Fields that are numbers, and not empty.
    pub(super) numbers: usize,
    pub(super) empty: usize,
    /// Whether the first field is a number.
    pub(super) begins: bool,
}

impl Seen {
    fn of(line: &Line, dialect: Dialect) -> Self {
        let dialect = Dialect { quoted: line.bytes.contains(&b'"'), ..dialect };
        let mut places = Vec::new();
        if is_comment(&line.bytes) || dialect.split(&line.bytes, &mut places).is_err() {
            return Self::default();
        }
        let mut seen = Self { fields: places.len(), ..Self::default() };
        for (i, place) in places.into_iter().enumerate() {
            let field = &line.bytes[place];
            if field.is_empty() {
                seen.empty += 1;
            } else if dialect.number(field).is_some() {
                seen.numbers += 1;
                seen.begins = seen.begins || i == 0;
            }
        }
        seen
    }

    /// Whether it can be a point: it has three numbers, or none of its fields is anything else.
    fn is_row(self) -> bool {
        self.fields >= 3
            && (self.numbers >= 3 || self.numbers > 0 && self.numbers + self.empty == self.fields)
    }

    /// Whether nothing stands in its fields.
    pub(super) fn is_void(self) -> bool {
        self.fields >= 3 && self.empty == self.fields
    }
}

/// How good a fit is: points, numbers in them, no words. Of equals, see [`Fit::tie`].
type Score = (usize, usize, Reverse<usize>);

/// The dialect in which most lines are points of the same number of fields, and most fields numbers. None where no line is
/// a point in any.
pub(super) fn best(lines: &[&Line], separator: Option<Separator>, decimal: Option<Decimal>) -> Option<Fit> {
    // What stands nowhere neither separates nor begins a fraction.
    let stands = |c: char| lines.iter().any(|line| line.bytes.contains(&(c as u8)));
    let may_separate = |one: &Separator| match separator {
        Some(only) => *one == only,
        None => one.character().is_none_or(stands),
    };
    let decimals: Vec<Decimal> = match decimal {
        Some(only) => vec![only],
        None if stands(',') => vec![Decimal::Point, Decimal::Comma],
        None => vec![Decimal::Point],
    };
    let mut fits: Vec<(Score, Fit)> = Vec::new();
    for separator in Separator::ALL.into_iter().filter(may_separate) {
        // A comma is not both.
        for &decimal in decimals.iter().filter(|one| (separator, **one) != (Separator::Comma, Decimal::Comma))
        {
            let dialect = Dialect { separator, decimal, quoted: false };
            fits.extend(scored(lines, dialect));
        }
    }
    let most = fits.iter().map(|(score, _)| *score).max()?;
    fits.retain(|(score, _)| *score == most);
    if fits.len() == 1 {
        return fits.pop().map(|(_, fit)| fit);
    }
    // The first of those that are as good.
    fits.into_iter().map(|(_, fit)| fit).rev().max_by_key(|fit| fit.tie(lines))
}

impl Fit {
    /// What decides between fits of one score: names that fit, nothing empty, points from the beginning on. Lines are cut
    /// into names for it.
    fn tie(&self, lines: &[&Line]) -> (bool, Reverse<usize>, Reverse<usize>) {
        let has_names = lines[..self.first].iter().any(|line| {
            let heading = Heading::fitting(Heading::all(&line.bytes, self.dialect.separator), self.width);
            heading.is_some_and(|heading| !matches!(heading.axes(), Ok(None)))
        });
        let points = self.lines.iter().filter(|line| line.is_row() && line.fields == self.width);
        (has_names, Reverse(points.map(|line| line.empty).sum()), Reverse(self.first))
    }
}

fn scored(lines: &[&Line], dialect: Dialect) -> Option<(Score, Fit)> {
    let seen: Vec<Seen> = lines.iter().map(|line| Seen::of(line, dialect)).collect();
    let width = most_common(seen.iter().filter(|line| line.is_row()).map(|line| line.fields))?;
    let is_point = |line: &&Seen| line.is_row() && line.fields == width;
    let first = seen.iter().position(|line| is_point(&line))?;
    let (mut rows, mut numbers, mut empty) = (0, 0, 0);
    for line in seen.iter().filter(is_point) {
        rows += 1;
        numbers += line.numbers;
        empty += line.empty;
    }
    let words = rows * width - numbers - empty;
    let quoted = lines[first..].iter().any(|line| line.bytes.contains(&b'"'));
    let fit = Fit { dialect: Dialect { quoted, ..dialect }, width, lines: seen, first };
    Some(((rows, numbers, Reverse(words)), fit))
}

/// The most common number, the first of those that are as common.
fn most_common(numbers: impl Iterator<Item = usize>) -> Option<usize> {
    let mut counts: Vec<(usize, usize)> = Vec::new();
    for number in numbers {
        match counts.iter_mut().find(|(known, _)| *known == number) {
            Some((_, count)) => *count += 1,
            None => counts.push((number, 1)),
        }
    }
    let most = counts.iter().map(|(_, count)| *count).max()?;
    counts.into_iter().find(|(_, count)| *count == most).map(|(number, _)| number)
}
