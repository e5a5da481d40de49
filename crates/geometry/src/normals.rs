//! Normals of a cloud by principal component analysis.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

use super::{KdTree, Neighbour};
use densecloud_cloud::Point;

/// Queries a task: enough to hide what a task costs.
const CHUNK: usize = 512;

/// A unit normal for each point: the direction in which its `k` nearest points (itself among
/// them) vary least (Hoppe et al., 1992).
///
/// Unoriented: which of the two sides is out cannot be told from points, so the component of the
/// largest magnitude is made positive. Where the neighbours lie on a line or in one place, it is
/// some direction across them, the same in every run. O(n (k + log n)), on all threads of the
/// current pool; the result does not depend on their number.
#[must_use]
pub fn estimate_normals(points: &[Point], k: usize) -> Vec<[f32; 3]> {
    let tree = KdTree::new(points);
    let found: Vec<[f32; 3]> = tree
        .order()
        .par_chunks(CHUNK)
        .flat_map_iter(|chunk| {
            let mut near = Vec::with_capacity(k);
            let tree = &tree;
            chunk.iter().map(move |&i| {
                tree.nearest(points[i as usize], k, &mut near);
                normal(points, &near)
            })
        })
        .collect();
    let mut normals = vec![[0.0; 3]; points.len()];
    for (&i, normal) in tree.order().iter().zip(found) {
        normals[i as usize] = normal;
    }
    normals
}

/// The normal of one point whose nearest are `near`.
pub fn normal(points: &[Point], near: &[Neighbour]) -> [f32; 3] {
    directed(least_eigenvector(covariance(points, near)))
}

/// The same of four points, in less than half of the time of four.
pub fn normals_of_four(points: &[Point], near: [&[Neighbour]; 4]) -> [[f32; 3]; 4] {
    let covariances = near.map(|near| covariance(points, near));
    least_eigenvectors_of_four(covariances).map(directed)
}

/// [`least_eigenvector`] of four matrices, in the processor's own vectors.
pub(super) fn least_eigenvectors_of_four(all: [[[f64; 3]; 3]; 4]) -> [[f64; 3]; 4] {
    Arch::new().dispatch(Four(all))
}

struct Four([[[f64; 3]; 3]; 4]);

impl WithSimd for Four {
    type Output = [[f64; 3]; 4];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [[f64; 3]; 4] {
        least_eigenvectors(self.0)
    }
}

/// With the component of the largest magnitude positive.
fn directed(v: [f64; 3]) -> [f32; 3] {
    let largest = (1..3).fold(0, |best, a| if v[a].abs() > v[best].abs() { a } else { best });
    let sign = v[largest].signum();
    v.map(|c| (sign * c) as f32)
}

/// The sums of products of deviations from the mean: upper triangle.
pub(super) fn covariance(points: &[Point], near: &[Neighbour]) -> [[f64; 3]; 3] {
    let share = 1.0 / near.len().max(1) as f64;
    let at = |n: &Neighbour| points[n.index as usize].map(f64::from);
    let mut mean = [0.0; 3];
    for p in near.iter().map(at) {
        for a in 0..3 {
            mean[a] += share * p[a];
        }
    }
    let mut covariance = [[0.0; 3]; 3];
    for p in near.iter().map(at) {
        let d: [f64; 3] = std::array::from_fn(|a| p[a] - mean[a]);
        for a in 0..3 {
            for b in a..3 {
                covariance[a][b] += d[a] * d[b];
            }
        }
    }
    covariance
}

/// The unit eigenvector of the smallest eigenvalue.
pub(super) fn least_eigenvector(m: [[f64; 3]; 3]) -> [f64; 3] {
    least_eigenvectors([m])[0]
}

/// The same of several matrices.
#[inline(always)]
fn least_eigenvectors<const N: usize>(all: [[[f64; 3]; 3]; N]) -> [[f64; 3]; N] {
    let (values, vectors) = eigen_each(all);
    let least = |n: usize| (1..3).fold(0, |best, a| if values[a][n] < values[best][n] { a } else { best });
    std::array::from_fn(|n| vectors[least(n)].map(|c| c[n]))
}

/// The eigenvalues of a symmetric matrix, of which the upper triangle is read, and the unit eigenvector of each.
pub(super) fn eigen(m: [[f64; 3]; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
    let (values, vectors) = eigen_each([m]);
    (values.map(|[value]| value), vectors.map(|vector| vector.map(|[c]| c)))
}

/// The eigenvalues of symmetric matrices, of which the upper triangle is read, and the unit eigenvector of
/// each; cyclic Jacobi rotations, which are exact where eigenvalues are equal too. Matrices are worked on side by side, each
/// as if it were alone: `[value][matrix]`, `[vector][axis][matrix]`.
#[inline(always)]
fn eigen_each<const N: usize>(all: [[[f64; 3]; 3]; N]) -> ([[f64; N]; 3], [[[f64; N]; 3]; 3]) {
    let mut m: [[[f64; N]; 3]; 3] =
        std::array::from_fn(|i| std::array::from_fn(|j| std::array::from_fn(|n| all[n][i][j])));
    let mut vectors = [0, 1, 2].map(|v| [0, 1, 2].map(|a| [f64::from(u8::from(a == v)); N]));
    let scale: [f64; N] = std::array::from_fn(|n| m[0][0][n] + m[1][1][n] + m[2][2][n]);
    let mut done = [false; N];
    // Converges quadratically: six sweeps are more than 3 x 3 ever needs.
    for _ in 0..6 {
        for n in 0..N {
            done[n] |= m[0][1][n].abs() + m[0][2][n].abs() + m[1][2][n].abs() <= 1e-14 * scale[n];
        }
        if done == [true; N] {
            break;
        }
        rotate(&mut m, &mut vectors, done, [0, 1, 2]);
        rotate(&mut m, &mut vectors, done, [0, 2, 1]);
        rotate(&mut m, &mut vectors, done, [1, 2, 0]);
    }
    ([m[0][0], m[1][1], m[2][2]], vectors)
}

/// Makes the entry of row `p` and column `q` zero by a rotation in their plane, where a matrix is not `done`; `r` is the
/// third axis.
#[inline(always)]
fn rotate<const N: usize>(
    m: &mut [[[f64; N]; 3]; 3],
    vectors: &mut [[[f64; N]; 3]; 3],
    done: [bool; N],
    [p, q, r]: [usize; 3],
) {
    let across = m[p][q];
    let turns: [bool; N] = std::array::from_fn(|n| !done[n] & (across[n] != 0.0));
    let t: [f64; N] = std::array::from_fn(|n| {
        let theta = (m[q][q][n] - m[p][p][n]) / (2.0 * across[n]);
        1.0_f64.copysign(theta) / (theta.abs() + (theta * theta + 1.0).sqrt())
    });
    let c: [f64; N] = std::array::from_fn(|n| 1.0 / (t[n] * t[n] + 1.0).sqrt());
    let s: [f64; N] = std::array::from_fn(|n| t[n] * c[n]);
    let set = |place: &mut [f64; N], value: [f64; N]| {
        *place = std::array::from_fn(|n| if turns[n] { value[n] } else { place[n] });
    };
    let turned = |x: [f64; N], y: [f64; N]| -> [[f64; N]; 2] {
        [
            std::array::from_fn(|n| c[n] * x[n] - s[n] * y[n]),
            std::array::from_fn(|n| s[n] * x[n] + c[n] * y[n]),
        ]
    };
    let (pp, qq) = (m[p][p], m[q][q]);
    set(&mut m[p][p], std::array::from_fn(|n| pp[n] - t[n] * across[n]));
    set(&mut m[q][q], std::array::from_fn(|n| qq[n] + t[n] * across[n]));
    set(&mut m[p][q], [0.0; N]);
    let (pr, qr) = ((p.min(r), p.max(r)), (q.min(r), q.max(r)));
    let [x, y] = turned(m[pr.0][pr.1], m[qr.0][qr.1]);
    set(&mut m[pr.0][pr.1], x);
    set(&mut m[qr.0][qr.1], y);
    for axis in [0, 1, 2] {
        let [x, y] = turned(vectors[p][axis], vectors[q][axis]);
        set(&mut vectors[p][axis], x);
        set(&mut vectors[q][axis], y);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Rng;
    use super::*;
    use proptest::prelude::*;

    fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }

    proptest! {
        #[test]
        fn eigenvector_is_one_and_the_least(seed in any::<u64>(), flatness in 0.0f64..1.0) {
            let mut rng = Rng::new(seed);
            let rows: [[f64; 3]; 3] = std::array::from_fn(|i| {
                std::array::from_fn(|_| rng.normal() * if i == 0 { flatness } else { 1.0 })
            });
            // A Gram matrix: symmetric, no negative eigenvalue.
            let m: [[f64; 3]; 3] = std::array::from_fn(|a| std::array::from_fn(|b| {
                (0..3).map(|r| rows[r][a] * rows[r][b]).sum()
            }));
            let v = least_eigenvector(m);
            let image = m.map(|row| dot(row, v));
            let value = dot(image, v);
            prop_assert!((dot(v, v) - 1.0).abs() < 1e-12);
            for a in 0..3 {
                prop_assert!((image[a] - value * v[a]).abs() < 1e-9, "not an eigenvector");
            }
            for _ in 0..20 {
                let w: [f64; 3] = std::array::from_fn(|_| rng.normal());
                prop_assert!(dot(m.map(|row| dot(row, w)), w) / dot(w, w) >= value - 1e-9, "not the least");
            }
        }
    }

    #[test]
    fn normals_of_a_sphere_point_along_the_radius() {
        let mut rng = Rng::new(2);
        let points: Vec<Point> = (0..4000)
            .map(|_| {
                let v: [f64; 3] = std::array::from_fn(|_| rng.normal());
                v.map(|c| (c / dot(v, v).sqrt()) as f32)
            })
            .collect();
        let normals = estimate_normals(&points, 16);
        for (p, n) in points.iter().zip(&normals) {
            assert!(dot(p.map(f64::from), n.map(f64::from)).abs() > 0.97, "{p:?} {n:?}");
            assert!(n.iter().copied().fold(0.0, |m: f32, c| if c.abs() > m.abs() { c } else { m }) > 0.0);
        }
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        assert_eq!(one.install(|| estimate_normals(&points, 16)), normals);
    }

    #[test]
    fn degenerate_neighbourhoods_give_unit_vectors() {
        let line: Vec<Point> = (0..9).map(|i| [i as f32, 2.0, 3.0]).collect();
        for normals in
            [estimate_normals(&line, 5), estimate_normals(&[[1.0; 3]; 4], 3), estimate_normals(&line, 0)]
        {
            for n in normals {
                assert!((dot(n.map(f64::from), n.map(f64::from)) - 1.0).abs() < 1e-6);
            }
        }
        assert!(estimate_normals(&line, 5).iter().all(|n| n[0].abs() < 1e-6));
        assert!(estimate_normals(&[], 5).is_empty());
    }
}
