//! How many points a tile has.

use densecloud::Options;
use densecloud::survey::Goal;
use densecloud_cascade::{Demand, MAX_RATIO, Target};
use densecloud_formats::Header;

/// Points of a tile where nobody says how many, and the memory that may not be enough for them: that of a ratio above 18.
pub const TILE_POINTS: u64 = 400_000;
const ENOUGH: u64 = 4 << 30;

/// Fewer points have too few neighbours, more cannot be told apart.
const FEWEST: u64 = densecloud::LEAST_TILE;
const MOST: u64 = u32::MAX as u64;

/// Bytes that the program takes whatever a tile has: its sessions, and a plan's sample of the whole.
const FIXED: u64 = 160 << 20;
/// Points of a tile and of its halo, for each of its own.
const HALO: f64 = 1.25;
/// Bytes of a point beside its attributes, and of each of these.
const POSITION: u64 = 28;
const ATTRIBUTE: u64 = 8;

/// How large tiles are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum TileSize {
    /// About [`TILE_POINTS`], fewer where each gives so many points that working on one would take more than 4 GiB.
    #[default]
    Usual,
    /// About so many points.
    Points(u64),
    /// As many as can be worked on in so many bytes of memory, by estimate.
    Memory(u64),
}

/// Too little memory for tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{memory} bytes of memory are too few for tiles; give {least} or more")]
pub struct TooLittle {
    memory: u64,
    least: u64,
}

impl TileSize {
    /// As the options have it.
    #[must_use]
    pub fn of(options: &Options) -> Self {
        options.tile_points.map_or(Self::Usual, Self::Points)
    }

    /// Points of a tile of a cloud with that header, of which that is wanted; the same on any machine.
    ///
    /// How many points each gives has to be known: where it depends on the cloud's surface, or on a number of points that the
    /// header does not tell, [`Memory`](Self::Memory) goes by the most that there can be, 64.
    ///
    /// # Errors
    /// The memory is less than a tile of the [fewest points](densecloud::LEAST_TILE) takes.
    pub fn points(self, goal: Goal, header: &Header) -> Result<u64, TooLittle> {
        let needs = |ratio| bytes_a_point(ratio, header);
        let fitting = |memory: u64, ratio| memory.saturating_sub(FIXED) / needs(ratio);
        let ratio = ratio(goal, header);
        let points = match self {
            Self::Points(points) => points,
            Self::Usual => ratio.map_or(TILE_POINTS, |ratio| fitting(ENOUGH, ratio).min(TILE_POINTS)),
            Self::Memory(memory) => {
                let ratio = ratio.unwrap_or(f64::from(MAX_RATIO));
                let (points, least) = (fitting(memory, ratio), FIXED + FEWEST * needs(ratio));
                if points < FEWEST {
                    return Err(TooLittle { memory, least });
                }
                points
            }
        };
        Ok(points.clamp(FEWEST, MOST))
    }
}

/// Points out for each point in, where that is known.
fn ratio(goal: Goal, header: &Header) -> Option<f64> {
    let ratio = match goal {
        Goal::Target(Target::Ratio(ratio)) => ratio,
        Goal::Target(Target::Points(points)) => points as f64 / header.points? as f64,
        Goal::Spacing(_) | Goal::Density(_) => return None,
    };
    Some(ratio.clamp(1.0, f64::from(MAX_RATIO)))
}

/// Bytes that a tile takes for each of its points: its last level, what it is made of and its result.
fn bytes_a_point(ratio: f64, header: &Header) -> u64 {
    let last = ratio.max(2.0).log2().ceil().exp2();
    let point = (POSITION + ATTRIBUTE * header.attributes.len() as u64) as f64;
    (HALO * (last * Demand::default().a_point as f64 + point) + ratio * point).ceil() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_formats::Format;

    fn header(points: Option<u64>) -> Header {
        Header {
            format: Format::TEXT,
            points,
            attributes: vec!["red".to_owned(); 3],
            dropped_properties: Vec::new(),
        }
    }

    fn points(size: TileSize, goal: Goal, points: Option<u64>) -> Result<u64, TooLittle> {
        size.points(goal, &header(points))
    }

    #[test]
    fn tiles_shrink_where_each_point_gives_many() {
        let usual =
            |ratio| points(TileSize::Usual, Goal::Target(Target::Ratio(ratio)), None).expect("enough");
        assert_eq!([1.0, 4.0, 16.0].map(usual), [TILE_POINTS; 3]);
        assert!((100_000..150_000).contains(&usual(64.0)), "{}", usual(64.0));
        let wanted =
            |of| points(TileSize::Usual, Goal::Target(Target::Points(64_000_000)), of).expect("enough");
        assert_eq!(wanted(Some(1_000_000)), usual(64.0));
        assert_eq!([wanted(Some(16_000_000)), wanted(None)], [TILE_POINTS; 2]);
        assert_eq!(points(TileSize::Usual, Goal::Spacing(0.1), None), Ok(TILE_POINTS));
        assert_eq!(points(TileSize::Points(5000), Goal::Spacing(0.1), None), Ok(5000));
    }

    #[test]
    fn memory_decides_and_too_little_is_refused() {
        let goal = Goal::Target(Target::Ratio(4.0));
        let of = |memory| points(TileSize::Memory(memory), goal, None);
        // BENCHMARKS.md: a tile of 400,000 points at 4x takes 640 MB at most.
        assert!((350_000..450_000).contains(&of(1 << 30).expect("enough")), "{:?}", of(1 << 30));
        assert!(of(8 << 30).expect("enough") > 3_000_000);
        let refused = of(100 << 20).expect_err("too little");
        assert_eq!(of(refused.least), Ok(FEWEST));
        assert!(refused.to_string().contains(&refused.least.to_string()));
        // By the most that there can be.
        let spacing = points(TileSize::Memory(1 << 30), Goal::Spacing(0.1), None);
        assert_eq!(spacing, points(TileSize::Memory(1 << 30), Goal::Target(Target::Ratio(64.0)), None));
    }
}
