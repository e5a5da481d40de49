//! Which side of a surface normals point to.

use densecloud_cloud::Point;
use rayon::prelude::*;

use super::{KdTree, Walk};

/// Neighbours that a normal's side is passed on to.
const NEIGHBOURS: usize = 10;

/// The normals, each turned so that it points to where its point was seen from; as it is where that is not known.
#[must_use]
pub fn towards(
    points: &[Point],
    normals: &[[f32; 3]],
    seen_from: impl Fn(usize) -> Option<Point>,
) -> Vec<[f32; 3]> {
    let turned = |(i, (p, n)): (usize, (&Point, &[f32; 3]))| match seen_from(i) {
        Some(from) if (0..3).map(|a| n[a] * (from[a] - p[a])).sum::<f32>() < 0.0 => n.map(|c| -c),
        _ => *n,
    };
    points.iter().zip(normals).enumerate().map(turned).collect()
}

/// The normals, each turned as those beside it are (Hoppe et al., 1992): along a minimum spanning tree of the graph of
/// neighbours, where an edge costs the more the less parallel two normals are. Of each connected part the highest point looks up, which
/// is outwards where the surface is closed; where it is open, the side is as good as chance. O(n log n).
#[must_use]
pub fn propagated(points: &[Point], normals: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let mut parts = Parts::new(points.len());
    for (_, a, b) in edges(points, normals) {
        let against = dot(normals[a as usize], normals[b as usize]) < 0.0;
        parts.join(a, b, against);
    }
    parts.turned(points, normals)
}

/// Pairs of neighbours, those whose normals are most nearly parallel first.
fn edges(points: &[Point], normals: &[[f32; 3]]) -> Vec<(u32, u32, u32)> {
    let tree = KdTree::new(points);
    let of = |walk: &mut Walk, i: usize| {
        tree.nearest_next(points[i], NEIGHBOURS + 1, walk);
        let edge = |j: u32| {
            let cost = 1.0 - dot(normals[i], normals[j as usize]).abs();
            // As bits, positive numbers sort as they do by value.
            (cost.max(0.0).to_bits(), j.min(i as u32), j.max(i as u32))
        };
        walk.found.iter().filter(|n| n.index as usize != i).map(|n| edge(n.index)).collect::<Vec<_>>()
    };
    let mut edges: Vec<(u32, u32, u32)> =
        (0..points.len()).into_par_iter().map_init(Walk::default, of).flatten_iter().collect();
    edges.par_sort_unstable();
    edges.dedup();
    edges
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|c| a[c] * b[c]).sum()
}

/// Parts that are joined, and which of their members are turned against the part's first.
struct Parts {
    parent: Vec<u32>,
    against: Vec<bool>,
}

impl Parts {
    fn new(n: usize) -> Self {
        Self { parent: super::indices(n).collect(), against: vec![false; n] }
    }

    /// A member's first, and whether it is turned against that; paths become half as long on the way.
    fn first(&mut self, of: u32) -> (u32, bool) {
        let (mut at, mut against) = (of as usize, false);
        while self.parent[at] as usize != at {
            let up = self.parent[at] as usize;
            against ^= self.against[at];
            self.against[at] ^= self.against[up];
            self.parent[at] = self.parent[up];
            // What was passed over counts too, unless it was the first.
            if self.parent[up] as usize != up {
                against ^= self.against[up];
            }
            at = self.parent[at] as usize;
        }
        (at as u32, against)
    }

    fn join(&mut self, a: u32, b: u32, against: bool) {
        let ((a, turned_a), (b, turned_b)) = (self.first(a), self.first(b));
        if a != b {
            let (low, high) = (a.min(b), a.max(b));
            self.parent[high as usize] = low;
            self.against[high as usize] = turned_a ^ turned_b ^ against;
        }
    }

    fn turned(mut self, points: &[Point], normals: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let of: Vec<(u32, bool)> = super::indices(points.len()).map(|i| self.first(i)).collect();
        let mut highest = self.parent;
        for (i, (first, _)) in of.iter().enumerate() {
            let so_far = &mut highest[*first as usize];
            if points[i][2] > points[*so_far as usize][2] {
                *so_far = i as u32;
            }
        }
        let turn = |i: usize| {
            let (first, against) = of[i];
            let top = highest[first as usize] as usize;
            let flip = against ^ of[top].1 ^ (normals[top][2] < 0.0);
            if flip { normals[i].map(|c| -c) } else { normals[i] }
        };
        (0..points.len()).map(turn).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Rng, estimate_normals};

    fn sphere(n: usize) -> Vec<Point> {
        let mut rng = Rng::new(5);
        let at = |_| {
            let p: [f64; 3] = std::array::from_fn(|_| rng.normal());
            let length = p.iter().map(|c| c * c).sum::<f64>().sqrt();
            p.map(|c| (c / length) as f32)
        };
        (0..n).map(at).collect()
    }

    #[test]
    fn a_closed_surface_faces_out_and_two_of_them_do_both() {
        let one = sphere(2000);
        let both: Vec<Point> =
            one.iter().copied().chain(one.iter().map(|p| [p[0] + 5.0, p[1], p[2]])).collect();
        let normals = propagated(&both, &estimate_normals(&both, 10));
        let out = |(i, n): (usize, &[f32; 3])| dot(*n, one[i % 2000]) > 0.0;
        assert!(normals.iter().enumerate().all(out));
    }

    #[test]
    fn a_sensor_inside_turns_all_towards_it() {
        let points = sphere(500);
        let normals = estimate_normals(&points, 10);
        let turned = towards(&points, &normals, |_| Some([0.1, 0.0, 0.0]));
        assert!(points.iter().zip(&turned).all(|(p, n)| dot(*p, *n) < 0.0));
        assert_eq!(towards(&points, &normals, |_| None), normals);
    }
}
