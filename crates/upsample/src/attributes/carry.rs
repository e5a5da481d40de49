//! Values for new points from those of the nearest source points.

use rayon::prelude::*;

use super::rules::{Rule, Rules};
use densecloud_cloud::{Attribute, Cloud, Frame, Kind, Point, Position, Values};
use densecloud_geometry::{KdTree, Walk, indices};

/// Source points that a mean is taken over; the last one only sets how far the others reach.
const NEAREST: usize = 6;

/// New points looked up between two questions whether to stop.
const BLOCK: usize = 1 << 16;

/// The attributes of `dense`, each by its rule.
///
/// - [`Rule::Mean`]: Shepard's method in its local form (Franke and Little): the mean of the 5 nearest
///   with weights ((R - d) / (R d))^2, where d is a point's distance and R that of the 6th. It varies without
///   jumps, and is the source's own value at a source point. NaNs have no weight; integers are rounded.
/// - [`Rule::Nearest`]: the value of the nearest, exactly; of equally near ones the first.
/// - A normal: the mean, with the same weights, of those normals that point to the same side as the
///   nearest one's, made unit. So orientation is the source's, and the two sides of a thin sheet do
///   not cancel out.
///
/// Attributes keep their names, types and order. Source points that are not finite have no part. Cost: a
/// tree of the source, O(n log n), and 6 neighbours of each new point, on all threads of the current
/// pool; memory 40 bytes a new point beside the result. `None` when `cancelled` says so in between, or
/// when no source point is finite.
#[must_use]
pub fn carry(
    source: &Cloud,
    dense: &[Position],
    rules: &Rules,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<Vec<Attribute>> {
    let kept: Vec<(&Attribute, Rule)> = (source.attributes.iter())
        .map(|a| (a, rules.of(&a.name, a.values.kind())))
        .filter(|(_, rule)| *rule != Rule::Drop)
        .collect();
    if kept.is_empty() {
        return Some(Vec::new());
    }
    let near = Near::find(&source.positions, dense, cancelled)?;
    let usual = Rules::default();
    let follows_usual = |(a, rule): &&(&Attribute, Rule)| *rule == usual.of(&a.name, a.values.kind());
    let normal = normal_of(kept.iter().map(|pair| {
        let name = if follows_usual(&pair) { pair.0.name.as_str() } else { "" };
        (name, pair.0.values.kind())
    }));
    let mut carried: Vec<Attribute> = Vec::with_capacity(kept.len());
    for (i, (attribute, rule)) in kept.iter().enumerate() {
        if cancelled() {
            return None;
        }
        let values = match rule {
            _ if normal.is_some_and(|axes| axes.contains(&i)) => Values::new(attribute.values.kind()),
            Rule::Mean => near.mean(&attribute.values),
            Rule::Nearest | Rule::Drop => attribute.values.gather(&near.nearest),
        };
        carried.push(Attribute { name: attribute.name.clone(), values });
    }
    if let Some(axes) = normal {
        let vectors = near.normals(axes.map(|i| &kept[i].0.values));
        for (a, i) in axes.into_iter().enumerate() {
            let kind = kept[i].0.values.kind();
            carried[i].values = Values::from_f64(kind, vectors.iter().map(|v| v[a]));
        }
    }
    Some(carried)
}

/// Where the three parts of a normal stand, if all are there and are floats.
pub(super) fn normal_of<'a>(attributes: impl Iterator<Item = (&'a str, Kind)>) -> Option<[usize; 3]> {
    let attributes: Vec<(&str, Kind)> = attributes.collect();
    let find = |wanted: &str| {
        attributes.iter().position(|(name, kind)| name.eq_ignore_ascii_case(wanted) && kind.is_float())
    };
    [["nx", "ny", "nz"], ["normal_x", "normal_y", "normal_z"], ["normalx", "normaly", "normalz"]]
        .into_iter()
        .find_map(|names| Some([find(names[0])?, find(names[1])?, find(names[2])?]))
}

/// For each new point its nearest source points, by their rows in the source.
pub(super) struct Near {
    pub(super) nearest: Vec<u32>,
    weighted: Vec<[(u32, f32); NEAREST - 1]>,
}

impl Near {
    pub(super) fn find(
        source: &[Position],
        dense: &[Position],
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Option<Self> {
        let finite = |p: &Position| p.iter().all(|c| c.is_finite());
        let rows: Vec<u32> = indices(source.len()).filter(|&i| finite(&source[i as usize])).collect();
        let positions: Vec<Position> = rows.iter().map(|&i| source[i as usize]).collect();
        let frame = Frame::fit(&positions).ok()?;
        let points: Vec<Point> = positions.iter().map(|p| frame.to_local(*p)).collect();
        drop(positions);
        let tree = KdTree::new(&points);
        let k = NEAREST.min(points.len());
        let look = |walk: &mut Walk, p: &Position| {
            tree.nearest_next(frame.to_local(*p), k, walk);
            let reach = walk.found.last().map_or(0.0, |n| n.distance_squared.sqrt());
            let mut weighted = [(rows[walk.found[0].index as usize], 0.0); NEAREST - 1];
            for (slot, n) in weighted.iter_mut().zip(&walk.found) {
                let d = n.distance_squared.sqrt();
                *slot = (rows[n.index as usize], ((reach - d) / (reach * d)).powi(2));
            }
            // On a source point, or between points that are all the same distance away.
            let exact = walk.found[0].distance_squared == 0.0;
            if exact
                || weighted.iter().all(|(_, w)| *w <= 0.0)
                || weighted.iter().any(|(_, w)| !w.is_finite())
            {
                weighted = [(weighted[0].0, 0.0); NEAREST - 1];
                weighted[0].1 = 1.0;
            }
            weighted
        };
        let mut weighted = Vec::with_capacity(dense.len());
        for block in dense.chunks(BLOCK) {
            if cancelled() {
                return None;
            }
            weighted.par_extend(block.par_iter().map_init(Walk::default, look));
        }
        Some(Self { nearest: weighted.iter().map(|w| w[0].0).collect(), weighted })
    }

    fn mean(&self, values: &Values) -> Values {
        let mean = |near: &[(u32, f32); NEAREST - 1]| {
            let (mut sum, mut weights) = (0.0, 0.0);
            for &(row, weight) in near {
                let value = values.get(row as usize);
                if !value.is_nan() && weight > 0.0 {
                    sum += f64::from(weight) * value;
                    weights += f64::from(weight);
                }
            }
            if weights > 0.0 { sum / weights } else { values.get(near[0].0 as usize) }
        };
        let means: Vec<f64> = self.weighted.par_iter().map(mean).collect();
        Values::from_f64(values.kind(), means.into_iter())
    }

    fn normals(&self, axes: [&Values; 3]) -> Vec<[f64; 3]> {
        let of = |row: u32| axes.map(|values| values.get(row as usize));
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let normal = |near: &[(u32, f32); NEAREST - 1]| {
            let first = of(near[0].0);
            let mut sum = [0.0; 3];
            for &(row, weight) in near {
                let n = of(row);
                // False for NaN, too.
                if dot(n, first) > 0.0 {
                    for a in 0..3 {
                        sum[a] += f64::from(weight) * n[a];
                    }
                }
            }
            let length = dot(sum, sum).sqrt();
            // Zero stands for a normal that is not known.
            if length > 0.0 && length.is_finite() { sum.map(|c| c / length) } else { first }
        };
        self.weighted.par_iter().map(normal).collect()
    }
}

#[cfg(test)]
mod tests {
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
        carry(source, dense, &rules, &|| false).expect("attributes")
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
        assert_eq!(carry(&source, &[[0.0; 3]], &Rules::default(), &|| true), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
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
