use super::*;
use densecloud_geometry::{Rng, farthest_point_sampling, indices};

/// So many lines one apart, each of so many points, of which so many are as long as a gap is wide.
fn scanned(lines: usize, each: usize, dense: f32, height: impl Fn(f32) -> f32) -> Vec<Point> {
    let mut random = Rng::new(7);
    let mut points = Vec::new();
    for line in 0..lines {
        let phase = random.f64() as f32;
        let x = |k: usize, random: &mut Rng| (k as f32 + phase + 0.3 * random.f64() as f32) / dense;
        let y = line as f32;
        points.extend((0..each).map(|k| [x(k, &mut random), y, height(y)]));
    }
    points
}

fn share_woven(points: &[Point]) -> f32 {
    let Some(lines) = Lines::of(points) else { return 0.0 };
    indices(points.len()).filter(|&i| lines.is_woven(i)).count() as f32 / points.len() as f32
}

/// The bridges by the heights at their ends.
fn bridges(points: &[Point]) -> Vec<[f32; 2]> {
    let lines = Lines::of(points).expect("lines");
    let woven = lines.stretches.iter().filter(|s| s.woven);
    let of = |s: &Stretch| {
        let from = lines.place(s)[2];
        s.sides.iter().filter(|side| side.bridged).map(|side| [from, side.foot[2]]).collect::<Vec<_>>()
    };
    woven.flat_map(of).collect()
}

#[test]
fn lines_are_found_however_dense_they_are() {
    for (lines, each, dense) in [(40, 100, 2.0), (20, 200, 4.0), (12, 400, 30.0), (8, 2000, 1500.0)] {
        let points = scanned(lines, each, dense, |_| 0.0);
        let share = share_woven(&points);
        assert!(share > 0.97, "{share} at {dense} points a gap");
        // Each point is bridged to both sides, those of the outermost lines to one, but for ends of lines.
        let most = 2 * points.len() - 2 * each;
        let count = bridges(&points).len();
        assert!((most * 9 / 10..=most).contains(&count), "{count} of {most} at {dense}");
    }
}

#[test]
fn surfaces_that_were_sampled_in_other_ways_have_none() {
    for seed in 0..4 {
        let mut random = Rng::new(seed);
        let mut square = |n: usize, rough: f32| -> Vec<Point> {
            (0..n)
                .map(|_| [random.f64() as f32, random.f64() as f32, rough * random.normal() as f32])
                .collect()
        };
        let (random, rough, volume) = (square(2000, 0.0), square(2000, 0.03), square(2000, 1.0));
        let many = square(16_000, 0.0);
        let even: Vec<Point> =
            farthest_point_sampling(&many, 2000, 0).iter().map(|&i| many[i as usize]).collect();
        let grid: Vec<Point> = (0..2500).map(|i| [(i % 50) as f32, (i / 50) as f32, 0.0]).collect();
        for (name, points) in
            [("random", random), ("rough", rough), ("volume", volume), ("even", even), ("grid", grid)]
        {
            assert!(Lines::of(&points).is_none(), "{name}, seed {seed}");
        }
    }
}

#[test]
fn a_few_wires_are_no_surface() {
    for wires in 1..RUN {
        assert!(Lines::of(&scanned(wires, 500, 10.0, |_| 0.0)).is_none(), "{wires} wires");
    }
    // The edge of a blade: two rows, and a surface that ends there.
    let mut blade = scanned(2, 400, 4.0, |_| 0.0);
    let mut random = Rng::new(3);
    blade.extend((0..4000).map(|_| [100.0 * random.f64() as f32, 0.5, -3.0 * random.f64() as f32]));
    assert!(Lines::of(&blade).is_none());
}

#[test]
fn what_climbs_a_step_or_crosses_a_wide_gap_is_open() {
    let step = |height: f32| bridges(&scanned(16, 200, 8.0, |y| if y > 7.5 { height } else { 0.0 }));
    for height in [0.7, 1.0, 2.0, 30.0] {
        let found = step(height);
        assert!(found.len() > 4000, "{} at {height}", found.len());
        assert!(found.iter().all(|[from, to]| from == to), "{height}");
    }
    // A slope goes on, and a bend of half a right angle.
    let slope = bridges(&scanned(16, 200, 8.0, |y| 2.0 * y));
    assert!(slope.len() > 5000, "{}", slope.len());
    let roof = bridges(&scanned(16, 200, 8.0, |y| (y - 7.0).max(0.0)));
    assert!(roof.iter().any(|[from, to]| *from == 0.0 && *to == 1.0));
    // Two floors, further apart than a few gaps.
    let mut floors = scanned(8, 200, 8.0, |_| 0.0);
    floors.extend(scanned(8, 200, 8.0, |_| 0.0).iter().map(|p| [p[0], p[1] + 11.5, 0.0]));
    let lines = Lines::of(&floors).expect("lines");
    let across = lines.stretches.iter().flat_map(|s| s.sides.iter().filter(|side| side.bridged));
    assert!(across.clone().count() > 5000);
    assert!(across.map(|side| side.gap).fold(0.0, f32::max) < 2.0);
}

#[test]
fn a_bridge_goes_straight_across() {
    let points = scanned(10, 300, 12.0, |_| 0.0);
    let lines = Lines::of(&points).expect("lines");
    for stretch in lines.stretches.iter().filter(|s| s.woven) {
        for side in stretch.sides.iter().filter(|side| side.bridged) {
            let off = sub(side.foot, lines.place(stretch));
            assert!((off[1].abs() - 1.0).abs() < 1e-4, "{off:?}");
            // Past the end of a line its last point has to do.
            assert!(off[0].abs() < 0.2, "{off:?}");
        }
    }
}
