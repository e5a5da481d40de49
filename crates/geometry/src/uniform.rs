//! Area-uniform random points on a mesh.

use super::mesh::triangle_area;
use super::{Mesh, MeshError, Rng};
use densecloud_cloud::Position;

/// Why a mesh cannot be sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SampleError {
    /// The mesh is broken.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// There is no triangle, or all have zero area, or the area overflows.
    #[error("the mesh has no triangle with a finite area above zero, so there is no surface to sample")]
    NoArea,
    /// The number of candidates would not fit in 32 bits.
    #[error("{points} points are too many to sample at once; at most {limit} can be asked for")]
    TooMany {
        /// Points asked for.
        points: usize,
        /// The most that can be.
        limit: usize,
    },
}

/// `count` independent random points, uniform by area: O(t + n log t) for t triangles.
///
/// # Errors
/// See [`SampleError`].
pub fn uniform(mesh: &Mesh, count: usize, seed: u64) -> Result<Vec<Position>, SampleError> {
    let surface = Surface::new(mesh)?;
    // A stream for each count: samples of two sizes share no point, as if they had two seeds.
    let mut rng = Rng::stream(seed, count as u64);
    Ok((0..count).map(|_| surface.random(&mut rng)).collect())
}

/// A mesh made ready for drawing random points.
pub(super) struct Surface {
    corners: Vec<[Position; 3]>,
    /// Running sum of the triangles' areas.
    cumulative: Vec<f64>,
}

impl Surface {
    pub(super) fn new(mesh: &Mesh) -> Result<Self, SampleError> {
        mesh.validate()?;
        let mut surface = Self { corners: Vec::new(), cumulative: Vec::new() };
        let mut total = 0.0;
        for corners in mesh.corners() {
            let area = triangle_area(&corners);
            // A triangle whose area vanishes beside the sum so far can never be drawn.
            if total + area > total {
                total += area;
                surface.corners.push(corners);
                surface.cumulative.push(total);
            }
        }
        if total > 0.0 && total.is_finite() { Ok(surface) } else { Err(SampleError::NoArea) }
    }

    pub(super) fn area(&self) -> f64 {
        self.cumulative.last().copied().unwrap_or(0.0)
    }

    pub(super) fn random(&self, rng: &mut Rng) -> Position {
        let at = rng.f64() * self.area();
        let last = self.corners.len() - 1;
        let [a, b, c] = self.corners[self.cumulative.partition_point(|&sum| sum <= at).min(last)];
        let (mut u, mut v) = (rng.f64(), rng.f64());
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        std::array::from_fn(|i| a[i] + u * (b[i] - a[i]) + v * (c[i] - a[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_spread_by_area() {
        // A small and a large square, areas 1 and 9.
        let mesh = Mesh {
            vertices: vec![
                [0.0, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [1.0, 1.0, 0.0],
                [0.0, 1.0, 0.0],
                [0.0, 0.0, 5.0],
                [3.0, 0.0, 5.0],
                [3.0, 3.0, 5.0],
                [0.0, 3.0, 5.0],
            ],
            triangles: vec![[0, 1, 2], [0, 0, 1], [0, 2, 3], [4, 5, 6], [4, 6, 7]],
        };
        let points = uniform(&mesh, 10_000, 3).expect("points");
        assert_eq!(points, uniform(&mesh, 10_000, 3).expect("points"));
        let low = points.iter().filter(|p| p[2] == 0.0).count();
        assert!((900..1100).contains(&low), "{low}");
        let above: Vec<_> = points.iter().filter(|p| p[2] == 5.0).collect();
        let mean_x = above.iter().map(|p| p[0]).sum::<f64>() / above.len() as f64;
        assert!((mean_x - 1.5).abs() < 0.05, "{mean_x}");
        assert_eq!(low + above.len(), 10_000);
    }

    #[test]
    fn no_surface_is_an_error() {
        let line = Mesh { vertices: vec![[0.0; 3], [1.0; 3]], triangles: vec![[0, 1, 1], [0, 0, 0]] };
        assert_eq!(uniform(&line, 5, 0), Err(SampleError::NoArea));
        assert_eq!(uniform(&Mesh::default(), 5, 0), Err(SampleError::NoArea));
        let broken = Mesh { triangles: vec![[0, 1, 2]], ..line };
        assert!(matches!(uniform(&broken, 5, 0), Err(SampleError::Mesh(_))));
    }
}
