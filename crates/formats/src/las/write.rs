//! Writing: the header counts the points and their returns, and LAZ ends with a table that its beginning refers to.

use std::fmt;
use std::io::{Cursor, Seek, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};

use las::{Builder, Header, PointData, PointDataBuilder, Vector, Writer};

use super::super::FormatError;
use super::super::kind::{Begun, FirstPass, Rows};
use super::super::spool::Spool;
use super::Las;
use super::plan::{Plan, failed};
use super::records::{number, to_vlr};
use super::seen::Seen;
use densecloud_cloud::{Attribute, Origin, Position};

/// Most points encoded at a time, and most bytes of them, whatever a point has.
const BLOCK: (usize, usize) = (1 << 16, 1 << 22);

/// Bytes of the header up to the end of the bounds.
const HEAD: usize = 227;

/// Begins a file. What comes from LAS keeps its version, point format, scale, offset and records; else it is version
/// 1.4, and scale and offset are those of [`Plan`].
///
/// # Errors
/// There are more points than the version counts, or records that it has no place for.
pub(super) fn begin(mut plan: Plan, las: Las, points: u64) -> Result<Begun, FormatError> {
    plan.format.is_compressed = las.compressed;
    guarded(|| {
        if las.compressed {
            return Ok((Vec::new(), Box::new(PackedRows::new(plan)?) as Box<dyn Rows>));
        }
        let (header, rows) = plain(plan, points)?;
        Ok((header, Box::new(rows) as Box<dyn Rows>))
    })
}

/// The whole compressed file of a cloud, from its beginning.
///
/// # Errors
/// As those of [`begin`], or a coordinate is no number, or the disk is full.
pub(super) fn packed(
    las: Las,
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<Spool, FormatError> {
    let mut seen = Seen::new(las, attributes, origin);
    seen.see(positions, attributes, 0)?;
    let mut plan = Plan::new(&seen)?;
    plan.format.is_compressed = las.compressed;
    guarded(|| {
        let mut rows = PackedRows::new(plan)?;
        rows.pack(positions, attributes, 0)?;
        Ok(rows.file()?.unwrap_or_else(Spool::new))
    })
}

/// A fault of another's code should be an answer, not the end of the program.
fn guarded<T>(work: impl FnOnce() -> Result<T, FormatError>) -> Result<T, FormatError> {
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|_| Err(FormatError::NotWritten("the LAS writer failed".into())))
}

/// Rows as they stand in the file, and the records that follow them.
struct PlainRows {
    plan: Plan,
    after: Vec<u8>,
}

/// The header of an uncompressed file, with the records before the points.
fn plain(mut plan: Plan, points: u64) -> Result<(Vec<u8>, PlainRows), FormatError> {
    let encoding = plan.encoding();
    let header = header(&mut plan)?;
    // A file without points: the header and the records, and behind them those that are to follow the points.
    let mut bare = Writer::new(Cursor::new(Vec::new()), header).map_err(failed)?;
    bare.close().map_err(failed)?;
    let mut before = bare.into_inner().map_err(failed)?.into_inner();
    let after = before.split_off(number::<4>(&before, 96) as usize);
    patch(&mut before, &plan, encoding);
    count(&mut before, &plan, points)?;
    Ok((before, PlainRows { plan, after }))
}

impl Rows for PlainRows {
    fn put(
        &mut self,
        bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        let stride = usize::from(self.plan.format.len());
        let begin = bytes.len();
        bytes.resize(begin + positions.len() * stride, 0);
        self.plan.fill(&mut bytes[begin..], stride, positions, attributes, from);
        Ok(())
    }

    fn end(&mut self, sink: &mut dyn Write) -> Result<(), FormatError> {
        Ok(sink.write_all(&self.after)?)
    }
}

impl fmt::Debug for PlainRows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PlainRows").finish_non_exhaustive()
    }
}

/// A file that is compressed into a spool.
struct PackedRows {
    plan: Plan,
    encoding: u16,
    rows: PointData,
    /// Until the file is whole.
    writer: Option<Writer<Spool>>,
}

impl PackedRows {
    fn new(mut plan: Plan) -> Result<Self, FormatError> {
        let encoding = plan.encoding();
        let header = header(&mut plan)?;
        let rows = PointDataBuilder::new().for_header(&header).build();
        let writer = Some(Writer::new(Spool::new(), header).map_err(failed)?);
        Ok(Self { plan, encoding, rows, writer })
    }

    /// Compresses further points. The first point's attributes are at row `from`.
    fn pack(
        &mut self,
        positions: &[Position],
        attributes: &[Attribute],
        mut from: usize,
    ) -> Result<(), FormatError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        let stride = self.rows.record_len();
        for part in positions.chunks(block(stride)) {
            self.plan.fill(self.rows.resize_for(part.len()), stride, part, attributes, from);
            writer.write_points(&self.rows).map_err(failed)?;
            from += part.len();
        }
        Ok(())
    }

    /// The whole file, from its beginning; once.
    fn file(&mut self) -> Result<Option<Spool>, FormatError> {
        let Some(writer) = self.writer.take() else { return Ok(None) };
        let mut file = writer.into_inner().map_err(failed)?;
        let mut head = [0; HEAD];
        file.read_at(0, &mut head)?;
        patch(&mut head, &self.plan, self.encoding);
        file.rewind()?;
        file.write_all(&head)?;
        file.rewind()?;
        Ok(Some(file))
    }
}

impl Rows for PackedRows {
    fn put(
        &mut self,
        _bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        guarded(|| self.pack(positions, attributes, from))
    }

    fn end(&mut self, sink: &mut dyn Write) -> Result<(), FormatError> {
        if let Some(mut file) = guarded(|| self.file())? {
            std::io::copy(&mut file, sink)?;
        }
        Ok(())
    }
}

impl fmt::Debug for PackedRows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PackedRows").finish_non_exhaustive()
    }
}

/// Points of `stride` bytes to encode at a time.
fn block(stride: usize) -> usize {
    let (points, bytes) = BLOCK;
    (bytes / stride.max(1)).clamp(1, points)
}

/// The header as the crate has it, with the plan's records.
fn header(plan: &mut Plan) -> Result<Header, FormatError> {
    let mut builder = Builder::from((1, plan.minor));
    builder.generating_software = concat!("densecloud ", env!("CARGO_PKG_VERSION")).to_owned();
    builder.point_format = plan.format;
    let [x, y, z] = plan.axes;
    builder.transforms = Vector { x, y, z };
    for record in std::mem::take(&mut plan.records) {
        let list = if record.is_extended { &mut builder.evlrs } else { &mut builder.vlrs };
        list.push(to_vlr(record));
    }
    builder.into_header().map_err(failed)
}

/// What the header says that the `las` crate has other opinions of, or none: it rounds the bounds outwards once
/// more, for one.
fn patch(head: &mut [u8], plan: &Plan, encoding: u16) {
    let mut put = |at: usize, word: &[u8]| head[at..at + word.len()].copy_from_slice(word);
    let las = &plan.las;
    put(4, &las.file_source_id.to_le_bytes());
    put(6, &encoding.to_le_bytes());
    put(8, &las.guid);
    put(26, &las.system_identifier);
    put(90, &las.created.0.to_le_bytes());
    put(92, &las.created.1.to_le_bytes());
    if plan.format.is_extended {
        // The counts of before version 1.4 are for the point formats of before.
        put(107, &[0; 24]);
    }
    for (i, axis) in plan.axes.iter().enumerate() {
        let bounds = plan.reach.map_or([0.0; 2], |reach| [reach[i].1, reach[i].0].map(|n| axis.direct(n)));
        put(179 + 16 * i, &bounds.map(f64::to_le_bytes).concat());
    }
}

/// Puts the number of points into a header that was made for none: at once, by return, and where they end.
fn count(before: &mut [u8], plan: &Plan, points: u64) -> Result<(), FormatError> {
    let short = |count: u64| u32::try_from(count).unwrap_or(0).to_le_bytes();
    let is_latest = plan.minor >= 4;
    if points > u64::from(u32::MAX) && !is_latest {
        return Err(FormatError::NotWritten(format!(
            "{points} points are too many for LAS before version 1.4"
        )));
    }
    let returns = plan.returns;
    let (data, follow) = (before.len() as u64, if is_latest { number::<4>(before, 243) } else { 0 });
    let mut put = |at: usize, word: &[u8]| before[at..at + word.len()].copy_from_slice(word);
    if !plan.format.is_extended {
        put(107, &short(points));
        for (i, count) in returns.iter().take(5).enumerate() {
            put(111 + 4 * i, &short(*count));
        }
    }
    if is_latest {
        if follow > 0 {
            put(235, &(data + points * u64::from(plan.format.len())).to_le_bytes());
        }
        put(247, &points.to_le_bytes());
        put(255, &returns.map(u64::to_le_bytes).concat());
    }
    Ok(())
}
