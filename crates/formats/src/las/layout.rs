//! Where the fields of a point lie in its bytes.

use las::point::Format;

use densecloud_cloud::{Kind, Values};

/// A field of a point.
#[derive(Clone, Copy)]
pub(super) struct Field {
    /// The attribute's name.
    pub(super) name: &'static str,
    /// The first byte.
    at: usize,
    form: Form,
    /// Whether it is kept even where it is zero everywhere.
    pub(super) always: bool,
}

#[derive(Clone, Copy)]
enum Form {
    /// Bits of a byte, from the lowest one on.
    Bits { lowest: u8, count: u8 },
    /// 16 bits.
    Word,
    /// A 64-bit float.
    Double,
    /// Whole degrees in a signed byte.
    Degrees,
    /// Degrees in steps of [`ANGLE`], in 16 bits.
    Steps,
}

/// The step of a scan angle in the point formats from 6 on, in degrees.
const ANGLE: f32 = 0.006;

/// The fields of a point format, waveforms apart, in the order in which they become attributes.
pub(super) fn fields(format: Format) -> Vec<Field> {
    let mut fields = Vec::new();
    let mut add = |name, at, form, always| fields.push(Field { name, at, form, always });
    let bits = |lowest, count| Form::Bits { lowest, count };
    let time = if format.is_extended { 22 } else { 20 };
    let colour = if format.has_gps_time { time + 8 } else { time };
    if format.has_color {
        for (i, name) in ["red", "green", "blue"].into_iter().enumerate() {
            add(name, colour + 2 * i, Form::Word, true);
        }
    }
    if format.has_nir {
        add("nir", colour + 6, Form::Word, true);
    }
    add("intensity", 12, Form::Word, true);
    if format.is_extended {
        add("return_number", 14, bits(0, 4), true);
        add("number_of_returns", 14, bits(4, 4), true);
        add("classification", 16, bits(0, 8), true);
    } else {
        add("return_number", 14, bits(0, 3), true);
        add("number_of_returns", 14, bits(3, 3), true);
        // Class 12 stands for the flag of overlap.
        add("classification", 15, bits(0, 5), true);
    }
    add("user_data", 17, bits(0, 8), true);
    let flags = if format.is_extended { 15 } else { 14 };
    add("scan_direction_flag", flags, bits(6, 1), false);
    add("edge_of_flight_line", flags, bits(7, 1), false);
    let first = if format.is_extended { 0 } else { 5 };
    add("synthetic", 15, bits(first, 1), false);
    add("key_point", 15, bits(first + 1, 1), false);
    add("withheld", 15, bits(first + 2, 1), false);
    if format.is_extended {
        add("overlap", 15, bits(3, 1), false);
        add("scanner_channel", 15, bits(4, 2), false);
        add("scan_angle", 18, Form::Steps, true);
        add("point_source_id", 20, Form::Word, true);
    } else {
        add("scan_angle", 16, Form::Degrees, true);
        add("point_source_id", 18, Form::Word, true);
    }
    if format.has_gps_time {
        add("gps_time", time, Form::Double, true);
    }
    fields
}

impl Field {
    /// An empty column of the field's type.
    pub(super) fn column(&self) -> Values {
        Values::new(match self.form {
            Form::Bits { .. } => Kind::U8,
            Form::Word => Kind::U16,
            Form::Double => Kind::F64,
            Form::Degrees | Form::Steps => Kind::F32,
        })
    }

    /// Appends the field of each of `rows` to its column.
    pub(super) fn take<'a>(&self, rows: impl Iterator<Item = &'a [u8]>, column: &mut Values) {
        let at = self.at;
        match (self.form, column) {
            (Form::Bits { lowest, count }, Values::U8(column)) => {
                column.extend(rows.map(|row| row[at] >> lowest & (0xFF >> (8 - count))));
            }
            (Form::Degrees, Values::F32(column)) => column.extend(rows.map(|row| f32::from(row[at] as i8))),
            (Form::Steps, Values::F32(column)) => {
                column.extend(rows.map(|row| f32::from(i16::from_le_bytes([row[at], row[at + 1]])) * ANGLE));
            }
            (_, column) => column.extend_from_bytes(rows.map(|row| &row[at..]), false),
        }
    }

    /// Whether the field holds these numbers of a type as they are; angles are rounded to its steps.
    pub(super) fn holds(&self, kind: Kind, mut numbers: impl Iterator<Item = f64>) -> bool {
        let mut whole = |most: u32| numbers.all(|v| v.fract() == 0.0 && (0.0..=f64::from(most)).contains(&v));
        match self.form {
            Form::Bits { count, .. } => whole((1 << count) - 1),
            Form::Word => whole(u16::MAX.into()),
            Form::Double => match kind {
                Kind::I64 | Kind::U64 => numbers.all(|v| v.abs() <= (1_u64 << 53) as f64),
                _ => true,
            },
            Form::Degrees => numbers.all(|v| v.round().abs() <= f64::from(i8::MAX)),
            Form::Steps => numbers.all(|v| (v / f64::from(ANGLE)).round().abs() <= f64::from(i16::MAX)),
        }
    }

    /// Puts numbers that the field [holds](Self::holds) into rows of `stride` bytes that are zero there.
    pub(super) fn put(&self, rows: &mut [u8], stride: usize, numbers: impl Iterator<Item = f64>) {
        for (row, number) in rows.chunks_exact_mut(stride).zip(numbers) {
            let place = &mut row[self.at..];
            match self.form {
                Form::Bits { lowest, .. } => place[0] |= (number as u8) << lowest,
                Form::Word => place[..2].copy_from_slice(&(number as u16).to_le_bytes()),
                Form::Double => place[..8].copy_from_slice(&number.to_le_bytes()),
                Form::Degrees => place[0] = (number.round() as i8).to_le_bytes()[0],
                Form::Steps => {
                    let steps = (number / f64::from(ANGLE)).round() as i16;
                    place[..2].copy_from_slice(&steps.to_le_bytes());
                }
            }
        }
    }
}
