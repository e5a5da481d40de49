//! Writing: the header counts the points and their returns, and LAZ ends with a table that its beginning refers to.

use std::fmt;
use std::io::{Cursor, Seek, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};

use las::{Builder, Header, Vector, Writer};
use laz::{LasZipError, LazVlr, LazVlrBuilder};

use super::super::FormatError;
use super::super::kind::{Begun, FirstPass, Rows};
use super::super::spool::Spool;
use super::octree::IndexedRows;
use super::pack::Packed;
use super::plan::{Plan, failed};
use super::records::{number, to_vlr};
use super::seen::Seen;
use super::{Form, LasRecord};
use densecloud_cloud::{Attribute, Origin, Position};

/// Points of a chunk, and most bytes of them, whatever a point has.
const CHUNK: usize = 50_000;
const LONGEST: usize = 16 << 20;

/// Begins a file. What comes from LAS keeps its version, point format, scale, offset and records; else it is version
/// 1.4, and scale and offset are those of [`Plan`].
///
/// # Errors
/// There are more points than the version counts, or records that it has no place for.
pub(super) fn begin(plan: Plan, form: Form, points: u64) -> Result<Begun, FormatError> {
    guarded(|| {
        let (before, rows): (Vec<u8>, Box<dyn Rows>) = match form {
            Form::Plain => plain(plan, points)?,
            Form::Packed => (Vec::new(), Box::new(Spooled(Some(PackedRows::new(plan, points)?)))),
            Form::Indexed => (Vec::new(), Box::new(Spooled(Some(IndexedRows::new(plan, points))))),
        };
        Ok((before, rows))
    })
}

/// Begins an uncompressed file.
fn plain(plan: Plan, points: u64) -> Result<Begun, FormatError> {
    let Frame { mut before, after } = Frame::of(&plan, Vec::new())?;
    let end = before.len() as u64 + points * u64::from(plan.format.len());
    count(&mut before, &plan, points, end)?;
    Ok((before, Box::new(PlainRows { plan, after })))
}

/// The whole compressed file of a cloud, from its beginning.
///
/// # Errors
/// As those of [`begin`], or a coordinate is no number, or the disk is full.
pub(super) fn whole(
    form: Form,
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<Spool, FormatError> {
    let mut seen = Seen::new(form, attributes, origin);
    seen.see(positions, attributes, 0)?;
    let (plan, points) = (Plan::new(&seen)?, positions.len() as u64);
    guarded(|| match form {
        Form::Indexed => made(IndexedRows::new(plan, points), positions, attributes),
        _ => made(PackedRows::new(plan, points)?, positions, attributes),
    })
}

fn made(
    mut making: impl Making,
    positions: &[Position],
    attributes: &[Attribute],
) -> Result<Spool, FormatError> {
    making.add(positions, attributes, 0)?;
    making.file()
}

/// A fault of another's code should be an answer, not the end of the program.
pub(super) fn guarded<T>(work: impl FnOnce() -> Result<T, FormatError>) -> Result<T, FormatError> {
    catch_unwind(AssertUnwindSafe(work))
        .unwrap_or_else(|_| Err(FormatError::NotWritten("the LAS writer failed".into())))
}

/// A file that is made in a spool.
pub(super) trait Making {
    /// Takes further points. The first point's attributes are at row `from`.
    fn add(
        &mut self,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError>;

    /// The whole file, from its beginning.
    fn file(self) -> Result<Spool, FormatError>;
}

/// The rows of such a file, until that is whole.
struct Spooled<M>(Option<M>);

impl<M: Making + Send> Rows for Spooled<M> {
    fn put(
        &mut self,
        _bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        let Some(making) = &mut self.0 else { return Ok(()) };
        guarded(|| making.add(positions, attributes, from))
    }

    fn end(&mut self, sink: &mut dyn Write) -> Result<(), FormatError> {
        if let Some(making) = self.0.take() {
            std::io::copy(&mut guarded(|| making.file())?, sink)?;
        }
        Ok(())
    }
}

impl<M> fmt::Debug for Spooled<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Spooled").finish_non_exhaustive()
    }
}

/// Rows as they stand in the file, and the records that follow them.
struct PlainRows {
    plan: Plan,
    after: Vec<u8>,
}

/// What lies about the points: the header with the records before them, and the records behind them.
pub(super) struct Frame {
    pub(super) before: Vec<u8>,
    pub(super) after: Vec<u8>,
}

impl Frame {
    /// That of a file without points; `more` records stand behind the plan's own.
    pub(super) fn of(plan: &Plan, more: Vec<LasRecord>) -> Result<Self, FormatError> {
        let mut bare = Writer::new(Cursor::new(Vec::new()), header(plan, more)?).map_err(failed)?;
        bare.close().map_err(failed)?;
        let mut before = bare.into_inner().map_err(failed)?.into_inner();
        let after = before.split_off(number::<4>(&before, 96) as usize);
        patch(&mut before, plan);
        Ok(Self { before, after })
    }

    /// That of a compressed one.
    pub(super) fn packed(plan: &Plan, how: &LazVlr) -> Result<Self, FormatError> {
        let mut frame = Self::of(plan, vec![compression(how)?])?;
        frame.before[104] |= 0x80;
        Ok(frame)
    }

    /// Completes a file that stands at its end, and goes to its beginning.
    pub(super) fn about(self, mut file: Spool) -> Result<Spool, FormatError> {
        file.write_all(&self.after)?;
        file.rewind()?;
        file.write_all(&self.before)?;
        file.rewind()?;
        Ok(file)
    }
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
    points: u64,
    frame: Frame,
    /// Bytes of a whole chunk, and of the next one as far as it goes.
    chunk: usize,
    rows: Vec<u8>,
    packed: Packed,
}

impl PackedRows {
    fn new(plan: Plan, points: u64) -> Result<Self, FormatError> {
        let (format, stride) = (plan.format, usize::from(plan.format.len()));
        let rows = (LONGEST / stride).min(CHUNK);
        let number = format.to_u8().map_err(failed)?;
        let how = LazVlrBuilder::default().with_point_format(number, format.extra_bytes);
        let how = how.map_err(packing)?.with_fixed_chunk_size(rows as u32).build();
        let frame = Frame::packed(&plan, &how)?;
        let packed = Packed::new(Spool::new(), &frame.before, how)?;
        Ok(Self { plan, points, frame, chunk: rows * stride, rows: Vec::new(), packed })
    }
}

impl Making for PackedRows {
    fn add(
        &mut self,
        mut positions: &[Position],
        attributes: &[Attribute],
        mut from: usize,
    ) -> Result<(), FormatError> {
        let stride = usize::from(self.plan.format.len());
        while !positions.is_empty() {
            let (begin, room) = (self.rows.len(), (self.chunk - self.rows.len()) / stride);
            let (part, rest) = positions.split_at(room.min(positions.len()));
            self.rows.resize(begin + part.len() * stride, 0);
            self.plan.fill(&mut self.rows[begin..], stride, part, attributes, from);
            if self.rows.len() == self.chunk {
                self.packed.add(std::mem::take(&mut self.rows))?;
            }
            (positions, from) = (rest, from + part.len());
        }
        Ok(())
    }

    fn file(mut self) -> Result<Spool, FormatError> {
        if !self.rows.is_empty() {
            self.packed.add(self.rows)?;
        }
        let (file, _) = self.packed.end()?;
        count(&mut self.frame.before, &self.plan, self.points, file.len())?;
        self.frame.about(file)
    }
}

/// The record that tells how points are compressed.
fn compression(how: &LazVlr) -> Result<LasRecord, FormatError> {
    let mut data = Vec::new();
    how.write_to(&mut data).map_err(|why| packing(why.into()))?;
    Ok(LasRecord {
        user_id: LazVlr::USER_ID.to_owned(),
        id: LazVlr::RECORD_ID,
        description: LazVlr::DESCRIPTION.to_owned(),
        data,
        is_extended: false,
    })
}

/// What the crate for compression has against a cloud.
pub(super) fn packing(why: LasZipError) -> FormatError {
    FormatError::NotWritten(why.to_string())
}

/// The header as the crate has it, with the plan's records and `more` of them.
fn header(plan: &Plan, more: Vec<LasRecord>) -> Result<Header, FormatError> {
    let mut builder = Builder::from((1, plan.minor));
    builder.generating_software = concat!("densecloud ", env!("CARGO_PKG_VERSION")).to_owned();
    builder.point_format = plan.format;
    let [x, y, z] = plan.axes;
    builder.transforms = Vector { x, y, z };
    for record in plan.records.iter().cloned().chain(more) {
        let list = if record.is_extended { &mut builder.evlrs } else { &mut builder.vlrs };
        list.push(to_vlr(record));
    }
    builder.into_header().map_err(failed)
}

/// What the header says that the `las` crate has other opinions of, or none: it rounds the bounds outwards once
/// more, for one.
fn patch(head: &mut [u8], plan: &Plan) {
    let mut put = |at: usize, word: &[u8]| head[at..at + word.len()].copy_from_slice(word);
    let las = &plan.las;
    put(4, &las.file_source_id.to_le_bytes());
    put(6, &plan.encoding().to_le_bytes());
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

/// Puts the number of points into a header that was made for none: at once, by return, and where they `end`.
pub(super) fn count(before: &mut [u8], plan: &Plan, points: u64, end: u64) -> Result<(), FormatError> {
    let short = |count: u64| u32::try_from(count).unwrap_or(0).to_le_bytes();
    let is_latest = plan.minor >= 4;
    if points > u64::from(u32::MAX) && !is_latest {
        return Err(FormatError::NotWritten(format!(
            "{points} points are too many for LAS before version 1.4"
        )));
    }
    let returns = plan.returns;
    let follow = if is_latest { number::<4>(before, 243) } else { 0 };
    let mut put = |at: usize, word: &[u8]| before[at..at + word.len()].copy_from_slice(word);
    if !plan.format.is_extended {
        put(107, &short(points));
        for (i, count) in returns.iter().take(5).enumerate() {
            put(111 + 4 * i, &short(*count));
        }
    }
    if is_latest {
        if follow > 0 {
            put(235, &end.to_le_bytes());
        }
        put(247, &points.to_le_bytes());
        put(255, &returns.map(u64::to_le_bytes).concat());
    }
    Ok(())
}
