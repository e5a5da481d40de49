//! Reading lines of numbers.

use std::borrow::Cow;
use std::ops::Range;

use super::super::columns::{Guess, TextColumn};
use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::reading::AXES;
use super::super::source::Source;
use super::super::text::shown;
use super::super::{Format, FormatError, Header, Limits, Place, Reading};
use super::Decimal;
use super::dialect::Dialect;
use super::head::{as_count, wrong_width};
use super::layout::Layout;
use super::sample::{Sample, is_blank, is_comment, without_end};
use super::thousands::Thousands;
use densecloud_cloud::{Extra, Kind, Values};

/// The attribute that tells the clouds of a file apart, from 0.
const SCAN: &str = "scan";

/// A text cloud, whose first lines have decided how it is read ([`Layout`]). Every line that is not empty and no comment
/// has as many fields as the first points, and numbers where these have them; whatever does not fit is an error. Where a
/// line counts the points (`.pts`), another one begins another cloud.
///
/// Every column beside the coordinates is an attribute; where nothing names them, three columns of bytes are `red`,
/// `green` and `blue` (one before them `intensity`), and three that make unit vectors `nx`, `ny` and `nz`.
pub(super) struct XyzPoints {
    /// None where no line is a point.
    layout: Option<Layout>,
    /// What the file begins with, for the error that no line is a point.
    begins: Option<String>,
    sample: Sample,
    limits: Limits,
    /// Points read.
    count: u64,
    /// The other columns, and their places in a line.
    others: Vec<(usize, TextColumn)>,
    /// What they may be called, where nothing names them.
    guess: Guess,
    clouds: Clouds,
    thousands: Thousands,
    /// The places of a line's fields.
    fields: Vec<Range<usize>>,
}

/// The clouds of a file that counts their points.
#[derive(Debug, Default)]
struct Clouds {
    /// The count of the last one, and the line where it stands.
    counted: Option<(u64, u64)>,
    /// Points before it.
    before: u64,
    /// Its number.
    number: u16,
    notes: Vec<String>,
}

impl Clouds {
    /// The cloud ends here: whether its count was right.
    fn end(&mut self, points: u64) {
        let Some((line, count)) = self.counted else { return };
        let found = points - self.before;
        if found != count {
            self.notes.push(format!(
                "line {line} counts {count} points, and {found} follow it; all of them are read"
            ));
        }
    }

    /// A line counts the points of another cloud.
    fn next(&mut self, points: u64, line: u64, count: u64) -> Result<(), FormatError> {
        // A count of nothing before the first points is no cloud.
        if points > 0 {
            self.end(points);
            let why = || {
                FormatError::malformed(
                    Place::Line(line),
                    format!("more than {} clouds in one file", u16::MAX),
                )
            };
            self.number = self.number.checked_add(1).ok_or_else(why)?;
        }
        (self.counted, self.before) = (Some((line, count)), points);
        Ok(())
    }
}

impl XyzPoints {
    /// Reads the first lines.
    pub(super) fn open(
        source: &mut Source<'_>,
        limits: Limits,
        reading: &Reading,
    ) -> Result<(Self, Header), FormatError> {
        let mut sample = Sample::read(source)?;
        let layout = Layout::of(&sample, reading)?;
        let begins =
            sample.lines().find(|line| !is_comment(&line.bytes)).map(|line| shown(line.bytes.trim_ascii()));
        let mut points = Self {
            layout: None,
            begins,
            sample: Sample::default(),
            limits,
            count: 0,
            others: Vec::new(),
            guess: Guess::default(),
            clouds: Clouds::default(),
            thousands: Thousands::new(Decimal::Point, true, 0),
            fields: Vec::new(),
        };
        let Some(layout) = layout else {
            let attributes = Vec::new();
            let header =
                Header { format: Format::TEXT, points: None, attributes, dropped_properties: Vec::new() };
            return Ok((points, header));
        };
        sample.forget_before(layout.from);
        points.sample = sample;
        points.clouds.counted = layout.counted;
        let claimed = layout.counted.map(|(_, count)| count);
        limits.check_points(claimed.unwrap_or(0))?;
        let others = (0..layout.width).filter(|i| !layout.axes.contains(i));
        points.others = others.map(|i| (i, TextColumn::new())).collect();
        let Dialect { separator, decimal, .. } = layout.dialect;
        points.thousands = Thousands::new(decimal, reading.decimal.is_some(), layout.width);
        let header = Header {
            format: Format::Xyz { names: layout.names.is_some(), separator, decimal },
            points: claimed,
            attributes: points.others.iter().map(|(i, _)| name(&layout, *i)).collect(),
            dropped_properties: Vec::new(),
        };
        points.layout = Some(layout);
        Ok((points, header))
    }

    /// A block without rows.
    fn empty(&self, layout: &Layout) -> Block {
        let mut columns: Vec<Values> = self.others.iter().map(|(_, column)| column.empty()).collect();
        if layout.counted.is_some() {
            columns.push(Values::new(Kind::U16));
        }
        Block { positions: Vec::new(), columns }
    }

    /// Whether nothing names the columns, and none is text.
    fn is_guessed(&self, layout: &Layout) -> bool {
        layout.names.is_none() && self.others.iter().all(|(_, column)| *column != TextColumn::Text)
    }

    /// Reads the next line that is a point; false at the end.
    fn next(
        &mut self,
        layout: &Layout,
        source: &mut Source<'_>,
        to: &mut Block,
    ) -> Result<bool, FormatError> {
        loop {
            let (number, line) = match self.sample.next() {
                Some(line) => (line.number, Cow::Owned(line.bytes)),
                None => match source.next_line()? {
                    Some(range) => (source.line_number(), Cow::Borrowed(without_end(source.bytes(range)))),
                    None => return Ok(false),
                },
            };
            if is_blank(&line) || is_comment(&line) {
                continue;
            }
            if self.row(layout, number, &line, to)? {
                return Ok(true);
            }
        }
    }

    /// Appends the point of a line; false where it counts those of another cloud.
    fn row(
        &mut self,
        layout: &Layout,
        number: u64,
        line: &[u8],
        to: &mut Block,
    ) -> Result<bool, FormatError> {
        let wrong = |why: String| FormatError::malformed(Place::Line(number), why);
        let mut dialect = layout.dialect;
        dialect.split(line, &mut self.fields).map_err(wrong)?;
        self.drop_trailing(layout);
        let is_quoted = |field: &Range<usize>| line.get(field.start) == Some(&b'"');
        if self.fields.len() != layout.width || !dialect.quoted && self.fields.iter().any(is_quoted) {
            if self.fields.len() == 1
                && layout.counted.is_some()
                && let Some(count) = as_count(line)
            {
                self.clouds.next(self.count, number, count)?;
                return Ok(false);
            }
            // Quotes that the first lines have not.
            dialect.quoted = true;
            dialect.split(line, &mut self.fields).map_err(wrong)?;
            self.drop_trailing(layout);
            if self.fields.len() != layout.width {
                return Err(wrong(wrong_width(self.fields.len(), layout.width, dialect, "the first points")));
            }
        }
        let mut position = [0.0; 3];
        for (coordinate, column) in position.iter_mut().zip(layout.axes) {
            let field = &line[self.fields[column].clone()];
            *coordinate =
                dialect.number(field).ok_or_else(|| wrong(no_coordinate(layout, dialect, column, field)))?;
        }
        if !self.thousands.is_settled() {
            self.see_thousands(layout, number, line);
        }
        for ((column, other), numbers) in self.others.iter_mut().zip(&mut to.columns) {
            let field = &line[self.fields[*column].clone()];
            let was_text = *other == TextColumn::Text;
            other.push_by(numbers, field, |field| dialect.number(field));
            if !was_text && *other == TextColumn::Text {
                if dialect.is_foreign(field) {
                    return Err(wrong(no_number(layout, dialect, *column, field)));
                }
                self.thousands.forget(*column);
            }
        }
        if layout.counted.is_some()
            && let Some(Values::U16(scans)) = to.columns.last_mut()
        {
            scans.push(self.clouds.number);
        }
        to.positions.push(position);
        self.count += 1;
        self.limits.check_points(self.count)?;
        Ok(true)
    }

    /// Takes note of all numbers of a line.
    fn see_thousands(&mut self, layout: &Layout, number: u64, line: &[u8]) {
        let texts =
            self.others.iter().filter(|(_, other)| *other != TextColumn::Text).map(|(column, _)| *column);
        for column in layout.axes.into_iter().chain(texts) {
            self.thousands.see(column, number, &line[self.fields[column].clone()]);
        }
    }

    /// Refuses numbers that may be a thousand times what they are read as; a note where only what is usual tells that
    /// they are not.
    fn without_thousands(&self, layout: &Layout) -> Result<Option<String>, FormatError> {
        let Some(doubt) = self.thousands.doubt() else { return Ok(None) };
        let (column, decimal) = (place(layout, doubt.column), layout.dialect.decimal);
        match doubt.refused(&column, decimal) {
            Some(why) => Err(FormatError::malformed(Place::Line(doubt.grouped.0), why)),
            None => Ok(doubt.noted(&column, decimal)),
        }
    }

    /// Where a separator ends each line, nothing behind it is no field.
    fn drop_trailing(&mut self, layout: &Layout) {
        if layout.trailing
            && self.fields.len() == layout.width + 1
            && self.fields.last().is_some_and(Range::is_empty)
        {
            self.fields.pop();
        }
    }
}

fn no_number(layout: &Layout, dialect: Dialect, column: usize, field: &[u8]) -> String {
    format!("{}: {}", place(layout, column), dialect.no_number(field))
}

/// A column by its number and, if it has one, its name.
fn place(layout: &Layout, column: usize) -> String {
    let named = layout.names.as_ref().map(|names| format!(" ({})", names[column])).unwrap_or_default();
    format!("column {}{named}", column + 1)
}

/// As [`no_number`], of a column that nothing but its place makes a coordinate.
fn no_coordinate(layout: &Layout, dialect: Dialect, column: usize, field: &[u8]) -> String {
    let why = no_number(layout, dialect, column, field);
    if layout.names.is_some() || dialect.is_foreign(field) {
        return why;
    }
    format!("{why}; if the coordinates stand in other columns, say {AXES} A,B,C (numbers from 1)")
}

fn name(layout: &Layout, column: usize) -> String {
    let name = layout.names.as_ref().and_then(|names| names.get(column));
    name.cloned().unwrap_or_else(|| format!("column {}", column + 1))
}

impl Points for XyzPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        let Some(layout) = self.layout.take() else {
            let Some(begins) = &self.begins else { return Ok(()) };
            let found = format!("text without a line of numbers, which begins with {begins}");
            return Err(FormatError::Unrecognised { found });
        };
        let from = to.positions.len();
        if to.columns.is_empty() {
            to.columns = self.empty(&layout).columns;
        }
        let mut more = Ok(true);
        while to.positions.len() - from < rows && matches!(more, Ok(true)) {
            more = self.next(&layout, source, to);
        }
        if self.is_guessed(&layout) {
            self.guess.see(&to.columns[..self.others.len()], from);
        }
        self.layout = Some(layout);
        more.map(|_| ())
    }

    fn finish(mut self: Box<Self>, _source: &mut Source<'_>) -> Result<Ending, FormatError> {
        self.clouds.end(self.count);
        let Some(layout) = self.layout.take() else { return Ok(Ending::of_text(std::iter::empty())) };
        let mut names: Vec<String> = self.others.iter().map(|(place, _)| name(&layout, *place)).collect();
        let note = self.without_thousands(&layout)?;
        if self.is_guessed(&layout) {
            self.guess.name(&mut names, |column| self.others[column].1.kind() == Some(Kind::U8));
        }
        let has_scan = self.clouds.number > 0 && !names.iter().any(|name| name == SCAN);
        let mut ending = Ending::of_text(names.into_iter().zip(self.others.iter().map(|(_, column)| column)));
        if layout.counted.is_some() {
            ending.columns.push(has_scan.then(|| ColumnName { name: SCAN.to_owned(), kind: Kind::U16 }));
        }
        if has_scan {
            let clouds = u32::from(self.clouds.number) + 1;
            ending.notes.insert(0, format!("the file has {clouds} clouds; `{SCAN}` numbers them from 0"));
        }
        // What is told once comes before what may be told often.
        let once = note.into_iter().chain(std::mem::take(&mut ending.notes));
        ending.notes = once.chain(layout.notes).chain(self.clouds.notes).collect();
        ending.origin.extra = layout.style.map(Extra::new);
        Ok(ending)
    }
}
