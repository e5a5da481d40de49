//! What a description claims, held against what the file has room for.

use std::collections::HashSet;
use std::io;

use ::e57::{PointCloud, RecordDataType};

use super::super::columns::MAX_COLUMNS;
use super::super::spool::Spool;
use super::super::{FormatError, Limits};
use super::read::Layout;

/// Why a file is not read.
pub(super) enum Refusal {
    TooMany(FormatError),
    Contradiction(String),
}

/// Refuses what would be decoded beyond all that the file can hold.
pub(super) fn check(scans: &[PointCloud], length: u64, limits: Limits) -> Result<(), Refusal> {
    let (mut points, mut bits) = (0_u64, 0_u64);
    for scan in scans {
        let sizes = scan.prototype.iter().map(|record| bits_of(&record.data_type));
        let row: u64 = sizes.clone().sum();
        // Columns of one value take no room: without any other, nothing tells how many points there are.
        let constant = sizes.filter(|bits| *bits == 0).count() as u64;
        if scan.records > 0 && (constant > row || scan.prototype.len() > MAX_COLUMNS) {
            return Err(Refusal::Contradiction("the columns of a scan hold next to nothing".into()));
        }
        points = points.saturating_add(scan.records);
        bits = bits.saturating_add(scan.records.saturating_mul(row));
    }
    limits.check_points(points).map_err(Refusal::TooMany)?;
    if bits / 8 > length {
        let why = format!("the description counts {points} points, more than the file has room for");
        return Err(Refusal::Contradiction(why));
    }
    Ok(())
}

/// Most numbers of all columns, for each byte of a file. Those of a scan that is let through take a bit each, or share one
/// with a column of one value.
const MOST_A_BYTE: u64 = 16;

/// Refuses columns that would be many and empty nearly everywhere: each is as long as all scans together.
pub(super) fn check_columns(scans: &[PointCloud], layouts: &[Layout], length: u64) -> Result<(), String> {
    let names = layouts.iter().flat_map(|layout| layout.columns.iter().map(|(_, name)| name.as_str()));
    let columns = names.collect::<HashSet<_>>().len();
    if columns > MAX_COLUMNS {
        return Err(format!("the scans have {columns} columns; more than {MAX_COLUMNS} are not read"));
    }
    let points = scans.iter().fold(0, |sum: u64, scan| sum.saturating_add(scan.records));
    if points.saturating_mul(columns as u64) > length.saturating_mul(MOST_A_BYTE) {
        return Err(format!(
            "the scans have {columns} columns of {points} points, most of which hold nothing; convert the scans one by one"
        ));
    }
    Ok(())
}

/// Bytes of a page, and of those that the checksum at its end leaves.
const PAGE: (u64, u64) = (1024, 1020);

/// Most numbers of a scan that are decoded before the rest of their points, all columns together. Writers
/// keep columns together to a packet, which holds half a million at most.
const MOST_AHEAD: u64 = 4_000_000;

/// Refuses a scan some of whose columns are far ahead of others: they are decoded, and held, up to the
/// last. What else is wrong is left to the crate.
pub(super) fn check_packets(file: &mut Spool, scan: &PointCloud) -> io::Result<Result<(), String>> {
    let logical = |physical: u64| physical - physical / PAGE.0 * (PAGE.0 - PAGE.1);
    let mut byte = |at: u64| file.number::<1>(at / PAGE.1 * PAGE.0 + at % PAGE.1);
    let mut number = |at: u64, size: u64| -> io::Result<Option<u64>> {
        let mut sum = 0;
        for i in 0..size {
            let Some(at) = at.checked_add(i) else { return Ok(None) };
            let Some(byte) = byte(at)? else { return Ok(None) };
            sum |= byte << (8 * i);
        }
        Ok(Some(sum))
    };
    let sizes: Vec<u64> = scan.prototype.iter().map(|record| bits_of(&record.data_type)).collect();
    let mut bits = vec![0_u64; sizes.len()];
    let Some(data) = number(logical(scan.file_offset).saturating_add(16), 8)? else { return Ok(Ok(())) };
    let mut at = logical(data);
    loop {
        let counts =
            || bits.iter().zip(&sizes).filter(|(_, size)| **size > 0).map(|(bits, size)| bits / size);
        let least = counts().min().unwrap_or(0);
        if least >= scan.records {
            return Ok(Ok(()));
        }
        if counts().map(|count| count - least).sum::<u64>() > MOST_AHEAD {
            return Ok(Err("the columns of a scan are of different lengths".into()));
        }
        let (Some(kind), Some(length)) = (number(at, 1)?, number(at.saturating_add(2), 2)?) else {
            return Ok(Ok(()));
        };
        at = match kind {
            0 => at.saturating_add(16 + length + 1),
            1 => {
                let mut end = at.saturating_add(6 + 2 * sizes.len() as u64);
                for (i, bits) in bits.iter_mut().enumerate() {
                    let Some(bytes) = number(at.saturating_add(6 + 2 * i as u64), 2)? else {
                        return Ok(Ok(()));
                    };
                    *bits += 8 * bytes;
                    end = end.saturating_add(bytes);
                }
                end
            }
            2 => at.saturating_add(4 + length + 1),
            _ => return Ok(Ok(())),
        };
        at = at.saturating_add(3) & !3;
    }
}

/// Bits a number.
fn bits_of(kind: &RecordDataType) -> u64 {
    match kind {
        RecordDataType::Single { .. } => 32,
        RecordDataType::Double { .. } => 64,
        RecordDataType::Integer { min, max } | RecordDataType::ScaledInteger { min, max, .. } => {
            u64::from(128 - (i128::from(*max) - i128::from(*min)).leading_zeros())
        }
    }
}
