//! A few points of many, spread evenly over all: which ones depends on their numbers alone.

use densecloud_cloud::{Frame, FrameError, Point, Position};
use densecloud_geometry::{KdTree, Walk};
use rayon::prelude::*;

/// Most points of a sample.
pub(super) const MOST: usize = 1 << 17;

/// Points of a sample whose distance tells the spacing.
const NEAREST: usize = 16;

/// Points by a hash of their numbers.
pub(super) struct Sample {
    most: usize,
    /// Hashes above are left out.
    highest: u64,
    points: Vec<(u64, Position)>,
}

impl Sample {
    pub(super) fn new(most: usize) -> Self {
        Self { most, highest: u64::MAX, points: Vec::new() }
    }

    /// Takes note of the point of that number.
    pub(super) fn see(&mut self, number: u64, position: Position) {
        let hash = hash(number);
        if hash > self.highest {
            return;
        }
        self.points.push((hash, position));
        while self.points.len() > self.most {
            self.highest /= 2;
            self.points.retain(|(hash, _)| *hash <= self.highest);
        }
    }

    /// In the order in which they were seen.
    pub(super) fn positions(&self) -> Vec<Position> {
        self.points.iter().map(|(_, position)| *position).collect()
    }
}

/// A number of which neighbouring ones have nothing in common (the finalizer of splitmix64).
fn hash(number: u64) -> u64 {
    let mut z = number.wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// How far apart a cloud's points are, about, at any place: by a sample of them.
pub(super) struct Spacings {
    frame: Frame,
    tree: KdTree,
    spacings: Vec<f64>,
    /// The largest.
    pub(super) largest: f64,
}

impl Spacings {
    /// Of a sample of a cloud of so many points: the root of the area that a point has. O(n log n).
    ///
    /// # Errors
    /// All points are the same, or there is none.
    pub(super) fn of(sample: &[Position], points: u64) -> Result<Self, FrameError> {
        let frame = Frame::fit(sample)?;
        let local: Vec<Point> = sample.iter().map(|p| frame.to_local(*p)).collect();
        let tree = KdTree::new(&local);
        let share = sample.len() as f64 / points.max(1) as f64;
        let spacing = |walk: &mut Walk, p: &Point| {
            tree.nearest_next(*p, NEAREST + 1, walk);
            let others = walk.found.len().saturating_sub(1).max(1) as f64;
            let square = walk.found.last().map_or(0.0, |n| f64::from(n.distance_squared));
            frame.scale() * (std::f64::consts::PI * square / others * share).sqrt()
        };
        let spacings: Vec<f64> = local.par_iter().map_init(Walk::default, spacing).collect();
        let largest = spacings.iter().copied().fold(0.0, f64::max);
        Ok(Self { frame, tree, spacings, largest })
    }

    /// At a place: that of the nearest point of the sample.
    pub(super) fn at(&self, position: Position) -> f64 {
        let nearest = self.tree.nearest_one(self.frame.to_local(position));
        nearest.map_or(0.0, |n| self.spacings[n.index as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_spread_over_all_and_depends_on_numbers_alone() {
        let sample = |blocks: &[u64]| {
            let mut sample = Sample::new(1000);
            for number in 0..blocks.iter().sum() {
                sample.see(number, [number as f64, 0.0, 0.0]);
            }
            sample.positions()
        };
        let points = sample(&[50_000]);
        assert!((400..=1000).contains(&points.len()), "{}", points.len());
        assert_eq!(points, sample(&[20_000, 30_000]));
        let below = points.iter().filter(|p| p[0] < 25_000.0).count() as f64;
        assert!((0.45..0.55).contains(&(below / points.len() as f64)));
        assert_eq!(sample(&[700]).len(), 700, "few are all of them");
    }

    #[test]
    fn spacings_are_those_of_the_whole() {
        // A grid of spacing 1, and one of spacing 3 beside it.
        let mut sample = Sample::new(4000);
        let mut count = 0;
        for i in 0..40_000_u64 {
            let (x, y) = ((i % 200) as f64, (i / 200) as f64);
            for p in [[x, y, 5.0], [1000.0 + 3.0 * x, 3.0 * y, 5.0]] {
                sample.see(count, p);
                count += 1;
            }
        }
        let spacings = Spacings::of(&sample.positions(), count).expect("an extent");
        let mean = |from: f64, step: f64| {
            let at = |i: i32| {
                spacings.at([
                    from + step * f64::from(40 + i % 12 * 10),
                    step * f64::from(40 + i / 12 * 10),
                    5.0,
                ])
            };
            (0..144).map(at).sum::<f64>() / 144.0
        };
        assert!((0.8..1.25).contains(&mean(0.0, 1.0)), "{}", mean(0.0, 1.0));
        assert!((2.4..3.75).contains(&mean(1000.0, 3.0)), "{}", mean(1000.0, 3.0));
        assert!(spacings.largest >= 3.0);
        assert!(Spacings::of(&[[1.0; 3]; 5], 5).is_err());
    }
}
