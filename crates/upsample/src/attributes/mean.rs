//! Means of numbers, in their own types.

use rayon::prelude::*;

use super::near::{Present, Weighted, those_with};
use densecloud_cloud::{Values, each_kind};

/// The weighted mean of the nearest values of a column, for each new point: never outside of the range of those that it is
/// of, so the mean of equal values is that value, exactly. Where none is there, the nearest point's number.
pub(super) fn mean(values: &Values, weighted: &[Weighted], present: &Present) -> Values {
    each_kind!(values, column => {
        Number::column(weighted.par_iter().map(|near| mean_of(column, near, present)).collect())
    })
}

fn mean_of<T: Number>(column: &[T], near: &Weighted, present: &Present) -> T {
    let mut there = those_with(near, present);
    let Some((row, weight)) = there.next() else { return column[near[0].0 as usize] };
    let first = column[row];
    let (mut sum, mut weights, mut least, mut most) = (0.0, weight, first, first);
    for (row, weight) in there {
        let value = column[row];
        sum += weight * value.minus(first);
        weights += weight;
        least = if value < least { value } else { least };
        most = if value > most { value } else { most };
    }
    let mean = first.plus(sum / weights);
    if mean < least {
        least
    } else if mean > most {
        most
    } else {
        mean
    }
}

/// A number of a column.
trait Number: Copy + PartialOrd + Send + Sync {
    fn minus(self, other: Self) -> f64;

    /// The nearest number of the type to the sum.
    fn plus(self, offset: f64) -> Self;

    fn column(numbers: Vec<Self>) -> Values;
}

macro_rules! floats {
    ($($kind:ident $number:ty),*) => {
        $(#[allow(clippy::unnecessary_cast, clippy::cast_lossless, reason = "one expression for both types")]
        impl Number for $number {
            fn minus(self, other: Self) -> f64 {
                self as f64 - other as f64
            }

            fn plus(self, offset: f64) -> Self {
                (self as f64 + offset) as $number
            }

            fn column(numbers: Vec<Self>) -> Values {
                Values::$kind(numbers)
            }
        })*
    };
}

macro_rules! integers {
    ($($kind:ident $number:ty),*) => {
        $(impl Number for $number {
            fn minus(self, other: Self) -> f64 {
                (i128::from(self) - i128::from(other)) as f64
            }

            // Halves are rounded away from zero, wherever a double can tell them.
            fn plus(self, offset: f64) -> Self {
                let whole = i128::from(self);
                let sum = if whole.abs() < 1 << 51 {
                    (whole as f64 + offset).round() as i128
                } else {
                    whole + offset.round() as i128
                };
                // A mean is within the range of its numbers, but for an error of rounding.
                Self::try_from(sum).unwrap_or(self)
            }

            fn column(numbers: Vec<Self>) -> Values {
                Values::$kind(numbers)
            }
        })*
    };
}

floats!(F32 f32, F64 f64);
integers!(I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64);

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::Kind;
    use proptest::prelude::*;

    fn of(values: &Values, weights: [f32; 5], present: &Present) -> Values {
        let near = [0, 1, 2, 3, 4].map(|i| (i, weights[i as usize]));
        mean(values, &[near], present)
    }

    #[test]
    fn the_mean_of_equal_values_is_that_value() {
        let weights = [0.1, 0.7, 1e-3, 3.3, 0.123_456_7];
        for values in [
            Values::F64(vec![6.0; 5]),
            Values::F64(vec![0.1; 5]),
            Values::F64(vec![f64::MAX; 5]),
            Values::F32(vec![0.1; 5]),
            Values::I64(vec![i64::MAX; 5]),
            Values::I64(vec![i64::MIN; 5]),
            Values::I64(vec![(1 << 53) + 1; 5]),
            Values::U64(vec![u64::MAX; 5]),
            Values::U8(vec![255; 5]),
            Values::I8(vec![-128; 5]),
        ] {
            assert_eq!(of(&values, weights, &None), values.gather(&[0]), "{:?}", values.kind());
        }
    }

    #[test]
    fn integers_are_rounded_and_large_ones_are_exact() {
        let twice = [1.0, 1.0, 0.0, 0.0, 0.0];
        assert_eq!(of(&Values::U8(vec![4, 5, 9, 9, 9]), twice, &None), Values::U8(vec![5]));
        assert_eq!(of(&Values::U8(vec![5, 4, 9, 9, 9]), twice, &None), Values::U8(vec![5]));
        assert_eq!(of(&Values::I16(vec![-4, -5, 9, 9, 9]), twice, &None), Values::I16(vec![-5]));
        let large = (1_i64 << 60) + 1;
        let column = Values::I64(vec![large, large + 2, 0, 0, 0]);
        assert_eq!(of(&column, twice, &None), Values::I64(vec![large + 1]));
        let ends = Values::I64(vec![i64::MIN, i64::MAX, 0, 0, 0]);
        assert!(of(&ends, twice, &None).get(0).abs() < 2.0);
    }

    #[test]
    fn what_is_absent_has_no_weight() {
        let present = Some(vec![false, true, true, false, true]);
        let column = Values::U8(vec![0, 200, 200, 0, 200]);
        assert_eq!(of(&column, [5.0, 1.0, 1.0, 1.0, 1.0], &present), Values::U8(vec![200]));
        assert_eq!(of(&column, [5.0, 0.0, 0.0, 1.0, 0.0], &present), Values::U8(vec![0]), "none is there");
    }

    proptest! {
        #[test]
        fn a_mean_stays_within_its_values(
            numbers in proptest::array::uniform5(any::<i64>()),
            weights in proptest::array::uniform5(1e-6_f32..1e6),
            turn in 0_usize..5,
        ) {
            for kind in [Kind::I8, Kind::U8, Kind::I16, Kind::U16, Kind::I32, Kind::U32, Kind::I64, Kind::U64, Kind::F32, Kind::F64] {
                let values = Values::from_f64(kind, numbers.iter().map(|n| (*n >> 3) as f64 * if kind.size() < 8 { 1e-14 } else { 1.0 }));
                let all: Vec<f64> = (0..5).map(|i| values.get(i)).collect();
                let mean = of(&values, weights, &None).get(0);
                let (least, most) = (all.iter().copied().fold(f64::MAX, f64::min), all.iter().copied().fold(f64::MIN, f64::max));
                prop_assert!((least..=most).contains(&mean), "{mean} of {all:?}");
                let sum: f64 = weights.iter().map(|w| f64::from(*w)).sum();
                let plain: f64 = all.iter().zip(weights).map(|(v, w)| v * f64::from(w)).sum::<f64>() / sum;
                let slack = 1e-6 * (most - least) + if kind.is_float() { 1e-6 * most.abs().max(least.abs()) } else { 0.5 + 1e-6 * most.abs().max(least.abs()) };
                prop_assert!((mean - plain).abs() <= slack, "{mean}, not {plain}");
                // The order of the points does not matter.
                let order: Vec<u32> = (0..5).map(|i| (i + turn as u32) % 5).collect();
                let turned = values.gather(&order);
                let turned = of(&turned, std::array::from_fn(|i| weights[order[i] as usize]), &None).get(0);
                prop_assert!((mean - turned).abs() <= 1.0_f64.max(1e-6 * mean.abs().max(most - least)));
            }
        }
    }
}
