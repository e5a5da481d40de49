//! From a target to the sizes of the levels.

use std::fmt;
use std::str::FromStr;

use super::{CascadeError, check_count};
use crate::runner::UnitShape;

/// The highest ratio: six levels.
pub const MAX_RATIO: u32 = 64;

/// How many points are wanted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// A multiple of the finite input points, 1 to 64, rounded to the nearest whole number.
    Ratio(f64),
    /// The number itself, 1 to 64 times the finite input points.
    Points(u64),
}

impl Target {
    /// Points out for `points_in` finite points in: known before any work.
    ///
    /// # Errors
    /// [`CascadeError::Ratio`] or [`CascadeError::Points`] when it is outside 1 to 64.
    pub fn points_out(self, points_in: u64) -> Result<u64, CascadeError> {
        match self {
            Self::Ratio(ratio) if (1.0..=f64::from(MAX_RATIO)).contains(&ratio) => {
                Ok((ratio * points_in as f64).round() as u64)
            }
            Self::Ratio(ratio) => Err(CascadeError::Ratio(ratio)),
            Self::Points(points)
                if points >= points_in && points <= points_in.saturating_mul(u64::from(MAX_RATIO)) =>
            {
                Ok(points)
            }
            Self::Points(points) => Err(CascadeError::Points { wanted: points, from: points_in }),
        }
    }
}

/// How many points the last level makes for those that are kept.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Quality {
    /// As few levels as give the target.
    #[default]
    Standard,
    /// A level more, from whose points, twice as many as wanted at least, the result is chosen: what lies in gaps is
    /// covered better. About twice the work.
    Best,
}

impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Standard => "standard",
            Self::Best => "best",
        })
    }
}

impl FromStr for Quality {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "standard" => Ok(Self::Standard),
            "best" => Ok(Self::Best),
            _ => Err(format!("{text:?}; there are `standard` and `best`")),
        }
    }
}

/// What the last level chooses its result among.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Choice {
    /// What its unit makes, and midpoints: for a polish.
    Polished,
    /// What its unit makes.
    Made,
    /// The same, but for what lies at the border of a part or beyond.
    MadeInside,
}

impl Choice {
    /// How many points the level may output, in those that its unit makes, which are twice its input.
    fn share(self) -> f64 {
        match self {
            Self::Polished => 1.25,
            Self::Made => 1.0,
            // Of a part of 100 points a tenth is lost at its border, of larger ones less; and there are strays.
            Self::MadeInside => 0.8,
        }
    }
}

/// How many points are wanted of an input, and in how many levels.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Plan {
    wanted: usize,
    /// Doublings of all the input's points that give as many.
    levels: usize,
    quality: Quality,
}

impl Plan {
    /// `finite` input points, of which `distinct` differ.
    pub(super) fn new(
        target: Target,
        quality: Quality,
        finite: usize,
        distinct: usize,
        shape: UnitShape,
    ) -> Result<Self, CascadeError> {
        let duplicates = finite - distinct;
        let wanted = target.points_out(finite as u64)?.try_into().unwrap_or(usize::MAX);
        check_count(wanted)?;
        let needed = shape.neighbours + 1;
        if distinct < needed {
            return Err(CascadeError::TooFewPoints { distinct, duplicates, needed });
        }
        if wanted > distinct.saturating_mul(MAX_RATIO as usize) {
            return Err(CascadeError::TooManyDuplicates { distinct, total: finite });
        }
        if quality == Quality::Best {
            check_count(wanted.saturating_mul(2))?;
        }
        let levels = wanted.div_ceil(finite).next_power_of_two().ilog2().max(1) as usize;
        Ok(Self { wanted, levels, quality })
    }

    /// The sizes after each level, doubling, and the target last, when `apart` points are kept as they are and `together`
    /// are worked on. A polished last level can choose among more than twice its input, so a few points that are apart
    /// or coincide with others do not cost a level.
    pub(super) fn sizes(&self, apart: usize, together: usize, among: Choice) -> Vec<usize> {
        let wanted = self.wanted - apart;
        let share = match self.quality {
            Quality::Standard => among.share(),
            // The level more has room for all that a part lacks.
            Quality::Best => among.share().max(1.0),
        };
        let (mut sizes, mut size) = (Vec::new(), together);
        while sizes.len() < self.levels || share * (size as f64) < wanted as f64 {
            size *= 2;
            sizes.push(size.min(wanted));
        }
        if self.quality == Quality::Standard {
            sizes.pop();
        }
        sizes.push(wanted);
        sizes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: UnitShape = UnitShape { patch_size: 312, neighbours: 32, channels: 264 };

    fn sizes(target: Target, finite: usize, distinct: usize) -> Vec<usize> {
        Plan::new(target, Quality::Standard, finite, distinct, SHAPE).unwrap().sizes(
            0,
            distinct,
            Choice::Polished,
        )
    }

    #[test]
    fn levels_double_and_the_last_meets_the_target() {
        for (ratio, expected) in [
            (1.0, vec![1000]),
            (1.5, vec![1500]),
            (2.0, vec![2000]),
            (2.001, vec![2000, 2001]),
            (7.3, vec![2000, 4000, 7300]),
            (16.0, vec![2000, 4000, 8000, 16000]),
            (64.0, vec![2000, 4000, 8000, 16000, 32000, 64000]),
        ] {
            assert_eq!(sizes(Target::Ratio(ratio), 1000, 1000), expected, "ratio {ratio}");
        }
        assert_eq!(sizes(Target::Points(1001), 1000, 1000), [1001]);
    }

    #[test]
    fn the_best_quality_takes_a_level_more() {
        let of = |ratio| Plan::new(Target::Ratio(ratio), Quality::Best, 1000, 1000, SHAPE).unwrap();
        assert_eq!(of(1.0).sizes(0, 1000, Choice::Polished), [1000, 1000]);
        assert_eq!(of(3.0).sizes(0, 1000, Choice::Polished), [2000, 3000, 3000]);
        assert_eq!(of(4.0).sizes(0, 1000, Choice::Polished), [2000, 4000, 4000]);
        assert_eq!(of(4.0).sizes(100, 900, Choice::Polished), [1800, 3600, 3900]);
        assert_eq!(of(4.0).sizes(0, 400, Choice::Polished), [800, 1600, 3200, 4000]);
        let large = Plan::new(Target::Points(3 << 30), Quality::Best, 1 << 30, 1 << 30, SHAPE).unwrap_err();
        assert!(matches!(large, CascadeError::TooManyPoints(_)), "{large}");
    }

    #[test]
    fn a_quality_is_read_as_it_is_told() {
        for quality in [Quality::Standard, Quality::Best] {
            assert_eq!(quality.to_string().parse(), Ok(quality));
        }
        assert!("good".parse::<Quality>().expect_err("an error").contains("`best`"));
    }

    #[test]
    fn duplicates_count_towards_the_target_and_few_cost_no_level() {
        assert_eq!(sizes(Target::Ratio(4.0), 1000, 999), [1998, 4000]);
        assert_eq!(sizes(Target::Ratio(2.0), 1000, 999), [2000]);
        assert_eq!(sizes(Target::Ratio(4.0), 1000, 700), [1400, 2800, 4000]);
        assert_eq!(sizes(Target::Ratio(2.0), 1000, 390), [780, 1560, 2000]);
        let rough = Plan::new(Target::Ratio(4.0), Quality::Standard, 1000, 999, SHAPE).unwrap();
        assert_eq!(rough.sizes(0, 999, Choice::Made), [1998, 3996, 4000]);
        assert_eq!(rough.sizes(10, 989, Choice::Polished), [1978, 3990]);
    }

    #[test]
    fn points_apart_take_none_of_the_levels_and_cost_none() {
        let quality = Quality::Standard;
        let of = |ratio, apart, among| {
            let plan = Plan::new(Target::Ratio(ratio), quality, 1000, 1000, SHAPE).unwrap();
            plan.sizes(apart, 1000 - apart, among)
        };
        assert_eq!(of(4.0, 0, Choice::Polished), [2000, 4000]);
        assert_eq!(of(4.0, 10, Choice::Polished), [1980, 3990]);
        assert_eq!(of(4.0, 10, Choice::Made), [1980, 3960, 3990]);
        assert_eq!(of(4.0, 400, Choice::Polished), [1200, 2400, 3600]);
        assert_eq!(of(1.0, 10, Choice::Polished), [990]);
        assert_eq!(of(3.0, 10, Choice::Polished), [1980, 2990]);
    }

    #[test]
    fn parts_without_a_polish_have_points_to_spare() {
        let of = |ratio, quality| {
            let plan = Plan::new(Target::Ratio(ratio), quality, 1000, 1000, SHAPE).unwrap();
            plan.sizes(0, 1000, Choice::MadeInside)
        };
        assert_eq!(of(1.5, Quality::Standard), [1500]);
        assert_eq!(of(2.0, Quality::Standard), [2000, 2000]);
        assert_eq!(of(3.0, Quality::Standard), [2000, 3000]);
        assert_eq!(of(4.0, Quality::Standard), [2000, 4000, 4000]);
        assert_eq!(of(4.0, Quality::Best), [2000, 4000, 4000], "as many as need be");
    }

    #[test]
    fn impossible_targets_are_refused() {
        for ratio in [0.99, 64.01, -1.0, 0.0, f64::NAN, f64::INFINITY] {
            assert!(matches!(Target::Ratio(ratio).points_out(10), Err(CascadeError::Ratio(_))), "{ratio}");
        }
        for points in [0, 9, 641] {
            assert!(matches!(Target::Points(points).points_out(10), Err(CascadeError::Points { .. })));
        }
        let few = Plan::new(Target::Ratio(2.0), Quality::Best, 40, 32, SHAPE).unwrap_err();
        assert!(few.to_string().contains("at least 33"), "{few}");
        let large = Plan::new(Target::Ratio(64.0), Quality::Standard, 1 << 27, 1 << 27, SHAPE).unwrap_err();
        assert!(large.to_string().starts_with("8589934592 points are more than the 4294967295"), "{large}");
        let same = Plan::new(Target::Ratio(64.0), Quality::Standard, 1000, 400, SHAPE).unwrap_err();
        assert!(matches!(same, CascadeError::TooManyDuplicates { distinct: 400, total: 1000 }));
    }
}
