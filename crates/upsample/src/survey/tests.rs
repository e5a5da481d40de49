use super::*;
use densecloud_cascade::Target;
use densecloud_geometry::{Mesh, poisson_disk, uniform};
use std::f64::consts::PI;

/// A sphere about a point far from the origin, of meridians and circles of latitude.
fn sphere(n: usize, even: bool, radius: f64) -> Vec<Position> {
    let mut mesh = Mesh::default();
    let (around, up) = (96_u32, 48_u32);
    for i in 0..=up {
        for j in 0..around {
            let (latitude, longitude) =
                (PI * f64::from(i) / f64::from(up), 2.0 * PI * f64::from(j) / f64::from(around));
            let (x, y) = (latitude.sin() * longitude.cos(), latitude.sin() * longitude.sin());
            mesh.vertices.push([x, y, latitude.cos()]);
        }
    }
    for i in 0..up {
        for j in 0..around {
            let at = |i: u32, j: u32| i * around + j % around;
            mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    let points = if even { poisson_disk(&mesh, n, 1) } else { uniform(&mesh, n, 1) }.expect("points");
    points.into_iter().map(|p| p.map(|c| 5e5 + c * radius)).collect()
}

#[test]
fn the_area_of_a_sphere_is_found_whatever_the_sampling() {
    for even in [true, false] {
        for (n, sample) in [(2_000, SAMPLE), (8_000, SAMPLE), (30_000, 4_000)] {
            let survey = Survey::of(&sphere(n, even, 3.0), sample).expect("a survey");
            let ratio = survey.area / (4.0 * PI * 9.0);
            assert!((0.97..1.03).contains(&ratio), "{ratio} of {n} points, even {even}");
            assert!(if even { survey.unevenness < 0.25 } else { survey.unevenness > 0.4 }, "{survey:?}");
            assert!(
                survey.off_surface < 0.01 && survey.on_lines < 0.01 && survey.isolated < 0.02,
                "{survey:?}"
            );
            assert!(survey.noise < 0.02 * survey.spacing.median, "{survey:?}");
            assert_eq!(survey.warnings(Scalar::F64), [""; 0]);
        }
    }
}

#[test]
fn what_is_no_surface_is_noticed() {
    let mut random = Rng::new(4);
    let fog: Vec<Position> = (0..4000).map(|_| std::array::from_fn(|_| random.f64())).collect();
    let survey = Survey::of(&fog, SAMPLE).expect("a survey");
    assert!(survey.off_surface > 0.5, "{survey:?}");
    assert!(survey.warnings(Scalar::F64)[0].contains("fill a volume"), "{:?}", survey.warnings(Scalar::F64));

    let lines: Vec<Position> =
        (0..4000).map(|i| [f64::from(i % 400) * 0.01, f64::from(i / 400), 0.0]).collect();
    let survey = Survey::of(&lines, SAMPLE).expect("a survey");
    assert!(survey.on_lines > 0.9, "{survey:?}");
    assert!(survey.warnings(Scalar::F64)[0].contains("lie on lines"), "{:?}", survey.warnings(Scalar::F64));

    let mut stray = sphere(2000, true, 1.0);
    let area = Survey::of(&stray, SAMPLE).expect("a survey").area;
    for i in (0..2000).step_by(20) {
        stray[i] = stray[i].map(|c| 5e5 + 1.3 * (c - 5e5));
    }
    let survey = Survey::of(&stray, SAMPLE).expect("a survey");
    assert!((0.03..=0.05).contains(&survey.isolated), "{survey:?}");
    assert!((survey.area / area - 1.0).abs() < 0.15, "{survey:?} for {area}");
    assert!(survey.warnings(Scalar::F64)[0].contains("stand alone"), "{:?}", survey.warnings(Scalar::F64));
}

#[test]
fn a_plate_thinner_than_its_points_are_apart_is_a_surface() {
    // Two sides 0.7 spacings apart: each point's neighbours are of both.
    let mut random = Rng::new(8);
    let plate: Vec<Position> =
        (0..4000).map(|i| [random.f64(), random.f64(), 0.015 * f64::from(i % 2)]).collect();
    let survey = Survey::of(&plate, SAMPLE).expect("a survey");
    assert!(survey.off_surface < 0.1, "{survey:?}");
    // As thick, and filled.
    let filled: Vec<Position> = plate.iter().map(|p| [0.2 * p[0], 0.2 * p[1], 0.2 * random.f64()]).collect();
    assert!(Survey::of(&filled, SAMPLE).expect("a survey").off_surface > 0.5);
}

#[test]
fn units_that_look_wrong_are_noticed() {
    let degrees: Vec<Position> = sphere(2000, true, 1.0)
        .into_iter()
        .map(|p| [7.0 + 1e-4 * (p[0] - 5e5), 50.0 + 1e-4 * (p[1] - 5e5), 300.0 + 20.0 * (p[2] - 5e5)])
        .collect();
    let survey = Survey::of(&degrees, SAMPLE).expect("a survey");
    assert!(
        survey.warnings(Scalar::F64).iter().any(|w| w.contains("look like degrees")),
        "{:?}",
        survey.warnings(Scalar::F64)
    );
    let coarse: Vec<Position> =
        sphere(2000, true, 0.5).into_iter().map(|p| p.map(|c| f64::from((c + 4.5e6) as f32))).collect();
    let survey = Survey::of(&coarse, SAMPLE).expect("a survey");
    let warned = |storage| survey.warnings(storage).iter().any(|w| w.contains("32-bit floats"));
    assert!(warned(Scalar::F32) && !warned(Scalar::F64));
}

#[test]
fn counts_and_bounds_are_exact() {
    let mut points = sphere(500, true, 2.0);
    points.push(points[3]);
    points.push(points[3]);
    points.push([f64::NAN, 0.0, 0.0]);
    let survey = Survey::of(&points, SAMPLE).expect("a survey");
    assert_eq!((survey.finite, survey.non_finite, survey.duplicates), (502, 1, 2));
    let highest = points[..502].iter().fold(f64::MIN, |m, p| m.max(p[2]));
    assert_eq!(survey.bounds[1][2], highest);
    assert!(Survey::of(&[[1.0; 3]; 5], SAMPLE).is_err());
    // Too few neighbours to measure anything, and no panic.
    let few = Survey::of(&points[..3], SAMPLE).expect("a survey");
    assert_eq!((few.finite, few.measured), (3, 0));
}

#[test]
fn a_goal_becomes_a_number_of_points() {
    let points = sphere(3000, true, 3.0);
    let area = 4.0 * PI * 9.0;
    let Ok(Target::Points(n)) = Goal::Density(100.0).target(&points) else { panic!("no target") };
    assert!((n as f64 / (100.0 * area) - 1.0).abs() < 0.03, "{n}");
    assert_eq!(Goal::Target(Target::Ratio(3.0)).target(&points), Ok(Target::Ratio(3.0)));
    for (goal, what) in [
        (Goal::Density(-1.0), "not a positive number"),
        (Goal::Spacing(f64::NAN), "not a positive number"),
        (Goal::Density(1.0), "0.038"),
        (Goal::Spacing(1e-4), "from 1 to 64 is possible"),
    ] {
        let error = goal.target(&points).expect_err("an error").to_string();
        assert!(error.contains(what), "{error}");
    }
    // Far from possible: numbers that can still be read.
    let error = Goal::Spacing(1e-9).target(&points).expect_err("an error").to_string();
    let longest = error.split([' ', ',']).map(str::len).max();
    assert!(longest.is_some_and(|longest| longest <= 9) && error.contains("e19 points"), "{error}");
}

#[test]
fn parts_with_what_lies_around_them_give_the_survey_of_the_whole() {
    let points = sphere(8_000, false, 3.0);
    let whole = Survey::of(&points, SAMPLE).expect("a survey");
    for some in [1, 2] {
        let mut parts = Parts::default();
        for octant in (0..8).filter(|octant| octant % some == 0) {
            let is_own = |p: &Position| (0..3).all(|a| (p[a] < 5e5) == (octant >> a & 1 == 1));
            let (mut part, around): (Vec<Position>, Vec<Position>) = points.iter().partition(|p| is_own(p));
            let own = part.len();
            part.extend(around);
            parts.add(&part, own, &Frame::fit(&part).expect("a frame"), SAMPLE);
        }
        let survey = parts.survey(8_000, 7, whole.bounds);
        let near = |a: f64, b: f64, within: f64| (a / b - 1.0).abs() < within;
        assert!(near(survey.area, whole.area, if some == 1 { 1e-3 } else { 0.05 }), "{survey:?}");
        assert!(near(survey.spacing.median, whole.spacing.median, 0.1) && survey.non_finite == 7);
        assert_eq!(survey.warnings(Scalar::F64), [""; 0]);
    }
}
