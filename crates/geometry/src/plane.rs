//! The plane of a few points, and how far they are from a smooth surface over it.

use super::Neighbour;
use super::mls::{TERMS, solve, tangents};
use super::normals::{covariance, eigen};
use densecloud_cloud::Point;

/// The plane that points vary least from.
pub struct Plane {
    /// Of the points, along the normal, and along two axes across it: ascending.
    pub variances: [f64; 3],
    axes: [[f64; 3]; 2],
    /// Of unit length.
    pub normal: [f64; 3],
}

impl Plane {
    /// By principal component analysis.
    pub fn fit(points: &[Point], near: &[Neighbour]) -> Self {
        let (values, vectors) = eigen(covariance(points, near));
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
        let normal = vectors[order[0]];
        let (u, v) = tangents(normal);
        Self { variances: order.map(|i| values[i].max(0.0) / near.len() as f64), axes: [u, v], normal }
    }

    /// Where `point` lies on the plane, seen from `origin`.
    pub fn flat(&self, origin: Point, point: Point) -> [f64; 2] {
        self.axes.map(|axis| along(axis, origin, point))
    }

    /// How far `point` lies off the parallel plane through `origin`, along [`Self::normal`].
    pub fn height(&self, origin: Point, point: Point) -> f64 {
        along(self.normal, origin, point)
    }
}

fn along(axis: [f64; 3], origin: Point, point: Point) -> f64 {
    (0..3).map(|a| axis[a] * (f64::from(point[a]) - f64::from(origin[a]))).sum()
}

/// Root mean square distance of points, of which the first is the middle one, from the quadratic height
/// field over their plane that fits them best; corrected for what the fit itself takes up. Zero where they
/// are too few.
pub fn quadratic_residual(points: &[Point], near: &[Neighbour]) -> f64 {
    let reach = near.last().map_or(0.0, |n| f64::from(n.distance_squared)).sqrt();
    if near.len() <= 2 * TERMS || reach == 0.0 {
        return 0.0;
    }
    let plane = Plane::fit(points, near);
    let at = |n: &Neighbour| points[n.index as usize];
    let origin = at(&near[0]);
    let (mut matrix, mut right, mut squares) = ([[0.0; TERMS]; TERMS], [0.0; TERMS], 0.0);
    for p in near.iter().map(at) {
        let [a, b] = plane.flat(origin, p).map(|c| c / reach);
        let height = along(plane.normal, origin, p) / reach;
        let terms = [1.0, a, b, a * a, a * b, b * b];
        for i in 0..TERMS {
            for j in 0..=i {
                matrix[i][j] += terms[i] * terms[j];
            }
            right[i] += terms[i] * height;
        }
        squares += height * height;
    }
    for (i, row) in matrix.iter_mut().enumerate() {
        row[i] += 1e-9 * near.len() as f64;
    }
    let Some(fit) = solve(matrix, right) else { return 0.0 };
    let explained: f64 = fit.iter().zip(right).map(|(x, y)| x * y).sum();
    let free = (near.len() - TERMS) as f64;
    ((squares - explained).max(0.0) / free).sqrt() * reach
}

#[cfg(test)]
mod tests {
    use super::super::{KdTree, Rng};
    use super::*;

    #[test]
    fn the_noise_of_a_curved_surface_is_found() {
        let mut random = Rng::new(1);
        for noise in [0.0, 0.003, 0.01] {
            let points: Vec<Point> = (0..3000)
                .map(|_| {
                    let (x, y) = (random.f64(), random.f64());
                    [x, y, 0.5 * x * x - 0.3 * x * y + noise * random.normal()].map(|c| c as f32)
                })
                .collect();
            let tree = KdTree::new(&points);
            let mut near = Vec::new();
            let mut sum = 0.0;
            for p in points.iter().step_by(10) {
                tree.nearest(*p, 25, &mut near);
                sum += quadratic_residual(&points, &near).powi(2);
            }
            let found = (sum / 300.0).sqrt();
            assert!((found - noise).abs() < 0.1 * noise + 1e-4, "{found} for {noise}");
        }
    }

    #[test]
    fn variances_tell_a_line_from_a_plane() {
        let points: Vec<Point> = (0..20).map(|i| [i as f32, 2.0 * i as f32, (i % 2) as f32 * 0.01]).collect();
        let tree = KdTree::new(&points);
        let mut near = Vec::new();
        tree.nearest(points[10], 17, &mut near);
        let plane = Plane::fit(&points, &near);
        let [least, middle, most] = plane.variances;
        assert!(least <= middle && middle < 1e-4 * most, "{:?}", plane.variances);
    }
}
