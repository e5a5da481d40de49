//! A first column that may be an id, a class or a count rather than x.

use super::super::reading::AXES;
use super::super::{FormatError, Place};
use super::layout::Layout;
use super::sample::{Line, is_comment};

/// Points that tell of columns: fewer may have whole numbers by chance.
const ENOUGH: usize = 16;

/// Refuses points without names that begin with whole numbers, and then have three fractions: survey and scanner programs
/// write ids, classes and rows before coordinates. Only a person can tell these from an x that is whole.
pub(super) fn is_coordinate(lines: &[&Line], layout: &Layout) -> Result<(), FormatError> {
    if layout.width < 4 || layout.axes != [0, 1, 2] {
        return Ok(());
    }
    let dialect = layout.dialect;
    let (mut points, mut fractions, mut places) = (0, [0_usize; 3], Vec::new());
    for line in lines.iter().filter(|line| line.number >= layout.from && !is_comment(&line.bytes)) {
        if dialect.split(&line.bytes, &mut places).is_err() || places.len() < layout.width {
            continue;
        }
        let field = |column: usize| line.bytes[places[column].clone()].trim_ascii();
        if !field(0).iter().all(u8::is_ascii_digit) {
            return Ok(());
        }
        points += 1;
        for (column, count) in fractions.iter_mut().enumerate() {
            *count += usize::from(!field(column + 1).iter().all(|b| b.is_ascii_digit() || *b == b'-'));
        }
    }
    if points < ENOUGH || fractions.iter().any(|count| 2 * count <= points) {
        return Ok(());
    }
    let why = format!(
        "column 1 has whole numbers alone, and the next three have fractions: is it x, or an id, a class or a count before \
         x, y and z? Nothing in the file tells. Say {AXES} 2,3,4, or {AXES} 1,2,3 if the coordinates come first"
    );
    Err(FormatError::malformed(Place::Line(layout.from), why))
}
