//! Writing: the header counts the points and their returns, and LAZ ends with a table that its beginning refers to.

use std::io::{Cursor, Seek, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};

use las::{Builder, Header, PointDataBuilder, Vector, Writer};

use super::super::FormatError;
use super::super::spool::Spool;
use super::Las;
use super::plan::{Plan, failed};
use super::records::{number, to_vlr};
use densecloud_cloud::{Attribute, Origin, Position};

/// Most points encoded at a time, and most bytes of them, whatever a point has.
const BLOCK: (usize, usize) = (1 << 16, 1 << 22);

/// Bytes of the header up to the end of the bounds.
const HEAD: usize = 227;

/// Writes a cloud. What comes from LAS keeps its version, point format, scale, offset and records; else
/// it is version 1.4, and scale and offset are those of [`Plan`].
///
/// LAS is written as it is encoded; LAZ as a whole first, into a [`Spool`].
///
/// # Errors
/// The sink fails, a coordinate is no number, or a point's attributes do not fit into 64 KiB.
pub(super) fn encode(
    las: Las,
    sink: &mut dyn Write,
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<(), FormatError> {
    let mut plan = Plan::new(positions, attributes, origin)?;
    plan.format.is_compressed = las.compressed;
    let write = if las.compressed { write_packed } else { write_plain };
    // A fault of another's code should be an answer, not the end of the program.
    catch_unwind(AssertUnwindSafe(|| write(plan, sink, positions)))
        .unwrap_or_else(|_| Err(FormatError::NotWritten("the LAS writer failed".into())))
}

fn write_plain(mut plan: Plan<'_>, sink: &mut dyn Write, positions: &[Position]) -> Result<(), FormatError> {
    let encoding = plan.encoding();
    let header = header(&mut plan)?;
    // A file without points: the header and the records, and behind them those that are to follow the points.
    let mut bare = Writer::new(Cursor::new(Vec::new()), header).map_err(failed)?;
    bare.close().map_err(failed)?;
    let mut before = bare.into_inner().map_err(failed)?.into_inner();
    let after = before.split_off(number::<4>(&before, 96) as usize);
    patch(&mut before, &plan, encoding);
    count(&mut before, &plan, positions.len() as u64)?;
    sink.write_all(&before)?;
    let stride = usize::from(plan.format.len());
    let mut rows = Vec::new();
    let mut from = 0;
    for part in positions.chunks(block(stride)) {
        rows.resize(part.len() * stride, 0);
        plan.fill(&mut rows, stride, part, from);
        sink.write_all(&rows)?;
        from += part.len();
    }
    Ok(sink.write_all(&after)?)
}

fn write_packed(mut plan: Plan<'_>, sink: &mut dyn Write, positions: &[Position]) -> Result<(), FormatError> {
    let encoding = plan.encoding();
    let header = header(&mut plan)?;
    let mut rows = PointDataBuilder::new().for_header(&header).build();
    let stride = rows.record_len();
    let mut writer = Writer::new(Spool::new(), header).map_err(failed)?;
    let mut from = 0;
    for part in positions.chunks(block(stride)) {
        plan.fill(rows.resize_for(part.len()), stride, part, from);
        writer.write_points(&rows).map_err(failed)?;
        from += part.len();
    }
    let mut file = writer.into_inner().map_err(failed)?;
    let mut head = [0; HEAD];
    file.read_at(0, &mut head)?;
    patch(&mut head, &plan, encoding);
    file.rewind()?;
    file.write_all(&head)?;
    file.rewind()?;
    std::io::copy(&mut file, sink)?;
    Ok(())
}

/// Points of `stride` bytes to encode at a time.
fn block(stride: usize) -> usize {
    let (points, bytes) = BLOCK;
    (bytes / stride.max(1)).clamp(1, points)
}

/// The header as the crate has it, with the plan's records.
fn header(plan: &mut Plan<'_>) -> Result<Header, FormatError> {
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
fn patch(head: &mut [u8], plan: &Plan<'_>, encoding: u16) {
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
fn count(before: &mut [u8], plan: &Plan<'_>, points: u64) -> Result<(), FormatError> {
    let short = |count: u64| u32::try_from(count).unwrap_or(0).to_le_bytes();
    let is_latest = plan.minor >= 4;
    if points > u64::from(u32::MAX) && !is_latest {
        return Err(FormatError::NotWritten(format!(
            "{points} points are too many for LAS before version 1.4"
        )));
    }
    let returns = plan.returns();
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
