//! LAS and LAZ, by the `las` crate: every point format, extra bytes, and COPC as the LAZ that it is.

use std::io::{Cursor, Read};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use las::{PointData, PointDataBuilder, Reader, Vlr};

use super::source::Source;
use super::{Format, FormatError, Header, Limits, Place};
use crate::cloud::{Attribute, Cloud, Kind, LasOrigin, Origin, Values};

/// The shortest header, that of version 1.0 to 1.2.
const SHORTEST: usize = 227;

/// The header up to the point count of version 1.4.
const LONGEST: usize = 255;

/// Points decoded at a time: memory grows with what is there, whatever the header counts.
const BLOCK: u64 = 1 << 16;

/// What the fixed part of the header tells; the rest is read with the points.
pub(super) fn open<R: Read>(source: &mut Source<R>, limits: Limits) -> Result<Header, FormatError> {
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
pub(super) fn read<R: Read>(source: &mut Source<R>) -> Result<Cloud, FormatError> {
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
        let mut table = number::<8>(bytes, data as usize);
        if table == u64::MAX {
            table = number::<8>(bytes, bytes.len() - 8);
        }
        if !inside(table, 8) || number::<4>(bytes, table as usize + 4) > len {
            return at(data, "the table of compressed chunks is not inside the file");
        }
    }
    Ok(())
}

/// A little-endian number of `N` bytes at `from`.
fn number<const N: usize>(bytes: &[u8], from: usize) -> u64 {
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
    let mut reader = Reader::new(Cursor::new(bytes)).map_err(bad)?;
    let header = reader.header().clone();
    let format = *header.point_format();
    let mut dropped = Vec::new();
    if header.has_crs_vlrs() {
        dropped.push("the coordinate system".to_owned());
    }
    if format.has_waveform {
        dropped.push("waveforms".to_owned());
    }
    let mut positions = Vec::new();
    let mut columns = Columns::default();
    let mut extra = extra_columns(header.all_vlrs(), format.extra_bytes.into(), &mut dropped);
    let mut block: PointData = PointDataBuilder::new().for_header(&header).build();
    let mut left = header.number_of_points();
    while left > 0 {
        let got = reader.fill_points(BLOCK.min(left), &mut block).map_err(bad)?;
        if got == 0 {
            return Err(FormatError::truncated(end, format!("the header counts {left} points more")));
        }
        left -= got;
        for point in block.points() {
            let point = point.map_err(bad)?;
            positions.push([point.x, point.y, point.z]);
            columns.push(&point, format.is_extended);
            for column in &mut extra {
                column.push(&point.extra_bytes);
            }
        }
    }
    let mut attributes = columns.into_attributes(format);
    for column in extra {
        let mut name = column.name;
        while attributes.iter().any(|a| a.name == name) {
            name.push('_');
        }
        let values = match column.scale {
            Some((scale, shift)) => {
                let raw = &column.values;
                Values::F64((0..raw.len()).map(|i| raw.get(i) * scale + shift).collect())
            }
            None => column.values,
        };
        attributes.push(Attribute { name, values });
    }
    let transforms = header.transforms();
    let axes = [transforms.x, transforms.y, transforms.z];
    let las = LasOrigin { scale: axes.map(|t| t.scale), offset: axes.map(|t| t.offset) };
    let origin = Origin { las: Some(Arc::new(las)), ..Origin::default() };
    Ok(Cloud { positions, attributes, dropped_properties: dropped, origin })
}

/// The columns that point formats have.
#[derive(Default)]
struct Columns {
    intensity: Vec<u16>,
    bytes: [Vec<u8>; BYTES.len()],
    scan_angle: Vec<f32>,
    point_source_id: Vec<u16>,
    gps_time: Vec<f64>,
    colour: [Vec<u16>; 3],
    nir: Vec<u16>,
}

/// Names of the attributes of one byte or less, in the order of [`Columns::push`].
const BYTES: [&str; 11] = [
    "return_number",
    "number_of_returns",
    "classification",
    "user_data",
    "scan_direction_flag",
    "edge_of_flight_line",
    "synthetic",
    "key_point",
    "withheld",
    "overlap",
    "scanner_channel",
];

/// How many of [`BYTES`] are kept even where they are zero everywhere.
const ALWAYS: usize = 4;

impl Columns {
    fn push(&mut self, point: &las::Point, extended: bool) {
        self.intensity.push(point.intensity);
        // Formats 0 to 5 have no overlap flag: class 12 stands for it.
        let legacy_overlap = point.is_overlap && !extended;
        let class = if legacy_overlap { 12 } else { u8::from(point.classification) };
        let bytes = [
            point.return_number,
            point.number_of_returns,
            class,
            point.user_data,
            u8::from(matches!(point.scan_direction, las::point::ScanDirection::LeftToRight)),
            u8::from(point.is_edge_of_flight_line),
            u8::from(point.is_synthetic),
            u8::from(point.is_key_point),
            u8::from(point.is_withheld),
            u8::from(point.is_overlap && extended),
            point.scanner_channel,
        ];
        for (column, byte) in self.bytes.iter_mut().zip(bytes) {
            column.push(byte);
        }
        self.scan_angle.push(point.scan_angle);
        self.point_source_id.push(point.point_source_id);
        self.gps_time.extend(point.gps_time);
        if let Some(colour) = point.color {
            for (column, value) in self.colour.iter_mut().zip([colour.red, colour.green, colour.blue]) {
                column.push(value);
            }
        }
        self.nir.extend(point.nir);
    }

    fn into_attributes(self, format: las::point::Format) -> Vec<Attribute> {
        let mut attributes = Vec::new();
        let mut add = |name: &str, values| attributes.push(Attribute { name: name.to_owned(), values });
        let [red, green, blue] = self.colour;
        if format.has_color {
            add("red", Values::U16(red));
            add("green", Values::U16(green));
            add("blue", Values::U16(blue));
        }
        if format.has_nir {
            add("nir", Values::U16(self.nir));
        }
        add("intensity", Values::U16(self.intensity));
        for (i, (column, name)) in self.bytes.into_iter().zip(BYTES).enumerate() {
            if i < ALWAYS || column.iter().any(|b| *b != 0) {
                add(name, Values::U8(column));
            }
        }
        add("scan_angle", Values::F32(self.scan_angle));
        add("point_source_id", Values::U16(self.point_source_id));
        if format.has_gps_time {
            add("gps_time", Values::F64(self.gps_time));
        }
        attributes
    }
}

/// An attribute in the bytes that follow each point.
struct Extra {
    name: String,
    offset: usize,
    /// Where the record tells how whole numbers become true ones.
    scale: Option<(f64, f64)>,
    values: Values,
}

impl Extra {
    /// `offset` and size are within the extra bytes of the point format, hence of each point.
    fn push(&mut self, bytes: &[u8]) {
        self.values.extend_from_bytes(std::iter::once(&bytes[self.offset..]), false);
    }
}

/// What the record of extra bytes describes (LAS 1.4, table 24: 192 bytes an attribute), in `length` bytes
/// a point. What it does not describe, or as arrays, is not kept.
fn extra_columns<'a>(
    vlrs: impl Iterator<Item = &'a Vlr>,
    length: usize,
    dropped: &mut Vec<String>,
) -> Vec<Extra> {
    const KINDS: [Kind; 10] = [
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
    let mut extra = Vec::new();
    let mut offset = 0;
    for vlr in vlrs {
        if vlr.user_id != "LASF_Spec" || vlr.record_id != 4 {
            continue;
        }
        for record in vlr.data.chunks_exact(192) {
            let (kind, options) = (usize::from(record[2]), record[3]);
            let name = String::from_utf8_lossy(&record[4..36]).trim_matches(['\0', ' ']).to_owned();
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
                let double = |from: usize| f64::from_bits(number::<8>(record, from));
                let scale = if options & 8 != 0 { double(112) } else { 1.0 };
                let shift = if options & 16 != 0 { double(136) } else { 0.0 };
                let scale = (options & 24 != 0).then_some((scale, shift));
                extra.push(Extra { name, offset, scale, values: Values::new(KINDS[kind - 1]) });
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
