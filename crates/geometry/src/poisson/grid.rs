//! Cells and nodes of a sparse grid, by keys that sort as their coordinates do.

use rayon::prelude::*;

/// A cell or a node, three coordinates in one number.
pub(super) type Key = u64;

/// Stands for a neighbour that is not there.
pub(super) const NONE: u32 = u32::MAX;

const BITS: u32 = 21;
const MASK: u64 = (1 << BITS) - 1;
/// Keys a task.
const CHUNK: usize = 4096;

/// Cells a side that keys can tell apart, with room for what is put about them.
pub(super) const MOST_ACROSS: f64 = (1 << 20) as f64;

/// Coordinates are counted from the grid's corner and never negative.
pub(super) fn key([x, y, z]: [u32; 3]) -> Key {
    (u64::from(x) << (2 * BITS)) | (u64::from(y) << BITS) | u64::from(z)
}

pub(super) fn coordinates(key: Key) -> [u32; 3] {
    [key >> (2 * BITS), (key >> BITS) & MASK, key & MASK].map(|c| c as u32)
}

/// What is added to a key to go that far.
pub(super) fn step([x, y, z]: [i64; 3]) -> i64 {
    (x << (2 * BITS)) + (y << BITS) + z
}

/// The corner `c` of a cell, or the cell that `c` stands for at a node: a bit an axis, x the lowest.
pub(super) fn bits(c: usize) -> [i64; 3] {
    [c & 1, (c >> 1) & 1, c >> 2].map(|bit| bit as i64)
}

/// The place of a neighbour in a row of 27.
pub(super) fn place([x, y, z]: [i64; 3]) -> usize {
    ((x + 1) * 9 + (y + 1) * 3 + z + 1) as usize
}

/// Sorted, each once.
pub(super) fn distinct(mut keys: Vec<Key>) -> Vec<Key> {
    keys.par_sort_unstable();
    keys.dedup();
    keys
}

/// Every key, moved by each of the steps.
pub(super) fn moved(keys: &[Key], steps: &[i64]) -> Vec<Key> {
    let about = |chunk: &[Key]| -> Vec<Key> {
        let mut all: Vec<Key> =
            chunk.iter().flat_map(|key| steps.iter().map(|s| key.wrapping_add_signed(*s))).collect();
        all.sort_unstable();
        all.dedup();
        all
    };
    distinct(keys.par_chunks(CHUNK).flat_map_iter(about).collect())
}

/// The corners of all cells.
pub(super) fn corners(cells: &[Key]) -> Vec<Key> {
    moved(cells, &std::array::from_fn::<i64, 8, _>(|c| step(bits(c))))
}

/// The cells twice as large that hold these, and those beside them.
pub(super) fn coarser(cells: &[Key]) -> Vec<Key> {
    let halved = |key: &Key| key_of_half(*key);
    let parents = distinct(cells.par_iter().map(halved).collect());
    let mut about = parents;
    for axis in 0..3 {
        let along = |by: i64| step(std::array::from_fn(|a| if a == axis { by } else { 0 }));
        about = moved(&about, &[along(-1), 0, along(1)]);
    }
    about
}

fn key_of_half(cell: Key) -> Key {
    key(coordinates(cell).map(|c| c >> 1))
}

/// For each of `from`, which is sorted, where in `among`, which is too, that key moved by each step is.
pub(super) fn find<const N: usize>(from: &[Key], among: &[Key], steps: [i64; N]) -> Vec<[u32; N]> {
    let in_chunk = |chunk: &[Key]| -> Vec<[u32; N]> {
        let start = |s: i64| among.partition_point(|k| *k < chunk[0].wrapping_add_signed(s));
        let mut at = steps.map(start);
        chunk.iter().map(|key| found(*key, among, steps, &mut at)).collect()
    };
    from.par_chunks(CHUNK).flat_map_iter(in_chunk).collect()
}

fn found<const N: usize>(from: Key, among: &[Key], steps: [i64; N], at: &mut [usize; N]) -> [u32; N] {
    std::array::from_fn(|n| {
        let wanted = from.wrapping_add_signed(steps[n]);
        while among.get(at[n]).is_some_and(|key| *key < wanted) {
            at[n] += 1;
        }
        if among.get(at[n]) == Some(&wanted) { at[n] as u32 } else { NONE }
    })
}

/// For each node, the eight nodes of the grid twice as coarse whose mean it is: those that it lies between, repeated where it
/// lies on their lines.
pub(super) fn parents(nodes: &[Key], coarse: &[Key]) -> Vec<[u32; 8]> {
    let of = |node: &Key| {
        let c = coordinates(*node);
        std::array::from_fn(|n| {
            let towards = bits(n);
            let parent = key(std::array::from_fn(|a| (c[a] + towards[a] as u32) >> 1));
            coarse.binary_search(&parent).map_or(NONE, |at| at as u32)
        })
    };
    nodes.par_iter().with_min_len(CHUNK).map(of).collect()
}
