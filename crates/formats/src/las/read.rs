//! Reading.

use std::io::{Cursor, Read};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use las::{PointData, PointDataBuilder, Reader};

use super::super::source::Source;
use super::super::{Format, FormatError, Header, Limits, Place};
use super::records::{Role, records, role, text};
use super::{crs, layout};
use densecloud_cloud::{Attribute, Cloud, Kind, LasExtra, LasOrigin, LasRecord, Origin, Values};

/// The shortest header, that of version 1.0 to 1.2.
const SHORTEST: usize = 227;

/// The header up to the point count of version 1.4.
const LONGEST: usize = 255;

/// Most extra bytes in a compressed point: the decoder has tables of 10 KB for each. Real files have some tens.
const MOST_EXTRA: usize = 1024;

/// Bytes of points decoded at a time: memory grows with what is there, whatever the header counts, and
/// however long it says that a point is.
const BLOCK: usize = 1 << 22;

/// What the fixed part of the header tells; the rest is read with the points.
pub(in super::super) fn open<R: Read>(source: &mut Source<R>, limits: Limits) -> Result<Header, FormatError> {
    let head = source.peek(LONGEST)?;
    if head.len() < SHORTEST {
        return Err(FormatError::truncated(Place::Byte(head.len() as u64), "the LAS header is incomplete"));
    }
    let legacy = u64::from(number::<4>(head, 107) as u32);
    let extended = head.len() >= LONGEST && (head[24], head[25]) >= (1, 4);
    let points = if legacy == 0 && extended { number::<8>(head, 247) } else { legacy };
    if let Some(limit) = limits.max_points
        && points > limit
    {
        return Err(FormatError::TooManyPoints { points, limit });
    }
    Ok(Header {
        // The top bits of the point format mean compression.
        format: Format::Las { compressed: head[104] & 0xC0 != 0 },
        points: Some(points),
        attributes: Vec::new(),
        dropped_properties: Vec::new(),
    })
}

/// Reads everything: the whole file is held, since LAZ is not in the order of its bytes.
pub(in super::super) fn read<R: Read>(source: &mut Source<R>) -> Result<Cloud, FormatError> {
    let mut bytes = Vec::new();
    while source.ensure(1)? {
        bytes.extend_from_slice(source.buffered());
        source.consume(source.buffered().len());
    }
    check(&bytes)?;
    let end = Place::Byte(bytes.len() as u64);
    // Files are made to break readers, and this one is not ours.
    catch_unwind(AssertUnwindSafe(|| decode(bytes, end)))
        .unwrap_or_else(|_| Err(FormatError::malformed(end, "the LAS file contradicts itself")))
}

/// Refuses counts that would be reserved before they are read.
fn check(bytes: &[u8]) -> Result<(), FormatError> {
    let len = bytes.len() as u64;
    let at = |place: u64, why: &str| Err(FormatError::malformed(Place::Byte(place), why));
    let inside = |from: u64, count: u64| from.checked_add(count).is_some_and(|end| end <= len);
    let data = number::<4>(bytes, 96);
    if !inside(data, 0) {
        return Err(FormatError::truncated(
            Place::Byte(len),
            format!("the points should begin at byte {data}"),
        ));
    }
    if (bytes[24], bytes[25]) >= (1, 4) && bytes.len() >= LONGEST {
        let (start, count) = (number::<8>(bytes, 235), number::<4>(bytes, 243));
        if count > 0 && !(inside(start, 60) && inside(start + 60, number::<8>(bytes, start as usize + 20))) {
            return at(235, "the extended records are not inside the file");
        }
    }
    // The top bits of the point format mean compression.
    if bytes[104] & 0xC0 != 0 && inside(data, 8) {
        let table = table_of_chunks(bytes) as u64;
        if table < data + 8 || !inside(table, 8) || number::<4>(bytes, table as usize + 4) > len {
            return at(data, "the table of compressed chunks is not inside the file");
        }
    }
    Ok(())
}

/// Refuses what the decoder would make room for before it reads it: more extra bytes than any file has, and
/// layers (LAZ of point formats 6 and up) that do not fit into the file. A chunk is its first point, the number of its points, the size of each
/// layer, and the layers; the next one follows.
fn check_layers(bytes: &[u8], records: &[LasRecord]) -> Result<(), FormatError> {
    let compression = records.iter().find(|r| r.user_id == "laszip encoded" && r.id == 22_204);
    let Some(items) = compression.and_then(|r| r.data.get(34..)).filter(|_| bytes[104] & 0xC0 != 0) else {
        return Ok(());
    };
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
            _ => return Ok(()),
        };
    }
    // The place of the table of chunks comes before the first.
    let mut at = (number::<4>(bytes, 96) as usize).saturating_add(8);
    while let Some(sizes) = bytes.get(at.saturating_add(point + 4)..).and_then(|rest| rest.get(..4 * layers))
    {
        let total: u64 = sizes.chunks_exact(4).map(|size| number::<4>(size, 0)).sum();
        let from = at + point + 4 + 4 * layers;
        if total > (bytes.len() - from) as u64 {
            // What follows the last chunk is no chunk: then the decoder never comes here.
            let why = "the layers of compressed points are not inside the file";
            return if at < table_of_chunks(bytes) {
                Err(FormatError::malformed(Place::Byte(at as u64), why))
            } else {
                Ok(())
            };
        }
        at = from + total as usize;
    }
    Ok(())
}

/// Where the table of chunks begins, as [`check`] has found it to be inside the file.
fn table_of_chunks(bytes: &[u8]) -> usize {
    let table = number::<8>(bytes, number::<4>(bytes, 96) as usize);
    (if table == u64::MAX { number::<8>(bytes, bytes.len() - 8) } else { table }) as usize
}

/// A little-endian number of `N` bytes at `from`.
pub(super) fn number<const N: usize>(bytes: &[u8], from: usize) -> u64 {
    let mut word = [0; 8];
    word[..N].copy_from_slice(&bytes[from..from + N]);
    u64::from_le_bytes(word)
}

fn decode(bytes: Vec<u8>, end: Place) -> Result<Cloud, FormatError> {
    let bad = |why: las::Error| match why {
        las::Error::Io(why) if why.kind() == std::io::ErrorKind::UnexpectedEof => {
            FormatError::truncated(end, "the LAS header counts more than is there")
        }
        other => FormatError::malformed(Place::Byte(0), format!("not a readable LAS file: {other}")),
    };
    let records = records(&bytes);
    check_layers(&bytes, &records)?;
    let las = told(&bytes);
    let mut reader = Reader::new(Cursor::new(bytes)).map_err(bad)?;
    let header = reader.header().clone();
    let format = *header.point_format();
    let mut dropped = Vec::new();
    if format.has_waveform {
        dropped.push("waveforms".to_owned());
    }
    let transforms = header.transforms();
    let axes = [transforms.x, transforms.y, transforms.z];
    let length = usize::from(format.len());
    let mut positions = Vec::new();
    let fields = layout::fields(format);
    let mut columns: Vec<Values> = fields.iter().map(layout::Field::column).collect();
    let mut extra = extra_columns(&records, format.extra_bytes.into(), &mut dropped);
    let mut block: PointData = PointDataBuilder::new().for_header(&header).build();
    let block_points = (BLOCK / length.max(1)).max(1) as u64;
    let mut left = header.number_of_points();
    while left > 0 {
        let got = reader.fill_points(block_points.min(left), &mut block).map_err(bad)?;
        if got == 0 {
            return Err(FormatError::truncated(end, format!("the header counts {left} points more")));
        }
        left -= got;
        let rows = || block.raw_bytes().chunks_exact(length);
        positions.extend(
            rows().map(|row| [0, 1, 2].map(|i| axes[i].direct(number::<4>(row, 4 * i) as u32 as i32))),
        );
        for (field, column) in fields.iter().zip(&mut columns) {
            field.take(rows(), column);
        }
        for column in &mut extra {
            // Offset and size are within the extra bytes, which end the row.
            let from = length - usize::from(format.extra_bytes) + column.offset;
            column.values.extend_from_bytes(rows().map(|row| &row[from..]), false);
        }
    }
    let mut attributes: Vec<Attribute> = fields
        .iter()
        .zip(columns)
        .filter(|(field, values)| field.always || (0..values.len()).any(|i| values.get(i) != 0.0))
        .map(|(field, values)| Attribute { name: field.name.to_owned(), values })
        .collect();
    let mut described = Vec::new();
    for column in extra {
        let mut name = column.name;
        while attributes.iter().any(|a| a.name == name) {
            name.push('_');
        }
        described.push(LasExtra { name: name.clone(), entry: column.entry });
        let values = match column.scale {
            Some((scale, shift)) => {
                let raw = &column.values;
                Values::F64((0..raw.len()).map(|i| raw.get(i) * scale + shift).collect())
            }
            None => column.values,
        };
        attributes.push(Attribute { name, values });
    }
    let mut origin = Origin { crs: crs::read(&records), ..Origin::default() };
    for record in records.iter().filter(|record| role(record) == Role::Provenance) {
        origin.comments.extend(String::from_utf8_lossy(&record.data).lines().map(str::to_owned));
    }
    origin.las = Some(Arc::new(LasOrigin {
        point_format: format.to_u8().map_err(bad)?,
        scale: axes.map(|t| t.scale),
        offset: axes.map(|t| t.offset),
        is_indexed: records.iter().any(|record| role(record) == Role::Index),
        records: records.into_iter().filter(|record| role(record) == Role::Other).collect(),
        extra: described,
        ..las
    }));
    Ok(Cloud { positions, attributes, dropped_properties: dropped, origin })
}

/// What the fixed part of the header tells beside the points.
fn told(bytes: &[u8]) -> LasOrigin {
    let version = (bytes[24], bytes[25]);
    let mut las = LasOrigin {
        version,
        file_source_id: number::<2>(bytes, 4) as u16,
        // Reserved before version 1.2.
        global_encoding: if version >= (1, 2) { number::<2>(bytes, 6) as u16 } else { 0 },
        created: (number::<2>(bytes, 90) as u16, number::<2>(bytes, 92) as u16),
        ..LasOrigin::default()
    };
    las.guid.copy_from_slice(&bytes[8..24]);
    las.system_identifier.copy_from_slice(&bytes[26..58]);
    las
}

/// An attribute in the bytes that follow each point.
struct Extra {
    name: String,
    offset: usize,
    /// Where the record tells how whole numbers become true ones.
    scale: Option<(f64, f64)>,
    entry: Vec<u8>,
    values: Values,
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
fn extra_columns(records: &[LasRecord], length: usize, dropped: &mut Vec<String>) -> Vec<Extra> {
    let mut extra = Vec::new();
    let mut offset = 0;
    for record in records.iter().filter(|record| role(record) == Role::Extra) {
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
                let (scale, values) = (scale(entry), Values::new(KINDS[kind - 1]));
                extra.push(Extra { name, offset, scale, entry: entry.to_vec(), values });
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
