//! What of a surface is kept: what has points near it.

use std::collections::HashSet;

use rayon::prelude::*;

use super::Surface;
use crate::KdTree;

/// How far from its nearest point a corner at the surface's border may lie, in spacings; less than
/// that lies between points spread at random as well.
const BORDER: f64 = 1.2;

/// The triangles all of whose corners are within `most` spacings of a point, less those at open borders that are past the
/// last points, as a surface.
pub(super) fn trimmed(
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    tree: &KdTree,
    spacings: &[f64],
    most: f64,
) -> Surface {
    let away = |v: &[f64; 3]| {
        let nearest = tree.nearest_one(v.map(|c| c as f32))?;
        Some(f64::from(nearest.distance_squared).sqrt() / spacings[nearest.index as usize])
    };
    let far: Vec<f64> = vertices.par_iter().map(|v| away(v).unwrap_or(f64::INFINITY)).collect();
    let furthest = |t: &[u32; 3]| t.iter().map(|v| far[*v as usize]).fold(0.0, f64::max);
    let mut triangles: Vec<[u32; 3]> = triangles.into_iter().filter(|t| furthest(t) <= most).collect();
    let mut open = open_corners(&triangles);
    loop {
        let before = triangles.len();
        let at_border = |t: &[u32; 3]| t.iter().any(|v| open.contains(v));
        triangles.retain(|t| furthest(t) <= BORDER || !at_border(t));
        if triangles.len() == before {
            break;
        }
        open = open_corners(&triangles);
    }
    let (vertices, triangles) = used(&vertices, triangles);
    let open_sides = open_sides(&triangles).count();
    Surface { vertices, triangles, cell: 0.0, open_sides }
}

/// The corners at open borders.
fn open_corners(triangles: &[[u32; 3]]) -> HashSet<u32> {
    open_sides(triangles).flat_map(|(a, b)| [a, b]).collect()
}

/// The sides that belong to one triangle.
fn open_sides(triangles: &[[u32; 3]]) -> impl Iterator<Item = (u32, u32)> + use<> {
    let side = |a: u32, b: u32| (a.min(b), a.max(b));
    let of = |t: &[u32; 3]| [side(t[0], t[1]), side(t[1], t[2]), side(t[2], t[0])];
    let mut sides: Vec<(u32, u32)> = triangles.iter().flat_map(of).collect();
    sides.par_sort_unstable();
    let alone: Vec<(u32, u32)> =
        sides.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).map(|same| same[0]).collect();
    alone.into_iter()
}

/// Without the vertices that no triangle has.
fn used(vertices: &[[f64; 3]], mut triangles: Vec<[u32; 3]>) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let mut new = vec![u32::MAX; vertices.len()];
    let mut kept = Vec::new();
    for corner in triangles.as_flattened_mut() {
        let at = &mut new[*corner as usize];
        if *at == u32::MAX {
            *at = kept.len() as u32;
            kept.push(vertices[*corner as usize]);
        }
        *corner = *at;
    }
    (kept, triangles)
}
