//! Shapes that need no file: for demonstrations and tests.

use std::f64::consts::TAU;

use super::Mesh;
use super::mesh::{cross, dot, sub};
use densecloud_cloud::Position;

/// Names that [`shape`] knows.
pub const SHAPES: [&str; 3] = ["knot", "gear", "stairs"];

/// A built-in shape of about unit size: `knot` (a tube along a trefoil knot: curved, and near to
/// itself), `gear` (teeth and a bore: sharp edges), `stairs` (flat faces that meet in convex and
/// concave edges). `None` for another name.
#[must_use]
pub fn shape(name: &str) -> Option<Mesh> {
    match name {
        "knot" => Some(knot()),
        "gear" => Some(gear()),
        "stairs" => Some(stairs()),
        _ => None,
    }
}

/// A tube with a slow ripple along the trefoil knot (a (2, 3) torus knot).
fn knot() -> Mesh {
    const ALONG: u32 = 480;
    const AROUND: u32 = 40;
    let centre = |t: f64| -> Position {
        let r = 2.0 + (3.0 * t).cos();
        [r * (2.0 * t).cos() / 3.0, r * (2.0 * t).sin() / 3.0, (3.0 * t).sin() / 3.0]
    };
    let mut mesh = Mesh::default();
    for i in 0..ALONG {
        let t = TAU * f64::from(i) / f64::from(ALONG);
        let p = centre(t);
        let tangent = unit(sub(centre(t + 1e-4), centre(t - 1e-4)));
        // The torus's own normal makes a frame that closes without a twist.
        let ring = [2.0 * (2.0 * t).cos() / 3.0, 2.0 * (2.0 * t).sin() / 3.0, 0.0];
        let side = unit(cross(tangent, sub(p, ring)));
        let up = cross(side, tangent);
        let radius = 0.16 + 0.03 * (9.0 * t).sin();
        for j in 0..AROUND {
            let (sin, cos) = (TAU * f64::from(j) / f64::from(AROUND)).sin_cos();
            mesh.vertices.push(std::array::from_fn(|a| p[a] + radius * (cos * side[a] + sin * up[a])));
        }
    }
    for i in 0..ALONG {
        for j in 0..AROUND {
            let at = |i: u32, j: u32| i % ALONG * AROUND + j % AROUND;
            quad(&mut mesh, [at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)]);
        }
    }
    mesh
}

/// A spur gear: 18 teeth with straight flanks, and a bore.
fn gear() -> Mesh {
    const TEETH: u32 = 18;
    const STEPS: u32 = 12;
    const HALF_HEIGHT: f64 = 0.18;
    const BORE: f64 = 0.35;
    // Radius over one tooth, by a piecewise straight profile: root, flank, tip, flank.
    let radius = |phase: f64| -> f64 {
        let ramp = ((0.5 - (phase - 0.5).abs()) - 0.15) / 0.1;
        0.8 + 0.2 * ramp.clamp(0.0, 1.0)
    };
    let n = TEETH * STEPS;
    let mut mesh = Mesh::default();
    for i in 0..n {
        let (sin, cos) = (TAU * f64::from(i) / f64::from(n)).sin_cos();
        let outer = radius(f64::from(i % STEPS) / f64::from(STEPS));
        for (r, z) in [(outer, -HALF_HEIGHT), (outer, HALF_HEIGHT), (BORE, HALF_HEIGHT), (BORE, -HALF_HEIGHT)]
        {
            mesh.vertices.push([r * cos, r * sin, z]);
        }
    }
    for i in 0..n {
        let next = (i + 1) % n;
        for side in 0..4 {
            let other = (side + 1) % 4;
            quad(&mut mesh, [4 * i + side, 4 * next + side, 4 * next + other, 4 * i + other]);
        }
    }
    mesh
}

/// Four steps, closed on all sides.
fn stairs() -> Mesh {
    const STEPS: u32 = 4;
    const HALF_WIDTH: f64 = 0.5;
    let side = 1.6 / f64::from(STEPS);
    let mut mesh = Mesh::default();
    // The profile in x and z, each face subdivided nowhere: the surface is what counts.
    let mut face = |corners: [Position; 4]| {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(corners);
        quad(&mut mesh, [first, first + 1, first + 2, first + 3]);
    };
    let w = HALF_WIDTH;
    for i in 0..STEPS {
        let (x0, x1) = (f64::from(i) * side - 0.8, f64::from(i + 1) * side - 0.8);
        let (below, z) = (f64::from(i) * 0.3 - 0.6, f64::from(i + 1) * 0.3 - 0.6);
        face([[x0, -w, below], [x0, w, below], [x0, w, z], [x0, -w, z]]);
        face([[x0, -w, z], [x0, w, z], [x1, w, z], [x1, -w, z]]);
        for y in [-w, w] {
            face([[x0, y, -0.6], [x1, y, -0.6], [x1, y, z], [x0, y, z]]);
        }
        face([[x0, -w, -0.6], [x1, -w, -0.6], [x1, w, -0.6], [x0, w, -0.6]]);
    }
    face([[0.8, -w, -0.6], [0.8, w, -0.6], [0.8, w, 0.6], [0.8, -w, 0.6]]);
    mesh
}

fn quad(mesh: &mut Mesh, [a, b, c, d]: [u32; 4]) {
    mesh.triangles.extend([[a, b, c], [a, c, d]]);
}

fn unit(v: Position) -> Position {
    let length = dot(v, v).sqrt();
    v.map(|c| c / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shape_is_valid_and_of_about_unit_size() {
        for name in SHAPES {
            let mesh = shape(name).expect("a listed shape");
            assert_eq!(mesh.validate(), Ok(()), "{name}");
            let (lo, hi) = mesh.bounds().expect("triangles");
            let size = (0..3).map(|a| hi[a] - lo[a]).fold(0.0, f64::max);
            assert!((1.5..3.0).contains(&size), "{name} has size {size}");
        }
        assert_eq!(shape("teapot"), None);
    }

    #[test]
    fn the_stairs_have_the_area_of_their_faces() {
        // Back and bottom, treads and risers have the area of two rectangles each; two profiles.
        let profile: f64 = (1..=4).map(|i| 0.4 * 0.3 * f64::from(i)).sum();
        assert!(
            (shape("stairs").expect("stairs").area() - (2.0 * 1.6 + 2.0 * 1.2 + 2.0 * profile)).abs() < 1e-12
        );
    }
}
