//! What the numbers of a column are like, for those who decide what becomes of it without having them all.

use std::collections::HashSet;

use super::{Values, each_kind};

/// What the numbers of a column are like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facts {
    /// How many there are, those that are not a number included.
    pub rows: u64,
    /// How many are not NaN.
    pub numbers: u64,
    /// Whether all that are not NaN are finite and whole.
    pub is_whole: bool,
    /// The least that is not NaN; infinity where there is none.
    pub least: f64,
    /// The largest that is not NaN; negative infinity where there is none.
    pub most: f64,
    /// Whether all are whole, and each stands at two points on average or more: at most half as many different ones as
    /// there are numbers, and at most [`Facts::MOST_DIFFERENT`]. Never where there are integers of up to 32 bits among them,
    /// which are not counted.
    pub repeats: bool,
    /// Whether all are 0, 1 or NaN, and there is one.
    pub is_flag: bool,
}

impl Facts {
    /// Most different numbers that are counted, so that the count takes little memory.
    pub const MOST_DIFFERENT: usize = 1 << 20;

    /// Of all numbers of a column. O(n).
    #[must_use]
    pub fn of(values: &Values) -> Self {
        let mut seen = FactsSeen::default();
        seen.see(values);
        seen.facts()
    }
}

/// Gathers the [`Facts`] of a column a part at a time; the parts may be of different types. Memory: 16 MiB at most, for
/// whole numbers of many values.
#[derive(Debug, Clone)]
pub struct FactsSeen {
    facts: Facts,
    /// The whole numbers so far; none where one is not whole, or there are too many.
    different: Option<HashSet<u64>>,
}

impl Default for FactsSeen {
    fn default() -> Self {
        let facts = Facts {
            rows: 0,
            numbers: 0,
            is_whole: true,
            least: f64::INFINITY,
            most: f64::NEG_INFINITY,
            repeats: false,
            is_flag: true,
        };
        Self { facts, different: Some(HashSet::new()) }
    }
}

impl FactsSeen {
    /// Takes note of further numbers. O(n).
    #[allow(clippy::unnecessary_cast, clippy::cast_lossless, reason = "one expression for every type")]
    pub fn see(&mut self, values: &Values) {
        let kind = values.kind();
        if !kind.is_float() && kind.size() < 8 && !values.is_empty() {
            self.different = None;
        }
        each_kind!(values, column => column.iter().for_each(|number| self.see_one(*number as f64)));
    }

    fn see_one(&mut self, number: f64) {
        let facts = &mut self.facts;
        facts.rows += 1;
        facts.is_flag = facts.is_flag && (number == 0.0 || number == 1.0 || number.is_nan());
        if number.is_nan() {
            return;
        }
        facts.numbers += 1;
        (facts.least, facts.most) = (facts.least.min(number), facts.most.max(number));
        // That of infinity is NaN.
        facts.is_whole = facts.is_whole && number.fract() == 0.0;
        if let Some(different) = &mut self.different {
            // Zero has two signs.
            different.insert((number + 0.0).to_bits());
            if !facts.is_whole || different.len() > Facts::MOST_DIFFERENT {
                self.different = None;
            }
        }
    }

    /// What is known of the numbers so far.
    #[must_use]
    pub fn facts(&self) -> Facts {
        let repeats = |different: &HashSet<u64>| 2 * different.len() as u64 <= self.facts.numbers;
        let repeats = self.facts.numbers > 0 && self.different.as_ref().is_some_and(repeats);
        Facts { repeats, is_flag: self.facts.is_flag && self.facts.rows > 0, ..self.facts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(numbers: &[f64]) -> Facts {
        Facts::of(&Values::F64(numbers.to_vec()))
    }

    #[test]
    fn facts_are_those_of_all_parts_together() {
        let parts = [Values::I64(vec![3, -1]), Values::F64(vec![f64::NAN, 3.0]), Values::U64(vec![3])];
        let mut seen = FactsSeen::default();
        parts.iter().for_each(|part| seen.see(part));
        let expected = Facts {
            rows: 5,
            numbers: 4,
            is_whole: true,
            least: -1.0,
            most: 3.0,
            repeats: true,
            is_flag: false,
        };
        assert_eq!((seen.facts(), of(&[3.0, -1.0, f64::NAN, 3.0, 3.0])), (expected, expected));
    }

    #[test]
    fn whole_numbers_repeat_or_do_not() {
        let repeats = |numbers: &[f64]| of(numbers).repeats;
        assert!(repeats(&[3.0; 4]) && repeats(&[0.0, -0.0, f64::NAN]) && repeats(&[1.0, 1.0, 2.0, 2.0]));
        assert!(
            !repeats(&[1.0, 2.0, 2.0]) && !repeats(&[0.5, 0.5]) && !repeats(&[f64::NAN; 3]) && !repeats(&[])
        );
        assert!(!repeats(&[1.0, 1.0, f64::INFINITY]));
        let many = |count: usize| {
            let numbers: Vec<f64> = (0..2 * count).map(|i| (i / 2) as f64).collect();
            of(&numbers).repeats
        };
        assert!(many(Facts::MOST_DIFFERENT) && !many(Facts::MOST_DIFFERENT + 1));
    }

    #[test]
    fn flags_are_zeros_and_ones() {
        assert!(of(&[0.0, 1.0, f64::NAN]).is_flag && of(&[f64::NAN]).is_flag);
        assert!(!of(&[0.0, 2.0]).is_flag && !of(&[]).is_flag);
    }
}
