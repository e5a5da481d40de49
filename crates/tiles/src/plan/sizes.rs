//! How many points of the result each tile gives.

use densecloud_cascade::MAX_RATIO;

/// By the tiles' own points: as many of each as of the others, to the rounding; the sum is `total`, which is from 1 to 64
/// times the sum of `own`, and so is each of its tile's points.
pub(super) fn by_points(own: &[u64], total: u64) -> Vec<u64> {
    let all: u128 = own.iter().map(|n| u128::from(*n)).sum();
    let (mut before, mut rounded) = (0, 0);
    let size = |n: &u64| {
        before += u128::from(*n);
        // At most `total`.
        let until = ((2 * u128::from(total) * before + all) / (2 * all.max(1))) as u64;
        let size = until - rounded;
        rounded = until;
        size
    };
    own.iter().map(size).collect()
}

/// By the area of each tile's surface, so that all are as dense, as far as tiles may have from 1 to 64 times their own points;
/// the sum is `total`.
pub(super) fn by_area(own: &[u64], areas: &[f64], total: u64) -> Vec<u64> {
    let most = |n: u64| n.saturating_mul(u64::from(MAX_RATIO));
    let wanted = |density: f64| -> Vec<f64> {
        let of = |(n, area): (&u64, &f64)| (density * area).clamp(*n as f64, most(*n) as f64);
        own.iter().zip(areas).map(of).collect()
    };
    let sum = |density: f64| wanted(density).iter().sum::<f64>();
    let (mut low, mut high) = (0.0, f64::MIN_POSITIVE);
    while sum(high) < total as f64 && high < f64::MAX / 4.0 {
        high *= 4.0;
    }
    for _ in 0..200 {
        let middle = low + (high - low) / 2.0;
        if sum(middle) < total as f64 { low = middle } else { high = middle }
    }
    let mut sizes: Vec<u64> = wanted(high).iter().map(|size| *size as u64).collect();
    // What was rounded off goes to the first that have room.
    let mut given: u64 = sizes.iter().sum();
    while given != total {
        let before = given;
        for (size, n) in sizes.iter_mut().zip(own) {
            if given < total && *size < most(*n) {
                (*size, given) = (*size + 1, given + 1);
            } else if given > total && *size > *n {
                (*size, given) = (*size - 1, given - 1);
            }
        }
        if given == before {
            return by_points(own, total);
        }
    }
    sizes
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sizes_are_exact_and_possible(
            own in proptest::collection::vec(1_u64..1000, 1..40), ratio in 1.0_f64..=64.0, seed in any::<u64>(),
        ) {
            let all: u64 = own.iter().sum();
            let total = (ratio * all as f64).round() as u64;
            let mut rng = densecloud_geometry::Rng::new(seed);
            let areas: Vec<f64> = own.iter().map(|_| 1e-3 * rng.f64() * rng.f64()).collect();
            for sizes in [by_points(&own, total), by_area(&own, &areas, total), by_area(&own, &vec![0.0; own.len()], total)] {
                prop_assert_eq!(sizes.iter().sum::<u64>(), total);
                for (size, n) in sizes.iter().zip(&own) {
                    prop_assert!((*n..=64 * n).contains(size), "{} of {}", size, n);
                }
            }
            for (size, n) in by_points(&own, total).iter().zip(&own) {
                prop_assert!((*size as f64 - ratio * *n as f64).abs() <= 1.5);
            }
        }
    }

    #[test]
    fn areas_share_the_points() {
        assert_eq!(by_area(&[100, 300], &[1.0, 1.0], 1600), [800, 800]);
        assert_eq!(by_area(&[100, 300], &[3.0, 1.0], 1600), [1200, 400]);
        assert_eq!(by_area(&[100, 300], &[1.0, 0.0], 1600), [1300, 300], "no fewer than there are");
    }
}
