//! Attributes in the bytes that follow each point.

use super::LasRecord;
use super::records::{RecordRole, number, role, text};
use densecloud_cloud::{Kind, Values};

/// An attribute in the bytes that follow each point.
pub(super) struct Extra {
    pub(super) name: String,
    offset: usize,
    /// Where the record tells how whole numbers become true ones.
    scale: Option<(f64, f64)>,
    pub(super) entry: Vec<u8>,
    /// As it is stored.
    kind: Kind,
}

impl Extra {
    /// The type of the attribute.
    pub(super) fn kind(&self) -> Kind {
        if self.scale.is_some() { Kind::F64 } else { self.kind }
    }

    /// Appends the attribute of each row. The extra bytes begin at byte `bytes` of a row.
    pub(super) fn take<'a>(&self, rows: impl Iterator<Item = &'a [u8]>, bytes: usize, column: &mut Values) {
        // Offset and size are within the extra bytes, which end the row.
        let from = bytes + self.offset;
        let rows = rows.map(|row| &row[from..]);
        match (self.scale, column) {
            (Some((scale, shift)), Values::F64(column)) => {
                let mut raw = Values::new(self.kind);
                raw.extend_from_bytes(rows, false);
                column.extend((0..raw.len()).map(|i| raw.get(i) * scale + shift));
            }
            (_, column) => column.extend_from_bytes(rows, false),
        }
    }
}

/// The types of extra bytes, from number 1 on.
pub(super) const KINDS: [Kind; 10] = [
    Kind::U8,
    Kind::I8,
    Kind::U16,
    Kind::I16,
    Kind::U32,
    Kind::I32,
    Kind::U64,
    Kind::I64,
    Kind::F32,
    Kind::F64,
];

/// Bytes of an entry in the record of extra bytes.
pub(super) const ENTRY: usize = 192;

/// The type of the numbers that an entry of the record of extra bytes describes, if each is one.
pub(super) fn kind(entry: &[u8]) -> Option<Kind> {
    KINDS.get(usize::from(entry[2]).checked_sub(1)?).copied()
}

/// The scale and the offset in an entry of the record of extra bytes.
pub(super) fn scale(entry: &[u8]) -> Option<(f64, f64)> {
    let options = entry[3];
    let double = |from: usize| f64::from_bits(number::<8>(entry, from));
    let scale = if options & 8 != 0 { double(112) } else { 1.0 };
    let shift = if options & 16 != 0 { double(136) } else { 0.0 };
    (options & 24 != 0).then_some((scale, shift))
}

/// What the record of extra bytes describes (LAS 1.4, table 24: 192 bytes an attribute), in `length` bytes
/// a point. What it does not describe, or as arrays, is not kept.
pub(super) fn extra_columns(records: &[LasRecord], length: usize, dropped: &mut Vec<String>) -> Vec<Extra> {
    let mut extra = Vec::new();
    let mut offset = 0;
    for record in records.iter().filter(|record| role(record) == RecordRole::Extra) {
        for entry in record.data.chunks_exact(ENTRY) {
            let (kind, options) = (usize::from(entry[2]), entry[3]);
            let name = text(&entry[4..36]).trim().to_owned();
            let name = if name.is_empty() { format!("extra {}", extra.len() + 1) } else { name };
            let bytes = match kind {
                // Undocumented: the options are their number.
                0 => usize::from(options),
                1..=10 => KINDS[kind - 1].size(),
                11..=30 => KINDS[(kind - 1) % 10].size() * (kind / 10 + usize::from(kind % 10 != 0)),
                _ => return extra,
            };
            if offset + bytes > length {
                return extra;
            }
            if (1..=10).contains(&kind) {
                let (scale, kind) = (scale(entry), KINDS[kind - 1]);
                extra.push(Extra { name, offset, scale, entry: entry.to_vec(), kind });
            } else {
                dropped.push(name);
            }
            offset += bytes;
        }
    }
    if offset < length {
        dropped.push(format!("{} bytes a point without a description", length - offset));
    }
    extra
}
