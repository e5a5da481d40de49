use super::*;
use crate::Silent;
use crate::globals::Globals;
use crate::measured::Measured;
use densecloud_cloud::Frame;
use densecloud_geometry::farthest_point_sampling;

fn reference(points: &[Point], spacing: f32) -> Reference {
    let frame = Frame::fit(&[[0.0; 3], [1.0; 3]]).unwrap();
    Reference::new(Measured::new(points, spacing), None, &mut Globals::new(frame))
}

fn nearest(points: &[Point], reference: &Reference) -> Vec<u32> {
    let nearest = |p: &Point| reference.input.tree.nearest_one(*p).expect("a point").index;
    points.iter().map(nearest).collect()
}

fn polished(made: &[Point], full: usize, size: usize, reference: Reference) -> Vec<Point> {
    let (mut globals, mut random) = (PolishGlobals::default(), Rng::new(5));
    let made = Kept { points: made.to_vec(), nearest: nearest(made, &reference) };
    let polish = Polish { sizes: Sizes { full, size }, part: None, observer: &Silent };
    polish.run(made, reference, &mut globals, &mut random).unwrap().0
}

/// A square of unit side, at some height.
fn square(n: u64, height: f32, seed: u64) -> Vec<Point> {
    let mut random = Rng::new(seed);
    (0..n).map(|_| [random.f64() as f32, random.f64() as f32, height]).collect()
}

fn all_midpoints(points: &[Point]) -> Vec<Point> {
    midpoints(points, &rings(&KdTree::new(points), points), None).0
}

/// Coefficient of variation of nearest-neighbour distances.
fn variation(points: &[Point]) -> f64 {
    let tree = KdTree::new(points);
    let mut found = Vec::new();
    let distances: Vec<f64> = points
        .iter()
        .map(|&p| {
            tree.nearest(p, 2, &mut found);
            f64::from(found[1].distance_squared).sqrt()
        })
        .collect();
    let mean = distances.iter().sum::<f64>() / distances.len() as f64;
    let square = distances.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / distances.len() as f64;
    square.sqrt() / mean
}

#[test]
fn the_result_is_more_even_than_the_sample_and_stays_on_the_surface() {
    let made = square(3000, 0.5, 1);
    let sample: Vec<Point> =
        farthest_point_sampling(&made, 2000, 0).iter().map(|&i| made[i as usize]).collect();
    let dense = polished(&made, 2000, 2000, reference(&sample[..500], 0.05));
    assert_eq!(dense.len(), 2000);
    assert!(dense.iter().all(|p| (p[2] - 0.5).abs() < 1e-6));
    let (before, after) = (variation(&sample), variation(&dense));
    assert!(after < 0.4 * before, "{after} from {before}");
}

#[test]
fn a_tip_of_one_point_keeps_its_reach() {
    let made = square(3000, 0.5, 1);
    let sample: Vec<Point> =
        farthest_point_sampling(&made, 2000, 0).iter().map(|&i| made[i as usize]).collect();
    let mut measured = sample[..500].to_vec();
    measured.push([0.5, 1.06, 0.5]);
    let dense = polished(&made, 2000, 2000, reference(&measured, 0.05));
    assert!(dense.iter().any(|p| p[1] > 1.04), "nothing near the tip");
}

#[test]
fn what_lies_on_no_surface_gives_the_size_too() {
    for n in [20_u64, 60, 300] {
        let mut random = Rng::new(n);
        let made: Vec<Point> = (0..n).map(|_| std::array::from_fn(|_| random.f64() as f32)).collect();
        // Edges at any angle to any normal: few midpoints are of one surface.
        for size in [2 * made.len(), 3 * made.len()] {
            assert_eq!(polished(&made, size, size, reference(&made, 0.1)).len(), size);
        }
    }
}

#[test]
fn sheets_are_not_bridged() {
    // Sheets 0.035 apart: with a spacing of 0.022 that is nearer than some neighbours in a
    // sheet. What is left are edges of less than 45 degrees.
    let even = |height: f32, seed| -> Vec<Point> {
        let all = square(8000, height, seed);
        farthest_point_sampling(&all, 2000, 0).iter().map(|&i| all[i as usize]).collect()
    };
    let (mut points, other) = (even(0.0, 1), even(0.035, 2));
    points.extend(other);
    let middles = all_midpoints(&points);
    let between = middles.iter().filter(|p| (0.01..0.025).contains(&p[2])).count();
    assert!(between * 40 < middles.len(), "{between} of {} between the sheets", middles.len());
}

#[test]
fn input_points_share_the_area_of_the_surface() {
    // A square of area 1, half as dense on its right half; both clouds are thinned out, and have points on the border.
    let thinned = |from: u64, to: usize, seed| -> Vec<Point> {
        let all = square(from, 0.5, seed);
        farthest_point_sampling(&all, to, 0).iter().map(|&i| all[i as usize]).collect()
    };
    let points: Vec<Point> = thinned(20_000, 6000, 1)
        .into_iter()
        .enumerate()
        .filter(|(i, p)| p[0] < 0.5 || *i < 3000)
        .map(|(_, p)| p)
        .collect();
    let even = thinned(8000, 400, 2);
    let (tree, made) = KdTree::in_order(&points);
    let (input, mut globals) = (reference(&even, 0.06), PolishGlobals::default());
    let sample = Sample { tree: &tree, points: &made, nearest: &nearest(&made, &input) };
    let surface = Surface { input: &input.input, borders: &input.borders, trust: 1.0 };
    let areas = Candidates::of(sample, made.len(), surface, None, &mut globals).areas;
    let whole: f32 = areas.iter().sum();
    assert!((0.93..1.1).contains(&whole), "{whole}");
    let right: f32 =
        input.input.points.iter().zip(&areas).filter(|(p, _)| p[0] > 0.5).map(|(_, area)| area).sum();
    assert!((right / whole - 0.5).abs() < 0.03, "{right} of {whole} on the right");
}

#[test]
fn every_pair_comes_once() {
    let points = square(60, 0.0, 4);
    let mut middles: Vec<[u32; 3]> = all_midpoints(&points).iter().map(|p| p.map(f32::to_bits)).collect();
    let count = middles.len();
    assert!((60 * 7 / 2..=60 * 7).contains(&count), "{count} pairs");
    middles.sort_unstable();
    middles.dedup();
    assert_eq!(middles.len(), count);
}

#[test]
fn too_few_midpoints_are_made_up_for() {
    let points = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    assert_eq!(polished(&points, 5, 5, reference(&points, 1.0)).len(), 5);
}
