//! Which points of a cloud are sent: all, or as many as are wanted, each as likely as any other.
//!
//! Each point has a key of its own, by its place in the file and nothing else. Those of the least keys are kept, and sent in
//! the order of their keys: so any first part of what is sent is an even sample, the same each time, and memory is that of
//! what is kept, however long the file.

use super::asked::Order;
use densecloud_cloud::{Kind, Position, Values};
use densecloud_formats::Block;

/// Points that are kept so far.
pub(super) struct Sample {
    order: Order,
    limit: usize,
    /// Only points with keys below this may still be among those that are wanted.
    below: u64,
    keys: Vec<u64>,
    /// About the anchor.
    pub(super) positions: Vec<[f32; 3]>,
    /// The other columns. Their numbers are to be shown, for which 32 bits do.
    pub(super) columns: Vec<Vec<f32>>,
    /// The first point, about which the others are told: 32 bits tell differences, not places.
    pub(super) anchor: Option<Position>,
    /// All that came, and those of them that are nowhere.
    pub(super) seen: u64,
    pub(super) nowhere: u64,
    pub(super) least: Position,
    pub(super) greatest: Position,
}

impl Sample {
    /// Of at most so many points.
    pub(super) fn new(limit: usize, order: Order) -> Self {
        Self {
            order,
            limit,
            below: u64::MAX,
            keys: Vec::new(),
            positions: Vec::new(),
            columns: Vec::new(),
            anchor: None,
            seen: 0,
            nowhere: 0,
            least: [f64::INFINITY; 3],
            greatest: [f64::NEG_INFINITY; 3],
        }
    }

    /// Bytes that it takes, at most, until its points are sent.
    pub(super) fn bytes(&self) -> u64 {
        // While they are sorted, keys stand beside their places, too.
        let row = size_of::<u64>() + size_of::<(u64, u32)>() + size_of::<[f32; 3]>() + 4 * self.columns.len();
        (self.len() * row) as u64
    }

    /// Takes the next points of the file.
    pub(super) fn take(&mut self, block: &Block) {
        let mut rows = Vec::new();
        for (row, position) in block.positions.iter().enumerate() {
            let key = self.key(self.seen);
            self.seen += 1;
            if !position.iter().all(|part| part.is_finite()) {
                self.nowhere += 1;
                continue;
            }
            self.bound(position);
            if key < self.below {
                self.keys.push(key);
                rows.push(row as u32);
            }
        }
        self.append(&block.gather(&rows));
        if self.keys.len() > self.limit + self.limit / 4 {
            self.prune();
        }
    }

    /// Different for each place.
    fn key(&self, place: u64) -> u64 {
        match self.order {
            Order::File => place,
            Order::Shuffled => mixed(place),
        }
    }

    fn bound(&mut self, position: &Position) {
        self.least = std::array::from_fn(|axis| self.least[axis].min(position[axis]));
        self.greatest = std::array::from_fn(|axis| self.greatest[axis].max(position[axis]));
    }

    fn append(&mut self, block: &Block) {
        let Some(first) = block.positions.first() else { return };
        let anchor = *self.anchor.get_or_insert(*first);
        self.positions
            .extend(block.positions.iter().map(|p| [0, 1, 2].map(|axis| (p[axis] - anchor[axis]) as f32)));
        self.columns.resize_with(block.columns.len(), Vec::new);
        for (column, values) in self.columns.iter_mut().zip(&block.columns) {
            if let Values::F32(mut numbers) = values.clone().cast(Kind::F32) {
                column.append(&mut numbers);
            }
            // A column of text ends where it turns out to be none.
            column.resize(self.positions.len(), f32::NAN);
        }
    }

    /// Lets go of all but the points with the least keys.
    fn prune(&mut self) {
        let mut keys = self.keys.clone();
        let (_, below, _) = keys.select_nth_unstable(self.limit);
        self.below = *below;
        let kept: Vec<bool> = self.keys.iter().map(|key| *key < self.below).collect();
        keep(&mut self.keys, &kept);
        keep(&mut self.positions, &kept);
        self.columns.iter_mut().for_each(|column| keep(column, &kept));
    }

    /// How many are kept.
    pub(super) fn len(&self) -> usize {
        self.keys.len()
    }

    /// The rows in the order in which they are sent. O(n log n).
    pub(super) fn sort(&mut self) -> Vec<u32> {
        if self.len() > self.limit {
            self.prune();
        }
        let keys = std::mem::take(&mut self.keys);
        let mut rows: Vec<(u64, u32)> = keys.into_iter().zip(0..).collect();
        if self.order == Order::Shuffled {
            rows.sort_unstable();
        }
        rows.into_iter().map(|(_, row)| row).collect()
    }
}

fn keep<T>(all: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    all.retain(|_| kept.next() == Some(&true));
}

/// A number for each number, each for one alone, in no order that shows: the finaliser of SplitMix64.
fn mixed(place: u64) -> u64 {
    let z = place.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points along x, with their places as a column.
    fn block(places: std::ops::Range<u64>) -> Block {
        let column = Values::I64(places.clone().map(|i| i as i64).collect());
        Block { positions: places.map(|i| [1e6 + i as f64, 0.0, 0.0]).collect(), columns: vec![column] }
    }

    /// The places of the points that are sent, of a hundred thousand.
    fn sent(limit: usize, order: Order, blocks: u64) -> Vec<f32> {
        let mut sample = Sample::new(limit, order);
        for i in 0..blocks {
            sample.take(&block(i * 100_000 / blocks..(i + 1) * 100_000 / blocks));
        }
        assert_eq!((sample.seen, sample.anchor), (100_000, Some([1e6 + first(&sample), 0.0, 0.0])));
        let rows = sample.sort();
        rows.iter().map(|row| sample.columns[0][*row as usize]).collect()
    }

    /// The place of the point about which the others are told.
    fn first(sample: &Sample) -> f64 {
        f64::from(sample.columns[0][0] - sample.positions[0][0])
    }

    #[test]
    fn any_first_part_is_an_even_sample_however_the_points_come() {
        let all = sent(100_000, Order::Shuffled, 7);
        for (limit, blocks) in [(1000, 1), (1000, 90), (40_000, 7)] {
            assert_eq!(sent(limit, Order::Shuffled, blocks), all[..limit], "{limit} of {blocks} blocks");
        }
        for part in [100, 1000, 10_000] {
            let early = all[..part].iter().filter(|place| **place < 25_000.0).count() as f64 / part as f64;
            assert!((early - 0.25).abs() < 1.5 / (part as f64).sqrt(), "{early} of {part}");
        }
        let mut sorted = all;
        sorted.sort_by(f32::total_cmp);
        assert!(sorted.iter().enumerate().all(|(i, place)| *place == i as f32), "each of them once");
    }

    #[test]
    fn the_files_order_is_kept_where_it_is_asked_for() {
        let sent = sent(5000, Order::File, 13);
        assert!(sent.iter().enumerate().all(|(i, place)| *place == i as f32) && sent.len() == 5000);
    }

    #[test]
    fn points_that_are_nowhere_are_counted_and_not_sent() {
        let mut odd = block(0..10);
        odd.positions[3][1] = f64::NAN;
        odd.positions[9][2] = f64::INFINITY;
        let mut sample = Sample::new(100, Order::File);
        sample.take(&odd);
        assert_eq!((sample.len(), sample.seen, sample.nowhere), (8, 10, 2));
        assert_eq!((sample.least, sample.greatest), ([1e6, 0.0, 0.0], [1e6 + 8.0, 0.0, 0.0]));
    }

    #[test]
    fn a_column_that_ends_is_filled_up() {
        let mut sample = Sample::new(100, Order::File);
        sample.take(&block(0..2));
        sample.take(&Block { columns: vec![Values::I64(Vec::new())], ..block(2..4) });
        assert_eq!(sample.columns[0][..2], [0.0, 1.0]);
        assert!(sample.columns[0][2..].iter().all(|value| value.is_nan()) && sample.columns[0].len() == 4);
    }
}
