//! Columns whose type and meaning only their numbers tell.

use std::str::FromStr;

use super::text::parse_f64;
use densecloud_cloud::{Kind, Values};

/// More columns than any real table of points has; bounds what a hostile line costs.
pub(super) const MAX_COLUMNS: usize = 1000;

/// What a column of text holds, as far as it is read: whole numbers for as long as there is nothing else.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum TextColumn {
    Whole {
        lowest: i64,
        highest: i64,
    },
    /// Whole numbers, none of them negative and one at least from 2^63 on.
    Large,
    Real {
        /// Whether whole numbers among them may have lost digits.
        rounded: bool,
    },
    /// Something in it is no number.
    Text,
}

/// Floats hold all whole numbers up to this one.
pub(super) const EXACT: u64 = 1 << 53;

/// What is told of a column of floats that had whole numbers beyond [`EXACT`].
pub(super) fn rounded(name: &str) -> String {
    format!(
        "`{name}` has whole numbers beyond 2^53, and not all of it are 64-bit integers: it is read as floats, and the last \
         digits of these are rounded"
    )
}

impl TextColumn {
    pub(super) fn new() -> Self {
        Self::Whole { lowest: i64::MAX, highest: i64::MIN }
    }

    /// An empty column for the next numbers.
    pub(super) fn empty(&self) -> Values {
        Values::new(match self {
            Self::Whole { .. } => Kind::I64,
            Self::Large => Kind::U64,
            Self::Real { .. } | Self::Text => Kind::F64,
        })
    }

    /// Appends a field to the numbers so far; an empty one is a NaN.
    pub(super) fn push(&mut self, numbers: &mut Values, field: &[u8]) {
        self.push_by(
            numbers,
            field,
            |field| if field.is_empty() { Some(f64::NAN) } else { parse_f64(field) },
        );
    }

    /// As [`push`](Self::push); `real` reads what is no whole number.
    pub(super) fn push_by(
        &mut self,
        numbers: &mut Values,
        field: &[u8],
        real: impl FnOnce(&[u8]) -> Option<f64>,
    ) {
        if self.push_whole(numbers, field) || self.widen(numbers, field) {
            return;
        }
        if let (Self::Real { rounded }, Values::F64(reals)) = (&mut *self, &mut *numbers) {
            match real(field) {
                Some(number) => {
                    *rounded = *rounded || number.abs() >= EXACT as f64 && is_whole(field);
                    reals.push(number);
                }
                None => {
                    *numbers = Values::new(Kind::F64);
                    *self = Self::Text;
                }
            }
        }
    }

    /// Appends a whole number to such, if the field is one that they hold.
    fn push_whole(&mut self, numbers: &mut Values, field: &[u8]) -> bool {
        match (self, numbers) {
            (Self::Whole { lowest, highest }, Values::I64(whole)) => {
                let Some(number) = parsed::<i64>(field) else { return false };
                (*lowest, *highest) = (number.min(*lowest), number.max(*highest));
                whole.push(number);
            }
            (Self::Large, Values::U64(large)) => {
                let Some(number) = parsed(field) else { return false };
                large.push(number);
            }
            _ => return false,
        }
        true
    }

    /// Makes another column of whole numbers where this field is none that they hold; true where it holds it then.
    fn widen(&mut self, numbers: &mut Values, field: &[u8]) -> bool {
        let (is_large, rounded) = match *self {
            Self::Whole { lowest, highest } => {
                let most = lowest.unsigned_abs().max(highest.unsigned_abs());
                (lowest >= 0 && parsed::<u64>(field).is_some(), lowest <= highest && most > EXACT)
            }
            Self::Large => (false, true),
            Self::Real { .. } | Self::Text => return false,
        };
        match numbers {
            Values::I64(whole) if is_large => {
                *numbers = Values::U64(whole.iter().map(|&n| n as u64).collect());
                *self = Self::Large;
            }
            _ => {
                *numbers = Values::F64((0..numbers.len()).map(|i| numbers.get(i)).collect());
                *self = Self::Real { rounded };
            }
        }
        self.push_whole(numbers, field)
    }

    /// The smallest usual type that holds the numbers: bytes, 32-bit and 64-bit integers, doubles; none for text.
    pub(super) fn kind(&self) -> Option<Kind> {
        match *self {
            Self::Whole { lowest, highest } if lowest >= 0 && highest <= 255 => Some(Kind::U8),
            Self::Whole { lowest, highest } if lowest >= i32::MIN.into() && highest <= i32::MAX.into() => {
                Some(Kind::I32)
            }
            Self::Whole { .. } => Some(Kind::I64),
            Self::Large => Some(Kind::U64),
            Self::Real { .. } => Some(Kind::F64),
            Self::Text => None,
        }
    }
}

fn parsed<T: FromStr>(field: &[u8]) -> Option<T> {
    std::str::from_utf8(field).ok()?.parse().ok()
}

/// Whether a field is digits, with a sign or without.
fn is_whole(field: &[u8]) -> bool {
    let digits = field.strip_prefix(b"-").or(field.strip_prefix(b"+")).unwrap_or(field);
    !digits.is_empty() && digits.iter().all(u8::is_ascii_digit)
}

/// Gathers what the numbers of columns without names tell of their meaning.
#[derive(Debug, Default)]
pub(super) struct Guess {
    rows: u64,
    /// Of each three neighbouring columns, how many rows are vectors of length 1, to the digits that text usually has.
    unit: Vec<u64>,
    /// Of each column, whether all numbers are whole ones from 0 to 255.
    bytes: Vec<bool>,
}

impl Guess {
    /// Takes note of all columns from row `from` on.
    pub(super) fn see(&mut self, columns: &[Values], from: usize) {
        self.bytes.resize(columns.len(), true);
        self.unit.resize(columns.len().saturating_sub(2), 0);
        self.rows += columns.first().map_or(0, |column| column.len().saturating_sub(from)) as u64;
        let mut squares: Vec<Vec<f64>> = Vec::with_capacity(columns.len());
        for (column, bytes) in columns.iter().zip(&mut self.bytes) {
            let mut numbers: Vec<f64> = (from..column.len()).map(|i| column.get(i)).collect();
            *bytes = *bytes && numbers.iter().all(|v| (0.0..=255.0).contains(v) && v.fract() == 0.0);
            numbers.iter_mut().for_each(|v| *v = v.powi(2));
            squares.push(numbers);
        }
        for (three, unit) in squares.windows(3).zip(&mut self.unit) {
            let [x, y, z] = three else { continue };
            let lengths = x.iter().zip(y).zip(z).map(|((x, y), z)| (x + y + z).sqrt());
            *unit += lengths.filter(|length| (length - 1.0).abs() < 0.01).count() as u64;
        }
    }

    /// Whether all numbers of a column are whole ones from 0 to 255.
    pub(super) fn is_bytes(&self, column: usize) -> bool {
        self.bytes.get(column).is_some_and(|bytes| *bytes)
    }

    /// Whether nearly all rows of three columns from this one on are vectors of length 1.
    fn is_unit(&self, first: usize) -> bool {
        self.unit.get(first).is_some_and(|unit| unit * 20 >= self.rows * 19)
    }

    /// Names columns that have no names of their own: three that `is_bytes` are a colour, one more before them its
    /// intensity, and three that make unit vectors are a normal.
    pub(super) fn name(&self, names: &mut [String], is_bytes: impl Fn(usize) -> bool) {
        let count = names.len();
        let are_bytes = |from: usize| from + 3 <= count && (from..from + 3).all(&is_bytes);
        let mut i = 0;
        while i < count {
            let guessed: &[&str] = if are_bytes(i) {
                &["red", "green", "blue"]
            } else if self.is_unit(i) {
                &["nx", "ny", "nz"]
            } else if i == 0 && are_bytes(1) {
                &["intensity", "red", "green", "blue"]
            } else {
                i += 1;
                continue;
            };
            if !guessed.iter().any(|guess| names.iter().any(|name| name == guess)) {
                for (name, guess) in names[i..].iter_mut().zip(guessed) {
                    *name = (*guess).to_owned();
                }
            }
            i += guessed.len();
        }
    }
}
