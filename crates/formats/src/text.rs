//! Numbers and columns in text.

use std::ops::Range;

use densecloud_cloud::Values;

/// Parses a decimal number; `None` when it is none.
///
/// Takes what C libraries print for values that are no numbers, `nan`, `-nan(ind)` and `1.#INF`
/// among them, because scanners write them for missing returns.
pub(super) fn parse_f64(token: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(token).ok()?;
    text.parse().ok().or_else(|| non_finite(text))
}

/// As [`parse_f64`], rounded once to 32 bits.
pub(super) fn parse_f32(token: &[u8]) -> Option<f32> {
    let text = std::str::from_utf8(token).ok()?;
    text.parse().ok().or_else(|| non_finite(text).map(|v| v as f32))
}

/// Appends a number to a column, exactly; `None` when the column's type has no such number. Whole
/// numbers may be written as floats (`255.0`).
pub(super) fn push_number(values: &mut Values, token: &[u8]) -> Option<()> {
    macro_rules! push {
        ($($int:ident $number:ty),*) => {
            match values {
                Values::F32(column) => column.push(parse_f32(token)?),
                Values::F64(column) => column.push(parse_f64(token)?),
                $(Values::$int(column) => {
                    let exact = std::str::from_utf8(token).ok()?.parse().ok();
                    column.push(exact.or_else(|| {
                        let value = parse_f64(token)?;
                        ((value as $number) as f64 == value).then_some(value as $number)
                    })?);
                })*
            }
        };
    }
    push!(I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64);
    Some(())
}

fn non_finite(text: &str) -> Option<f64> {
    let (sign, digits) = match text.as_bytes().first()? {
        b'-' => (-1.0, &text[1..]),
        b'+' => (1.0, &text[1..]),
        _ => (1.0, text),
    };
    let digits = digits.to_ascii_lowercase();
    if digits.starts_with("1.#inf") {
        Some(sign * f64::INFINITY)
    } else if digits.starts_with("nan(") || digits.starts_with("1.#") {
        Some(f64::NAN)
    } else {
        None
    }
}

/// Cuts the next token, delimited by white space, from the front of `line`.
pub(super) fn next_token<'a>(line: &mut &'a [u8]) -> Option<&'a [u8]> {
    let from = line.iter().position(|b| !is_space(*b))?;
    let rest = &line[from..];
    let to = rest.iter().position(|b| is_space(*b)).unwrap_or(rest.len());
    *line = &rest[to..];
    Some(&rest[..to])
}

/// Tells where each field of a line stands as CSV has them, without white space and quotes about them, and whether each
/// stands in quotes: these may hold the separator, and quotes twice for each. Where it may have `comments`, one ends
/// it. Stops behind `most` fields.
///
/// # Errors
/// Quotes are not closed, or something stands behind them.
pub(super) fn split_quoted(
    line: &[u8],
    separator: u8,
    comments: bool,
    most: usize,
    mut tell: impl FnMut(Range<usize>, bool),
) -> Result<(), String> {
    let mut from = 0;
    for _ in 0..most {
        let skip = line[from..].iter().position(|b| *b == separator || !is_space(*b));
        let begin = skip.map_or(line.len(), |i| from + i);
        let quotes = line.get(begin) == Some(&b'"');
        let close = if quotes { closing(line, begin)? } else { begin };
        let end = line[close..].iter().position(|b| *b == separator).map_or(line.len(), |i| close + i);
        let after = if quotes { close + 1 } else { from };
        let comment = comment(line, after, end).filter(|_| comments);
        let rest = trimmed(line, after..comment.unwrap_or(end));
        if quotes {
            if !rest.is_empty() {
                return Err(format!("{} follows a closing quote", shown(&line[rest])));
            }
            tell(trimmed(line, begin + 1..close), true);
        } else {
            tell(rest, false);
        }
        if comment.is_some() || end == line.len() {
            break;
        }
        from = end + 1;
    }
    Ok(())
}

/// As [`split_quoted`], the fields themselves, and without comments; none where quotes are not closed, or something
/// stands behind them.
pub(super) fn quoted_fields(line: &str, separator: u8) -> Option<Vec<(String, bool)>> {
    let mut fields = Vec::new();
    let tell = |place: Range<usize>, quoted: bool| {
        // White space, quotes and separators are ASCII, so fields begin and end between characters.
        let field = line.get(place).unwrap_or_default();
        fields.push((if quoted { field.replace("\"\"", "\"") } else { field.to_owned() }, quoted));
    };
    split_quoted(line.as_bytes(), separator, false, usize::MAX, tell).ok()?;
    Some(fields)
}

/// Where the quotes close that open at `open`. Two in a row are one of the field's.
pub(super) fn closing(line: &[u8], open: usize) -> Result<usize, String> {
    let mut at = open + 1;
    while let Some(quote) = line[at..].iter().position(|b| *b == b'"').map(|i| at + i) {
        if line.get(quote + 1) != Some(&b'"') {
            return Ok(quote);
        }
        at = quote + 2;
    }
    Err("quotes are opened and not closed in this line".to_owned())
}

/// Where a comment begins in this part of a line: at the line's beginning or after white space.
pub(super) fn comment(line: &[u8], from: usize, to: usize) -> Option<usize> {
    let mut at = from;
    while let Some(found) = line[at..to].iter().position(|b| matches!(b, b'#' | b'/')).map(|i| at + i) {
        if begins_comment(&line[found..]) && (found == 0 || is_space(line[found - 1])) {
            return Some(found);
        }
        at = found + 1;
    }
    None
}

/// Whether a comment begins here.
pub(super) fn begins_comment(rest: &[u8]) -> bool {
    rest.starts_with(b"#") || rest.starts_with(b"//")
}

/// A part of a line without white space about it.
pub(super) fn trimmed(line: &[u8], field: Range<usize>) -> Range<usize> {
    let part = &line[field.clone()];
    match part.iter().position(|b| !is_space(*b)) {
        None => field.start..field.start,
        Some(first) => {
            let last = part.iter().rposition(|b| !is_space(*b)).unwrap_or(first);
            field.start + first..field.start + last + 1
        }
    }
}

/// `line` without a comment that `#` or `//` begins.
pub(super) fn strip_comment(line: &[u8]) -> &[u8] {
    let end = line
        .iter()
        .enumerate()
        .position(|(i, b)| *b == b'#' && !is_number_hash(line, i) || line[i..].starts_with(b"//"));
    &line[..end.unwrap_or(line.len())]
}

/// Whether the `#` at `i` belongs to a Windows non-number such as `1.#INF`.
fn is_number_hash(line: &[u8], i: usize) -> bool {
    line[..i].ends_with(b"1.")
}

/// A token as an error message shows it: short and printable.
pub(super) fn shown(token: &[u8]) -> String {
    const MOST: usize = 40;
    let text: String = String::from_utf8_lossy(&token[..token.len().min(MOST)])
        .chars()
        .map(|c| if c.is_control() { '\u{FFFD}' } else { c })
        .collect();
    if token.len() > MOST { format!("`{text}…`") } else { format!("`{text}`") }
}

/// Whether a byte is white space: as in C, a vertical tab too.
pub(super) fn is_space(b: u8) -> bool {
    matches!(b, b' ' | b'\t' | b'\r' | b'\n' | 0x0B | 0x0C)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotes_hold_a_field_together() {
        let split = |line| quoted_fields(line, b',');
        let fields =
            |fields: &[(&str, bool)]| Some(fields.iter().map(|(text, q)| ((*text).to_owned(), *q)).collect());
        assert_eq!(split("a, b c ,"), fields(&[("a", false), ("b c", false), ("", false)]));
        assert_eq!(
            split("\"a, b\" , \"say \"\"h\"\"\",c\"d"),
            fields(&[("a, b", true), ("say \"h\"", true), ("c\"d", false)])
        );
        assert_eq!(split(""), fields(&[("", false)]));
        assert_eq!((split("\"a"), split("\"a\"b,c")), (None, None));
    }

    #[test]
    fn numbers_and_non_numbers_are_parsed() {
        assert_eq!(parse_f64(b"-1.5e3"), Some(-1500.0));
        assert_eq!(parse_f64(b"+7"), Some(7.0));
        assert_eq!(parse_f64(b"-inf"), Some(f64::NEG_INFINITY));
        assert_eq!(parse_f64(b"-1.#INF00"), Some(f64::NEG_INFINITY));
        for nan in [b"nan".as_slice(), b"NaN", b"-nan(ind)", b"1.#QNAN", b"-1.#IND"] {
            assert!(parse_f64(nan).expect("a number").is_nan());
            assert!(parse_f32(nan).expect("a number").is_nan());
        }
        for bad in [b"".as_slice(), b"x", b"1,5", b"0x10", b"\xFF", b"-", b"\xC3\xA9"] {
            assert_eq!(parse_f64(bad), None);
        }
    }

    #[test]
    fn comments_end_a_line() {
        assert_eq!(strip_comment(b"1 2 3 # four"), b"1 2 3 ");
        assert_eq!(strip_comment(b"// X Y Z"), b"");
        assert_eq!(strip_comment(b"1.#INF 2"), b"1.#INF 2");
    }
}
