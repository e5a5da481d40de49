//! What stands before the points: titles, names, a count.

use std::ops::Range;

use super::super::reading::{AXES, SEPARATOR};
use super::super::text::shown;
use super::super::{FormatError, Place, Reading};
use super::Separator;
use super::dialect::Dialect;
use super::fit::Fit;
use super::heading::{Heading, Style};
use super::layout::Layout;
use super::sample::{Line, is_comment};

/// What stands before the points.
pub(super) struct Head<'a> {
    fit: Fit,
    lines: &'a [&'a Line],
    width: usize,
    trailing: bool,
    /// The lines that could name the columns: their place, and what they say.
    headings: Vec<(usize, Heading)>,
    /// One that could, but for the number of its names.
    unfit: Option<(usize, Heading)>,
    counted: Option<(u64, u64)>,
    notes: Vec<String>,
}

impl<'a> Head<'a> {
    pub(super) fn of(lines: &'a [&'a Line], fit: Fit) -> Result<Self, FormatError> {
        let (width, trailing) = width(lines, &fit);
        if width < 3 {
            let why = format!("{width} columns where a point needs 3");
            return Err(FormatError::malformed(Place::Line(lines[fit.first].number), why));
        }
        let first = fit.first;
        let mut head = Self {
            fit,
            lines,
            width,
            trailing,
            headings: Vec::new(),
            unfit: None,
            counted: None,
            notes: Vec::new(),
        };
        for (at, line) in lines[..first].iter().enumerate() {
            if is_comment(&line.bytes) {
                head.see_comment(at);
            } else if let Some(count) = as_count(&line.bytes) {
                head.see_count(line.number, count)?;
            } else {
                head.see_plain(at)?;
            }
        }
        Ok(head)
    }

    fn see_comment(&mut self, at: usize) {
        let all = Heading::all(&self.lines[at].bytes, self.fit.dialect.separator);
        let names_axes = |heading: &Heading| !matches!(heading.axes(), Ok(None));
        match Heading::fitting(all.clone(), self.width) {
            Some(heading) if names_axes(&heading) || self.names_other_columns(at, &heading) => {
                self.headings.push((at, heading));
            }
            _ => {
                if let Some(heading) = all.into_iter().find(names_axes) {
                    self.unfit = Some((at, heading));
                }
            }
        }
    }

    /// Whether a comment names the columns, no coordinates among them, and not by chance: right before the points, and
    /// with marks between the names.
    fn names_other_columns(&self, at: usize, heading: &Heading) -> bool {
        at + 1 == self.fit.first && self.fit.dialect.separator.character().is_some() && heading.is_of_words()
    }

    fn see_count(&mut self, line: u64, count: u64) -> Result<(), FormatError> {
        if let Some((_, earlier @ 1..)) = self.counted {
            let why = format!("1 column where a point needs 3, after a line that counts {earlier} points");
            return Err(FormatError::malformed(Place::Line(line), why));
        }
        self.counted = Some((line, count));
        Ok(())
    }

    fn see_plain(&mut self, at: usize) -> Result<(), FormatError> {
        let (line, seen) = (self.lines[at], self.fit.lines[at]);
        // A point with something wrong in it is no title.
        if seen.begins && (seen.numbers >= 2 || seen.numbers == seen.fields || seen.fields == self.fit.width)
        {
            return Err(self.broken(at));
        }
        let all = Heading::all(&line.bytes, self.fit.dialect.separator);
        // So is one that another separator cuts.
        if all.iter().any(Heading::is_numbers) {
            return Err(self.broken(at));
        }
        match Heading::fitting(all.clone(), self.width) {
            Some(heading) => self.headings.push((at, heading)),
            None => {
                if let Some(heading) = all.into_iter().find(Heading::names_columns) {
                    self.unfit = Some((at, heading));
                }
            }
        }
        Ok(())
    }

    /// What is wrong with a line that should be a point.
    fn broken(&self, at: usize) -> FormatError {
        let (line, dialect) = (self.lines[at], Dialect { quoted: true, ..self.fit.dialect });
        let mut places = Vec::new();
        let why = match dialect.split(&line.bytes, &mut places) {
            Err(why) => why,
            Ok(()) if places.len() != self.fit.width => {
                wrong_width(places.len(), self.fit.width, dialect, "the points")
            }
            Ok(()) => {
                let wrong =
                    places.iter().position(|place| dialect.number(&line.bytes[place.clone()]).is_none());
                let column = wrong.unwrap_or(0);
                format!("column {}: {}", column + 1, dialect.no_number(&line.bytes[places[column].clone()]))
            }
        };
        FormatError::malformed(Place::Line(line.number), why)
    }

    /// The names, the coordinates among them, and the first point.
    pub(super) fn layout(mut self, reading: &Reading) -> Result<Layout, FormatError> {
        let named = self.headings.iter().rposition(|(_, heading)| !matches!(heading.axes(), Ok(None)));
        let chosen = named.or(self.headings.len().checked_sub(1)).map(|at| self.headings.swap_remove(at));
        let (axes, heading) = match chosen {
            Some((at, heading)) => (self.named_axes(at, &heading, reading)?, Some((at, heading))),
            None => (self.unnamed_axes(reading)?, None),
        };
        let (axes, from) = self.first_point(axes, heading.as_ref().map(|(at, _)| *at), reading)?;
        let style = heading.as_ref().map(|(_, heading)| Style {
            prefix: heading.prefix.clone(),
            quoted: heading.quoted,
            axes: axes.map(|axis| heading.names[axis].clone()),
        });
        let names = heading.map(|(_, mut heading)| {
            self.notes.extend(heading.mend());
            heading.names
        });
        Ok(Layout {
            dialect: self.fit.dialect,
            width: self.width,
            trailing: self.trailing,
            axes,
            names,
            style,
            from,
            counted: self.counted,
            notes: self.notes,
        })
    }

    fn named_axes(
        &mut self,
        at: usize,
        heading: &Heading,
        reading: &Reading,
    ) -> Result<[usize; 3], FormatError> {
        let number = self.lines[at].number;
        let wrong = |why: String| FormatError::malformed(Place::Line(number), why);
        if let Some(axes) = &reading.axes {
            return axes.places(&heading.names, self.width).map_err(wrong);
        }
        let names = heading.names.join(", ");
        match heading.axes() {
            Ok(Some(axes)) => {
                if axes.geographic {
                    self.notes.push(
                        "x and y are longitude and latitude: degrees are no metres, and of different lengths along each \
                         axis; project the cloud to a metric coordinate system first"
                            .to_owned(),
                    );
                }
                Ok(axes.columns)
            }
            Ok(None) => Err(wrong(format!(
                "none of the names {names} says which columns are x, y and z; say it: {AXES} A,B,C (names, or numbers from 1)"
            ))),
            Err(why) => Err(wrong(format!(
                "of the names {names}, {why}; say which: {AXES} A,B,C (names, or numbers from 1)"
            ))),
        }
    }

    fn unnamed_axes(&mut self, reading: &Reading) -> Result<[usize; 3], FormatError> {
        let mut mismatch = None;
        if let Some((at, heading)) = &self.unfit {
            let (number, names) = (self.lines[*at].number, &heading.names);
            let found = format!(
                "line {number} has {} names ({}), and the points have {} columns",
                names.len(),
                names.join(", "),
                self.width
            );
            let first_three = matches!(heading.axes(), Ok(Some(axes)) if axes.columns == [0, 1, 2]);
            if reading.axes.is_some() || first_three && is_comment(&self.lines[*at].bytes) {
                self.notes.push(format!("{found}; the names are left aside"));
            } else {
                mismatch = Some(format!(
                    "{found}: a name for each is needed, or none (separated by {}: {SEPARATOR}); with {AXES} A,B,C, numbers \
                     from 1, the names are left aside",
                    self.fit.dialect.separator.shown()
                ));
            }
        }
        let at = Place::Line(self.lines[self.fit.first].number);
        if let Some(why) = mismatch {
            return Err(FormatError::malformed(at, why));
        }
        match &reading.axes {
            Some(axes) => axes.places(&[], self.width).map_err(|why| FormatError::malformed(at, why)),
            None => Ok([0, 1, 2]),
        }
    }

    /// The line of the first point, and the axes: where the columns are but counted, in pandas' way, these numbers are no
    /// point.
    fn first_point(
        &mut self,
        axes: [usize; 3],
        heading: Option<usize>,
        reading: &Reading,
    ) -> Result<([usize; 3], u64), FormatError> {
        let mut from = self.fit.first;
        // Points of which nothing is known may stand before the first with numbers.
        let after = heading.map_or(0, |at| at + 1);
        while from > after && self.is_unknown(from - 1, axes, heading.is_some()) {
            from -= 1;
        }
        for at in (0..from).filter(|at| heading != Some(*at)) {
            let (line, has_numbers) = (self.lines[at], self.fit.lines[at].numbers > 0);
            if is_comment(&line.bytes) || as_count(&line.bytes).is_some() {
                continue;
            }
            // Before the names are titles, and they may have numbers, but not where the coordinates stand.
            let is_behind = heading.is_some() && at >= after;
            if is_behind && (has_numbers || self.is_foreign(at)) || self.has_position(at, axes) {
                return Err(self.broken(at));
            }
            if is_behind || has_numbers {
                let shown = shown(&line.bytes);
                self.notes.push(format!("line {} is not taken for a point: {shown}", line.number));
            }
        }
        if let (None, Some(skipped)) = (heading, self.counted_columns(from)) {
            self.notes.push(format!(
                "line {} counts the columns, as pandas does where they have no names; it is not taken for a point",
                self.lines[from].number
            ));
            let axes = if reading.axes.is_some() { axes } else { axes.map(|axis| axis + skipped) };
            return Ok((axes, self.lines[from + 1].number));
        }
        Ok((axes, self.lines[from].number))
    }

    /// Whether a line has numbers where the coordinates stand.
    fn has_position(&self, at: usize, axes: [usize; 3]) -> bool {
        let (line, dialect) = (self.lines[at], Dialect { quoted: true, ..self.fit.dialect });
        let mut places = Vec::new();
        let is_number =
            |place: &Range<usize>| !place.is_empty() && dialect.number(&line.bytes[place.clone()]).is_some();
        dialect.split(&line.bytes, &mut places).is_ok()
            && axes.iter().all(|axis| places.get(*axis).is_some_and(is_number))
    }

    /// Whether a line has as many fields as points have, and numbers of other files among them.
    fn is_foreign(&self, at: usize) -> bool {
        let (line, dialect) = (self.lines[at], Dialect { quoted: true, ..self.fit.dialect });
        let mut places = Vec::new();
        self.fit.lines[at].fields == self.fit.width
            && dialect.split(&line.bytes, &mut places).is_ok()
            && places.iter().any(|place| dialect.is_foreign(&line.bytes[place.clone()]))
    }

    /// Whether a line is a point of which coordinates are not known: nothing stands there, or, under names, numbers in part.
    fn is_unknown(&self, at: usize, axes: [usize; 3], is_named: bool) -> bool {
        let (line, seen) = (self.lines[at], self.fit.lines[at]);
        let dialect = Dialect { quoted: true, ..self.fit.dialect };
        let mut places = Vec::new();
        seen.fields == self.fit.width
            && (seen.is_void()
                || is_named
                    && dialect.split(&line.bytes, &mut places).is_ok()
                    && axes.iter().all(|axis| dialect.number(&line.bytes[places[*axis].clone()]).is_some()))
    }

    /// Whether a line numbers the columns from 0, while other points are no whole numbers; and whether the first, an index,
    /// has no number: 1 then, else 0.
    fn counted_columns(&self, at: usize) -> Option<usize> {
        let dialect = Dialect { quoted: true, ..self.fit.dialect };
        let mut places = Vec::new();
        dialect.split(&self.lines[at].bytes, &mut places).ok()?;
        let mut fields = places.iter().map(|place| &self.lines[at].bytes[place.clone()]).peekable();
        let skipped = usize::from(fields.next_if(|field| field.is_empty()).is_some());
        let counts = fields.enumerate().all(|(i, field)| field == i.to_string().as_bytes());
        let is_fraction = |field: &[u8]| field.contains(&b'.') || field.contains(&b',');
        let others_are_fractions = self.lines.get(at + 1).is_some_and(|next| {
            dialect.split(&next.bytes, &mut places).is_ok()
                && places.iter().skip(skipped).take(3).any(|place| is_fraction(&next.bytes[place.clone()]))
        });
        (counts && others_are_fractions && self.width >= 3 + skipped).then_some(skipped)
    }
}

/// The columns of the points, and whether a separator with nothing behind it ends each line.
fn width(lines: &[&Line], fit: &Fit) -> (usize, bool) {
    let dialect = Dialect { quoted: true, ..fit.dialect };
    let mut places = Vec::new();
    let mut ends_empty = |line: &Line| {
        dialect.split(&line.bytes, &mut places).is_ok() && places.last().is_some_and(|last| last.is_empty())
    };
    let points = lines.iter().zip(&fit.lines).skip(fit.first).filter(|(_, seen)| seen.fields == fit.width);
    let trailing =
        dialect.separator != Separator::Space && points.into_iter().all(|(line, _)| ends_empty(line));
    // A column that has a name, and nothing in it as far as is known, is one.
    let is_named = || {
        lines[..fit.first].iter().any(|line| {
            let all = Heading::all(&line.bytes, dialect.separator);
            let heading = all.into_iter().find(|heading| heading.names.len() == fit.width);
            heading.is_some_and(|h| h.names.last().is_some_and(|name| !name.is_empty()) && h.names_columns())
        })
    };
    if trailing && !is_named() { (fit.width - 1, true) } else { (fit.width, false) }
}

/// The count that a line holds alone.
pub(super) fn as_count(line: &[u8]) -> Option<u64> {
    let text = std::str::from_utf8(line).ok()?.trim();
    if text.bytes().all(|b| b.is_ascii_digit()) { text.parse().ok() } else { None }
}

/// Why a line of another number of fields is no point.
pub(super) fn wrong_width(found: usize, width: usize, dialect: Dialect, whose: &str) -> String {
    let columns = if found == 1 { "1 column".to_owned() } else { format!("{found} columns") };
    format!("{columns} where {whose} have {width}, separated by {} ({SEPARATOR})", dialect.separator.shown())
}
