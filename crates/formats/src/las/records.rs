//! The variable length records, before the points and after them.

use std::io;

use las::Vlr;

use super::super::names::cut;
use super::super::spool::Spool;
use super::LasRecord;
use densecloud_cloud::Origin;

/// Most bytes in a record before the points.
pub(super) const MOST: usize = u16::MAX as usize;

/// Where the records are.
pub(super) struct Places {
    /// Of those before the points: the first, and how many the header counts.
    pub(super) before: (u64, u64),
    /// Of those after the points.
    pub(super) after: Option<(u64, u64)>,
}

/// All records of a file. A header may count more than there are; those that end early are none.
pub(super) fn records(file: &mut Spool, places: &Places) -> io::Result<Vec<LasRecord>> {
    let mut all = Vec::new();
    let after = places.after.map(|place| (place, true));
    for ((mut at, count), is_extended) in [(places.before, false)].into_iter().chain(after) {
        for _ in 0..count {
            let Some((record, end)) = record(file, at, is_extended)? else { break };
            all.push(record);
            at = end;
        }
    }
    Ok(all)
}

/// The record at a place, and where it ends.
fn record(file: &mut Spool, at: u64, is_extended: bool) -> io::Result<Option<(LasRecord, u64)>> {
    let mut head = [0; 60];
    let head = &mut head[..if is_extended { 60 } else { 54 }];
    if !file.read_at(at, head)? {
        return Ok(None);
    }
    let length = if is_extended { number::<8>(head, 20) } else { number::<2>(head, 20) };
    // What was read lies within the file.
    let from = at + head.len() as u64;
    let Some(end) = from.checked_add(length).filter(|end| *end <= file.len()) else { return Ok(None) };
    let mut data = vec![0; usize::try_from(length).map_err(io::Error::other)?];
    file.read_at(from, &mut data)?;
    let record = LasRecord {
        user_id: text(&head[2..18]),
        id: number::<2>(head, 18) as u16,
        description: text(&head[head.len() - 32..]),
        data,
        is_extended,
    };
    Ok(Some((record, end)))
}

/// A little-endian number of `N` bytes at `from`.
pub(super) fn number<const N: usize>(bytes: &[u8], from: usize) -> u64 {
    let mut word = [0; 8];
    word[..N].copy_from_slice(&bytes[from..from + N]);
    u64::from_le_bytes(word)
}

/// The text before the first NUL.
pub(super) fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

/// Whether a record tells how the points are compressed.
pub(super) fn is_compression(record: &LasRecord) -> bool {
    record.user_id == "laszip encoded" && record.id == 22_204
}

/// What a record is about.
#[derive(PartialEq, Eq)]
pub(super) enum RecordRole {
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

pub(super) fn role(record: &LasRecord) -> RecordRole {
    match (record.user_id.as_str(), record.id) {
        ("laszip encoded", _) | ("LASF_Spec", 100..=354 | 65_535) => RecordRole::Storage,
        ("copc", _) | ("LAStools", 30) => RecordRole::Index,
        ("LASF_Spec", 4) => RecordRole::Extra,
        (PROVENANCE, 1) => RecordRole::Provenance,
        _ => RecordRole::Other,
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
