//! What a header claims, held against the file: places and counts.

use super::super::spool::Spool;
use super::super::{FormatError, Place};
use super::LasRecord;
use super::head::{Head, LONGEST};
use super::records::{is_compression, number};

/// Most extra bytes in a compressed point: the decoder has tables of 10 KB for each. Real files have some tens.
const MOST_EXTRA: usize = 1024;

/// Refuses counts that would be reserved before they are read.
pub(super) fn places(file: &mut Spool, head: &Head) -> Result<(), FormatError> {
    let len = file.len();
    let inside = |from: u64, count: u64| from.checked_add(count).is_some_and(|end| end <= len);
    let data = head.data();
    if !inside(data, 0) {
        return Err(FormatError::truncated(
            Place::Byte(len),
            format!("the points should begin at byte {data}"),
        ));
    }
    if let Some((start, 1..)) = head.extended().filter(|_| len >= LONGEST as u64) {
        // The first has its length in its head.
        let length = if inside(start, 60) { file.number::<8>(start + 20)? } else { None };
        if !length.is_some_and(|length| inside(start + 60, length)) {
            let why = "the extended records are not inside the file";
            return Err(FormatError::malformed(Place::Byte(235), why));
        }
    }
    if head.is_compressed() && inside(data, 8) {
        let table = table_of_chunks(file, data)?;
        let count = if table >= data + 8 && inside(table, 8) { file.number::<4>(table + 4)? } else { None };
        if count.is_none_or(|count| count > len) {
            let why = "the table of compressed chunks is not inside the file";
            return Err(FormatError::malformed(Place::Byte(data), why));
        }
    }
    Ok(())
}

/// Holds the number of points against what is there, and gives a sentence for each thing that a person should know.
///
/// # Errors
/// The header counts no points though some are there, or points where the file has something else.
pub(super) fn counts(
    file: &mut Spool,
    head: &Head,
    records: &[LasRecord],
) -> Result<Vec<String>, FormatError> {
    let counts = head.counts();
    let points = counts.points();
    let there = if head.is_compressed() { chunked(file, head, records)? } else { room(file, head) };
    let place = Place::Byte(if counts.modern.is_some() { 247 } else { 107 });
    let mut notes: Vec<String> = counts.stale().into_iter().collect();
    let Some(there) = there else { return Ok(notes) };
    if points == 0 && there.least > 0 {
        let why = format!(
            "the header counts no points, but the file has {}: whatever wrote it did not finish",
            there.words()
        );
        return Err(FormatError::malformed(place, why));
    }
    if points < there.least {
        notes.push(format!(
            "the header counts {points} points, the file has {}; those beyond were not read",
            there.words()
        ));
    }
    if there.most.is_some_and(|most| points > most) {
        let why = format!("the header counts {points} points, the file has {}", there.words());
        return Err(FormatError::malformed(place, why));
    }
    Ok(notes)
}

/// How many points a file has, whatever its header counts.
struct There {
    least: u64,
    /// Unknown where reading on finds out, too.
    most: Option<u64>,
    /// What is sure of the least number: `at least`, `room for`.
    sure: &'static str,
}

impl There {
    fn words(&self) -> String {
        format!("{}{}", self.sure, self.least)
    }
}

/// The points that there is room for, up to what follows them.
fn room(file: &Spool, head: &Head) -> Option<There> {
    let length = Some(head.number::<2>(105)).filter(|length| *length > 0)?;
    let records = head.extended().filter(|(_, count)| *count > 0).map(|(from, _)| from);
    let follows = |from: Option<u64>| from.filter(|from| *from >= head.data());
    let rows = |end: u64| (end - head.data()) / length;
    // A file that ends too early is found out by reading, with the place where it ends.
    let most = follows(records).map(rows);
    let end = [follows(records), follows(head.waveforms())].into_iter().flatten().fold(file.len(), u64::min);
    Some(There { least: rows(end), most, sure: "room for " })
}

/// The points of compressed chunks. Refuses what the decoder would make room for before it reads it: more extra bytes
/// than any file has, and layers (LAZ of point formats 6 and up) that do not fit into the file. A chunk is its first
/// point, the number of its points, the size of each layer, and the layers; the next one follows. Without layers, the
/// number of chunks alone tells how many points there are at least.
fn chunked(file: &mut Spool, head: &Head, records: &[LasRecord]) -> Result<Option<There>, FormatError> {
    let compression = records.iter().find(|record| is_compression(record));
    let Some(compression) = compression.map(|record| record.data.as_slice()) else { return Ok(None) };
    let Some(items) = compression.get(34..) else { return Ok(None) };
    // By the numbers that LASzip has for kinds of items: 0 and 14 are extra bytes.
    let items = || items.chunks_exact(6).map(|item| (number::<2>(item, 0), number::<2>(item, 2) as usize));
    if let Some((_, size)) = items().find(|(kind, size)| matches!(kind, 0 | 14) && *size > MOST_EXTRA) {
        let why = format!(
            "{size} extra bytes a point; of compressed points, at most {MOST_EXTRA} are read: unpack the file to LAS"
        );
        return Err(FormatError::malformed(Place::Byte(0), why));
    }
    let (mut point, mut layers) = (0, 0);
    for (kind, size) in items() {
        point += size;
        layers += match kind {
            10 => 9,
            11 | 13 => 1,
            12 => 2,
            14 => size,
            // Not in layers.
            _ => return plain_chunks(file, head, number::<4>(compression, 12)),
        };
    }
    if (4 * layers) as u64 > file.len() {
        return Ok(None);
    }
    let mut sizes = vec![0; 4 + 4 * layers];
    let table = table_of_chunks(file, head.data())?;
    // The place of the table of chunks comes before the first.
    let (mut at, mut points) = (head.data().saturating_add(8), 0_u64);
    while at < table && file.read_at(at.saturating_add(point as u64), &mut sizes)? {
        let total: u64 = sizes[4..].chunks_exact(4).map(|size| number::<4>(size, 0)).sum();
        let from = at + (point + sizes.len()) as u64;
        if total > file.len() - from {
            let why = "the layers of compressed points are not inside the file";
            return Err(FormatError::malformed(Place::Byte(at), why));
        }
        points = points.saturating_add(number::<4>(&sizes, 0));
        at = from + total;
    }
    Ok((at == table).then_some(There { least: points, most: Some(points), sure: "" }))
}

/// The points of chunks of `size` points each, of which the last may have fewer.
fn plain_chunks(file: &mut Spool, head: &Head, size: u64) -> Result<Option<There>, FormatError> {
    /// Chunks of any size.
    const ANY: u64 = u32::MAX as u64;
    if matches!(size, 0 | ANY) {
        return Ok(None);
    }
    let table = table_of_chunks(file, head.data())?;
    let count = file.number::<4>(table.saturating_add(4))?.unwrap_or(0);
    let least = count.saturating_sub(1).saturating_mul(size);
    Ok(Some(There { least, most: None, sure: "at least " }))
}

/// Where the table of chunks begins, in a file whose points begin at `data`, 8 bytes before its end at least.
pub(super) fn table_of_chunks(file: &mut Spool, data: u64) -> Result<u64, FormatError> {
    let table = file.number::<8>(data)?;
    let table = if table == Some(u64::MAX) { file.number::<8>(file.len() - 8)? } else { table };
    Ok(table.unwrap_or(u64::MAX))
}
