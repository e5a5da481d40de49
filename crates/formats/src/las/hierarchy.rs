//! COPC's octree: where its nodes are in space, and where in the file.

use std::io;

use super::super::reading::Bounds;
use super::super::spool::Spool;
use super::super::{FormatError, Place};
use super::LasRecord;
use super::chunks::Chunk;
use super::records::number;
use densecloud_cloud::Position;

/// Bytes of an entry: a node's key, and where its points are.
const ENTRY: usize = 32;

/// Bytes of the record that tells of the octree.
pub(super) const INFO: usize = 160;

/// Bits of a point's place along an edge of the octree.
const BITS: u32 = 31;

/// A node of the octree: its depth, and its place among the nodes of that depth, along each axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Key {
    pub(super) level: u32,
    pub(super) at: [u32; 3],
}

impl Key {
    pub(super) const ROOT: Self = Self { level: 0, at: [0; 3] };

    /// The one of its eight parts that has a bit for each axis.
    pub(super) fn child(self, octant: u32) -> Self {
        let at = [0, 1, 2].map(|axis| self.at[axis] << 1 | octant >> axis & 1);
        Self { level: self.level + 1, at }
    }
}

/// The space that the root has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cube {
    pub(super) centre: Position,
    pub(super) half: f64,
}

impl Cube {
    /// The one about the middle of these bounds.
    pub(super) fn about(bounds: [[f64; 2]; 3]) -> Self {
        let largest = bounds.into_iter().map(|[least, greatest]| greatest - least).fold(0.0, f64::max);
        let half = if largest > 0.0 { largest / 2.0 } else { 1.0 };
        Self { centre: bounds.map(|[least, greatest]| least / 2.0 + greatest / 2.0), half }
    }

    /// Where a point lies along each edge, in parts of 2^-31 of it: the first bits are its node's place.
    pub(super) fn place(&self, point: Position) -> [u32; 3] {
        /// The most that there is.
        const LAST: f64 = ((1_u64 << BITS) - 1) as f64;
        [0, 1, 2].map(|axis| {
            let share = (point[axis] - (self.centre[axis] - self.half)) / (2.0 * self.half);
            (share * (1_u64 << BITS) as f64).clamp(0.0, LAST) as u32
        })
    }

    /// Whether a node may have points within some bounds. What writers round is added to it.
    fn reaches(&self, key: Key, bounds: &Bounds) -> bool {
        let edge = 2.0 * self.half / f64::from(key.level).exp2();
        let spare = 1e-6 * self.half;
        let box_of = |axis: usize| {
            let least = self.centre[axis] - self.half + edge * f64::from(key.at[axis]);
            [least - spare, least + edge + spare]
        };
        bounds.meets([0, 1, 2].map(box_of))
    }
}

/// The number of the cell, of 2^`bits` along an edge, of a node of that level that a place lies in.
pub(super) fn cell(place: [u32; 3], level: u32, bits: u32) -> usize {
    let part = |at: u32| (at >> (BITS - level - bits) & ((1 << bits) - 1)) as usize;
    place.into_iter().fold(0, |cell, at| cell << bits | part(at))
}

/// The part of a node of that level that a place lies in: a bit for each axis.
pub(super) fn octant(place: [u32; 3], level: u32) -> u32 {
    [0, 1, 2].into_iter().map(|axis| (place[axis] >> (BITS - level - 1) & 1) << axis).sum()
}

/// A node that has points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub(super) key: Key,
    pub(super) chunk: Chunk,
}

impl Node {
    /// Its entry in the hierarchy; none where its chunk is longer than an entry can tell.
    pub(super) fn entry(&self) -> Option<[u8; ENTRY]> {
        let (Key { level, at: [x, y, z] }, chunk) = (self.key, self.chunk);
        let [bytes, points] = [chunk.bytes, chunk.points].map(|count| i32::try_from(count).ok());
        let mut entry = [0; ENTRY];
        for (place, word) in entry.chunks_exact_mut(4).zip([level, x, y, z]) {
            place.copy_from_slice(&word.to_le_bytes());
        }
        entry[16..24].copy_from_slice(&chunk.at.to_le_bytes());
        entry[24..28].copy_from_slice(&bytes?.to_le_bytes());
        entry[28..].copy_from_slice(&points?.to_le_bytes());
        Some(entry)
    }
}

/// What the record about the octree tells of a file without points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Info {
    pub(super) cube: Cube,
    /// Distance of points in the root.
    pub(super) spacing: f64,
    /// The root's page: its first byte, and its bytes.
    pub(super) page: (u64, u64),
    /// The least and the greatest time.
    pub(super) times: [f64; 2],
}

impl Info {
    /// From the record, if a file has one.
    pub(super) fn of(records: &[LasRecord]) -> Option<Self> {
        let record = records.iter().find(|record| record.user_id == "copc" && record.id == 1)?;
        let data = record.data.get(..INFO)?;
        let real = |i: usize| f64::from_bits(number::<8>(data, 8 * i));
        let cube = Cube { centre: [real(0), real(1), real(2)], half: real(3) };
        let page = (number::<8>(data, 40), number::<8>(data, 48));
        Some(Self { cube, spacing: real(4), page, times: [real(7), real(8)] })
    }

    /// The record's content.
    pub(super) fn bytes(&self) -> [u8; INFO] {
        let [x, y, z] = self.cube.centre;
        let reals = |numbers: &[f64]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>();
        let (from, bytes) = self.page;
        let mut all = reals(&[x, y, z, self.cube.half, self.spacing]);
        all.extend([from, bytes].map(u64::to_le_bytes).concat());
        all.extend(reals(&self.times));
        let mut info = [0; INFO];
        info[..all.len()].copy_from_slice(&all);
        info
    }

    /// The chunks of all nodes that may have points within some bounds, in the file's order. The whole hierarchy is read for
    /// it, and no point.
    ///
    /// # Errors
    /// The hierarchy is not inside the file, or does not have the file's `points`.
    pub(super) fn within(
        &self,
        file: &mut Spool,
        bounds: &Bounds,
        points: u64,
    ) -> Result<Vec<Chunk>, FormatError> {
        let broken = |why: &str| FormatError::malformed(Place::Byte(self.page.0), why);
        let nodes = self.nodes(file)?.ok_or_else(|| broken("COPC's hierarchy is not inside the file"))?;
        let there = nodes.iter().fold(0_u64, |sum, node| sum.saturating_add(node.chunk.points));
        if there != points {
            let why = format!("COPC's hierarchy has {there} points, the header counts {points}");
            return Err(broken(&why));
        }
        let is_near = |node: &&Node| self.cube.reaches(node.key, bounds);
        let mut chunks: Vec<Chunk> = nodes.iter().filter(is_near).map(|node| node.chunk).collect();
        chunks.sort_by_key(|chunk| chunk.at);
        Ok(chunks)
    }

    /// All nodes that have points; none where pages or a chunk are not inside the file.
    fn nodes(&self, file: &mut Spool) -> io::Result<Option<Vec<Node>>> {
        let (mut pages, mut nodes, mut read) = (vec![self.page], Vec::new(), 0_u64);
        let inside = |at: u64, bytes: u64, len: u64| at.checked_add(bytes).is_some_and(|end| end <= len);
        while let Some((at, bytes)) = pages.pop() {
            // Pages that overlap, or lead back to each other, are longer than the file.
            read = read.saturating_add(bytes.max(1));
            if !inside(at, bytes, file.len()) || read > file.len() {
                return Ok(None);
            }
            // It lies within the file.
            let mut page = vec![0; bytes as usize];
            file.read_at(at, &mut page)?;
            for entry in page.chunks_exact(ENTRY) {
                let [level, x, y, z] = [0, 4, 8, 12].map(|from| number::<4>(entry, from) as u32);
                let (at, bytes) = (number::<8>(entry, 16), number::<4>(entry, 24));
                match number::<4>(entry, 28) as u32 as i32 {
                    -1 => pages.push((at, bytes)),
                    0 => {}
                    points if points > 0 && level <= BITS && inside(at, bytes, file.len()) => {
                        let chunk = Chunk { at, bytes, points: u64::from(points.unsigned_abs()) };
                        nodes.push(Node { key: Key { level, at: [x, y, z] }, chunk });
                    }
                    _ => return Ok(None),
                }
            }
        }
        Ok(Some(nodes))
    }
}
