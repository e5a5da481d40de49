//! From the cascade's points to a result: the input's points among them, and what is known of each.

use super::carry::carry_near;
use super::finish::Finish;
use super::keep::without_nearest;
use super::near::Near;
use super::normals::{Stood, normals};
use super::plan::Plan;
use super::sure;
use densecloud_cascade::confidence;
use densecloud_cloud::{Attribute, Cloud, Position, Values};
use densecloud_geometry::indices;

/// Finishes a result, its attributes as planned for the cloud that `source` is. `None` when `cancelled` says so in between, or when
/// no source point is finite.
///
/// Cost: that of [`carry()`](super::carry()), and with [`Finish::keep_input`] or
/// [`Finish::estimate_normals`] a tree of the dense points and a few neighbours of each; a confidence takes that of
/// [`confidence`].
///
/// # Panics
/// Above [`MAX_POINTS`](densecloud_geometry::MAX_POINTS) points in the source, which the cascade refuses.
#[must_use]
pub fn finish(
    source: &Cloud,
    dense: Vec<Position>,
    how: &Finish,
    plan: &Plan,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<(Vec<Position>, Vec<Attribute>)> {
    finish_part(source, dense, how, plan, &Part::default(), cancelled)
}

/// What of a source and of the points made of it is a part of a whole, and what lies around that part; by default,
/// nothing does.
#[derive(Debug, Clone, Copy, Default)]
pub struct Part<'a> {
    /// The rows of the source that are the part's own, ascending; all where there is none.
    pub own: Option<&'a [u32]>,
    /// The row in the whole of each row of the source; the same where there is none.
    pub rows: Option<&'a [u32]>,
    /// Points made that lie beyond the part, for the normals of others.
    pub rim: &'a [Position],
    /// How many points are made of each in the whole; else by those at hand.
    pub ratio: Option<f64>,
}

/// As [`finish`], of a part of a cloud, whose attributes are as planned for the whole: `source` has the part's points and
/// those around it, `dense` the part's alone.
///
/// # Panics
/// As [`finish`].
#[must_use]
pub fn finish_part(
    source: &Cloud,
    mut dense: Vec<Position>,
    how: &Finish,
    plan: &Plan,
    part: &Part<'_>,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Option<(Vec<Position>, Vec<Attribute>)> {
    let mut kept: Vec<u32> = Vec::new();
    let mut originals: Vec<Position> = Vec::new();
    if how.keep_input {
        let finite = |i: &u32| source.positions[*i as usize].iter().all(|c| c.is_finite());
        kept = match part.own {
            Some(own) => own.iter().copied().filter(finite).collect(),
            None => indices(source.positions.len()).filter(finite).collect(),
        };
        originals = kept.iter().map(|&i| source.positions[i as usize]).collect();
        dense = without_nearest(dense, &originals)?;
    }
    let needed = how.source_fields || plan.kept().next().is_some();
    let near = if needed { Some(Near::find(&source.positions, &dense, cancelled)?) } else { None };
    let mut attributes = match &near {
        Some(near) => carry_near(source, near, plan, cancelled)?,
        None => Vec::new(),
    };
    // Else its memory is free from here.
    let near = near.filter(|_| how.source_fields);
    for (attribute, own) in attributes.iter_mut().zip(plan.kept()) {
        let mut values = source.attributes[own].values.gather(&kept);
        values.append(&mut attribute.values);
        attribute.values = values;
    }
    if let Some(near) = near {
        add_source_fields(&mut attributes, &kept, near.nearest(), part.rows);
    }
    let mut positions = originals;
    positions.append(&mut dense);
    if how.estimate_normals {
        if cancelled() {
            return None;
        }
        let stood = Stood::of(how, &source.origin, &attributes);
        normals(&positions, part.rim, kept.len(), &mut attributes, &stood)?;
    }
    if !how.asks_confidence() {
        return Some((positions, attributes));
    }
    let confidence = confidence(&source.positions, &positions, part.ratio, cancelled)?;
    Some(sure::finish(positions, attributes, confidence, kept.len(), how))
}

/// Adds the row in the whole of the source point that each point is, or that is `nearest`, and whether it is new.
fn add_source_fields(attributes: &mut Vec<Attribute>, kept: &[u32], nearest: &[u32], rows: Option<&[u32]>) {
    attributes.retain(|a| a.name != "source_index" && a.name != "is_generated");
    let mut index = kept.to_vec();
    index.extend_from_slice(nearest);
    if let Some(rows) = rows {
        index.iter_mut().for_each(|i| *i = rows[*i as usize]);
    }
    let mut generated = vec![0; kept.len()];
    generated.resize(index.len(), 1);
    attributes.push(Attribute { name: "source_index".into(), values: Values::U32(index) });
    attributes.push(Attribute { name: "is_generated".into(), values: Values::U8(generated) });
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::Sensors;
    use densecloud_geometry::Rng;

    /// Points on the unit sphere about a far centre, with an id and, if wanted, normals that point inwards.
    fn sphere(n: usize, seed: u64, inwards: bool) -> Cloud {
        let mut random = Rng::new(seed);
        let directions: Vec<Position> = (0..n)
            .map(|_| {
                let v: Position = std::array::from_fn(|_| random.normal());
                v.map(|c| c / v.iter().map(|c| c * c).sum::<f64>().sqrt())
            })
            .collect();
        let mut attributes = vec![Attribute {
            name: "id".into(),
            values: Values::U32((0..n as u32).map(|i| 7 * i).collect()),
        }];
        if inwards {
            for (a, name) in ["nx", "ny", "nz"].into_iter().enumerate() {
                let values = Values::F64(directions.iter().map(|d| -d[a]).collect());
                attributes.push(Attribute { name: name.into(), values });
            }
        }
        let positions = directions.iter().map(|d| [4e5 + d[0], 5e6 + d[1], 100.0 + d[2]]).collect();
        Cloud { positions, attributes, ..Cloud::default() }
    }

    fn run(source: &Cloud, dense: &Cloud, how: &Finish) -> (Vec<Position>, Vec<Attribute>) {
        let plan = Plan::of(&source.attributes, &how.rules);
        finish(source, dense.positions.clone(), how, &plan, &|| false).expect("a result")
    }

    #[test]
    fn the_input_is_kept_exactly() {
        let mut source = sphere(300, 1, true);
        source.positions[17] = [f64::NAN; 3];
        let dense = sphere(1200, 2, false);
        let how = Finish { keep_input: true, source_fields: true, ..Finish::default() };
        let (positions, attributes) = run(&source, &dense, &how);
        assert_eq!(positions.len(), 1200, "as many as asked for");
        let rows: Vec<u32> = (0..300).filter(|i| *i != 17).collect();
        for (i, &row) in rows.iter().enumerate() {
            assert_eq!(positions[i], source.positions[row as usize]);
            for (made, own) in attributes.iter().zip(&source.attributes) {
                assert_eq!((&made.name, made.values.get(i)), (&own.name, own.values.get(row as usize)));
            }
        }
        let names: Vec<&str> = attributes.iter().map(|a| a.name.as_str()).collect();
        assert_eq!(names, ["id", "nx", "ny", "nz", "source_index", "is_generated"]);
        for (i, p) in positions.iter().enumerate() {
            assert_eq!(attributes[5].values.get(i), f64::from(i >= rows.len()));
            let index = attributes[4].values.get(i) as usize;
            let to = |q: Position| (0..3).map(|a| (p[a] - q[a]).powi(2)).sum::<f64>();
            let nearest =
                source.positions.iter().map(|q| to(*q)).filter(|d| !d.is_nan()).fold(f64::MAX, f64::min);
            assert!(to(source.positions[index]) <= nearest + 1e-9, "point {i}");
        }
        // New ones are the cascade's own.
        for p in &positions[rows.len()..] {
            assert!(dense.positions.contains(p));
        }
    }

    #[test]
    fn parts_are_finished_as_the_whole_is() {
        let source = sphere(400, 1, true);
        let dense = sphere(1600, 2, false).positions;
        let how =
            Finish { source_fields: true, confidence: true, estimate_normals: true, ..Finish::default() };
        let (positions, attributes) = run(&source, &Cloud::from(dense.clone()), &how);
        let plan = Plan::of(&source.attributes, &how.rules);
        let is_own = |p: &Position| p[0] < 4e5 + 0.3;
        let reaches = |p: &&Position| p[0] < 4e5 + 0.9;
        // The source's rows are another way round in the part.
        let rows: Vec<u32> = (0..400).rev().filter(|i| reaches(&&source.positions[*i as usize])).collect();
        let part = Cloud {
            positions: rows.iter().map(|i| source.positions[*i as usize]).collect(),
            attributes: (source.attributes.iter())
                .map(|a| Attribute { name: a.name.clone(), values: a.values.gather(&rows) })
                .collect(),
            ..Cloud::default()
        };
        let own: Vec<u32> = indices(rows.len()).filter(|i| is_own(&part.positions[*i as usize])).collect();
        let (made, rim): (Vec<Position>, Vec<Position>) = dense.iter().partition(|p| is_own(p));
        let share = Part { own: Some(&own), rows: Some(&rows), rim: &rim, ratio: Some(4.0) };
        let (made, its) = finish_part(&part, made, &how, &plan, &share, &|| false).expect("a part");
        let of_whole: Vec<u32> = indices(1600).filter(|i| is_own(&positions[*i as usize])).collect();
        for (whole, its) in attributes.iter().zip(&its) {
            assert_eq!(whole.name, its.name);
            for (i, row) in of_whole.iter().enumerate() {
                let (a, b) = (whole.values.get(*row as usize), its.values.get(i));
                assert!((a - b).abs() < 1e-3, "{} of {:?}: {a}, {b}", its.name, made[i]);
            }
        }
        // The part's own points are kept, and none of those around it.
        let how = Finish { keep_input: true, ..Finish::default() };
        let (kept, _) = finish_part(&part, made.clone(), &how, &plan, &share, &|| false).expect("a part");
        assert_eq!(kept.len(), made.len());
        assert!(own.iter().zip(&kept).all(|(i, p)| part.positions[*i as usize] == *p));
    }

    #[test]
    fn estimated_normals_are_on_the_right_side() {
        let dense = sphere(2000, 3, false);
        let outwards = |positions: &[Position], attributes: &[Attribute], from: usize, i: usize| {
            let p = positions[i];
            let d = [p[0] - 4e5, p[1] - 5e6, p[2] - 100.0];
            (0..3).map(|a| d[a] * attributes[from + a].values.get(i)).sum::<f64>()
        };
        let how = Finish { estimate_normals: true, ..Finish::default() };
        let (positions, attributes) = run(&sphere(500, 4, true), &dense, &how);
        let mean = (0..2000).map(|i| outwards(&positions, &attributes, 1, i)).sum::<f64>() / 2000.0;
        assert!(mean < -0.98, "as the source's: {mean}");
        // From outside, the near half points out and the far half in.
        let how = Finish { sensor: Some([4e5 + 50.0, 5e6, 100.0]), ..how };
        let (positions, attributes) = run(&sphere(500, 4, false), &dense, &how);
        for i in 0..2000 {
            let side = positions[i][0] - 4e5;
            if side.abs() > 0.3 {
                assert!(side * outwards(&positions, &attributes, 1, i) > 0.0, "{:?}", positions[i]);
            }
        }
    }

    #[test]
    fn each_scan_has_a_sensor_of_its_own() {
        let dense = sphere(2000, 3, false);
        let mut source = sphere(500, 4, false);
        // What is above its middle was seen from outside, the rest from within, and of a third scan nothing is known.
        let scan = |p: &Position| if p[1] > 5e6 + 0.6 { 2 } else { u8::from(p[2] > 100.0) };
        let scans = source.positions.iter().map(scan).collect();
        source.attributes = vec![Attribute { name: "number".into(), values: Values::U8(scans) }];
        let places = vec![Some([4e5, 5e6, 100.0]), Some([4e5, 5e6, 150.0])];
        let sensors = Sensors { attribute: "number".into(), places };
        source.origin.sensors = Some(std::sync::Arc::new(sensors));
        let how = Finish { estimate_normals: true, ..Finish::default() };
        let (positions, attributes) = run(&source, &dense, &how);
        let mut sides = [[0; 2]; 2];
        for (i, p) in positions.iter().enumerate() {
            let d = [p[0] - 4e5, p[1] - 5e6, p[2] - 100.0];
            let outwards = (0..3).map(|a| d[a] * attributes[1 + a].values.get(i)).sum::<f64>() > 0.0;
            let scan = attributes[0].values.get(i) as usize;
            if scan < 2 {
                sides[scan][usize::from(outwards)] += 1;
            }
        }
        assert!(sides[0][1] == 0 && sides[0][0] > 500, "inwards: {sides:?}");
        // A tangent plane at the sphere's side passes the sensor on either side.
        assert!(sides[1][1] > 500 && sides[1][0] < 50, "outwards: {sides:?}");
        // What the caller says holds for all.
        let how = Finish { sensor: Some([4e5, 5e6, 100.0]), ..how };
        let (positions, attributes) = run(&source, &dense, &how);
        for (i, p) in positions.iter().enumerate() {
            let d = [p[0] - 4e5, p[1] - 5e6, p[2] - 100.0];
            assert!((0..3).map(|a| d[a] * attributes[1 + a].values.get(i)).sum::<f64>() < 0.0);
        }
    }

    #[test]
    fn what_is_not_sure_is_left_out_of_the_same_result() {
        let (mut source, mut dense) = (sphere(300, 1, true), sphere(1200, 2, false));
        source.positions[17] = [4e5, 5e6, 105.0];
        dense.positions.extend([[4e5, 5e6, 104.0], [4e5, 5e6, 106.0]]);
        for keep_input in [false, true] {
            let how = Finish {
                confidence: true,
                keep_input,
                estimate_normals: true,
                source_fields: true,
                ..Finish::default()
            };
            let (positions, attributes) = run(&source, &dense, &how);
            let names: Vec<&str> = attributes.iter().map(|a| a.name.as_str()).collect();
            assert_eq!(names, ["id", "nx", "ny", "nz", "source_index", "is_generated", "confidence"]);
            let kept = if keep_input { 300 } else { 0 };
            let left: Vec<u32> = indices(positions.len())
                .filter(|&i| i < kept || attributes[6].values.get(i as usize) >= 0.8)
                .collect();
            assert!((600..1202).contains(&left.len()), "{}", left.len());
            let fewer = run(&source, &dense, &Finish { min_confidence: 0.8, ..how });
            assert_eq!(fewer.0, left.iter().map(|&i| positions[i as usize]).collect::<Vec<_>>());
            for (fewer, all) in fewer.1.iter().zip(&attributes) {
                assert_eq!(fewer.values, all.values.gather(&left), "{}", all.name);
            }
        }
        let silent = run(&source, &dense, &Finish { min_confidence: 0.8, ..Finish::default() });
        assert_eq!(silent.1.len(), 4, "no attribute where none is asked for");
    }

    #[test]
    fn estimated_normals_take_the_place_of_parts() {
        let dense = sphere(500, 5, false);
        let mut source = sphere(300, 6, true);
        source.attributes.retain(|a| a.name != "ny");
        source.attributes.push(Attribute { name: "scan".into(), values: Values::U8(vec![0; 300]) });
        let centre = Some([4e5, 5e6, 100.0]);
        source.origin.sensors =
            Some(std::sync::Arc::new(Sensors { attribute: "scan".into(), places: vec![centre] }));
        let how = Finish { estimate_normals: true, ..Finish::default() };
        let (positions, attributes) = run(&source, &dense, &how);
        let names: Vec<&str> = attributes.iter().map(|a| a.name.as_str()).collect();
        assert_eq!(names, ["id", "scan", "nx", "ny", "nz"]);
        let inwards = positions.iter().enumerate().filter(|(i, p)| {
            (0..3).map(|a| (p[a] - [4e5, 5e6, 100.0][a]) * attributes[2 + a].values.get(*i)).sum::<f64>()
                < -0.9
        });
        assert!(inwards.count() > 490, "towards the sensor in the middle");
    }
}
