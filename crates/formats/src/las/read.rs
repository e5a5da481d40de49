//! Reading.

use std::io::{ErrorKind, Seek};
use std::panic::{AssertUnwindSafe, catch_unwind};

use las::{PointData, PointDataBuilder, Reader, Transform};

use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::source::Source;
use super::super::spool::Spool;
use super::super::{Format, FormatError, Header, Limits, Place};
use super::extra::{Extra, extra_columns};
use super::layout::{self, Field};
use super::records::{Places, Role, number, records, role};
use super::{LasExtra, LasOrigin, LasRecord, crs};
use densecloud_cloud::{self as cloud, Origin, Values};

/// The shortest header, that of version 1.0 to 1.2.
const SHORTEST: usize = 227;

/// The header up to the point count of version 1.4.
const LONGEST: usize = 255;

/// Most extra bytes in a compressed point: the decoder has tables of 10 KB for each. Real files have some tens.
const MOST_EXTRA: usize = 1024;

/// Bytes of points decoded at a time. The bound is in bytes, because the header may claim any number of points and any
/// length of one.
const BLOCK: usize = 1 << 22;

/// What the fixed part of the header tells; the rest is read with the points.
pub(super) fn open(source: &mut Source<'_>, limits: Limits) -> Result<Header, FormatError> {
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

/// The fixed part of a header, up to the point count of version 1.4 where it goes so far.
struct Head(Vec<u8>);

impl Head {
    /// From a file that is as long as [`open`] has found.
    fn of(file: &mut Spool) -> Result<Self, FormatError> {
        let mut bytes = vec![0; file.len().min(LONGEST as u64) as usize];
        file.read_at(0, &mut bytes)?;
        Ok(Self(bytes))
    }

    fn number<const N: usize>(&self, from: usize) -> u64 {
        number::<N>(&self.0, from)
    }

    fn version(&self) -> (u8, u8) {
        (self.0[24], self.0[25])
    }

    /// Where the points begin.
    fn data(&self) -> u64 {
        self.number::<4>(96)
    }

    /// The top bits of the point format mean compression.
    fn is_compressed(&self) -> bool {
        self.0[104] & 0xC0 != 0
    }

    /// Where the records after the points begin, and how many the header counts.
    fn extended(&self) -> Option<(u64, u64)> {
        let has = self.version() >= (1, 4) && self.0.len() >= 247;
        has.then(|| (self.number::<8>(235), self.number::<4>(243)))
    }

    /// What it tells beside the points.
    fn told(&self) -> LasOrigin {
        let mut las = LasOrigin {
            version: self.version(),
            file_source_id: self.number::<2>(4) as u16,
            // Reserved before version 1.2.
            global_encoding: if self.version() >= (1, 2) { self.number::<2>(6) as u16 } else { 0 },
            created: (self.number::<2>(90) as u16, self.number::<2>(92) as u16),
            ..LasOrigin::default()
        };
        las.guid.copy_from_slice(&self.0[8..24]);
        las.system_identifier.copy_from_slice(&self.0[26..58]);
        las
    }
}

/// Refuses counts that would be reserved before they are read.
fn check(file: &mut Spool, head: &Head) -> Result<(), FormatError> {
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

/// Refuses what the decoder would make room for before it reads it: more extra bytes than any file has, and
/// layers (LAZ of point formats 6 and up) that do not fit into the file. A chunk is its first point, the number of its points, the size of each
/// layer, and the layers; the next one follows.
fn check_layers(file: &mut Spool, head: &Head, records: &[LasRecord]) -> Result<(), FormatError> {
    let compression = records.iter().find(|r| r.user_id == "laszip encoded" && r.id == 22_204);
    let Some(items) = compression.and_then(|r| r.data.get(34..)).filter(|_| head.is_compressed()) else {
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
    let mut at = head.data().saturating_add(8);
    if (4 * layers) as u64 > file.len() {
        return Ok(());
    }
    let mut sizes = vec![0; 4 * layers];
    while file.read_at(at.saturating_add(point as u64 + 4), &mut sizes)? {
        let total: u64 = sizes.chunks_exact(4).map(|size| number::<4>(size, 0)).sum();
        let from = at + (point + 4 + 4 * layers) as u64;
        if total > file.len() - from {
            // What follows the last chunk is no chunk: then the decoder never comes here.
            let why = "the layers of compressed points are not inside the file";
            return if at < table_of_chunks(file, head.data())? {
                Err(FormatError::malformed(Place::Byte(at), why))
            } else {
                Ok(())
            };
        }
        at = from + total;
    }
    Ok(())
}

/// Where the table of chunks begins, in a file whose points begin at `data`, 8 bytes before its end at least.
fn table_of_chunks(file: &mut Spool, data: u64) -> Result<u64, FormatError> {
    let table = file.number::<8>(data)?;
    let table = if table == Some(u64::MAX) { file.number::<8>(file.len() - 8)? } else { table };
    Ok(table.unwrap_or(u64::MAX))
}

/// The points of a file, which is opened with the first of them.
#[derive(Default)]
pub(super) struct LasPoints(Option<Decoder>);

/// The points of an open file.
struct Decoder {
    reader: Reader,
    /// As long as the file is.
    end: Place,
    /// Points that are left to read.
    left: u64,
    block: PointData,
    /// Bytes a point, those of the extra bytes among them, and without them.
    length: usize,
    bare_length: usize,
    axes: [Transform; 3],
    fields: Vec<FieldColumn>,
    extra: Vec<Extra>,
    las: LasOrigin,
    records: Vec<LasRecord>,
    dropped: Vec<String>,
}

/// A field, which is kept if it always is or is somewhere not zero.
struct FieldColumn {
    field: Field,
    is_kept: bool,
}

impl Points for LasPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if self.0.is_none() {
            let mut file = source.stored()?;
            let head = Head::of(&mut file)?;
            check(&mut file, &head)?;
            let end = Place::Byte(file.len());
            self.0 = Some(guarded(end, || Decoder::open(file, &head))?);
        }
        match &mut self.0 {
            Some(decoder) => guarded(decoder.end, || decoder.append(rows, to)),
            None => Ok(()),
        }
    }

    fn finish(self: Box<Self>, _source: &mut Source<'_>) -> Result<Ending, FormatError> {
        self.0.map_or_else(|| Ok(Ending::of_text(std::iter::empty())), Decoder::finish)
    }
}

/// Files are made to break readers, and this one is not ours.
fn guarded<T>(end: Place, work: impl FnOnce() -> Result<T, FormatError>) -> Result<T, FormatError> {
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|_| Err(FormatError::malformed(end, "the LAS file contradicts itself")))
}

/// What the crate has against a file that ends there.
fn refused(end: Place, why: las::Error) -> FormatError {
    match why {
        las::Error::Io(why) if why.kind() == ErrorKind::UnexpectedEof => {
            FormatError::truncated(end, "the LAS header counts more than is there")
        }
        other => FormatError::malformed(Place::Byte(0), format!("not a readable LAS file: {other}")),
    }
}

impl Decoder {
    fn open(mut file: Spool, head: &Head) -> Result<Self, FormatError> {
        let end = Place::Byte(file.len());
        let places = Places { before: (head.number::<2>(94), head.number::<4>(100)), after: head.extended() };
        let records = records(&mut file, &places)?;
        check_layers(&mut file, head, &records)?;
        file.rewind()?;
        let reader = Reader::new(file).map_err(|why| refused(end, why))?;
        let header = reader.header();
        let format = *header.point_format();
        let mut dropped = Vec::new();
        if format.has_waveform {
            dropped.push("waveforms".to_owned());
        }
        let transforms = header.transforms();
        let axes = [transforms.x, transforms.y, transforms.z];
        let las = LasOrigin {
            point_format: format.to_u8().map_err(|why| refused(end, why))?,
            scale: axes.map(|t| t.scale),
            offset: axes.map(|t| t.offset),
            ..head.told()
        };
        let length = usize::from(format.len());
        let fields = layout::fields(format).into_iter();
        Ok(Self {
            end,
            left: header.number_of_points(),
            block: PointDataBuilder::new().for_header(header).build(),
            length,
            bare_length: length - usize::from(format.extra_bytes),
            axes,
            fields: fields.map(|field| FieldColumn { field, is_kept: field.always }).collect(),
            extra: extra_columns(&records, format.extra_bytes.into(), &mut dropped),
            las,
            records,
            dropped,
            reader,
        })
    }

    /// As [`Points::append`].
    fn append(&mut self, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if to.columns.is_empty() {
            let extra = self.extra.iter().map(|extra| Values::new(extra.kind()));
            to.columns = self.fields.iter().map(|column| column.field.column()).chain(extra).collect();
        }
        if self.left == 0 {
            return Ok(());
        }
        let most = (BLOCK / self.length.max(1)).max(1).min(rows) as u64;
        let got = self.reader.fill_points(most.min(self.left), &mut self.block);
        let got = got.map_err(|why| refused(self.end, why))?;
        if got == 0 {
            let why = format!("the header counts {} points more", self.left);
            return Err(FormatError::truncated(self.end, why));
        }
        self.left -= got;
        let rows = || self.block.raw_bytes().chunks_exact(self.length);
        let axes = self.axes;
        to.positions.extend(
            rows().map(|row| [0, 1, 2].map(|i| axes[i].direct(number::<4>(row, 4 * i) as u32 as i32))),
        );
        let (fields, extra) = to.columns.split_at_mut(self.fields.len());
        for (FieldColumn { field, is_kept }, column) in self.fields.iter_mut().zip(fields) {
            let from = column.len();
            field.take(rows(), column);
            *is_kept = *is_kept || (from..column.len()).any(|i| column.get(i) != 0.0);
        }
        for (described, column) in self.extra.iter().zip(extra) {
            described.take(rows(), self.bare_length, column);
        }
        Ok(())
    }

    fn finish(self) -> Result<Ending, FormatError> {
        let fields = self.fields.iter().map(|FieldColumn { field, is_kept }| {
            is_kept.then(|| ColumnName { name: field.name.to_owned(), kind: field.column().kind() })
        });
        let mut columns: Vec<Option<ColumnName>> = fields.collect();
        let mut described = Vec::new();
        for extra in self.extra {
            let (kind, mut name) = (extra.kind(), extra.name);
            while columns.iter().flatten().any(|column| column.name == name) {
                name.push('_');
            }
            described.push(LasExtra { name: name.clone(), entry: extra.entry });
            columns.push(Some(ColumnName { name, kind }));
        }
        let mut origin = Origin { crs: crs::read(&self.records), ..Origin::default() };
        for record in self.records.iter().filter(|record| role(record) == Role::Provenance) {
            origin.comments.extend(String::from_utf8_lossy(&record.data).lines().map(str::to_owned));
        }
        origin.extra = Some(cloud::Extra::new(LasOrigin {
            is_indexed: self.records.iter().any(|record| role(record) == Role::Index),
            records: self.records.into_iter().filter(|record| role(record) == Role::Other).collect(),
            extra: described,
            ..self.las
        }));
        Ok(Ending { columns, dropped_properties: self.dropped, notes: Vec::new(), origin })
    }
}
