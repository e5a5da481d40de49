//! How a line is cut into fields, and how a field is a number.

use std::ops::Range;

use super::super::columns::MAX_COLUMNS;
use super::super::text::{
    begins_comment, closing, comment, is_space, parse_f64, shown, split_quoted, trimmed,
};
use super::{Decimal, Separator};

/// What a file's lines are made of: decided once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Dialect {
    pub(super) separator: Separator,
    pub(super) decimal: Decimal,
    /// Whether fields may stand in quotes.
    pub(super) quoted: bool,
}

/// What stands for a number that is absent, in lower case.
const ABSENT: [&str; 6] = ["na", "n/a", "#n/a", "null", "none", "<na>"];

/// The longest number whose mark is exchanged without a copy on the heap.
const LONGEST: usize = 64;

impl Dialect {
    /// Cuts a line into the places of its fields, without white space and quotes about them. A comment ends it: `#` or
    /// `//` that begins the line or follows white space.
    ///
    /// # Errors
    /// A quote is not closed, or there are more than [`MAX_COLUMNS`] fields.
    pub(super) fn split(self, line: &[u8], fields: &mut Vec<Range<usize>>) -> Result<(), String> {
        fields.clear();
        match (self.separator.character(), self.quoted) {
            (None, false) => split_blanks(line, fields),
            (None, true) => split_quoted_blanks(line, fields)?,
            (Some(separator), false) => split_at(line, separator as u8, fields),
            (Some(separator), true) => {
                split_quoted(line, separator as u8, true, MAX_COLUMNS + 1, |place, _| fields.push(place))?;
            }
        }
        if fields.len() > MAX_COLUMNS {
            return Err(format!("the line has more than {MAX_COLUMNS} columns"));
        }
        Ok(())
    }

    /// The number that a field is, exactly rounded; NaN where it is empty or says that there is none.
    pub(super) fn number(self, field: &[u8]) -> Option<f64> {
        let number = match self.decimal {
            Decimal::Point => parse_f64(field),
            Decimal::Comma => self.with_comma(field),
        };
        number.or_else(|| is_absent(field).then_some(f64::NAN)).or_else(|| fortran(field))
    }

    fn with_comma(self, field: &[u8]) -> Option<f64> {
        let Some(comma) = field.iter().position(|b| *b == b',') else {
            // A point would be a separator of thousands, or a mistake.
            return if field.contains(&b'.') { not_finite(field) } else { parse_f64(field) };
        };
        // `1 ,2` with white space between columns is no number and .2.
        let is_bare = comma == 0 && self.separator == Separator::Space;
        let is_open = comma + 1 == field.len() && self.separator == Separator::Space;
        if is_bare || is_open || field.contains(&b'.') {
            return None;
        }
        let mut copy = [0; LONGEST];
        if let Some(copy) = copy.get_mut(..field.len()) {
            copy.copy_from_slice(field);
            copy[comma] = b'.';
            return parse_f64(copy);
        }
        let mut copy = field.to_vec();
        copy[comma] = b'.';
        parse_f64(&copy)
    }

    /// Why a field is no number, and what may be done.
    pub(super) fn no_number(self, field: &[u8]) -> String {
        let found = shown(field);
        match (otherwise(field), self.decimal) {
            (Some(Otherwise::Thousands), _) => {
                format!("{found} has separators of thousands, which are not read; write numbers without them")
            }
            (Some(Otherwise::Comma), Decimal::Point) => otherwise_marked(field, ["point", "comma"], ','),
            (Some(Otherwise::Point), Decimal::Comma) => otherwise_marked(field, ["comma", "point"], '.'),
            _ => format!("{found} is not a number"),
        }
    }

    /// Whether a field is no number here, but one as other files have them.
    pub(super) fn is_foreign(self, field: &[u8]) -> bool {
        self.number(field).is_none() && otherwise(field).is_some()
    }
}

/// How a field that is no number here is one elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Otherwise {
    Thousands,
    Comma,
    Point,
}

fn otherwise(field: &[u8]) -> Option<Otherwise> {
    let text = std::str::from_utf8(field).ok()?;
    let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
    let is_number =
        |text: &str| text.starts_with(|c: char| c.is_ascii_digit()) && text.parse::<f64>().is_ok();
    let exchanged =
        |mark: char| digits.matches(mark).count() == 1 && is_number(&digits.replacen(mark, ".", 1));
    if !digits.contains('.') && exchanged(',') {
        return Some(Otherwise::Comma);
    }
    if !digits.contains(',') && exchanged('.') {
        return Some(Otherwise::Point);
    }
    let marks = [',', '.', ' ', '\'', '\u{2019}', '\u{a0}', '\u{202f}', '_'];
    marks.into_iter().any(|mark| is_grouped(digits, mark)).then_some(Otherwise::Thousands)
}

/// Why a number with another mark than the file's is none, and what may be done.
fn otherwise_marked(field: &[u8], [here, other]: [&str; 2], mark: char) -> String {
    let digits = String::from_utf8_lossy(field);
    let thousands = if is_grouped(digits.trim_start_matches(['-', '+']), mark) {
        format!("; if {other}s part thousands, write numbers without them")
    } else {
        String::new()
    };
    format!(
        "{} is no number with a decimal {here}, as this file has them; if its decimal mark is a {other}, say --decimal \
         {other}{thousands}",
        shown(field)
    )
}

/// Whether the whole part of a number is groups of three digits with this mark between them.
fn is_grouped(number: &str, mark: char) -> bool {
    let begins_fraction = |c: char| matches!(c, '.' | ',') && c != mark;
    let mut groups = number.split(begins_fraction).next().unwrap_or_default().split(mark);
    let is_group = |group: &str| group.bytes().all(|b| b.is_ascii_digit());
    let begins = groups.next().is_some_and(|first| (1..=3).contains(&first.len()) && is_group(first));
    let mut others = groups.peekable();
    begins && others.peek().is_some() && others.all(|group| group.len() == 3 && is_group(group))
}

fn is_absent(field: &[u8]) -> bool {
    field.is_empty() || ABSENT.iter().any(|absent| field.eq_ignore_ascii_case(absent.as_bytes()))
}

/// `1.#QNAN` and its like.
fn not_finite(field: &[u8]) -> Option<f64> {
    parse_f64(field).filter(|number| !number.is_finite())
}

/// A number whose exponent is `D`, as Fortran writes doubles.
fn fortran(field: &[u8]) -> Option<f64> {
    let at = field.iter().position(|b| matches!(b, b'd' | b'D'))?;
    let mut copy = field.to_vec();
    copy[at] = b'e';
    parse_f64(&copy)
}

fn split_blanks(line: &[u8], fields: &mut Vec<Range<usize>>) {
    let mut at = 0;
    while let Some(from) = line[at..].iter().position(|b| !is_space(*b)).map(|i| at + i) {
        if begins_comment(&line[from..]) || fields.len() > MAX_COLUMNS {
            return;
        }
        at = line[from..].iter().position(|b| is_space(*b)).map_or(line.len(), |i| from + i);
        fields.push(from..at);
    }
}

fn split_quoted_blanks(line: &[u8], fields: &mut Vec<Range<usize>>) -> Result<(), String> {
    let mut at = 0;
    while let Some(from) = line[at..].iter().position(|b| !is_space(*b)).map(|i| at + i) {
        if begins_comment(&line[from..]) || fields.len() > MAX_COLUMNS {
            return Ok(());
        }
        if line[from] == b'"' {
            let to = closing(line, from)?;
            fields.push(from + 1..to);
            at = to + 1;
        } else {
            at = line[from..].iter().position(|b| is_space(*b)).map_or(line.len(), |i| from + i);
            fields.push(from..at);
        }
    }
    Ok(())
}

fn split_at(line: &[u8], separator: u8, fields: &mut Vec<Range<usize>>) {
    let line = &line[..comment(line, 0, line.len()).unwrap_or(line.len())];
    let mut from = 0;
    while fields.len() <= MAX_COLUMNS {
        let to = line[from..].iter().position(|b| *b == separator).map_or(line.len(), |i| from + i);
        fields.push(trimmed(line, from..to));
        if to == line.len() {
            return;
        }
        from = to + 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: Dialect = Dialect { separator: Separator::Space, decimal: Decimal::Point, quoted: false };

    fn fields(separator: Separator, quoted: bool, line: &str) -> Result<Vec<&str>, String> {
        let mut places = Vec::new();
        Dialect { separator, quoted, ..PLAIN }.split(line.as_bytes(), &mut places)?;
        Ok(places.into_iter().map(|place| &line[place]).collect())
    }

    #[test]
    fn lines_are_cut_at_their_separator_alone() {
        for quoted in [false, true] {
            let split = |separator, line| fields(separator, quoted, line);
            assert_eq!(split(Separator::Space, " 1 2\t3\r"), Ok(vec!["1", "2", "3"]));
            assert_eq!(split(Separator::Space, "1, 2;3"), Ok(vec!["1,", "2;3"]));
            assert_eq!(split(Separator::Comma, " 1, 2 ,3;4\r"), Ok(vec!["1", "2", "3;4"]));
            assert_eq!(split(Separator::Comma, ",1,,"), Ok(vec!["", "1", "", ""]));
            assert_eq!(split(Separator::Tab, "\t1 000\t \t2\r"), Ok(vec!["", "1 000", "", "2"]));
            assert_eq!(split(Separator::Bar, "1|2|3"), Ok(vec!["1", "2", "3"]));
            assert_eq!(split(Separator::Space, "1 2 # 3"), Ok(vec!["1", "2"]));
            assert_eq!(split(Separator::Space, "1 2#3 //4"), Ok(vec!["1", "2#3"]));
            assert_eq!(split(Separator::Comma, "1,2 // 3,4"), Ok(vec!["1", "2"]));
            assert_eq!(split(Separator::Comma, "1,#2,3/4"), Ok(vec!["1", "#2", "3/4"]));
            assert_eq!(split(Separator::Space, "1.#INF 2"), Ok(vec!["1.#INF", "2"]));
        }
        let wide = "1,".repeat(MAX_COLUMNS + 1);
        assert!(fields(Separator::Comma, false, &wide).is_err());
    }

    #[test]
    fn quotes_hold_a_field_together() {
        let split = |separator, line| fields(separator, true, line);
        assert_eq!(
            split(Separator::Comma, r#""1.5", "2","a, b","x""#.trim_end_matches('"')),
            Err("quotes are opened and not closed in this line".into())
        );
        assert_eq!(
            split(Separator::Comma, r#""1.5", "2","a, b","",3"#),
            Ok(vec!["1.5", "2", "a, b", "", "3"])
        );
        assert_eq!(split(Separator::Comma, r#""say ""h""",2 # "c"#), Ok(vec![r#"say ""h"""#, "2"]));
        assert_eq!(split(Separator::Comma, "\"1\" ,2,\"# 3\" # 4"), Ok(vec!["1", "2", "# 3"]));
        assert_eq!(split(Separator::Space, r#""1.5" "2 3" 4"#), Ok(vec!["1.5", "2 3", "4"]));
        assert_eq!(split(Separator::Comma, r#""1"2,3"#), Err("`2` follows a closing quote".into()));
    }

    #[test]
    fn numbers_are_exact_in_both_dialects() {
        let comma = Dialect { separator: Separator::Semicolon, decimal: Decimal::Comma, ..PLAIN };
        let in_blanks = Dialect { separator: Separator::Space, ..comma };
        for (text, number) in [
            ("3,128", 3.128),
            ("-0,1e-3", -0.1e-3),
            (",5", 0.5),
            ("5,", 5.0),
            ("7", 7.0),
            ("1e5", 1e5),
            ("-inf", f64::NEG_INFINITY),
        ] {
            assert_eq!(comma.number(text.as_bytes()), Some(number), "{text}");
        }
        let long = format!("0,{}1", "0".repeat(100));
        assert_eq!(comma.number(long.as_bytes()), Some(1e-101));
        for dialect in [PLAIN, comma] {
            for absent in ["", "NA", "n/a", "NULL", "nan", "-nan(ind)", "1.#QNAN"] {
                assert!(dialect.number(absent.as_bytes()).expect(absent).is_nan(), "{absent}");
            }
        }
        assert_eq!(PLAIN.number(b"1.5D+02"), Some(150.0));
        assert_eq!((in_blanks.number(b",5"), in_blanks.number(b"5,")), (None, None));
        for text in ["1,2,3", "1.234,5", "1.5", "1.5e3", "x", "-", "d", "1d"] {
            assert_eq!(comma.number(text.as_bytes()), None, "{text}");
        }
    }

    #[test]
    fn numbers_of_other_files_are_told_from_words() {
        let comma = Dialect { decimal: Decimal::Comma, ..PLAIN };
        for (dialect, field, part) in [
            (PLAIN, "3,5", "--decimal comma"),
            (PLAIN, "1,234", "--decimal comma"),
            (comma, "-3.5", "--decimal point"),
            (PLAIN, "1,234.5", "thousands"),
            (PLAIN, "1,234,567", "thousands"),
            (comma, "1.234,5", "thousands"),
            (PLAIN, "1 234.5", "thousands"),
            (PLAIN, "-1'234'567", "thousands"),
            (PLAIN, "1\u{202f}234", "thousands"),
        ] {
            assert!(dialect.is_foreign(field.as_bytes()), "{field}");
            let why = dialect.no_number(field.as_bytes());
            assert!(why.contains(part), "{why}");
        }
        for word in ["wall", "2020-01-02", "12:30:05", "1,2,3", "3,a", "1,23,456", "v1.2.3", "", "a 234"] {
            assert!(!PLAIN.is_foreign(word.as_bytes()), "{word}");
            assert!(PLAIN.no_number(word.as_bytes()).ends_with("is not a number"), "{word}");
        }
    }
}
