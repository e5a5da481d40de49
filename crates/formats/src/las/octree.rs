//! Writing COPC: each node of an octree has some of the points in its space, one of each cell of a grid, and its eight parts have
//! the others.

use std::io::{Read, Seek, Write};

use laz::LazVlrBuilder;

use super::super::FormatError;
use super::super::spool::Spool;
use super::LasRecord;
use super::chunks::Chunk;
use super::hierarchy::{Cube, INFO, Info, Key, Node, cell, octant};
use super::pack::Packed;
use super::plan::{Plan, failed};
use super::records::number;
use super::write::{Frame, Making, count, packing};
use densecloud_cloud::{Attribute, Position};

/// Points of a node that is not parted, and most bytes of any node, whatever a point has.
const LEAF: u64 = 50_000;
const LONGEST: u64 = 16 << 20;

/// A node's grid has 2^7 cells along each edge.
const CELLS: u32 = 7;

/// Nodes that are this deep are not parted: their points lie at one place.
const DEEPEST: u32 = 24;

/// Bytes of a part that are held in memory.
const HELD: usize = 4 << 20;

/// Where the content of the first record begins.
const FIRST_RECORD: usize = 375 + 54;

/// Points as they come, which become an octree when all are there.
pub(super) struct IndexedRows {
    plan: Plan,
    points: u64,
    rows: Spool,
}

impl IndexedRows {
    pub(super) fn new(plan: Plan, points: u64) -> Self {
        Self { plan, points, rows: Spool::new() }
    }
}

impl Making for IndexedRows {
    fn add(
        &mut self,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        let stride = usize::from(self.plan.format.len());
        for (i, part) in positions.chunks(4096).enumerate() {
            let mut bytes = vec![0; part.len() * stride];
            self.plan.fill(&mut bytes, stride, part, attributes, from + 4096 * i);
            self.rows.write_all(&bytes)?;
        }
        Ok(())
    }

    fn file(mut self) -> Result<Spool, FormatError> {
        self.plan.records.insert(0, info_record());
        let mut octree = Octree::new(&self.plan)?;
        octree.node(Key::ROOT, self.rows)?;
        octree.end(&self.plan, self.points)
    }
}

/// The record about the octree, which the file must have first; its content is known at the end.
fn info_record() -> LasRecord {
    LasRecord {
        user_id: "copc".to_owned(),
        id: 1,
        description: "COPC info VLR".to_owned(),
        data: vec![0; INFO],
        is_extended: false,
    }
}

/// An octree in the making.
struct Octree {
    frame: Frame,
    packed: Packed,
    cube: Cube,
    axes: [las::Transform; 3],
    stride: usize,
    /// The nodes so far, and how many points each has.
    nodes: Vec<(Key, u64)>,
    times: [f64; 2],
}

impl Octree {
    fn new(plan: &Plan) -> Result<Self, FormatError> {
        let number = plan.format.to_u8().map_err(failed)?;
        let how = LazVlrBuilder::default().with_point_format(number, plan.format.extra_bytes);
        let how = how.map_err(packing)?.with_variable_chunk_size().build();
        let frame = Frame::packed(plan, &how)?;
        let (axes, reach) = (plan.axes, plan.reach.unwrap_or_default());
        let bounds = [0, 1, 2].map(|i| [reach[i].0, reach[i].1].map(|step| axes[i].direct(step)));
        Ok(Self {
            packed: Packed::new(Spool::new(), &frame.before, how)?,
            frame,
            cube: Cube::about(bounds),
            axes,
            stride: usize::from(plan.format.len()),
            nodes: Vec::new(),
            times: [f64::INFINITY, f64::NEG_INFINITY],
        })
    }

    /// Makes the node of these points, and those below it.
    fn node(&mut self, key: Key, mut points: Spool) -> Result<(), FormatError> {
        points.rewind()?;
        let most = (LONGEST / self.stride as u64).min(LEAF);
        if points.len() <= most * self.stride as u64 || key.level == DEEPEST {
            let mut rows = Vec::new();
            points.read_to_end(&mut rows)?;
            return self.chunk(key, rows);
        }
        let (own, parts) = self.parted(key.level, &mut points)?;
        drop(points);
        self.chunk(key, own)?;
        for (octant, part) in (0..).zip(parts) {
            if part.len() > 0 {
                self.node(key.child(octant), part)?;
            }
        }
        Ok(())
    }

    /// The first point in each cell of a node's grid, and all others by the eight parts of the node.
    fn parted(&self, level: u32, points: &mut Spool) -> Result<(Vec<u8>, [Spool; 8]), FormatError> {
        let mut own = Vec::new();
        let mut is_taken = vec![false; 1 << (3 * CELLS)];
        let mut parts: [Spool; 8] = std::array::from_fn(|_| Spool::with(HELD));
        let mut rows = Vec::new();
        loop {
            rows.clear();
            points.take(4096 * self.stride as u64).read_to_end(&mut rows)?;
            if rows.is_empty() {
                return Ok((own, parts));
            }
            for row in rows.chunks_exact(self.stride) {
                let place = self.cube.place(self.position(row));
                let cell = &mut is_taken[cell(place, level, CELLS)];
                if !*cell && (own.len() + row.len()) as u64 <= LONGEST {
                    *cell = true;
                    own.extend_from_slice(row);
                } else {
                    parts[octant(place, level) as usize].write_all(row)?;
                }
            }
        }
    }

    fn position(&self, row: &[u8]) -> Position {
        [0, 1, 2].map(|i| self.axes[i].direct(number::<4>(row, 4 * i) as u32 as i32))
    }

    /// Adds the points of a node.
    fn chunk(&mut self, key: Key, rows: Vec<u8>) -> Result<(), FormatError> {
        /// Where a point has its time.
        const TIME: usize = 22;
        for row in rows.chunks_exact(self.stride) {
            let time = f64::from_bits(number::<8>(row, TIME));
            self.times = [self.times[0].min(time), self.times[1].max(time)];
        }
        self.nodes.push((key, (rows.len() / self.stride) as u64));
        Ok(self.packed.add(rows)?)
    }

    /// The whole file of `points` points.
    fn end(self, plan: &Plan, points: u64) -> Result<Spool, FormatError> {
        let Self { mut frame, packed, cube, nodes, times, .. } = self;
        let before = &mut frame.before;
        let (mut file, table) = packed.end()?;
        let hierarchy = hierarchy(&nodes, before.len() as u64, table.as_ref())?;
        let end = file.len();
        file.write_all(&hierarchy)?;
        let records = number::<4>(before, 243) as u32 + 1;
        before[243..247].copy_from_slice(&records.to_le_bytes());
        count(before, plan, points, end)?;
        let page = (end + RECORD, hierarchy.len() as u64 - RECORD);
        let times = if times[0] <= times[1] { times } else { [0.0; 2] };
        let spacing = 2.0 * cube.half / f64::from(1_u32 << CELLS);
        let info = Info { cube, spacing, page, times }.bytes();
        before[FIRST_RECORD..FIRST_RECORD + INFO].copy_from_slice(&info);
        frame.about(file)
    }
}

/// Bytes of the head of a record behind the points.
const RECORD: u64 = 60;

/// The record that tells where each node's points are.
fn hierarchy(
    nodes: &[(Key, u64)],
    data: u64,
    table: &[laz::laszip::ChunkTableEntry],
) -> Result<Vec<u8>, FormatError> {
    let mut record = vec![0; RECORD as usize];
    record[2..6].copy_from_slice(b"copc");
    record[18..20].copy_from_slice(&1000_u16.to_le_bytes());
    record[20..28].copy_from_slice(&(32 * nodes.len() as u64).to_le_bytes());
    record[28..41].copy_from_slice(b"EPT Hierarchy");
    let mut at = data + 8;
    for (&(key, points), entry) in nodes.iter().zip(table) {
        let chunk = Chunk { at, bytes: entry.byte_count, points };
        let entry = Node { key, chunk }.entry();
        record.extend(entry.ok_or_else(|| {
            FormatError::NotWritten(format!("COPC has no room for {points} points at one place"))
        })?);
        at += chunk.bytes;
    }
    Ok(record)
}
