//! Projection onto a moving least squares surface.

use pulp::Arch;
use rayon::prelude::*;

use super::normals::least_eigenvectors_of_four;
use super::{KdTree, Neighbour, Walk};
use densecloud_cloud::Point;

/// Points that a local surface is fitted to.
const NEIGHBOURS: usize = 24;
/// Width of the Gaussian weights, in multiples of the distance to the farthest of them.
const WIDTH: f32 = 0.6;
/// Weight of the penalty on curvature: keeps fits to few or badly spread points from bending.
const RIDGE: f64 = 0.01;
/// A point never moves further than this share of that distance.
const FARTHEST: f64 = 0.3;
/// Root mean square residual, in the same unit, from which a fit says nothing about a surface: two
/// sheets one spacing apart leave about 0.18, the noise of a cascade's outputs about 0.03.
const POOR: f64 = 0.1;
/// Terms of a quadratic height field over the tangent plane: 1, a, b, a^2, ab, b^2.
pub(super) const TERMS: usize = 6;
/// Queries a task: enough to hide what a task costs.
const CHUNK: usize = 256;

/// Moves each of `points` along the local normal to the surface that `support` suggests there.
///
/// The surface is the moving least squares one (Alexa et al., "Point set surfaces", 2001): for
/// each query the plane of its 24 nearest support points, and a quadratic height field over it,
/// both with Gaussian weights. A point moves less the worse the fit is, and not at all where the
/// points lie on no one surface (two sheets close together, a tuft of leaves).
///
/// `tree` must be built from `support`. About 2 microseconds a point and core; the result does not
/// depend on the number of threads.
pub fn project_to_surface(points: &mut [Point], support: &[Point], tree: &KdTree) {
    let arch = Arch::new();
    points.par_chunks_mut(CHUNK).for_each_init(Walk::default, |walk, chunk| {
        // Compiled for the processor's own vectors: the sums over neighbours are half of the time.
        arch.dispatch(|| {
            for points in chunk.chunks_mut(4) {
                let mut around = [const { Around::NONE }; 4];
                for (around, point) in around.iter_mut().zip(&*points) {
                    tree.nearest_next(*point, NEIGHBOURS, walk);
                    *around = Around::of(*point, support, &walk.found);
                }
                let normals = least_eigenvectors_of_four(around.each_ref().map(Around::covariance));
                for ((point, around), normal) in points.iter_mut().zip(&around).zip(normals) {
                    *point = around.foot(*point, normal);
                }
            }
        });
    });
}

/// One value for each neighbour.
type Each = [f32; NEIGHBOURS];
/// Sums are made of this many partial ones: as many as most processors' vectors hold.
const LANES: usize = 8;

/// The neighbours of a point in its frame, in units of their reach, with their weights; places that are left over weigh
/// nothing.
struct Around {
    /// 0 where they define no surface.
    reach: f32,
    local: [Each; 3],
    weights: Each,
    total: f32,
}

impl Around {
    const NONE: Self =
        Self { reach: 0.0, local: [[0.0; NEIGHBOURS]; 3], weights: [0.0; NEIGHBOURS], total: 0.0 };

    #[inline(always)]
    fn of(point: Point, support: &[Point], near: &[Neighbour]) -> Self {
        let reach = near.last().map_or(0.0, |n| n.distance_squared).sqrt();
        if near.len() < 2 * TERMS || reach == 0.0 {
            return Self::NONE;
        }
        let mut local = [[0.0; NEIGHBOURS]; 3];
        let mut weights = [0.0; NEIGHBOURS];
        for (i, n) in near.iter().enumerate() {
            let q = support[n.index as usize];
            for a in 0..3 {
                local[a][i] = (q[a] - point[a]) / reach;
            }
            weights[i] = n.distance_squared;
        }
        let narrow = -1.0 / (WIDTH * reach).powi(2);
        for w in &mut weights[..near.len()] {
            *w = exponential(*w * narrow);
        }
        Self { reach, local, weights, total: sum(&weights) }
    }

    #[inline(always)]
    fn covariance(&self) -> [[f64; 3]; 3] {
        if self.reach == 0.0 { [[0.0; 3]; 3] } else { covariance(&self.local, &self.weights, self.total) }
    }

    /// Where `point` lands by its `normal`; where it is if its neighbours define no surface.
    #[inline(always)]
    fn foot(&self, point: Point, normal: [f64; 3]) -> Point {
        if self.reach == 0.0 {
            return point;
        }
        let Self { reach, ref local, ref weights, total } = *self;
        let (u, v) = tangents(normal);
        let (a, b, height) = (along(local, u), along(local, v), along(local, normal));
        let terms = [[1.0; NEIGHBOURS], a, b, product(&a, &a), product(&a, &b), product(&b, &b)];
        let weighted_height = product(weights, &height);
        let squares = inner(&weighted_height, &height);
        let (mut matrix, mut right) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
        for i in 0..TERMS {
            let weighted = product(weights, &terms[i]);
            right[i] = inner(&weighted, &height);
            for j in 0..=i {
                matrix[i][j] = inner(&weighted, &terms[j]);
            }
        }
        let scale = (0..TERMS).map(|i| matrix[i][i]).sum::<f64>() / TERMS as f64;
        for (i, row) in matrix.iter_mut().enumerate() {
            row[i] += 1e-6 * scale;
        }
        // Half for the mixed term, so that the penalty does not depend on how u and v lie.
        for (i, share) in [(3, 1.0), (4, 0.5), (5, 1.0)] {
            matrix[i][i] += RIDGE * scale * share;
        }
        let Some(fit) = solve(matrix, right) else { return point };
        let explained: f64 = fit.iter().zip(right).map(|(x, y)| x * y).sum();
        let residual = ((squares - explained) / f64::from(total)).max(0.0);
        let trust = (1.0 - residual / (POOR * POOR)).max(0.0);
        let moved = (trust * fit[0]).clamp(-FARTHEST, FARTHEST) * f64::from(reach);
        std::array::from_fn(|a| (f64::from(point[a]) + moved * normal[a]) as f32)
    }
}

/// e^x for x from -3 to 0, to 5e-5: its Taylor polynomial at x / 8, to the eighth.
#[inline(always)]
fn exponential(x: f32) -> f32 {
    let y = x / 8.0;
    let root = 1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y / 120.0))));
    root.powi(8)
}

#[inline(always)]
fn sum(values: &Each) -> f32 {
    let mut sums = [0.0; LANES];
    for values in values.as_chunks::<LANES>().0 {
        for (s, v) in sums.iter_mut().zip(values) {
            *s += v;
        }
    }
    let halves: [f32; 4] = std::array::from_fn(|i| sums[i] + sums[i + 4]);
    (halves[0] + halves[2]) + (halves[1] + halves[3])
}

#[inline(always)]
fn product(a: &Each, b: &Each) -> Each {
    std::array::from_fn(|i| a[i] * b[i])
}

#[inline(always)]
fn inner(a: &Each, b: &Each) -> f64 {
    f64::from(sum(&product(a, b)))
}

/// The coordinate of each neighbour along a unit vector.
#[inline(always)]
fn along(local: &[Each; 3], axis: [f64; 3]) -> Each {
    let [x, y, z] = axis.map(|c| c as f32);
    std::array::from_fn(|i| local[0][i] * x + local[1][i] * y + local[2][i] * z)
}

/// The weighted covariance (upper triangle) of points whose weights sum to `total`.
#[inline(always)]
fn covariance(local: &[Each; 3], weights: &Each, total: f32) -> [[f64; 3]; 3] {
    let centred = local.each_ref().map(|axis| {
        let mean = sum(&product(weights, axis)) / total;
        axis.map(|value| value - mean)
    });
    let mut covariance = [[0.0; 3]; 3];
    for a in 0..3 {
        let weighted = product(weights, &centred[a]);
        for b in a..3 {
            covariance[a][b] = inner(&weighted, &centred[b]);
        }
    }
    covariance
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Two unit vectors across a unit normal and each other.
pub(super) fn tangents(n: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let least = (1..3).fold(0, |best, a| if n[a].abs() < n[best].abs() { a } else { best });
    let mut axis = [0.0; 3];
    axis[least] = 1.0;
    let u = cross(n, axis);
    let length = dot(u, u).sqrt();
    let u = u.map(|c| c / length);
    (u, cross(n, u))
}

/// Solves `m x = y` for a symmetric positive definite `m` (lower triangle read) by Cholesky's
/// factors; none when it is not positive definite.
pub(super) fn solve(mut m: [[f64; TERMS]; TERMS], mut y: [f64; TERMS]) -> Option<[f64; TERMS]> {
    for i in 0..TERMS {
        for j in 0..=i {
            let rest = m[i][j] - (0..j).map(|k| m[i][k] * m[j][k]).sum::<f64>();
            if j < i {
                m[i][j] = rest / m[j][j];
            } else if rest > 0.0 {
                m[i][i] = rest.sqrt();
            } else {
                return None;
            }
        }
        y[i] = (y[i] - (0..i).map(|k| m[i][k] * y[k]).sum::<f64>()) / m[i][i];
    }
    for i in (0..TERMS).rev() {
        y[i] = (y[i] - (i + 1..TERMS).map(|k| m[k][i] * y[k]).sum::<f64>()) / m[i][i];
    }
    Some(y)
}

#[cfg(test)]
mod tests {
    use super::super::Rng;
    use super::*;
    use proptest::prelude::*;

    fn project(points: &[Point], support: &[Point]) -> Vec<Point> {
        let mut moved = points.to_vec();
        project_to_surface(&mut moved, support, &KdTree::new(support));
        moved
    }

    fn square(n: u64, height: impl Fn(f64, f64) -> f64) -> Vec<Point> {
        let mut random = Rng::new(3);
        (0..n)
            .map(|_| {
                let (x, y) = (random.f64(), random.f64());
                [x, y, height(x, y)].map(|c| c as f32)
            })
            .collect()
    }

    proptest! {
        #[test]
        fn a_system_is_solved(seed in any::<u64>()) {
            let mut random = Rng::new(seed);
            let rows: [[f64; TERMS]; 8] = std::array::from_fn(|_| std::array::from_fn(|_| random.normal()));
            let m = std::array::from_fn(|i| std::array::from_fn(|j| rows.iter().map(|r| r[i] * r[j]).sum()));
            let wanted: [f64; TERMS] = std::array::from_fn(|_| random.normal());
            let y = std::array::from_fn(|i| (0..TERMS).map(|j| m[i][j] * wanted[j]).sum());
            let found = solve(m, y).unwrap();
            for (a, b) in found.iter().zip(wanted) {
                prop_assert!((a - b).abs() < 1e-5 * (1.0 + b.abs()), "{found:?} for {wanted:?}");
            }
        }
    }

    #[test]
    fn the_exponential_is_one() {
        for i in 0..=300 {
            let x = -0.01 * i as f32;
            assert!((exponential(x) / x.exp() - 1.0).abs() < 5e-5, "{x}");
        }
    }

    #[test]
    fn points_land_on_a_quadratic_surface() {
        let bowl = |x: f64, y: f64| 0.3 * x * x - 0.2 * x * y + 0.1 * y;
        let support = square(4000, bowl);
        let above: Vec<Point> = support.iter().map(|p| [p[0], p[1], p[2] + 0.01]).collect();
        let moved = project(&above, &support);
        let off: Vec<f64> =
            moved.iter().map(|p| (f64::from(p[2]) - bowl(f64::from(p[0]), f64::from(p[1]))).abs()).collect();
        // What is left is the penalty on curvature, and borders.
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        assert!(mean < 1e-3, "mean distance {mean}");
    }

    #[test]
    fn noise_is_halved_and_nothing_slides_along_the_surface() {
        let mut random = Rng::new(9);
        let noisy: Vec<Point> =
            square(4000, |_, _| 0.0).iter().map(|p| [p[0], p[1], 0.002 * random.normal() as f32]).collect();
        let moved = project(&noisy, &noisy);
        let size = |points: &[Point]| points.iter().map(|p| p[2].abs()).sum::<f32>() / points.len() as f32;
        assert!(size(&moved) < 0.6 * size(&noisy), "{} from {}", size(&moved), size(&noisy));
        for (a, b) in noisy.iter().zip(&moved) {
            assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 0.003, "{a:?} moved to {b:?}");
        }
    }

    #[test]
    fn two_sheets_are_not_drawn_together() {
        // A spacing of 0.016, and sheets that far apart.
        let mut support = square(4000, |_, _| 0.0);
        support.extend(square(4000, |_, _| 0.016));
        let moved = project(&support, &support);
        let between = moved.iter().filter(|p| (0.004..0.012).contains(&p[2])).count();
        assert!(between < 80, "{between} of 8000 points between the sheets");
    }

    #[test]
    fn too_few_or_equal_points_stay_where_they_are() {
        let few = square(11, |x, _| x * x);
        assert_eq!(project(&few, &few), few);
        let same = vec![[1.0, 2.0, 3.0]; 40];
        assert_eq!(project(&same, &same), same);
        let line: Vec<Point> = (0..40).map(|i| [i as f32, 0.0, 0.0]).collect();
        for (a, b) in line.iter().zip(project(&line, &line)) {
            assert!((0..3).all(|c| (a[c] - b[c]).abs() < 1e-3), "{a:?} moved to {b:?}");
        }
    }
}
