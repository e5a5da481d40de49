//! The numbers of an array, by the names of their types.

use half::f16;

use super::literal::quoted;
use densecloud_cloud::{Kind, Values};

/// How a number is stored.
#[derive(Debug, Clone, Copy)]
pub(super) struct Number {
    /// In memory, and in the file but for `half`.
    pub(super) kind: Kind,
    big: bool,
    /// 16-bit floats, which are made 32-bit ones.
    half: bool,
}

impl Number {
    /// The number of a type such as `<f8`; none for text, times, complex numbers and so on.
    pub(super) fn of(code: &str) -> Result<Option<Self>, String> {
        let kind = match code.get(1..) {
            Some("i1") => Kind::I8,
            Some("u1" | "b1") => Kind::U8,
            Some("i2") => Kind::I16,
            Some("u2") => Kind::U16,
            Some("i4") => Kind::I32,
            Some("u4") => Kind::U32,
            Some("i8") => Kind::I64,
            Some("u8") => Kind::U64,
            Some("f2" | "f4") => Kind::F32,
            Some("f8") => Kind::F64,
            Some("O") => return Err("the array holds Python objects, not numbers".into()),
            _ => return Ok(None),
        };
        Ok(Some(Self { kind, big: code.starts_with('>'), half: code.ends_with("f2") }))
    }

    /// Bytes in the file.
    pub(super) fn size(self) -> usize {
        if self.half { 2 } else { self.kind.size() }
    }

    /// Appends the number at the beginning of each of `rows`.
    pub(super) fn extend<'a>(self, column: &mut Values, rows: impl Iterator<Item = &'a [u8]>) {
        match column {
            Values::F32(floats) if self.half => {
                let word = |row: &[u8]| if self.big { [row[1], row[0]] } else { [row[0], row[1]] };
                floats.extend(rows.map(|row| f16::from_le_bytes(word(row)).to_f32()));
            }
            column => column.extend_from_bytes(rows, self.big),
        }
    }
}

/// Of what an array is that holds no numbers of ours.
pub(super) fn no_number(code: &str) -> String {
    let what = match code.chars().nth(1) {
        Some('U' | 'S' | 'a') => "text",
        Some('M' | 'm') => "times",
        Some('c') => "complex numbers",
        _ => "what is no number",
    };
    format!("the array holds {what} ({}); points are integers or floats", quoted(code))
}

/// Bytes of a type.
pub(super) fn code_size(code: &str) -> Result<usize, String> {
    let digits: String = code.chars().skip(2).take_while(char::is_ascii_digit).collect();
    let size = digits.parse::<usize>().ok();
    // Text is counted in characters of four bytes.
    let unit = if code.chars().nth(1) == Some('U') { 4 } else { 1 };
    size.and_then(|size| size.checked_mul(unit))
        .ok_or_else(|| format!("the type {} is not known", quoted(code)))
}
