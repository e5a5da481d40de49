//! Means of vectors whose parts stand in several columns.

use rayon::prelude::*;

use super::near::{Present, Weighted, those_with};
use densecloud_cloud::Values;

/// For each new point the mean of the normals that point to the same side as the nearest one's, made unit. So they keep
/// the source's orientation, and the two sides of a thin sheet do not cancel out. Normals that are all the same stay as they
/// are. Where none is there, the nearest point's numbers.
pub(super) fn normals(parts: [&Values; 3], weighted: &[Weighted], present: &Present) -> [Values; 3] {
    columns(parts, weighted, |near, of| {
        let mut there = those_with(near, present);
        let Some((row, weight)) = there.next() else { return of(near[0].0 as usize) };
        let first = of(row);
        let mut sum = first.map(|c| weight * c);
        let mut same = true;
        for (row, weight) in there {
            let normal = of(row);
            if dot(normal, first) > 0.0 {
                same &= normal == first;
                (0..3).for_each(|a| sum[a] += weight * normal[a]);
            }
        }
        if same { first } else { of_length(sum, 1.0).unwrap_or(first) }
    })
}

/// For each new point the mean of the rotations, by their quaternions: each with the sign that is nearer to the nearest's,
/// since a quaternion and its negative are one rotation; made as long as they are on average, so that unit ones stay unit.
/// Those that are all the same stay as they are. Where none is there, the nearest point's numbers.
pub(super) fn rotations(parts: [&Values; 4], weighted: &[Weighted], present: &Present) -> [Values; 4] {
    columns(parts, weighted, |near, of| {
        let mut there = those_with(near, present);
        let Some((row, weight)) = there.next() else { return of(near[0].0 as usize) };
        let first = of(row);
        let (mut sum, mut lengths, mut weights, mut same) = ([0.0; 4], 0.0, 0.0, true);
        let mut add = |turned: [f64; 4], weight: f64| {
            let length = dot(turned, turned).sqrt();
            (0..4).for_each(|a| sum[a] += weight * turned[a] / length);
            (lengths, weights) = (lengths + weight * length, weights + weight);
        };
        add(first, weight);
        for (row, weight) in there {
            let other = of(row);
            let turned = if dot(other, first) < 0.0 { other.map(|c| -c) } else { other };
            same &= turned == first;
            add(turned, weight);
        }
        if same { first } else { of_length(sum, lengths / weights).unwrap_or(first) }
    })
}

/// Which of the source's points have a vector: where all parts are finite and it has a length. Zero stands for one that
/// is not known.
pub(super) fn has_length<const N: usize>(parts: [&Values; N], row: usize) -> bool {
    let vector = parts.map(|part| part.get(row));
    let length = dot(vector, vector);
    length > 0.0 && length.is_finite()
}

fn columns<const N: usize>(
    parts: [&Values; N],
    weighted: &[Weighted],
    vector: impl Fn(&Weighted, &dyn Fn(usize) -> [f64; N]) -> [f64; N] + Sync,
) -> [Values; N] {
    let of = |row: usize| parts.map(|part| part.get(row));
    let vectors: Vec<[f64; N]> = weighted.par_iter().map(|near| vector(near, &of)).collect();
    std::array::from_fn(|a| Values::from_f64(parts[a].kind(), vectors.iter().map(|v| v[a])))
}

fn dot<const N: usize>(a: [f64; N], b: [f64; N]) -> f64 {
    (0..N).map(|i| a[i] * b[i]).sum()
}

/// The vector of that direction and length, if it has a direction.
fn of_length<const N: usize>(vector: [f64; N], length: f64) -> Option<[f64; N]> {
    let own = dot(vector, vector).sqrt();
    (own > 0.0 && own.is_finite()).then(|| vector.map(|c| c / own * length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::Kind;
    use proptest::prelude::*;

    fn near(weights: [f32; 5]) -> [Weighted; 1] {
        [[0, 1, 2, 3, 4].map(|i| (i, weights[i as usize]))]
    }

    fn parts<const N: usize>(kind: Kind, vectors: &[[f64; N]]) -> [Values; N] {
        std::array::from_fn(|a| Values::from_f64(kind, vectors.iter().map(|v| v[a])))
    }

    fn rotation(kind: Kind, vectors: &[[f64; 4]; 5], weights: [f32; 5], present: &Present) -> [f64; 4] {
        let parts = parts(kind, vectors);
        let [a, b, c, d] = &parts;
        rotations([a, b, c, d], &near(weights), present).map(|part| part.get(0))
    }

    #[test]
    fn signs_of_quaternions_do_not_matter() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let about_x = [half, half, 0.0, 0.0];
        let turned = [about_x, about_x.map(|c| -c), about_x, about_x.map(|c| -c), about_x];
        assert_eq!(rotation(Kind::F64, &turned, [1.0; 5], &None), about_x);
        // Halfway between no turn and a quarter turn about x, told with the other sign.
        let two = [[1.0, 0.0, 0.0, 0.0], about_x.map(|c| -c), [0.0; 4], [0.0; 4], [0.0; 4]];
        let present = Some(vec![true, true, false, false, false]);
        let made = rotation(Kind::F64, &two, [1.0; 5], &present);
        let eighth = std::f64::consts::PI / 8.0;
        let expected = [eighth.cos(), eighth.sin(), 0.0, 0.0];
        assert!((0..4).all(|a| (made[a] - expected[a]).abs() < 1e-15), "{made:?}");
    }

    #[test]
    fn lengths_of_quaternions_stay() {
        let long = [0.0, 0.0, 0.0, 2.0];
        assert_eq!(rotation(Kind::F32, &[long; 5], [0.3; 5], &None), long);
        let other = [0.0, 0.0, 2.0, 0.0];
        let made = rotation(Kind::F64, &[long, other, long, other, long], [1.0; 5], &None);
        assert!((dot(made, made).sqrt() - 2.0).abs() < 1e-15);
    }

    #[test]
    fn unknown_normals_have_no_weight() {
        let up = [0.0, 0.6, 0.8];
        let normals_of = |vectors: &[[f64; 3]; 5]| {
            let [x, y, z] = &parts(Kind::F32, vectors);
            let present = Some((0..5).map(|row| has_length([x, y, z], row)).collect());
            normals([x, y, z], &near([1.0; 5]), &present).map(|part| part.get(0) as f32)
        };
        let wanted = up.map(|c| c as f32);
        assert_eq!(normals_of(&[[0.0; 3], up, [f64::NAN; 3], up, up]), wanted, "exactly");
        assert_eq!(normals_of(&[up, up.map(|c| -c), up, up, up]), wanted, "the other side");
        assert_eq!(normals_of(&[[0.0; 3]; 5]), [0.0; 3], "none is known");
    }

    proptest! {
        #[test]
        fn unit_quaternions_stay_unit(
            seeds in proptest::array::uniform5(any::<u64>()),
            weights in proptest::array::uniform5(0.0_f32..10.0),
            signs in proptest::array::uniform5(any::<bool>()),
        ) {
            prop_assume!(weights.iter().any(|w| *w > 0.0));
            let unit = |seed: u64| {
                let mut random = densecloud_geometry::Rng::new(seed);
                let q: [f64; 4] = std::array::from_fn(|_| random.normal());
                q.map(|c| c / dot(q, q).sqrt())
            };
            let plain = seeds.map(unit);
            for kind in [Kind::F32, Kind::F64] {
                let made = rotation(kind, &plain, weights, &None);
                let exact = if kind == Kind::F32 { 1e-6 } else { 1e-14 };
                prop_assert!((dot(made, made).sqrt() - 1.0).abs() < exact, "{made:?}");
                let mut signed = plain;
                (0..5).filter(|i| signs[*i]).for_each(|i| signed[i] = signed[i].map(|c| -c));
                let again = rotation(kind, &signed, weights, &None);
                let first = (0..5).find(|i| weights[*i] > 0.0).expect("one");
                let sign = if signs[first] { -1.0 } else { 1.0 };
                prop_assert!((0..4).all(|a| (again[a] * sign - made[a]).abs() < exact), "{again:?} {made:?}");
            }
        }
    }
}
