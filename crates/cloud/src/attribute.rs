//! What a file tells of a point beside its position: one column of numbers a property.

/// A property of every point: `red`, `intensity`, `nx`.
#[derive(Debug, Clone, PartialEq)]
pub struct Attribute {
    /// The name in the file.
    pub name: String,
    /// One number a point, in the order of the positions.
    pub values: Values,
}

impl Attribute {
    /// Its name and type.
    #[must_use]
    pub fn without_values(&self) -> Self {
        Self { name: self.name.clone(), values: Values::new(self.values.kind()) }
    }
}

/// A type of number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// 8-bit, signed.
    I8,
    /// 8-bit, unsigned.
    U8,
    /// 16-bit, signed.
    I16,
    /// 16-bit, unsigned.
    U16,
    /// 32-bit, signed.
    I32,
    /// 32-bit, unsigned.
    U32,
    /// 64-bit, signed.
    I64,
    /// 64-bit, unsigned.
    U64,
    /// 32-bit float.
    F32,
    /// 64-bit float.
    F64,
}

/// A column of numbers in the type that the file has them in.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the same names as in `Kind`")]
pub enum Values {
    I8(Vec<i8>),
    U8(Vec<u8>),
    I16(Vec<i16>),
    U16(Vec<u16>),
    I32(Vec<i32>),
    U32(Vec<u32>),
    I64(Vec<i64>),
    U64(Vec<u64>),
    F32(Vec<f32>),
    F64(Vec<f64>),
}

/// Runs `$body` with `$column` bound to the vector inside, whatever its type.
#[macro_export]
macro_rules! each_kind {
    ($values:expr, $column:ident => $body:expr) => {
        match $values {
            $crate::Values::I8($column) => $body,
            $crate::Values::U8($column) => $body,
            $crate::Values::I16($column) => $body,
            $crate::Values::U16($column) => $body,
            $crate::Values::I32($column) => $body,
            $crate::Values::U32($column) => $body,
            $crate::Values::I64($column) => $body,
            $crate::Values::U64($column) => $body,
            $crate::Values::F32($column) => $body,
            $crate::Values::F64($column) => $body,
        }
    };
}
impl Kind {
    /// Bytes a number.
    #[must_use]
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Whether 32-bit floats hold every value of this type.
    #[must_use]
    pub fn fits_f32(self) -> bool {
        matches!(self, Self::I8 | Self::U8 | Self::I16 | Self::U16 | Self::F32)
    }

    /// Whether it is a float.
    #[must_use]
    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }
}

impl Values {
    /// An empty column.
    #[must_use]
    pub fn new(kind: Kind) -> Self {
        match kind {
            Kind::I8 => Self::I8(Vec::new()),
            Kind::U8 => Self::U8(Vec::new()),
            Kind::I16 => Self::I16(Vec::new()),
            Kind::U16 => Self::U16(Vec::new()),
            Kind::I32 => Self::I32(Vec::new()),
            Kind::U32 => Self::U32(Vec::new()),
            Kind::I64 => Self::I64(Vec::new()),
            Kind::U64 => Self::U64(Vec::new()),
            Kind::F32 => Self::F32(Vec::new()),
            Kind::F64 => Self::F64(Vec::new()),
        }
    }

    /// The type of the numbers.
    #[must_use]
    pub fn kind(&self) -> Kind {
        match self {
            Self::I8(_) => Kind::I8,
            Self::U8(_) => Kind::U8,
            Self::I16(_) => Kind::I16,
            Self::U16(_) => Kind::U16,
            Self::I32(_) => Kind::I32,
            Self::U32(_) => Kind::U32,
            Self::I64(_) => Kind::I64,
            Self::U64(_) => Kind::U64,
            Self::F32(_) => Kind::F32,
            Self::F64(_) => Kind::F64,
        }
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        each_kind!(self, column => column.len())
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The number at `index` as a double (64-bit integers beyond 2^53 are rounded).
    ///
    /// # Panics
    /// When `index` is not less than [`len`](Self::len).
    #[must_use]
    #[allow(clippy::unnecessary_cast, clippy::cast_lossless, reason = "one expression for every type")]
    pub fn get(&self, index: usize) -> f64 {
        each_kind!(self, column => column[index] as f64)
    }

    /// The numbers at `indices`, in their order and type, exactly.
    ///
    /// # Panics
    /// When an index is beyond the end.
    #[must_use]
    pub fn gather(&self, indices: &[u32]) -> Self {
        macro_rules! gathered {
            ($($kind:ident),*) => {
                match self {
                    $(Self::$kind(column) => Self::$kind(indices.iter().map(|&i| column[i as usize]).collect()),)*
                }
            };
        }
        gathered!(I8, U8, I16, U16, I32, U32, I64, U64, F32, F64)
    }

    /// The numbers in another type, as `as` has them: exactly, where that type holds them.
    #[must_use]
    #[allow(clippy::unnecessary_cast, clippy::cast_lossless, reason = "one expression for every type")]
    pub fn cast(self, kind: Kind) -> Self {
        if self.kind() == kind {
            return self;
        }
        macro_rules! cast {
            ($($kind:ident $number:ty),*) => {
                match kind {
                    $(Kind::$kind => {
                        Self::$kind(each_kind!(self, column => column.iter().map(|n| *n as $number).collect()))
                    })*
                }
            };
        }
        cast!(I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64, F32 f32, F64 f64)
    }

    /// Moves all numbers of `other` to the end of this column.
    ///
    /// # Panics
    /// When they are of another type.
    pub fn append(&mut self, other: &mut Self) {
        macro_rules! appended {
            ($($kind:ident),*) => {
                match (self, other) {
                    $((Self::$kind(column), Self::$kind(more)) => column.append(more),)*
                    (column, more) => panic!("{:?} after {:?}", more.kind(), column.kind()),
                }
            };
        }
        appended!(I8, U8, I16, U16, I32, U32, I64, U64, F32, F64);
    }

    /// Appends the number at the beginning of each of `rows`, in the byte order that `big` says.
    ///
    /// # Panics
    /// When a row is shorter than a number.
    pub fn extend_from_bytes<'a>(&mut self, rows: impl Iterator<Item = &'a [u8]>, big: bool) {
        macro_rules! extend {
            ($($kind:ident $number:ty),*) => {
                match self {
                    $(Self::$kind(column) => column.extend(rows.map(|row| {
                        let mut word = [0; size_of::<$number>()];
                        word.copy_from_slice(&row[..size_of::<$number>()]);
                        if big { <$number>::from_be_bytes(word) } else { <$number>::from_le_bytes(word) }
                    })),)*
                }
            };
        }
        extend!(I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64, F32 f32, F64 f64);
    }

    /// Appends the numbers of another column of the same type; of another type, nothing.
    pub fn extend_from(&mut self, other: &Self) {
        macro_rules! extend {
            ($($kind:ident),*) => {
                match (self, other) {
                    $((Self::$kind(column), Self::$kind(more)) => column.extend_from_slice(more),)*
                    _ => {}
                }
            };
        }
        extend!(I8, U8, I16, U16, I32, U32, I64, U64, F32, F64);
    }

    /// Doubles as numbers of `kind`: integers are rounded to the nearest and kept within their range;
    /// a NaN becomes 0 there.
    #[must_use]
    pub fn from_f64(kind: Kind, numbers: impl Iterator<Item = f64>) -> Self {
        // `as` saturates, and turns NaN into 0.
        match kind {
            Kind::I8 => Self::I8(numbers.map(|v| v.round() as i8).collect()),
            Kind::U8 => Self::U8(numbers.map(|v| v.round() as u8).collect()),
            Kind::I16 => Self::I16(numbers.map(|v| v.round() as i16).collect()),
            Kind::U16 => Self::U16(numbers.map(|v| v.round() as u16).collect()),
            Kind::I32 => Self::I32(numbers.map(|v| v.round() as i32).collect()),
            Kind::U32 => Self::U32(numbers.map(|v| v.round() as u32).collect()),
            Kind::I64 => Self::I64(numbers.map(|v| v.round() as i64).collect()),
            Kind::U64 => Self::U64(numbers.map(|v| v.round() as u64).collect()),
            Kind::F32 => Self::F32(numbers.map(|v| v as f32).collect()),
            Kind::F64 => Self::F64(numbers.collect()),
        }
    }
}

/// Bytes that the attributes of one point take.
#[must_use]
pub fn bytes_a_point(attributes: &[Attribute]) -> u64 {
    attributes.iter().map(|a| a.values.kind().size() as u64).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_become_integers_without_wrapping() {
        let numbers = [-1.0, 254.5, 300.0, f64::NAN, 7.49];
        assert_eq!(Values::from_f64(Kind::U8, numbers.into_iter()), Values::U8(vec![0, 255, 255, 0, 7]));
        let column = Values::I64(vec![i64::MAX, 3]);
        assert_eq!(column.gather(&[1, 0, 0]), Values::I64(vec![3, i64::MAX, i64::MAX]));
        assert_eq!((column.len(), column.kind(), column.get(1)), (2, Kind::I64, 3.0));
        assert_eq!(column.clone().cast(Kind::I64), column);
        assert_eq!(column.cast(Kind::U64), Values::U64(vec![(1 << 63) - 1, 3]), "exactly");
    }
}
