//! Numbers that may be a thousand times what they seem: `1.000` beside `999`.

use super::super::reading::DECIMAL;
use super::super::text::shown;
use super::Decimal;

/// What the fields of a file tell of its mark: whether it begins fractions, or could part thousands just as well.
///
/// `2.5`, `0.125` and `1234.5` have no thousands, and then no other number of the file has. Nor do numbers of a column that
/// has `1500` in it. Where all are like `1.000`, three decimals are the rule; but who writes these writes `999.000`, too.
#[derive(Debug)]
pub(super) struct Thousands {
    mark: u8,
    is_fraction: bool,
    columns: Vec<Column>,
}

/// What is in a column: the first field of each form, and its line.
#[derive(Debug, Default)]
struct Column {
    /// Up to three digits: `999`.
    short: Option<(u64, String)>,
    /// As of thousands: `1.000`.
    grouped: Option<(u64, String)>,
    /// Whether there is a longer one without a mark: `1500`.
    is_long: bool,
}

/// A column that can be read in two ways.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Doubt<'a> {
    pub(super) column: usize,
    /// The first number that may be of thousands, and its line.
    pub(super) grouped: &'a (u64, String),
    /// The first one without a mark, if there is any, and its line.
    pub(super) short: Option<&'a (u64, String)>,
}

impl Column {
    /// Whether it has such a field, as nearly every one is that is looked at.
    fn knows(&self, field: &[u8], mark: u8) -> bool {
        if is_grouped(field, mark) {
            return self.grouped.is_some();
        }
        let has_such = if field.len() > 3 { self.is_long } else { self.short.is_some() };
        has_such && field.iter().all(|b| *b != mark)
    }
}

impl Thousands {
    /// Of a table of `width` columns. `is_told` is whether a person says what the mark is.
    pub(super) fn new(decimal: Decimal, is_told: bool, width: usize) -> Self {
        let mark = match decimal {
            Decimal::Point => b'.',
            Decimal::Comma => b',',
        };
        let columns = std::iter::repeat_with(Column::default).take(width).collect();
        Self { mark, is_fraction: is_told, columns }
    }

    /// Whether no further field changes anything.
    pub(super) fn is_settled(&self) -> bool {
        self.is_fraction
    }

    /// Takes note of a number.
    pub(super) fn see(&mut self, column: usize, line: u64, field: &[u8]) {
        if self.columns[column].knows(field, self.mark) {
            return;
        }
        let of = |column: &mut Option<(u64, String)>| {
            column.get_or_insert_with(|| (line, String::from_utf8_lossy(field).into_owned()));
        };
        let column = &mut self.columns[column];
        match Form::of(field, self.mark) {
            Form::Short => of(&mut column.short),
            Form::Grouped => of(&mut column.grouped),
            Form::Long => column.is_long = true,
            Form::Fraction => self.is_fraction = true,
            Form::Other => return,
        }
        self.is_fraction = self.is_fraction || column.is_long && column.grouped.is_some();
    }

    /// A column is words, and its numbers tell nothing.
    pub(super) fn forget(&mut self, column: usize) {
        self.columns[column] = Column::default();
    }

    /// The first column of numbers that may be of thousands: one that mixes them with others before one that does not.
    pub(super) fn doubt(&self) -> Option<Doubt<'_>> {
        let doubts = || {
            self.columns.iter().enumerate().filter_map(|(column, Column { short, grouped, .. })| {
                Some(Doubt { column, grouped: grouped.as_ref()?, short: short.as_ref() })
            })
        };
        let mixed = doubts().find(|doubt| doubt.short.is_some());
        mixed.or_else(|| doubts().next()).filter(|_| !self.is_fraction)
    }
}

impl Doubt<'_> {
    /// Why numbers of this column are not read, where others of it tell against them.
    pub(super) fn refused(&self, column: &str, decimal: Decimal) -> Option<String> {
        let (other, short) = self.short?;
        Some(format!(
            "{column}: {} beside {} in line {other}: does its {decimal} begin a fraction or part thousands? Nothing in the file \
             tells. If a fraction, say {DECIMAL} {decimal}; separators of thousands are not read",
            shown(self.grouped.1.as_bytes()),
            shown(short.as_bytes()),
        ))
    }

    /// What is told where nothing but that points have three decimals tells: of commas alone, since points part thousands
    /// in few files.
    pub(super) fn noted(&self, column: &str, decimal: Decimal) -> Option<String> {
        let (line, field) = self.grouped;
        (decimal == Decimal::Comma).then(|| {
            format!(
                "{} (line {line}, {column}) is read as {}, since commas seem to be decimal marks here; to say so: {DECIMAL} \
                 comma",
                shown(field.as_bytes()),
                field.replace(',', "."),
            )
        })
    }
}

/// How a number is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Short,
    Long,
    Grouped,
    Fraction,
    /// None of these, or no number.
    Other,
}

impl Form {
    fn of(field: &[u8], mark: u8) -> Self {
        let number = unsigned(field);
        let Some(at) = number.iter().position(|b| *b == mark) else {
            return match number.len() {
                _ if !are_digits(number) => Self::Other,
                0 => Self::Other,
                1..=3 => Self::Short,
                _ => Self::Long,
            };
        };
        let (whole, fraction) = (&number[..at], &number[at + 1..]);
        let is_exponent = |b: &u8| matches!(b, b'e' | b'E' | b'd' | b'D' | b'+' | b'-');
        if !are_digits(whole) || !fraction.iter().all(|b| b.is_ascii_digit() || is_exponent(b)) {
            Self::Other
        } else if is_grouped(field, mark) {
            Self::Grouped
        } else {
            Self::Fraction
        }
    }
}

/// Whether a number is a thousand or more, with a mark before its last three digits.
fn is_grouped(field: &[u8], mark: u8) -> bool {
    match unsigned(field) {
        [b'1'..=b'9', whole @ .., found, a, b, c] => {
            *found == mark && whole.len() < 3 && are_digits(whole) && are_digits(&[*a, *b, *c])
        }
        _ => false,
    }
}

fn unsigned(field: &[u8]) -> &[u8] {
    match field {
        [b'-' | b'+', digits @ ..] => digits,
        _ => field,
    }
}

fn are_digits(digits: &[u8]) -> bool {
    digits.iter().all(u8::is_ascii_digit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_of_numbers() {
        for (field, form) in [
            ("999", Form::Short),
            ("-7", Form::Short),
            ("0", Form::Short),
            ("1500", Form::Long),
            ("1.000", Form::Grouped),
            ("-999.125", Form::Grouped),
            ("+12.345", Form::Grouped),
            ("0.125", Form::Fraction),
            ("1234.567", Form::Fraction),
            ("1.5", Form::Fraction),
            ("1.0000", Form::Fraction),
            ("1.", Form::Fraction),
            (".5", Form::Fraction),
            ("1.5e3", Form::Fraction),
            ("1.e3", Form::Fraction),
            ("1e3", Form::Other),
            ("", Form::Other),
            ("-", Form::Other),
            ("nan", Form::Other),
            ("1.#QNAN", Form::Other),
            ("1,000", Form::Other),
        ] {
            assert_eq!(Form::of(field.as_bytes(), b'.'), form, "{field}");
            let exchanged = field.replace(',', ";").replace('.', ",");
            assert_eq!(Form::of(exchanged.as_bytes(), b','), form, "{exchanged}");
        }
    }
}
