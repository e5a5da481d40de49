use super::*;
use crate::{Mesh, Rng, SurfaceDistance, shape, uniform};

const SETTINGS: PoissonSettings = PoissonSettings { cell: None, trim: 3.0 };

/// Points of a sphere of radius 0.8, evenly spread along a spiral.
fn sphere(n: usize) -> (Vec<Point>, Vec<[f32; 3]>) {
    let turn = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let at = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f64 / n as f64;
        let (r, t) = ((1.0 - z * z).sqrt(), turn * i as f64);
        [r * t.cos(), r * t.sin(), z].map(|c| c as f32)
    };
    let normals: Vec<[f32; 3]> = (0..n).map(at).collect();
    (normals.iter().map(|n| n.map(|c| 0.8 * c)).collect(), normals)
}

fn euler(surface: &Surface) -> i64 {
    let sides = (3 * surface.triangles.len() + surface.open_sides) / 2;
    surface.vertices.len() as i64 - sides as i64 + surface.triangles.len() as i64
}

#[test]
fn a_sphere_is_closed_round_and_faces_out() {
    for n in [500, 5000, 20_000] {
        let (points, normals) = sphere(n);
        let surface = reconstruct(&points, &normals, SETTINGS).expect("a surface");
        let off = |v: &[f64; 3]| (v.iter().map(|c| c * c).sum::<f64>().sqrt() - 0.8).abs();
        let worst = surface.vertices.iter().map(off).fold(0.0, f64::max);
        assert_eq!((surface.open_sides, euler(&surface)), (0, 2), "{n}");
        assert!(worst < 0.15 * surface.cell, "{n}: {worst} of cells of {}", surface.cell);
        let mesh = Mesh { vertices: surface.vertices, triangles: surface.triangles };
        let volume: f64 =
            mesh.corners().map(|[a, b, c]| crate::mesh::dot(a, crate::mesh::cross(b, c)) / 6.0).sum();
        assert!((volume / (4.0 / 3.0 * std::f64::consts::PI * 0.512) - 1.0).abs() < 0.03, "{volume}");
    }
}

#[test]
fn a_disc_keeps_its_border_and_does_not_close() {
    let mut rng = Rng::new(3);
    let mut points: Vec<Point> = Vec::new();
    while points.len() < 4000 {
        let at = [rng.normal(), rng.normal()].map(|c| (c * 0.5) as f32);
        if at[0].hypot(at[1]) < 0.7 {
            points.push([at[0], at[1], 0.1 * at[0] * at[1]]);
        }
    }
    let normals = vec![[0.0, 0.0, 1.0]; points.len()];
    let surface = reconstruct(&points, &normals, SETTINGS).expect("a surface");
    let reach = surface.vertices.iter().map(|v| v[0].hypot(v[1])).fold(0.0, f64::max);
    assert!(surface.open_sides > 50 && reach < 0.7 + 3.0 * surface.cell, "{reach}");
    // Past the last points it may bend.
    let inside = surface.vertices.iter().filter(|v| v[0].hypot(v[1]) < 0.66);
    let off = inside.map(|v| (v[2] - 0.1 * v[0] * v[1]).abs()).fold(0.0, f64::max);
    assert!(off < 0.5 * surface.cell, "{off}");
}

#[test]
fn shapes_come_back_from_random_points_of_them() {
    for name in crate::SHAPES {
        let mesh = shape(name).expect("a shape");
        let places = uniform(&mesh, 20_000, 1).expect("points");
        let points: Vec<Point> = places.iter().map(|p| p.map(|c| c as f32)).collect();
        let normals = crate::propagated(&points, &crate::estimate_normals(&points, 12));
        let surface = reconstruct(&points, &normals, SETTINGS).expect("a surface");
        let mean = |d: Vec<f64>| d.iter().sum::<f64>() / d.len() as f64;
        let to_true = mean(SurfaceDistance::new(&mesh).distances(&surface.vertices));
        let made = Mesh { vertices: surface.vertices.clone(), triangles: surface.triangles.clone() };
        let from_true = mean(SurfaceDistance::new(&made).distances(&places));
        assert!(to_true < 0.12 * surface.cell && from_true < 0.12 * surface.cell, "{name}");
    }
}

#[test]
fn threads_change_nothing() {
    let (points, normals) = sphere(3000);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| reconstruct(&points, &normals, SETTINGS)).expect("a surface")
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn what_is_no_surface_is_refused() {
    let (points, normals) = sphere(15);
    assert_eq!(reconstruct(&points, &normals, SETTINGS), Err(PoissonError::TooFew));
    let one = vec![[0.5; 3]; 100];
    assert_eq!(reconstruct(&one, &vec![[0.0, 0.0, 1.0]; 100], SETTINGS), Err(PoissonError::TooFew));
    let (points, normals) = sphere(500);
    let fine = PoissonSettings { cell: Some(1e-5), ..SETTINGS };
    assert_eq!(reconstruct(&points, &normals, fine), Err(PoissonError::TooFine));
}
