//! Triangle meshes: what point clouds are sampled from and measured against.

use densecloud_cloud::Position;

/// A triangle mesh. Triangles may be degenerate, vertices unused, the surface open.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Corner positions, in the file's units.
    pub vertices: Vec<Position>,
    /// Three vertex indices a triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// Why a mesh cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// A triangle names a vertex that is not there.
    #[error("triangle {triangle} names vertex {vertex}, but there are only {vertices} vertices")]
    NoSuchVertex {
        /// The triangle, from 0.
        triangle: usize,
        /// The vertex that it names.
        vertex: u32,
        /// How many there are.
        vertices: usize,
    },
    /// A corner of a triangle is NaN or infinite.
    #[error("vertex {vertex} is not finite")]
    NotFinite {
        /// The vertex, from 0.
        vertex: u32,
    },
}

impl Mesh {
    /// Whether every triangle names vertices that are there and finite. O(triangles).
    ///
    /// # Errors
    /// The first triangle that does not.
    pub fn validate(&self) -> Result<(), MeshError> {
        for (triangle, corners) in self.triangles.iter().enumerate() {
            for &vertex in corners {
                let position = self.vertices.get(vertex as usize).ok_or(MeshError::NoSuchVertex {
                    triangle,
                    vertex,
                    vertices: self.vertices.len(),
                })?;
                if position.iter().any(|c| !c.is_finite()) {
                    return Err(MeshError::NotFinite { vertex });
                }
            }
        }
        Ok(())
    }

    /// The corners of every triangle whose corners are there and finite, in order.
    pub fn corners(&self) -> impl Iterator<Item = [Position; 3]> + '_ {
        self.triangles.iter().filter_map(|t| {
            let mut corners = [[0.0; 3]; 3];
            for (corner, &v) in corners.iter_mut().zip(t) {
                *corner = *self.vertices.get(v as usize)?;
            }
            corners.as_flattened().iter().all(|c| c.is_finite()).then_some(corners)
        })
    }

    /// Surface area, in square units.
    #[must_use]
    pub fn area(&self) -> f64 {
        self.corners().map(|c| triangle_area(&c)).sum()
    }

    /// Lowest and highest corner of the box around all triangles (unused vertices do not count);
    /// `None` without triangles.
    #[must_use]
    pub fn bounds(&self) -> Option<(Position, Position)> {
        let mut bounds = None;
        for p in self.corners().flatten() {
            let (lo, hi) = bounds.get_or_insert((p, p));
            for a in 0..3 {
                lo[a] = lo[a].min(p[a]);
                hi[a] = hi[a].max(p[a]);
            }
        }
        bounds
    }
}

pub(super) fn triangle_area(&[a, b, c]: &[Position; 3]) -> f64 {
    let n = cross(sub(b, a), sub(c, a));
    0.5 * dot(n, n).sqrt()
}

pub(super) fn sub(a: Position, b: Position) -> Position {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(super) fn dot(a: Position, b: Position) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: Position, b: Position) -> Position {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Mesh {
        Mesh {
            vertices: vec![[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 2.0, 1.0], [0.0, 2.0, 1.0], [99.0; 3]],
            triangles: vec![[0, 1, 2], [0, 2, 3], [1, 1, 2]],
        }
    }

    #[test]
    fn area_and_bounds_ignore_degenerate_triangles_and_unused_vertices() {
        let mesh = square();
        assert_eq!(mesh.validate(), Ok(()));
        assert_eq!(mesh.area(), 4.0);
        assert_eq!(mesh.bounds(), Some(([0.0, 0.0, 1.0], [2.0, 2.0, 1.0])));
        assert_eq!(Mesh::default().bounds(), None);
    }

    #[test]
    fn validation_names_what_is_wrong() {
        let mut mesh = square();
        mesh.triangles.push([0, 1, 7]);
        let error = MeshError::NoSuchVertex { triangle: 3, vertex: 7, vertices: 5 };
        assert_eq!(mesh.validate(), Err(error));
        assert_eq!(mesh.area(), 4.0);
        let mut mesh = square();
        mesh.vertices[3][1] = f64::NAN;
        assert_eq!(mesh.validate(), Err(MeshError::NotFinite { vertex: 3 }));
        assert_eq!(mesh.area(), 2.0);
    }
}
