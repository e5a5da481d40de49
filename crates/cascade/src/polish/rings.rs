//! A point's nearest others on the same surface, and the midpoints between them.

use rayon::prelude::*;

use densecloud_cloud::Point;
use densecloud_geometry::{KdTree, Neighbour, Walk, normals_of_four};

/// Neighbours that a point shares midpoints with: the ring around it, and some.
const NEIGHBOURS: usize = 7;
/// Neighbours that a normal is estimated from, the point itself among them.
const NORMAL_NEIGHBOURS: usize = 12;
/// Points whose pairs are a task.
const CHUNK: usize = 4096;
/// Normals that are estimated at once.
const FOUR: usize = 4;
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

/// The number of four points, and the places of what is found of them.
type Out<'a, T> = (usize, ((&'a mut [Ring], &'a mut [[f32; 3]]), &'a mut [T]));

/// The rings, and whatever is wanted of each point's nearest (itself among them) and normal.
pub(super) fn surroundings<T: Clone + Default + Send>(
    tree: &KdTree,
    points: &[Point],
    of: impl Fn(usize, &[Neighbour], [f32; 3]) -> T + Sync,
) -> (Vec<Ring>, Vec<T>) {
    let mut rings = vec![Ring::default(); points.len()];
    let mut normals = vec![[0.0; 3]; points.len()];
    let mut wanted = vec![T::default(); points.len()];
    // Four at a time, for the sake of their normals.
    let find = |(walk, found): &mut (Walk, [Vec<Neighbour>; FOUR]),
                (first, ((rings, normals), wanted)): Out<'_, T>| {
        for (found, i) in found.iter_mut().zip(FOUR * first..).take(rings.len()) {
            tree.nearest_next(points[i], NORMAL_NEIGHBOURS, walk);
            found.clone_from(&walk.found);
        }
        let all = normals_of_four(points, found.each_ref().map(Vec::as_slice));
        for (k, found) in found.iter().enumerate().take(rings.len()) {
            let i = FOUR * first + k;
            (rings[k], normals[k], wanted[k]) = (Ring::of(i, found), all[k], of(i, found, all[k]));
        }
    };
    let fours = rings.par_chunks_mut(FOUR).zip(normals.par_chunks_mut(FOUR)).zip(wanted.par_chunks_mut(FOUR));
    fours.enumerate().for_each_init(Default::default, find);
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
    let of_chunk = |(chunk, own): (usize, &[Ring])| {
        let first = CHUNK * chunk;
        let mut pairs = Vec::with_capacity(NEIGHBOURS * own.len());
        for (i, ring) in (first..).zip(own) {
            let others = ring.others().iter().map(|&j| j as usize);
            let once = |&j: &usize| i < j || !rings[j].others().contains(&(i as u32));
            pairs.extend(others.filter(once).map(|j| (i as u32, j as u32)));
        }
        pairs
    };
    let pairs = rings.par_chunks(CHUNK).enumerate().map(of_chunk).collect::<Vec<_>>().concat();
    let middles = pairs.par_iter().map(|&(i, j)| middle(points[i as usize], points[j as usize])).collect();
    let spacing = |local: &[f32]| {
        pairs.par_iter().map(|&(i, j)| 0.5 * (local[i as usize] + local[j as usize])).collect()
    };
    (middles, local.map(spacing).unwrap_or_default())
}
