use super::super::{Rng, poisson_disk, shape};
use super::*;

const ALL: [Smoothing; 3] = [Smoothing::MovingLeastSquares, Smoothing::Bilateral, Smoothing::Wlop];

/// Points of a torus knot, with noise of so many of their spacings, and how far each is off after a smoothing.
fn knot(spacings: f64) -> (Vec<Point>, Vec<Point>) {
    let mesh = shape("knot").expect("a shape");
    let clean = poisson_disk(&mesh, 8000, 1).expect("points");
    let spacing = (mesh.area() / 8000.0).sqrt();
    let mut random = Rng::new(2);
    let clean: Vec<Point> = clean.iter().map(|p| p.map(|c| c as f32)).collect();
    let noisy = clean.iter().map(|p| p.map(|c| c + (spacings * spacing * random.normal()) as f32)).collect();
    (clean, noisy)
}

/// Mean distance from the points to the nearest of a dense sample of the knot.
fn off(points: &[Point]) -> f64 {
    let mesh = shape("knot").expect("a shape");
    let surface = crate::SurfaceDistance::new(&mesh);
    points.iter().map(|p| surface.distance(p.map(f64::from))).sum::<f64>() / points.len() as f64
}

#[test]
fn noise_shrinks() {
    let (_, noisy) = knot(0.5);
    for method in ALL {
        let smoothed = smooth(&noisy, method, 0.1);
        let (before, after) = (off(&noisy), off(&smoothed.points));
        // Weighted means and medians keep more of it than a fit does.
        let share = if method == Smoothing::MovingLeastSquares { 0.6 } else { 0.7 };
        assert!(after < share * before, "{method:?}: {before} to {after}");
    }
}

#[test]
fn what_is_clean_stays_to_the_last_bit() {
    let (clean, _) = knot(0.5);
    for method in ALL {
        let smoothed = smooth(&clean, method, 0.1);
        let same = clean.iter().zip(&smoothed.points).filter(|(p, q)| p == q).count();
        assert!(same > 7900, "{method:?}: {same}");
    }
}

#[test]
fn what_fills_a_volume_stays() {
    let mut random = Rng::new(4);
    let cube: Vec<Point> = (0..20_000).map(|_| std::array::from_fn(|_| random.f64() as f32)).collect();
    // A cube's faces are a surface, to the few.
    let inside = |p: &Point| p.iter().all(|c| (0.2..0.8).contains(c));
    let total = cube.iter().filter(|p| inside(p)).count();
    for method in ALL {
        let smoothed = smooth(&cube, method, 0.1);
        let moved = cube.iter().zip(&smoothed.points).filter(|(p, q)| inside(p) && p != q).count();
        assert!(20 * moved < total, "{method:?}: {moved} of {total}");
    }
    assert_eq!(smooth(&cube[..20], Smoothing::Bilateral, 0.1).points, cube[..20], "too few");
}

#[test]
fn noise_is_told_in_spacings() {
    for spacings in [0.1_f32, 0.4] {
        let (_, noisy) = knot(f64::from(spacings));
        let mut noise = smooth(&noisy, Smoothing::Bilateral, 9.0).noise;
        noise.sort_unstable_by(f32::total_cmp);
        let median = noise[noise.len() / 2];
        assert!((median / spacings - 1.0).abs() < 0.3, "{spacings}: {median}");
    }
}

#[test]
fn threads_change_nothing() {
    let (_, noisy) = knot(0.5);
    for method in ALL {
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        assert_eq!(one.install(|| smooth(&noisy, method, 0.1)), smooth(&noisy, method, 0.1));
    }
}

#[test]
fn decay_is_the_exponential() {
    for i in 0..300 {
        let x = f64::from(i) / 10.0;
        assert!((decay(x) / (-x).exp() - 1.0).abs() < 1e-6, "{x}: {}", decay(x));
    }
    assert_eq!(decay(31.0) + decay(f64::INFINITY), 0.0);
}
