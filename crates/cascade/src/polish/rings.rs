//! A point's nearest others on the same surface, and the midpoints between them.

use rayon::prelude::*;

use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Neighbour, Walk, normal};

/// Neighbours that a point shares midpoints with: the ring around it, and some.
const NEIGHBOURS: usize = 7;
/// Neighbours that a normal is estimated from, the point itself among them.
const NORMAL_NEIGHBOURS: usize = 12;
/// A midpoint is of one surface if the edge lies within 45 degrees of both tangent planes: this is
/// the sine. Others bridge sheets or cut corners.
const STEEPEST: f32 = 0.7;

/// The nearest others of a point that lie on the same surface.
#[derive(Clone, Copy, Default)]
pub(crate) struct Ring {
    others: [u32; NEIGHBOURS],
    count: u8,
}

impl Ring {
    /// The nearest to point `i` among those `found`, nearest first, whatever surface they lie on.
    fn of(i: usize, found: &[Neighbour]) -> Self {
        let mut ring = Self::default();
        for n in found.iter().filter(|n| n.index as usize != i).take(NEIGHBOURS) {
            ring.others[usize::from(ring.count)] = n.index;
            ring.count += 1;
        }
        ring
    }

    pub(super) fn others(&self) -> &[u32] {
        &self.others[..usize::from(self.count)]
    }
}

/// The ring of each of `points`, of which `tree` is built; best when they lie in the order of a tree.
pub(crate) fn rings(tree: &KdTree, points: &[Point]) -> Vec<Ring> {
    surroundings(tree, points, |_, _, _| ()).0
}

/// The nearest others of each of `points`, of which `tree` is built, on whatever surface they lie.
pub(super) fn nearest_rings(tree: &KdTree, points: &[Point]) -> Vec<Ring> {
    let ring = |found: &mut Vec<Neighbour>, (i, p): (usize, &Point)| {
        tree.nearest(*p, NEIGHBOURS + 1, found);
        Ring::of(i, found)
    };
    points.par_iter().enumerate().map_init(Vec::new, ring).collect()
}

/// The rings, and whatever is wanted of each point's nearest (itself among them) and normal.
pub(super) fn surroundings<T: Clone + Default + Send>(
    tree: &KdTree,
    points: &[Point],
    of: impl Fn(usize, &[Neighbour], [f32; 3]) -> T + Sync,
) -> (Vec<Ring>, Vec<T>) {
    let mut rings = vec![Ring::default(); points.len()];
    let mut normals = vec![[0.0; 3]; points.len()];
    let mut wanted = vec![T::default(); points.len()];
    let all = rings.par_iter_mut().zip(&mut normals).zip(&mut wanted).enumerate();
    all.for_each_init(Walk::default, |walk, (i, ((ring, normal_of), wanted))| {
        tree.nearest_next(points[i], NORMAL_NEIGHBOURS, walk);
        let found = &walk.found;
        *ring = Ring::of(i, found);
        *normal_of = normal(points, found);
        *wanted = of(i, found, *normal_of);
    });
    rings.par_iter_mut().enumerate().for_each(|(i, ring)| {
        let all = *ring;
        ring.count = 0;
        for &j in all.others() {
            let edge: [f32; 3] = std::array::from_fn(|a| points[j as usize][a] - points[i][a]);
            let length = edge.iter().map(|c| c * c).sum::<f32>().sqrt();
            let steep = |n: [f32; 3]| (0..3).map(|a| n[a] * edge[a]).sum::<f32>().abs() > STEEPEST * length;
            if !steep(normals[i]) && !steep(normals[j as usize]) {
                ring.others[usize::from(ring.count)] = j;
                ring.count += 1;
            }
        }
    });
    (rings, wanted)
}

pub(super) fn middle(p: Point, q: Point) -> Point {
    std::array::from_fn(|a| 0.5 * (p[a] + q[a]))
}

/// Of every point and its ring, each pair once; and the mean of their local spacings, where there are such.
pub(crate) fn midpoints(points: &[Point], rings: &[Ring], local: Option<&[f32]>) -> (Vec<Point>, Vec<f32>) {
    let pairs = |i: usize| {
        let others = rings[i].others().iter().map(|&j| j as usize);
        others.filter(move |&j| i < j || !rings[j].others().contains(&(i as u32))).map(move |j| (i, j))
    };
    let all = || (0..points.len()).into_par_iter().flat_map_iter(pairs);
    let middles = all().map(|(i, j)| middle(points[i], points[j])).collect();
    let spacings = local.map(|local| all().map(|(i, j)| 0.5 * (local[i] + local[j])).collect());
    (middles, spacings.unwrap_or_default())
}
