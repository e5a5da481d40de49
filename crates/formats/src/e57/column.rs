//! An attribute as scan after scan tells it.

use std::ops::Range;

use ::e57::{RecordDataType, RecordValue};

use super::super::columns::EXACT;
use super::STANDARD;
use densecloud_cloud::{Attribute, Kind, Values};

/// What ends the name of a flag that tells where an attribute is absent.
const INVALID: &str = "_invalid";

/// An attribute as it is read.
pub(super) struct Column {
    pub(super) name: String,
    numbers: Numbers,
    /// The range of the whole numbers, as the file tells it.
    lowest: i64,
    highest: i64,
    /// Whether whole numbers among floats may have lost digits.
    pub(super) rounded: bool,
    /// How many scans have it.
    pub(super) scans: usize,
    /// The points of scans that do not have it.
    absent: Vec<Range<usize>>,
}

/// In the narrowest type that all scans have them in.
enum Numbers {
    Whole(Vec<i64>),
    Single(Vec<f32>),
    Double(Vec<f64>),
}

impl Column {
    /// The column of that name, which a scan has in this type, its numbers `shift` too low, and which may
    /// be new at point `from`.
    pub(super) fn place(
        columns: &mut Vec<Self>,
        name: &str,
        kind: &RecordDataType,
        shift: i64,
        from: usize,
    ) -> usize {
        let place = columns.iter().position(|column| column.name == name);
        let place = place.unwrap_or_else(|| {
            let numbers = match kind {
                RecordDataType::Integer { .. } => Numbers::Whole(Vec::new()),
                RecordDataType::Single { .. } => Numbers::Single(Vec::new()),
                _ => Numbers::Double(Vec::new()),
            };
            columns.push(Self {
                name: name.to_owned(),
                numbers,
                lowest: i64::MAX,
                highest: i64::MIN,
                rounded: false,
                scans: 0,
                absent: Vec::new(),
            });
            columns.len() - 1
        });
        let column = &mut columns[place];
        column.fill(from);
        column.scans += 1;
        // Files that tell no range have the widest; the values tell more.
        if let RecordDataType::Integer { min, max } = kind
            && (*min, *max) != (i64::MIN, i64::MAX)
        {
            column.lowest = column.lowest.min(min.saturating_add(shift));
            column.highest = column.highest.max(max.saturating_add(shift));
        }
        place
    }

    pub(super) fn len(&self) -> usize {
        match &self.numbers {
            Numbers::Whole(numbers) => numbers.len(),
            Numbers::Single(numbers) => numbers.len(),
            Numbers::Double(numbers) => numbers.len(),
        }
    }

    /// Fills up to `to` points what no scan has told.
    pub(super) fn fill(&mut self, to: usize) {
        if self.len() < to {
            self.absent.push(self.len()..to);
        }
        match &mut self.numbers {
            Numbers::Whole(numbers) => numbers.resize(to, 0),
            Numbers::Single(numbers) => numbers.resize(to, f32::NAN),
            Numbers::Double(numbers) => numbers.resize(to, f64::NAN),
        }
    }

    /// Appends a number, which is `wide` as a double, and `shift` too low.
    pub(super) fn push(&mut self, value: &RecordValue, wide: f64, shift: i64) {
        let shifted = wide + shift as f64;
        match (&mut self.numbers, value) {
            (Numbers::Whole(numbers), RecordValue::Integer(value)) => {
                let value = value.saturating_add(shift);
                numbers.push(value);
                self.lowest = self.lowest.min(value);
                self.highest = self.highest.max(value);
            }
            (Numbers::Single(numbers), RecordValue::Single(value)) => numbers.push(*value),
            (Numbers::Double(numbers), RecordValue::Integer(value) | RecordValue::ScaledInteger(value)) => {
                numbers.push(shifted);
                self.rounded |= is_large(value);
            }
            (Numbers::Double(numbers), _) => numbers.push(shifted),
            _ => {
                self.widen();
                self.push(value, wide, shift);
            }
        }
    }

    /// Makes the numbers doubles, NaN where there are none.
    fn widen(&mut self) {
        let mut numbers: Vec<f64> = (0..self.len()).map(|i| self.get(i)).collect();
        for range in &self.absent {
            numbers[range.clone()].fill(f64::NAN);
        }
        self.rounded |= matches!(&self.numbers, Numbers::Whole(whole) if whole.iter().any(is_large));
        self.numbers = Numbers::Double(numbers);
    }

    pub(super) fn get(&self, i: usize) -> f64 {
        match &self.numbers {
            Numbers::Whole(numbers) => numbers[i] as f64,
            Numbers::Single(numbers) => f64::from(numbers[i]),
            Numbers::Double(numbers) => numbers[i],
        }
    }

    pub(super) fn set(&mut self, i: usize, value: f64) {
        match &mut self.numbers {
            Numbers::Whole(numbers) => numbers[i] = value.round() as i64,
            Numbers::Single(numbers) => numbers[i] = value as f32,
            Numbers::Double(numbers) => numbers[i] = value,
        }
    }

    /// Whether it is one of the format's own flags.
    pub(super) fn is_flag(&self) -> bool {
        self.name.ends_with(INVALID) && STANDARD.iter().any(|(.., name)| self.name == *name)
    }

    /// A flag that is never set.
    pub(super) fn is_unused_flag(&self) -> bool {
        self.is_flag() && (0..self.len()).all(|i| self.get(i) == 0.0)
    }

    /// The flag that tells where it is absent. Floats need none, since they are NaN there; but where the format has a flag of
    /// its own, that is set, too.
    pub(super) fn flag(&self) -> Option<String> {
        let flag = match self.name.as_str() {
            "red" | "green" | "blue" => format!("color{INVALID}"),
            name => format!("{name}{INVALID}"),
        };
        let own = STANDARD.iter().any(|(.., name)| flag == *name);
        let needed = own || matches!(self.numbers, Numbers::Whole(_));
        (needed && !self.absent.is_empty() && !self.is_flag()).then_some(flag)
    }

    pub(super) fn into_attribute(self) -> Attribute {
        let values = match self.numbers {
            Numbers::Single(numbers) => Values::F32(numbers),
            Numbers::Double(numbers) => Values::F64(numbers),
            Numbers::Whole(numbers) => whole(numbers, self.lowest.min(0), self.highest),
        };
        Attribute { name: self.name, values }
    }
}

/// Whether a whole number may lose digits as a double.
fn is_large(value: &i64) -> bool {
    value.unsigned_abs() > EXACT
}

/// Sets the flags of what only some scans have at the points of the others, all columns being `points` long.
pub(super) fn flag_absent(columns: &mut Vec<Column>, points: usize) {
    let absent: Vec<(String, Vec<Range<usize>>)> =
        columns.iter().filter_map(|column| Some((column.flag()?, column.absent.clone()))).collect();
    for (flag, ranges) in absent {
        let place = columns.iter().position(|column| column.name == flag).unwrap_or_else(|| {
            columns.push(Column {
                name: flag,
                numbers: Numbers::Whole(vec![0; points]),
                lowest: 0,
                highest: 1,
                rounded: false,
                scans: usize::MAX,
                absent: Vec::new(),
            });
            columns.len() - 1
        });
        let flag = &mut columns[place];
        flag.highest = flag.highest.max(1);
        ranges.into_iter().flatten().for_each(|i| flag.set(i, 1.0));
    }
}

/// Whole numbers in the narrowest type that holds all from `lowest` to `highest`.
pub(super) fn whole(numbers: Vec<i64>, lowest: i64, highest: i64) -> Values {
    let unsigned = [(Kind::U8, 0xFF), (Kind::U16, 0xFFFF), (Kind::U32, 0xFFFF_FFFF), (Kind::U64, i64::MAX)];
    let signed = [
        (Kind::I8, i64::from(i8::MAX)),
        (Kind::I16, i64::from(i16::MAX)),
        (Kind::I32, i64::from(i32::MAX)),
        (Kind::I64, i64::MAX),
    ];
    let kind = if lowest >= 0 {
        unsigned.into_iter().find(|(_, most)| highest <= *most)
    } else {
        signed.into_iter().find(|(_, most)| highest <= *most && lowest >= -*most - 1)
    };
    let numbers = numbers.into_iter();
    match kind.map_or(Kind::I64, |(kind, _)| kind) {
        Kind::U8 => Values::U8(numbers.map(|n| n as u8).collect()),
        Kind::U16 => Values::U16(numbers.map(|n| n as u16).collect()),
        Kind::U32 => Values::U32(numbers.map(|n| n as u32).collect()),
        Kind::U64 => Values::U64(numbers.map(|n| n as u64).collect()),
        Kind::I8 => Values::I8(numbers.map(|n| n as i8).collect()),
        Kind::I16 => Values::I16(numbers.map(|n| n as i16).collect()),
        Kind::I32 => Values::I32(numbers.map(|n| n as i32).collect()),
        _ => Values::I64(numbers.collect()),
    }
}
