//! Columns whose type and meaning only their numbers tell.

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
    Real,
    /// Something in it is no number.
    Text,
}

impl TextColumn {
    pub(super) fn new() -> Self {
        Self::Whole { lowest: i64::MAX, highest: i64::MIN }
    }

    /// An empty column for the next numbers.
    pub(super) fn empty(&self) -> Values {
        Values::new(if let Self::Whole { .. } = self { Kind::I64 } else { Kind::F64 })
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
        if let (Self::Whole { lowest, highest }, Values::I64(whole)) = (&mut *self, &mut *numbers) {
            if let Some(number) = std::str::from_utf8(field).ok().and_then(|f| f.parse::<i64>().ok()) {
                (*lowest, *highest) = (number.min(*lowest), number.max(*highest));
                whole.push(number);
                return;
            }
            *numbers = Values::F64(whole.iter().map(|&n| n as f64).collect());
            *self = Self::Real;
        }
        if let (Self::Real, Values::F64(reals)) = (&mut *self, &mut *numbers) {
            match real(field) {
                Some(number) => reals.push(number),
                None => {
                    *numbers = Values::new(Kind::F64);
                    *self = Self::Text;
                }
            }
        }
    }

    /// The smallest usual type that holds the numbers: bytes, 32-bit and 64-bit integers, doubles; none for text.
    pub(super) fn kind(&self) -> Option<Kind> {
        match *self {
            Self::Whole { lowest, highest } if lowest >= 0 && highest <= 255 => Some(Kind::U8),
            Self::Whole { lowest, highest } if lowest >= i32::MIN.into() && highest <= i32::MAX.into() => {
                Some(Kind::I32)
            }
            Self::Whole { .. } => Some(Kind::I64),
            Self::Real => Some(Kind::F64),
            Self::Text => None,
        }
    }
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
