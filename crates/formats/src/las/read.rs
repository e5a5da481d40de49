//! Reading.

use std::io::ErrorKind;
use std::panic::{AssertUnwindSafe, catch_unwind};

use las::{PointData, PointDataBuilder, Reader, Transform};
use laz::LazVlr;

use super::super::columns::MAX_COLUMNS;
use super::super::kind::Opened;
use super::super::names::Apart;
use super::super::reader::{Block, ColumnName, Ending, Points};
use super::super::reading::Bounds;
use super::super::source::Source;
use super::super::spool::Spool;
use super::super::{Format, FormatError, Header, Limits, Place, Reading};
use super::chunks::{Chunk, Chunks, are_short, chunks_of, count_so};
use super::extra::{Extra, extra_columns};
use super::head::{Counts, Head, LONGEST, Rewritten, SHORTEST};
use super::hierarchy::Info;
use super::layout::{self, Field};
use super::records::{Places, RecordRole, is_compression, number, records, role};
use super::{LasExtra, LasOrigin, LasRecord, check, crs};
use densecloud_cloud::{self as cloud, Origin, Values};

/// Bytes of points decoded at a time, which a core's cache holds while each field is taken from them. The bound is in
/// bytes, because the header may claim any number of points and any length of one.
const BLOCK: usize = 1 << 18;

/// What the fixed part of the header tells; the rest is read with the points. `format`: that of a file whose points are
/// compressed, or not.
pub(super) fn open(
    source: &mut Source<'_>,
    limits: Limits,
    reading: &Reading,
    format: impl FnOnce(bool) -> Format,
) -> Result<Opened, FormatError> {
    let head = source.peek(LONGEST)?;
    if head.len() < SHORTEST {
        return Err(FormatError::truncated(Place::Byte(head.len() as u64), "the LAS header is incomplete"));
    }
    let points = Counts::of(head).points();
    limits.check_points(points)?;
    let header = Header {
        // The top bits of the point format mean compression.
        format: format(head[104] & 0xC0 != 0),
        points: Some(points),
        attributes: Vec::new(),
        dropped_properties: Vec::new(),
    };
    Ok(Opened { header, points: Box::new(LasPoints { bounds: reading.bounds, decoder: None }) })
}

/// The points of a file, which is opened with the first of them.
struct LasPoints {
    /// Those that are wanted; others that lie in one chunk with them are given, too.
    bounds: Option<Bounds>,
    decoder: Option<Decoder>,
}

/// The points of an open file.
struct Decoder {
    rows: Rows,
    /// As long as the file is.
    end: Place,
    /// Points that are left to read.
    left: u64,
    /// Bytes a point, those of the extra bytes among them, and without them.
    length: usize,
    bare_length: usize,
    axes: [Transform; 3],
    fields: Vec<FieldColumn>,
    extra: Vec<Extra>,
    las: LasOrigin,
    records: Vec<LasRecord>,
    dropped: Vec<String>,
    notes: Vec<String>,
}

/// Where the bytes of points come from.
enum Rows {
    /// One point after another.
    Plain { reader: Reader, block: PointData },
    /// Several chunks at a time.
    Chunks(Chunks),
}

/// A field, which is kept if it always is or is somewhere not zero.
struct FieldColumn {
    field: Field,
    is_kept: bool,
}

impl Points for LasPoints {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if self.decoder.is_none() {
            let mut file = source.stored()?;
            let head = Head::of(&mut file)?;
            check::places(&mut file, &head)?;
            let end = Place::Byte(file.len());
            self.decoder = Some(guarded(end, || Decoder::open(file, &head, self.bounds.as_ref()))?);
        }
        match &mut self.decoder {
            Some(decoder) => guarded(decoder.end, || decoder.append(rows, to)),
            None => Ok(()),
        }
    }

    fn finish(self: Box<Self>, _source: &mut Source<'_>) -> Result<Ending, FormatError> {
        self.decoder.map_or_else(|| Ok(Ending::of_text(std::iter::empty())), Decoder::finish)
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

/// The nodes of COPC that reach into some bounds.
fn near(
    file: &mut Spool,
    info: &Info,
    bounds: &Bounds,
    points: u64,
    how: &LazVlr,
) -> Result<Vec<Chunk>, FormatError> {
    let chunks = info.within(file, bounds, points)?;
    if count_so(file, &chunks, how)? {
        return Ok(chunks);
    }
    let why = "COPC's hierarchy has other points in a node than the node itself";
    Err(FormatError::malformed(Place::Byte(info.page.0), why))
}

impl Rows {
    /// Those of a file, and how many there are: all, or, where it is COPC, those of the nodes that reach into the bounds.
    fn of(
        mut file: Spool,
        head: &Head,
        records: &[LasRecord],
        header: &las::Header,
        bounds: Option<&Bounds>,
    ) -> Result<(Self, u64), FormatError> {
        let (end, points) = (Place::Byte(file.len()), header.number_of_points());
        let compression = records.iter().find(|record| is_compression(record));
        if let Some(LasRecord { data, .. }) = compression.filter(|_| head.is_compressed()) {
            let how = LazVlr::from_buffer(data).map_err(|why| refused(end, why.into()))?;
            let near = match (bounds, Info::of(records)) {
                (Some(bounds), Some(info)) => Some(near(&mut file, &info, bounds, points, &how)?),
                _ => None,
            };
            let chunks = match near.filter(|chunks| are_short(chunks, &how)) {
                None => chunks_of(&mut file, head, data, points)?,
                near => near,
            };
            if let Some(chunks) = chunks {
                let left = chunks.iter().map(|chunk| chunk.points).sum();
                return Ok((Self::Chunks(Chunks::new(file, how, chunks)), left));
            }
        }
        let reader = Reader::new(Rewritten::new(file, head)?).map_err(|why| refused(end, why))?;
        Ok((Self::Plain { reader, block: PointDataBuilder::new().for_header(header).build() }, points))
    }

    /// The next points, at most `most` of them; none where there are no more.
    fn next(&mut self, most: u64) -> Result<&[u8], las::Error> {
        match self {
            Self::Plain { reader, block } => {
                reader.fill_points(most, block)?;
                Ok(block.raw_bytes())
            }
            Self::Chunks(chunks) => Ok(chunks.next(most)?),
        }
    }
}

impl Decoder {
    fn open(mut file: Spool, head: &Head, bounds: Option<&Bounds>) -> Result<Self, FormatError> {
        let end = Place::Byte(file.len());
        let places = Places { before: (head.number::<2>(94), head.number::<4>(100)), after: head.extended() };
        let records = records(&mut file, &places)?;
        let notes = check::counts(&mut file, head, &records)?;
        let mut file = Rewritten::new(file, head)?;
        let header = las::Header::new(&mut file).map_err(|why| refused(end, why))?;
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
        let extra = extra_columns(&records, format.extra_bytes.into(), &mut dropped);
        if extra.len() > MAX_COLUMNS {
            let why = format!("extra bytes of {} names; more than {MAX_COLUMNS} are not read", extra.len());
            return Err(FormatError::malformed(end, why));
        }
        let fields = layout::fields(format).into_iter();
        let (rows, left) = Rows::of(file.into_inner(), head, &records, &header, bounds)?;
        Ok(Self {
            end,
            left,
            rows,
            length,
            bare_length: length - usize::from(format.extra_bytes),
            axes,
            fields: fields.map(|field| FieldColumn { field, is_kept: field.always }).collect(),
            extra,
            las,
            records,
            dropped,
            notes,
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
        let bytes = self.rows.next(most.min(self.left)).map_err(|why| refused(self.end, why))?;
        if bytes.is_empty() {
            let why = format!("the header counts {} points more", self.left);
            return Err(FormatError::truncated(self.end, why));
        }
        self.left -= (bytes.len() / self.length) as u64;
        let rows = || bytes.chunks_exact(self.length);
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
        let kept = columns.iter().flatten().map(|column| column.name.as_str());
        let names: Vec<&str> = kept.chain(self.extra.iter().map(|extra| extra.name.as_str())).collect();
        let names = Apart::all(&names).split_off(names.len() - self.extra.len());
        let mut described = Vec::new();
        for (extra, name) in self.extra.into_iter().zip(names) {
            columns.push(Some(ColumnName { name: name.clone(), kind: extra.kind() }));
            described.push(LasExtra { name, entry: extra.entry });
        }
        let mut origin = Origin { crs: crs::read(&self.records), ..Origin::default() };
        for record in self.records.iter().filter(|record| role(record) == RecordRole::Provenance) {
            origin.comments.extend(String::from_utf8_lossy(&record.data).lines().map(str::to_owned));
        }
        origin.extra = Some(cloud::Extra::new(LasOrigin {
            is_indexed: self.records.iter().any(|record| role(record) == RecordRole::Index),
            records: self.records.into_iter().filter(|record| role(record) == RecordRole::Other).collect(),
            extra: described,
            ..self.las
        }));
        Ok(Ending { columns, dropped_properties: self.dropped, notes: self.notes, origin })
    }
}
