//! Comments that may be data.

use super::super::text::shown;
use super::dialect::Dialect;
use super::layout::Layout;
use super::sample::{Line, is_comment};

/// What is told where most points end in a comment: colours such as `#ff0000` and what stands behind them are none.
pub(super) fn behind_points(lines: &[&Line], layout: &Layout) -> Option<String> {
    let points = lines.iter().filter(|line| line.number >= layout.from && !is_comment(&line.bytes));
    let ends: Vec<Option<&[u8]>> = points.map(|line| behind(&line.bytes, layout.dialect)).collect();
    let found: Vec<&[u8]> = ends.iter().flatten().copied().collect();
    let (count, all) = (found.len(), ends.len());
    (2 * count > all).then(|| {
        format!(
            "{count} of the first {all} points end in a comment, which is left out: {}; if it is data, write it without `#` and \
             `//`",
            shown(found[0])
        )
    })
}

/// The comment that ends a line.
fn behind(line: &[u8], dialect: Dialect) -> Option<&[u8]> {
    let dialect = Dialect { quoted: line.contains(&b'"'), ..dialect };
    let mut places = Vec::new();
    dialect.split(line, &mut places).ok()?;
    let rest = &line[places.last()?.end..];
    let separates =
        |b: &u8| b.is_ascii_whitespace() || *b == b'"' || dialect.separator.as_str().as_bytes() == [*b];
    let from = rest.iter().position(|b| !separates(b))?;
    Some(&rest[from..])
}
