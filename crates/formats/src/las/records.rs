//! The variable length records, before the points and after them.

use las::Vlr;

use super::read::number;
use densecloud_cloud::{LasRecord, Origin};

/// Most bytes in a record before the points.
pub(super) const MOST: usize = u16::MAX as usize;

/// All records of a file. A header may count more than there are; those that end early are none.
pub(super) fn records(bytes: &[u8]) -> Vec<LasRecord> {
    let mut all = Vec::new();
    let mut follow = |mut at: usize, count: u64, is_extended: bool| {
        for _ in 0..count {
            let Some((record, end)) = record(bytes, at, is_extended) else { break };
            all.push(record);
            at = end;
        }
    };
    follow(number::<2>(bytes, 94) as usize, number::<4>(bytes, 100), false);
    if (bytes[24], bytes[25]) >= (1, 4) && bytes.len() >= 247 {
        let start = usize::try_from(number::<8>(bytes, 235)).unwrap_or(usize::MAX);
        follow(start, number::<4>(bytes, 243), true);
    }
    all
}

/// The record at a place, and where it ends.
fn record(bytes: &[u8], at: usize, is_extended: bool) -> Option<(LasRecord, usize)> {
    let length = if is_extended { 60 } else { 54 };
    let from = at.checked_add(length)?;
    let head = bytes.get(at..from)?;
    let length = if is_extended { number::<8>(head, 20) } else { number::<2>(head, 20) };
    let end = from.checked_add(usize::try_from(length).ok()?)?;
    let record = LasRecord {
        user_id: text(&head[2..18]),
        id: number::<2>(head, 18) as u16,
        description: text(&head[head.len() - 32..]),
        data: bytes.get(from..end)?.to_vec(),
        is_extended,
    };
    Some((record, end))
}

/// The text before the first NUL.
pub(super) fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

/// What a record is about.
#[derive(PartialEq, Eq)]
pub(super) enum Role {
    /// How the points are compressed, and waveforms: told anew, or dropped.
    Storage,
    /// Where points are in the file.
    Index,
    /// The attributes in extra bytes.
    Extra,
    /// The lines of [`Origin::comments`].
    Provenance,
    Other,
}

pub(super) fn role(record: &LasRecord) -> Role {
    match (record.user_id.as_str(), record.id) {
        ("laszip encoded", _) | ("LASF_Spec", 100..=354 | 65_535) => Role::Storage,
        ("copc", _) | ("LAStools", 30) => Role::Index,
        ("LASF_Spec", 4) => Role::Extra,
        (PROVENANCE, 1) => Role::Provenance,
        _ => Role::Other,
    }
}

/// Who defines the record of provenance.
const PROVENANCE: &str = "densecloud";

/// The comments as a record; the oldest lines are left out where there is no room for all.
pub(super) fn provenance(origin: &Origin) -> Option<LasRecord> {
    let mut lines = origin.comments.as_slice();
    while lines.iter().map(|line| line.len() + 1).sum::<usize>() > MOST {
        lines = &lines[1..];
    }
    (!lines.is_empty()).then(|| LasRecord {
        user_id: PROVENANCE.to_owned(),
        id: 1,
        description: "provenance".to_owned(),
        data: lines.join("\n").into_bytes(),
        is_extended: false,
    })
}

/// A record as the `las` crate writes it.
pub(super) fn to_vlr(record: LasRecord) -> Vlr {
    let LasRecord { user_id, id, description, data, .. } = record;
    Vlr { user_id: cut(user_id, 16), record_id: id, description: cut(description, 32), data }
}

/// The text without what is beyond `most` bytes.
pub(super) fn cut(mut text: String, most: usize) -> String {
    while text.len() > most {
        text.pop();
    }
    text
}
