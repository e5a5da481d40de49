//! Marching cubes over a sparse grid, without a table from anywhere: what each of the 256 cases looks like follows from its
//! six faces.

use super::grid::{NONE, place};
use super::level::Level;

/// The corners of each face, around it as seen from outside.
const FACES: [[usize; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
/// How near to a node a vertex may lie, in sides: nearer ones make triangles without an area.
const NEAREST: f64 = 0.01;

/// An edge of a cell: its lower corner and its axis.
type Edge = (usize, usize);

/// The surface where `values` are zero, in units of the grid, with the negative side behind its triangles.
pub(super) fn surface(level: &Level, values: &[f64]) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let (vertices, of_node) = vertices(level, values);
    let cases: Vec<Vec<[Edge; 3]>> = (0..256).map(case).collect();
    let mut triangles = Vec::new();
    for ends in level.corners_of_cells() {
        let inside = (0..8).filter(|c| values[ends[*c] as usize] < 0.0).fold(0, |all, c| all | 1 << c);
        let at = |(corner, axis): Edge| of_node[ends[corner] as usize][axis];
        triangles.extend(cases[inside].iter().map(|edges| edges.map(at)));
    }
    (vertices, triangles)
}

/// A vertex on each edge between nodes of different sides, and which these are, an entry an axis.
fn vertices(level: &Level, values: &[f64]) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let mut vertices = Vec::new();
    let mut of_node = vec![[NONE; 3]; values.len()];
    for (node, key) in level.nodes.iter().enumerate() {
        for axis in 0..3 {
            let next = level.around[node][place(std::array::from_fn(|a| i64::from(a == axis)))];
            if next == NONE || (values[node] < 0.0) == (values[next as usize] < 0.0) {
                continue;
            }
            let t = values[node] / (values[node] - values[next as usize]);
            let mut at = super::grid::coordinates(*key).map(f64::from);
            at[axis] += t.clamp(NEAREST, 1.0 - NEAREST);
            of_node[node][axis] = vertices.len() as u32;
            vertices.push(at.map(|c| c * level.side));
        }
    }
    (vertices, of_node)
}

/// The triangles of a case: which corners are inside, a bit each.
fn case(inside: usize) -> Vec<[Edge; 3]> {
    let mut next: Vec<(Edge, Edge)> = FACES.iter().flat_map(|face| segments(face, inside)).collect();
    let mut triangles = Vec::new();
    while let Some((first, mut at)) = next.pop() {
        let mut around = vec![first];
        while at != first {
            around.push(at);
            let Some(found) = next.iter().position(|(from, _)| *from == at) else { break };
            at = next.swap_remove(found).1;
        }
        triangles.extend(filled(&around));
    }
    triangles
}

/// How the surface crosses a face: around each run of corners that are inside, from where it begins to where it ends. Where
/// two corners across are inside, they stay apart, in both cells of the face.
fn segments(face: &[usize; 4], inside: usize) -> Vec<(Edge, Edge)> {
    let is_in = |n: usize| inside >> face[n % 4] & 1 == 1;
    let crossing = |n: usize| edge(face[n % 4], face[(n + 1) % 4]);
    let begins = (0..4).filter(|n| !is_in(*n) && is_in(n + 1));
    begins
        .map(|n| {
            let end = (n + 1..n + 4).find(|m| is_in(*m) && !is_in(m + 1)).unwrap_or(n + 3);
            (crossing(n), crossing(end))
        })
        .collect()
}

fn edge(a: usize, b: usize) -> Edge {
    (a & b, (a ^ b).trailing_zeros() as usize)
}

/// A loop as triangles, none with a side within a face of the cell, which the cell beyond might have as well.
fn filled(around: &[Edge]) -> Vec<[Edge; 3]> {
    if let Some(triangles) = split(around) {
        return triangles;
    }
    (2..around.len()).map(|n| [around[0], around[n - 1], around[n]]).collect()
}

fn split(around: &[Edge]) -> Option<Vec<[Edge; 3]>> {
    let n = around.len();
    if n < 3 {
        return Some(Vec::new());
    }
    let (first, last) = (around[0], around[n - 1]);
    (1..n - 1).find_map(|m| {
        let is_side = |a: usize, b: usize| b - a == 1 || !share_a_face(around[a], around[b]);
        if !is_side(0, m) || !is_side(m, n - 1) {
            return None;
        }
        let mut triangles = split(&around[..=m])?;
        triangles.extend(split(&around[m..])?);
        triangles.push([first, around[m], last]);
        Some(triangles)
    })
}

fn share_a_face(a: Edge, b: Edge) -> bool {
    let ends = |(corner, axis): Edge| [corner, corner | 1 << axis];
    FACES.iter().any(|face| [ends(a), ends(b)].as_flattened().iter().all(|c| face.contains(c)))
}

#[cfg(test)]
mod tests {
    use super::super::grid::bits;
    use super::*;

    #[test]
    fn every_case_uses_each_crossed_edge_and_closes_up_inside_its_cell() {
        for inside in 0..256 {
            let triangles = case(inside);
            let crossed = |corner: usize, axis: usize| {
                corner >> axis & 1 == 0 && (inside >> corner & 1) != (inside >> (corner | 1 << axis) & 1)
            };
            for (corner, axis) in (0..8).flat_map(|c| (0..3).map(move |a| (c, a))) {
                let used = triangles.iter().flatten().any(|e| *e == (corner, axis));
                assert_eq!(used, crossed(corner, axis), "case {inside}");
            }
            for triangle in &triangles {
                for n in 0..3 {
                    let (a, b) = (triangle[n], triangle[(n + 1) % 3]);
                    let back = triangles.iter().any(|t| (0..3).any(|m| (t[m], t[(m + 1) % 3]) == (b, a)));
                    assert!(back || share_a_face(a, b), "case {inside} is open within its cell");
                    assert!(!(back && share_a_face(a, b)), "case {inside} has a diagonal in a face");
                }
            }
        }
    }

    #[test]
    fn triangles_face_away_from_the_inside() {
        // One corner inside: the triangle about it looks towards +x, +y and +z.
        let [triangle] = case(1)[..] else { panic!("a corner is cut off by one triangle") };
        let at = triangle.map(|(corner, axis)| {
            let mut at = bits(corner).map(|c| c as f64);
            at[axis] += 0.5;
            at
        });
        let normal = crate::mesh::cross(crate::mesh::sub(at[1], at[0]), crate::mesh::sub(at[2], at[0]));
        assert!(normal.iter().all(|c| *c > 0.0), "{normal:?}");
    }
}
