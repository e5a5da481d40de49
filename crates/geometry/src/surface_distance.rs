//! Distance from points to a mesh.

use rayon::prelude::*;

use super::Mesh;
use super::mesh::{cross, dot, sub};
use densecloud_cloud::Position;

/// Triangles in a leaf at most.
const LEAF: usize = 4;
/// A triangle whose area is this small beside its sides is as good as its edges.
const FLAT: f64 = 1e-20;

/// Exact distances from points to a triangle mesh, by a bounding volume hierarchy.
///
/// Build O(t log t), query about O(log t). Triangles with missing or non-finite corners are left
/// out; degenerate ones count as the segments or points that they are.
///
/// ```
/// use densecloud_geometry::{Mesh, SurfaceDistance};
///
/// let mesh = Mesh { vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], triangles: vec![[0, 1, 2]] };
/// let surface = SurfaceDistance::new(&mesh);
/// assert_eq!(surface.distance([0.2, 0.2, -3.0]), 3.0);
/// assert_eq!(surface.distance([4.0, -4.0, 0.0]), 5.0);
/// ```
#[derive(Debug, Clone)]
pub struct SurfaceDistance {
    triangles: Vec<[Position; 3]>,
    /// The children of node `i` are `2 i + 1` and `2 i + 2`; all leaves are at one depth, and
    /// ranges are halved exactly, so ranges need not be stored.
    boxes: Vec<Box3>,
    depth: u32,
}

#[derive(Debug, Clone, Copy)]
struct Box3 {
    lo: Position,
    hi: Position,
}

impl SurfaceDistance {
    /// Makes the hierarchy. Deterministic.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        let mut triangles: Vec<[Position; 3]> = mesh.corners().collect();
        let mut depth = 0;
        while triangles.len().div_ceil(1 << depth) > LEAF {
            depth += 1;
        }
        let empty = Box3 { lo: [f64::INFINITY; 3], hi: [f64::NEG_INFINITY; 3] };
        let mut boxes = vec![empty; (2 << depth) - 1];
        build(&mut triangles, 0, depth, &mut boxes);
        Self { triangles, boxes, depth }
    }

    /// The distance from `p` to the nearest point of the surface, in the mesh's units; infinite
    /// when there is no triangle.
    #[must_use]
    pub fn distance(&self, p: Position) -> f64 {
        let mut best = f64::INFINITY;
        self.descend(p, 0, 0, (0, self.triangles.len()), &mut best);
        best.sqrt()
    }

    /// The distances of all points, in order, on all threads of the current pool.
    #[must_use]
    pub fn distances(&self, points: &[Position]) -> Vec<f64> {
        points.par_iter().map(|&p| self.distance(p)).collect()
    }

    fn descend(&self, p: Position, node: usize, level: u32, (start, end): (usize, usize), best: &mut f64) {
        if level == self.depth {
            for triangle in &self.triangles[start..end] {
                *best = best.min(triangle_distance_squared(p, triangle));
            }
            return;
        }
        let middle = start.midpoint(end);
        let mut children = [(2 * node + 1, (start, middle)), (2 * node + 2, (middle, end))]
            .map(|(child, range)| (self.boxes[child].distance_squared(p), child, range));
        if children[1].0 < children[0].0 {
            children.swap(0, 1);
        }
        for (distance, child, range) in children {
            if distance < *best {
                self.descend(p, child, level + 1, range, best);
            }
        }
    }
}

impl Box3 {
    fn distance_squared(&self, p: Position) -> f64 {
        let d: Position = std::array::from_fn(|a| (self.lo[a] - p[a]).max(p[a] - self.hi[a]).max(0.0));
        dot(d, d)
    }
}

fn build(triangles: &mut [[Position; 3]], node: usize, levels: u32, boxes: &mut [Box3]) {
    let mut around = Box3 { lo: [f64::INFINITY; 3], hi: [f64::NEG_INFINITY; 3] };
    let mut centres = around;
    let centre = |t: &[Position; 3], a: usize| t[0][a] + t[1][a] + t[2][a];
    for t in &*triangles {
        for a in 0..3 {
            for corner in t {
                around.lo[a] = around.lo[a].min(corner[a]);
                around.hi[a] = around.hi[a].max(corner[a]);
            }
            centres.lo[a] = centres.lo[a].min(centre(t, a));
            centres.hi[a] = centres.hi[a].max(centre(t, a));
        }
    }
    boxes[node] = around;
    if levels == 0 {
        return;
    }
    let side = |a: usize| centres.hi[a] - centres.lo[a];
    let axis = (1..3).fold(0, |best, a| if side(a) > side(best) { a } else { best });
    let middle = triangles.len() / 2;
    if middle < triangles.len() {
        triangles.select_nth_unstable_by(middle, |s, t| centre(s, axis).total_cmp(&centre(t, axis)));
    }
    let (left, right) = triangles.split_at_mut(middle);
    build(left, 2 * node + 1, levels - 1, boxes);
    build(right, 2 * node + 2, levels - 1, boxes);
}

/// Squared distance to a triangle: to its plane where the foot of the perpendicular is inside, else
/// to the nearest edge.
fn triangle_distance_squared(p: Position, &[a, b, c]: &[Position; 3]) -> f64 {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let n = cross(ab, ac);
    let nn = dot(n, n);
    // Only a normal that means something may decide; that of a sliver is mostly rounding.
    if nn > FLAT * dot(ab, ab) * dot(ac, ac) {
        let inside = |from: Position, edge: Position| dot(cross(edge, sub(p, from)), n) >= 0.0;
        if inside(a, ab) && inside(b, sub(c, b)) && inside(c, sub(a, c)) {
            let height = dot(ap, n);
            return height * height / nn;
        }
    }
    segment_distance_squared(p, a, b)
        .min(segment_distance_squared(p, b, c))
        .min(segment_distance_squared(p, c, a))
}

fn segment_distance_squared(p: Position, a: Position, b: Position) -> f64 {
    let (ab, ap) = (sub(b, a), sub(p, a));
    let length = dot(ab, ab);
    let t = if length > 0.0 { (dot(ap, ab) / length).clamp(0.0, 1.0) } else { 0.0 };
    let d: Position = std::array::from_fn(|i| ap[i] - t * ab[i]);
    dot(d, d)
}

#[cfg(test)]
mod tests {
    use super::super::{Rng, shape, uniform};
    use super::*;
    use proptest::prelude::*;

    /// The nearest of many points of the triangle: from above, and near for a fine grid.
    fn by_sampling(p: Position, t: &[Position; 3]) -> f64 {
        const STEPS: u32 = 60;
        let mut best = f64::INFINITY;
        for i in 0..=STEPS {
            for j in 0..=STEPS - i {
                let (u, v) = (f64::from(i) / f64::from(STEPS), f64::from(j) / f64::from(STEPS));
                let q: Position =
                    std::array::from_fn(|a| t[0][a] + u * (t[1][a] - t[0][a]) + v * (t[2][a] - t[0][a]));
                best = best.min(dot(sub(p, q), sub(p, q)));
            }
        }
        best.sqrt()
    }

    fn random(rng: &mut Rng) -> Position {
        std::array::from_fn(|_| 2.0 * rng.f64() - 1.0)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn one_triangle_agrees_with_dense_sampling(seed in any::<u64>(), kind in 0u8..4) {
            let mut rng = Rng::new(seed);
            let (a, b) = (random(&mut rng), random(&mut rng));
            let c = match kind {
                0 => random(&mut rng),
                1 => a,                                                  // a segment
                2 => std::array::from_fn(|i| 0.3 * a[i] + 0.7 * b[i]),  // corners on a line, up to rounding
                _ => std::array::from_fn(|i| 0.5 * (a[i] + b[i]) + 1e-7 * (rng.f64() - 0.5)), // a sliver
            };
            for _ in 0..8 {
                let p = random(&mut rng);
                let exact = triangle_distance_squared(p, &[a, b, c]).sqrt();
                let sampled = by_sampling(p, &[a, b, c]);
                // Sides are at most 2 sqrt 3 long, so the grid is at most 0.06 wide.
                prop_assert!(exact <= sampled + 1e-12 && sampled * sampled <= exact * exact + 0.06f64.powi(2) + 1e-9, "{exact} {sampled}");
            }
        }

        #[test]
        fn many_triangles_agree_with_the_nearest_of_all(seed in any::<u64>(), n in 1u32..80) {
            let mut rng = Rng::new(seed);
            let mesh = Mesh {
                vertices: (0..n + 2).map(|_| random(&mut rng)).collect(),
                triangles: (0..n).map(|_| std::array::from_fn(|_| rng.below(u64::from(n) + 2) as u32)).collect(),
            };
            let surface = SurfaceDistance::new(&mesh);
            for _ in 0..8 {
                let p = random(&mut rng);
                let brute = mesh.corners().map(|t| triangle_distance_squared(p, &t)).fold(f64::INFINITY, f64::min);
                prop_assert_eq!(surface.distance(p), brute.sqrt());
            }
        }
    }

    #[test]
    fn points_of_the_surface_are_at_no_distance() {
        for name in ["knot", "stairs"] {
            let mesh = shape(name).expect("a shape");
            let surface = SurfaceDistance::new(&mesh);
            let points = uniform(&mesh, 300, 1).expect("points");
            let distances = surface.distances(&points);
            assert!(distances.iter().all(|&d| d < 1e-12));
            assert_eq!(distances[7], surface.distance(points[7]));
        }
    }

    #[test]
    fn meshes_without_triangles_are_infinitely_far() {
        let broken = Mesh { vertices: vec![[0.0; 3], [f64::NAN; 3]], triangles: vec![[0, 0, 9], [0, 1, 0]] };
        for mesh in [Mesh::default(), broken] {
            assert_eq!(SurfaceDistance::new(&mesh).distance([0.0; 3]), f64::INFINITY);
        }
    }
}
