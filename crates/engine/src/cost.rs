//! What a request costs: in points, in memory, and, by a model that is measured, in time.

use std::time::Duration;

use super::workers::Lane;
use densecloud_cascade::Demand;

/// The size of a request: all that its cost depends on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cost {
    /// Points in the input.
    pub points_in: u64,
    /// Points in the result.
    pub points_out: u64,
    /// Points of the input that are worked on at a time, one part after another; all of them where there are no more.
    pub part: u64,
}

/// What a part has beside its own points, those around it, as a share of these: a tile of the usual size is a quarter
/// larger for them.
const AROUND: f64 = 0.25;

impl Cost {
    /// Of a request that is worked on as a whole.
    #[must_use]
    pub fn new(points_in: u64, points_out: u64) -> Self {
        Self { points_in, points_out, part: u64::MAX }
    }

    /// The same, worked on in parts of so many points of the input: memory is that of one part.
    #[must_use]
    pub fn in_parts(self, part: u64) -> Self {
        Self { part, ..self }
    }

    /// As much of it as `part` is, and what is left.
    pub(super) fn split(self, part: Self) -> (Self, Self) {
        let (points_in, points_out) =
            (part.points_in.min(self.points_in), part.points_out.min(self.points_out));
        let rest =
            Self { points_in: self.points_in - points_in, points_out: self.points_out - points_out, ..self };
        (Self { points_in, points_out, ..part }, rest)
    }

    /// What is at work at a time: the whole, or one part with the points around it.
    #[must_use]
    pub fn at_once(self) -> Self {
        if self.part >= self.points_in {
            return Self { part: u64::MAX, ..self };
        }
        let share = (self.part as f64 * (1.0 + AROUND) / self.points_in as f64).min(1.0);
        let of = |points: u64| (points as f64 * share).round() as u64;
        Self::new(of(self.points_in), of(self.points_out))
    }

    /// Levels of the cascade: the fewest doublings that reach the points out, and at least one.
    fn levels(self) -> u32 {
        let ratio = self.points_out.div_ceil(self.points_in.max(1));
        ratio.max(2).checked_next_power_of_two().map_or(63, u64::trailing_zeros)
    }

    /// Points that units read, over all levels: n, 2 n, 4 n, …
    fn points_read(self) -> f64 {
        self.points_in as f64 * (f64::from(self.levels()).exp2() - 1.0)
    }

    /// The cost of work that takes `effort` times as much for each point: as if there were so many times as many.
    #[must_use]
    pub fn times(self, effort: f64) -> Self {
        let times = |points: u64| if effort == 1.0 { points } else { (points as f64 * effort).ceil() as u64 };
        let Self { points_in, points_out, part } = self;
        Self { points_in: times(points_in), points_out: times(points_out), part: times(part) }
    }

    /// Memory that the work takes at its height, in bytes, over a runner of this demand; the input and the result aside.
    /// An estimate from above for clouds of some thousand points and more.
    #[must_use]
    pub fn memory(self, demand: Demand) -> u64 {
        let Self { points_in, points_out, .. } = self.at_once();
        demand.bytes(points_in.saturating_mul(1_u64 << self.levels().min(62)).max(points_out))
    }

    pub(super) fn lane(self) -> Lane {
        Lane::of(self.points_out)
    }
}

/// How long requests take when they have the machine to themselves: a fixed time and one for each point
/// that a unit reads, measured at two sizes, and corrected by what real requests take.
///
/// What a point costs does not grow with the cloud, and all stages go with the points that units read: a
/// level makes twice as many, which are then sampled.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pace {
    fixed: f64,
    a_point: f64,
    /// By lane: small requests err in the fixed time, large ones in the other.
    correction: [f64; 2],
}

impl Default for Pace {
    fn default() -> Self {
        Self { fixed: 0.0, a_point: 0.0, correction: [1.0; 2] }
    }
}

/// The part of the way to a new measurement that a correction goes, in its logarithm.
const STEP: f64 = 0.2;
/// The largest error that a measurement counts for: a machine may have been suspended.
const OUTLIER: f64 = 20.0;

impl Pace {
    /// A line through what two requests took, the second larger than the first.
    pub(super) fn measured(small: (Cost, Duration), large: (Cost, Duration)) -> Self {
        let (read_small, read_large) = (small.0.points_read(), large.0.points_read());
        let (small, large) = (small.1.as_secs_f64(), large.1.as_secs_f64());
        let slope = (large - small) / (read_large - read_small);
        // A hiccup in the small one: all is then taken to go with the points.
        let (fixed, a_point) = match slope > 0.0 {
            true => ((small - slope * read_small).max(0.0), slope),
            false => (0.0, large / read_large),
        };
        Self { fixed, a_point, ..Self::default() }
    }

    /// How long a request takes; nothing before anything was measured.
    pub(super) fn estimate(&self, cost: Cost) -> Duration {
        let seconds =
            (self.fixed + self.a_point * cost.points_read()) * self.correction[cost.lane() as usize];
        Duration::try_from_secs_f64(seconds.min(1e9)).unwrap_or_default()
    }

    /// Corrects the lane of a request by the time that it took, as if it had had the machine to itself.
    pub(super) fn learn(&mut self, cost: Cost, took: Duration) {
        let estimate = self.estimate(cost).as_secs_f64();
        if estimate <= 0.0 || took.is_zero() {
            return;
        }
        let error = (took.as_secs_f64() / estimate).clamp(1.0 / OUTLIER, OUTLIER);
        let correction = &mut self.correction[cost.lane() as usize];
        *correction = (*correction * error.powf(STEP)).clamp(1e-3, 1e3);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cost(points_in: u64, points_out: u64) -> Cost {
        Cost::new(points_in, points_out)
    }

    #[test]
    fn levels_are_those_of_the_cascade() {
        for (cost, levels) in [
            (cost(100, 100), 1),
            (cost(100, 200), 1),
            (cost(100, 201), 2),
            (cost(100, 400), 2),
            (cost(100, 6400), 6),
            (cost(0, 0), 1),
            (cost(1, u64::MAX), 63),
        ] {
            assert_eq!(cost.levels(), levels, "{cost:?}");
        }
        assert_eq!(cost(u64::MAX, u64::MAX).memory(Demand::default()), u64::MAX, "no overflow");
    }

    #[test]
    fn more_work_for_each_point_counts_as_more_points() {
        let exact = cost(u64::MAX - 1, u64::MAX);
        assert_eq!(exact.times(1.0), exact);
        assert_eq!(cost(100, 400).times(1.5), cost(150, 600));
        assert_eq!(cost(u64::MAX, u64::MAX).times(50.0), cost(u64::MAX, u64::MAX));
    }

    #[test]
    fn in_parts_memory_is_that_of_one_whatever_the_whole_is() {
        let tiles = |points: u64| cost(points, 4 * points).in_parts(400_000).memory(Demand::default());
        assert_eq!(tiles(400_000), cost(400_000, 1_600_000).memory(Demand::default()));
        assert_eq!(tiles(100_000_000), cost(500_000, 2_000_000).memory(Demand::default()));
        assert_eq!(tiles(u64::MAX / 8), tiles(100_000_000));
        assert_eq!(
            tiles(450_000),
            cost(450_000, 1_800_000).memory(Demand::default()),
            "no more than the whole"
        );
        let effort = cost(1_000_000, 4_000_000).in_parts(400_000).times(2.0);
        assert_eq!(effort.at_once(), cost(1_000_000, 4_000_000));
    }

    #[test]
    fn memory_is_more_than_what_was_measured_and_not_much_more() {
        // BENCHMARKS.md: points in, ratio, megabytes of the whole process, 50 of which it takes for itself.
        for (points_in, ratio, megabytes) in [(100_000, 1, 112), (100_000, 4, 164), (1_000_000, 4, 1275)] {
            let estimate = cost(points_in, ratio * points_in).memory(Demand::default()) / 1_000_000;
            assert!(
                (megabytes - 50..3 * megabytes).contains(&estimate),
                "{points_in} at {ratio}: {estimate}"
            );
        }
    }

    #[test]
    fn a_pace_is_a_line_through_what_was_measured_and_follows_what_comes() {
        let ms = Duration::from_millis;
        assert_eq!(Pace::default().estimate(cost(100, 400)), Duration::ZERO);
        let mut pace = Pace::measured((cost(100, 200), ms(20)), (cost(1000, 2000), ms(110)));
        for (size, expected) in [(cost(100, 200), 20), (cost(1000, 2000), 110), (cost(1000, 4000), 310)] {
            let estimate = pace.estimate(size).as_secs_f64() * 1000.0;
            assert!((estimate - f64::from(expected)).abs() < 0.01, "{size:?}: {estimate}");
        }
        for _ in 0..50 {
            pace.learn(cost(1000, 4000), ms(620));
        }
        let estimate = pace.estimate(cost(1000, 4000)).as_secs_f64();
        assert!((0.6..0.64).contains(&estimate), "{estimate}");
        let large = pace.estimate(cost(1_000_000, 4_000_000)).as_secs_f64();
        assert!((290.0..310.0).contains(&large), "the other lane has its own: {large}");
        let odd = Pace::measured((cost(100, 200), ms(50)), (cost(1000, 2000), ms(40)));
        assert_eq!(odd.estimate(cost(1000, 2000)), ms(40), "never backwards");
    }
}
