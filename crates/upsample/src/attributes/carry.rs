//! Values for new points from those of the nearest source points.

use std::borrow::Cow;

use rayon::prelude::*;

use super::mean::mean;
use super::near::{Near, Present, those_with};
use super::plan::{Group, How, Plan};
use super::vectors::{has_length, normals, rotations};
use densecloud_cloud::{Attribute, Cloud, Position, Values};

/// The attributes of `dense`, as planned for the cloud that `source` is or is a part of.
///
/// - [`Rule::Mean`](super::Rule::Mean): Shepard's method in its local form (Franke and Little): the mean of the 5 nearest
///   with weights ((R - d) / (R d))^2, where d is a point's distance and R that of the 6th. It varies without
///   jumps, is the source's own value at a source point, and never outside of the range of the values that it is of.
///   Integers are rounded.
/// - [`Rule::Nearest`](super::Rule::Nearest): the value of the nearest, exactly; of equally near ones the first.
/// - A normal: the mean, with the same weights, of those normals that point to the same side as the
///   nearest one's, made unit. So orientation is the source's, and the two sides of a thin sheet do
///   not cancel out.
/// - A rotation (`rot_0` to `rot_3`): the mean of the quaternions, each with the sign that is nearer to the nearest's, as
///   long as they are on average.
/// - A colour, the logarithms of a Gaussian's axes, and the coefficients of a colour that depends on the side: the mean of
///   those points that have all of their parts.
///
/// What is absent has no weight: numbers that are not finite (NaN alone for [`Rule::Nearest`](super::Rule::Nearest)),
/// normals and quaternions of no length, and what a flag calls invalid. Where no source point with a weight has a value, the
/// new point has none: its number is the nearest point's, and its flag is 1.
///
/// Attributes keep their names, types and order. Source points that are not finite have no part. Cost: a
/// tree of the source, O(n log n), and 6 neighbours of each new point, on all threads of the current
/// pool. Memory beside the result: 40 bytes a new point, 4 more where an attribute has the nearest's values, and while they are
/// worked on 24 for normals and 32 for rotations; one byte a source point. `None` when `cancelled` says so in between,
/// or when no source point is finite.
///
/// # Panics
/// When the plan is of a cloud with fewer attributes, or of other types.
#[must_use]
pub fn carry(
    source: &Cloud,
    dense: &[Position],
    plan: &Plan,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<Attribute>> {
    if plan.kept().next().is_none() {
        return Some(Vec::new());
    }
    carry_near(source, &Near::find(&source.positions, dense, cancelled)?, plan, cancelled)
}

/// As [`carry`], for points whose nearest are known.
pub(super) fn carry_near(
    source: &Cloud,
    near: &Near,
    plan: &Plan,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<Attribute>> {
    let mut carried: Vec<Option<Values>> = vec![None; source.attributes.len()];
    for group in &plan.groups {
        if cancelled() {
            return None;
        }
        let columns: Vec<&Values> = group.columns.iter().map(|i| &source.attributes[*i].values).collect();
        let flags: Vec<&Values> = group.flags.iter().map(|i| &source.attributes[*i].values).collect();
        for (i, values) in group.columns.iter().zip(group_of(group, &columns, &flags, near)) {
            carried[*i] = Some(values);
        }
    }
    let kept = plan.kept().filter_map(|i| {
        let name = source.attributes[i].name.clone();
        Some(Attribute { name, values: carried[i].take()? })
    });
    Some(kept.collect())
}

/// The values of a group's columns, in their order.
fn group_of(group: &Group, columns: &[&Values], flags: &[&Values], near: &Near) -> Vec<Values> {
    let present = present(group.how, columns, flags);
    let weighted = &near.weighted;
    match (group.how, columns) {
        (How::Normal, &[x, y, z]) => normals([x, y, z], weighted, &present).into(),
        (How::Rotation, &[w, x, y, z]) => rotations([w, x, y, z], weighted, &present).into(),
        (How::Flag, _) => columns.iter().map(|flag| flagged(flag, near, &present)).collect(),
        (How::Nearest, _) => {
            let rows = nearest(near, &present);
            columns.iter().map(|values| values.gather(&rows)).collect()
        }
        _ => columns.iter().map(|values| mean(values, weighted, &present)).collect(),
    }
}

/// Which source points have all of these values.
fn present(how: How, columns: &[&Values], flags: &[&Values]) -> Present {
    let floats: Vec<&Values> = columns.iter().copied().filter(|c| c.kind().is_float()).collect();
    if floats.is_empty() && flags.is_empty() {
        return None;
    }
    let told = |row: usize| match (how, columns) {
        (How::Normal, &[x, y, z]) => has_length([x, y, z], row),
        (How::Rotation, &[w, x, y, z]) => has_length([w, x, y, z], row),
        (How::Flag, _) => true,
        (How::Nearest, _) => floats.iter().all(|column| !column.get(row).is_nan()),
        _ => floats.iter().all(|column| column.get(row).is_finite()),
    };
    let rows = columns.first().map_or(0, |column| column.len());
    let here = |row: usize| told(row) && flags.iter().all(|flag| flag.get(row) == 0.0);
    let present: Vec<bool> = (0..rows).into_par_iter().map(here).collect();
    present.contains(&false).then_some(present)
}

/// The rows of the nearest source points that have a value.
fn nearest<'a>(near: &'a Near, present: &Present) -> Cow<'a, [u32]> {
    if present.is_none() {
        return Cow::Borrowed(near.nearest());
    }
    let row = |near| those_with(near, present).next().map_or(near[0].0, |(row, _)| row as u32);
    Cow::Owned(near.weighted.par_iter().map(row).collect())
}

/// Whether new points have no value where a flag says that of source points.
fn flagged(flag: &Values, near: &Near, present: &Present) -> Values {
    let none = |near| those_with(near, present).next().is_none();
    let flags: Vec<bool> = near.weighted.par_iter().map(none).collect();
    Values::from_f64(flag.kind(), flags.into_iter().map(|absent| f64::from(u8::from(absent))))
}

#[cfg(test)]
mod tests {
    use super::super::Rules;
    use super::*;
    use proptest::prelude::*;

    fn column(name: &str, values: Values) -> Attribute {
        Attribute { name: name.to_owned(), values }
    }

    fn grid(n: usize) -> Vec<Position> {
        (0..n * n).map(|i| [5e5 + (i % n) as f64, 4e6 + (i / n) as f64, 100.0]).collect()
    }

    fn run(source: &Cloud, dense: &[Position], rules: &str) -> Vec<Attribute> {
        let rules = if rules.is_empty() { Rules::default() } else { rules.parse().expect("rules") };
        carry(source, dense, &Plan::of(&source.attributes, &rules), &|| false).expect("attributes")
    }

    #[test]
    fn source_points_keep_their_own_values() {
        let positions = grid(20);
        let red: Vec<u8> = (0..400_u32).map(|i| (i * 37 % 256) as u8).collect();
        let time: Vec<f64> = (0..400).map(|i| 1e9 + f64::from(i)).collect();
        let id: Vec<i64> = (0..400).map(|i| i64::MAX - i).collect();
        let attributes = vec![
            column("red", Values::U8(red)),
            column("gps_time", Values::F64(time)),
            column("id", Values::I64(id)),
        ];
        let source =
            Cloud { positions: positions.clone(), attributes: attributes.clone(), ..Cloud::default() };
        assert_eq!(run(&source, &positions, ""), attributes);
        let names: Vec<String> =
            run(&source, &positions, "gps_time:drop").into_iter().map(|a| a.name).collect();
        assert_eq!(names, ["red", "id"]);
    }

    #[test]
    fn a_mean_lies_between_and_a_label_does_not() {
        let positions = grid(20);
        let left = |p: &Position| p[0] < 5e5 + 9.5;
        let ramp: Vec<f32> = positions.iter().map(|p| (p[0] - 5e5) as f32).collect();
        let label: Vec<f32> = positions.iter().map(|p| if left(p) { 1.0 } else { 7.0 }).collect();
        let attributes = vec![column("temperature", Values::F32(ramp)), column("label", Values::F32(label))];
        let source = Cloud { positions, attributes, ..Cloud::default() };
        let dense: Vec<Position> =
            (0..50).map(|i| [5e5 + 5.0 + f64::from(i) / 7.0, 4e6 + 10.3, 100.0]).collect();
        let carried = run(&source, &dense, "");
        for (i, p) in dense.iter().enumerate() {
            assert!(
                (carried[0].values.get(i) - (p[0] - 5e5)).abs() < 0.35,
                "{} at {p:?}",
                carried[0].values.get(i)
            );
            assert_eq!(carried[1].values.get(i), if left(p) { 1.0 } else { 7.0 });
        }
    }

    #[test]
    fn normals_stay_unit_and_on_their_side_of_a_thin_sheet() {
        let mut positions = grid(10);
        positions.extend(grid(10).into_iter().map(|[x, y, z]| [x, y, z - 0.2]));
        let nz: Vec<f32> = (0..200).map(|i| if i < 100 { 1.0 } else { -1.0 }).collect();
        let zero = || Values::F32(vec![0.0; 200]);
        let attributes = vec![column("nx", zero()), column("ny", zero()), column("nz", Values::F32(nz))];
        let source = Cloud { positions, attributes, ..Cloud::default() };
        let dense = [[5e5 + 4.4, 4e6 + 4.3, 99.99], [5e5 + 4.4, 4e6 + 4.3, 99.81]];
        assert_eq!(run(&source, &dense, "")[2].values, Values::F32(vec![1.0, -1.0]));
    }

    #[test]
    fn what_is_not_a_number_has_no_weight() {
        let mut positions = grid(5);
        positions.push([f64::NAN; 3]);
        let mut values = vec![3.0_f32; 26];
        values[12] = f32::NAN;
        let source =
            Cloud { positions, attributes: vec![column("t", Values::F32(values))], ..Cloud::default() };
        let carried = run(&source, &[[5e5 + 2.1, 4e6 + 2.1, 100.0]], "");
        assert_eq!(carried[0].values, Values::F32(vec![3.0]));
        let plan = Plan::of(&source.attributes, &Rules::default());
        assert_eq!(carry(&source, &[[0.0; 3]], &plan, &|| true), None);
    }

    /// Points between those of a grid.
    fn between(n: usize) -> Vec<Position> {
        (0..n * n).map(|i| [5e5 + (i % n) as f64 + 0.31, 4e6 + (i / n) as f64 + 0.44, 100.0]).collect()
    }

    #[test]
    fn absent_colours_have_no_weight() {
        // A third of the colours are black, and flagged; in one corner all are.
        let positions = grid(12);
        let absent = |i: usize| i.is_multiple_of(3) || (i % 12 > 7 && i / 12 > 7);
        let part = |full: u8| Values::U8((0..144).map(|i| if absent(i) { 0 } else { full }).collect());
        let attributes = vec![
            column("Red", part(200)),
            column("Green", part(100)),
            column("Blue", part(50)),
            column("isColorInvalid", Values::U8((0..144).map(|i| u8::from(absent(i))).collect())),
        ];
        let source = Cloud { positions: positions.clone(), attributes, ..Cloud::default() };
        let dense = between(11);
        let carried = run(&source, &dense, "");
        let mut absent_ones = 0;
        for (i, p) in dense.iter().enumerate() {
            let colour: Vec<f64> = (0..3).map(|a| carried[a].values.get(i)).collect();
            match carried[3].values.get(i) {
                0.0 => assert_eq!(colour, [200.0, 100.0, 50.0], "{p:?}"),
                flag => {
                    assert_eq!((flag, colour), (1.0, vec![0.0; 3]));
                    assert!(p[0] > 5e5 + 7.0 && p[1] > 4e6 + 7.0, "{p:?}");
                    absent_ones += 1;
                }
            }
        }
        assert!((4..16).contains(&absent_ones), "{absent_ones}");
        // A source point has what it had.
        assert_eq!(run(&source, &positions, ""), source.attributes);
        // Without the flags in the result, they are heeded all the same.
        let colours = run(&source, &dense, "isColorInvalid:drop");
        assert_eq!(colours, carried[..3]);
    }

    #[test]
    fn what_is_missing_from_the_nearest_comes_from_the_next() {
        let positions = grid(5);
        let label: Vec<f32> = (0..25).map(|i| if i % 2 == 0 { f32::NAN } else { 7.0 }).collect();
        let part =
            |odd: f32, even: f32| Values::F32((0..25).map(|i| if i % 2 == 0 { even } else { odd }).collect());
        let attributes = vec![
            column("label", Values::F32(label)),
            column("r", part(0.5, f32::NAN)),
            column("g", part(0.5, 0.0)),
            column("b", part(0.5, 0.0)),
        ];
        let source = Cloud { positions, attributes, ..Cloud::default() };
        // Nearest to an even one.
        let carried = run(&source, &[[5e5 + 2.1, 4e6 + 2.12, 100.0]], "");
        assert_eq!(carried[0].values, Values::F32(vec![7.0]));
        for colour in &carried[1..] {
            assert_eq!(colour.values, Values::F32(vec![0.5]), "{}: a colour is whole", colour.name);
        }
    }

    #[test]
    fn numbers_in_floats_are_those_of_a_point() {
        let positions = grid(20);
        let floats = |of: &dyn Fn(usize) -> f32| Values::F32((0..400).map(of).collect());
        let ids = |i: usize| if (i / 20).is_multiple_of(2) { 2.0 } else { 6.0 };
        let names = [
            "scalar_Classification",
            "scalar_Original_cloud_index",
            "scalar_ring",
            "scalar_sem",
            "Scan Angle Rank",
            "UserData",
            "tree", // By its values.
        ];
        let mut attributes: Vec<Attribute> = names.iter().map(|name| column(name, floats(&ids))).collect();
        attributes.push(column("scalar_Intensity", floats(&ids)));
        attributes.push(column("Elevation", floats(&ids)));
        let source = Cloud { positions, attributes, ..Cloud::default() };
        let carried = run(&source, &between(19), "");
        let whole = |i: usize| (0..361).all(|row| [2.0, 6.0].contains(&carried[i].values.get(row)));
        for (i, name) in names.iter().enumerate() {
            assert!(whole(i), "{name}");
        }
        assert!(!whole(7) && !whole(8), "an intensity and a height vary");
    }

    #[test]
    fn rotations_of_either_sign_are_one() {
        let positions = grid(10);
        // A turn about z that grows from left to right.
        let angle = |p: &Position| (p[0] - 5e5) * 0.05;
        let part = |of: &dyn Fn(f64) -> f64| {
            let sign = |i: usize| if (i * 7).is_multiple_of(3) { -1.0 } else { 1.0 };
            Values::F32(positions.iter().enumerate().map(|(i, p)| (sign(i) * of(angle(p))) as f32).collect())
        };
        let zero = || Values::F32(vec![0.0; 100]);
        let attributes = vec![
            column("rot_0", part(&f64::cos)),
            column("rot_1", zero()),
            column("rot_2", zero()),
            column("rot_3", part(&f64::sin)),
        ];
        let source = Cloud { positions, attributes, ..Cloud::default() };
        let dense = between(9);
        let carried = run(&source, &dense, "");
        for (i, p) in dense.iter().enumerate() {
            let [w, x, y, z] = [0, 1, 2, 3].map(|a| carried[a].values.get(i));
            assert!((w * w + z * z - 1.0).abs() < 1e-6 && x == 0.0 && y == 0.0);
            assert!(((z / w).atan() - angle(p)).abs() < 0.02, "{p:?}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn the_order_of_a_clouds_points_changes_nothing(seed in any::<u64>(), turn in 1_usize..60) {
            let mut rng = densecloud_geometry::Rng::new(seed);
            let mut numbers = |scale: f64| -> Vec<f64> { (0..60).map(|_| rng.f64() * scale).collect() };
            let (x, y, z) = (numbers(1.0), numbers(1.0), numbers(0.1));
            let positions: Vec<Position> = (0..60).map(|i| [x[i], y[i], z[i]]).collect();
            let mut attributes: Vec<Attribute> = ["rot_0", "rot_1", "rot_2", "rot_3", "heat"]
                .map(|name| column(name, Values::F32(numbers(1.0).iter().map(|v| *v as f32 + 0.1).collect())))
                .into();
            attributes.push(column("id", Values::U32((0..60).collect())));
            attributes.push(column("heat_invalid", Values::U8(numbers(1.4).iter().map(|v| *v as u8).collect())));
            let dense: Vec<Position> = (0..40).map(|i| [y[i], x[i], z[i]]).collect();
            let source = Cloud { positions, attributes, ..Cloud::default() };
            let order: Vec<u32> = (0..60).map(|i| (i + turn as u32) % 60).collect();
            let turned = Cloud {
                positions: order.iter().map(|i| source.positions[*i as usize]).collect(),
                attributes: (source.attributes.iter())
                    .map(|a| column(&a.name, a.values.gather(&order)))
                    .collect(),
                ..Cloud::default()
            };
            for (a, b) in run(&source, &dense, "").iter().zip(run(&turned, &dense, "")) {
                for i in 0..dense.len() {
                    prop_assert!((a.values.get(i) - b.values.get(i)).abs() < 1e-6, "{}", a.name);
                }
            }
        }


        #[test]
        fn values_stay_within_those_of_the_source(seed in any::<u64>(), n in 2_usize..200, same in any::<bool>()) {
            let mut rng = densecloud_geometry::Rng::new(seed);
            let mut spot = |_| -> Position { std::array::from_fn(|_| if same { (rng.f64() * 2.0).floor() } else { rng.f64() }) };
            let positions: Vec<Position> = (0..n).map(&mut spot).collect();
            prop_assume!(positions.iter().any(|p| *p != positions[0]));
            let dense: Vec<Position> = (0..50).map(&mut spot).collect();
            let values = Values::U8((0..n).map(|i| 50 + (i % 100) as u8).collect());
            let source = Cloud { positions, attributes: vec![column("red", values)], ..Cloud::default() };
            let carried = run(&source, &dense, "");
            prop_assert_eq!(carried[0].values.len(), 50);
            prop_assert!((0..50).all(|i| (50.0..150.0).contains(&carried[0].values.get(i))));
        }
    }
}
