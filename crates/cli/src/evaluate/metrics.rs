//! The scores of one dense cloud.

use rayon::prelude::*;
use serde::Serialize;

use super::nearest::Nearest;
use super::sphere::Sphere;
use densecloud_cloud::{Frame, FrameError, Position};
use densecloud_geometry::SurfaceDistance;

/// Default tolerance of the F-score, in radii of the reference.
pub const DEFAULT_TOLERANCE: f64 = 0.01;

/// Both blocks of scores of one cloud. Raw values: tables print them times 1000.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Scores {
    /// As in the field's tables.
    pub published: Published,
    /// The block that cannot be gamed.
    pub corrected: Corrected,
}

/// The scores of the evaluator that the field's tables come from. Each cloud is first centred and
/// scaled by **its own** centroid and largest distance to it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Published {
    /// CD: mean squared nearest distance, prediction to reference plus reference to prediction.
    pub chamfer: f64,
    /// HD: largest squared nearest distance, prediction to reference plus reference to prediction.
    pub hausdorff: f64,
    /// P2F: mean distance (not squared) of predicted points to the mesh, in the mesh's own units.
    /// None without a mesh.
    pub point_to_face: Option<f64>,
}

/// Scores with one normalisation: the reference's centroid and largest distance, for both clouds and
/// the mesh. All lengths are in that radius, and not squared unless said.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Corrected {
    /// Mean *squared* nearest distance, the sum of both ways.
    pub chamfer: f64,
    /// The Hausdorff distance: the largest nearest distance, either way.
    pub hausdorff: f64,
    /// The larger of both ways' 95th percentiles of nearest distances.
    pub hausdorff_95: f64,
    /// Mean distance from predicted points to the mesh. None without a mesh.
    pub to_surface: Option<f64>,
    /// Mean distance from the surface to the nearest predicted point. The reference stands for the
    /// surface, so it has to be dense.
    pub from_surface: f64,
    /// F-score at the tolerance: the harmonic mean of the share of predicted points within it of the
    /// reference, and of reference points within it of the prediction.
    pub f_score: f64,
    /// Standard deviation over mean of the distance from each predicted point to its nearest other
    /// one: 0 on a lattice, 0.52 for random points on a plane. Infinite (in JSON: null) when every
    /// point has a duplicate, the limit of ever fewer points that have none; 0 would praise repetition.
    pub spacing_variation: f64,
}

/// Why a cloud cannot be scored.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum MetricError {
    /// The predicted cloud has no extent.
    #[error("the prediction: {0}")]
    Prediction(FrameError),
    /// The reference cloud has no extent.
    #[error("the reference: {0}")]
    Reference(FrameError),
    /// The tolerance is not above zero.
    #[error("the tolerance {0} is not above zero")]
    Tolerance(f64),
}

/// Scores `prediction` against `reference` and, if given, the mesh behind `surface`. About
/// O((n + m) log(n + m)), in parallel; the same to the last bit on any number of threads.
/// `tolerance`, for the F-score, is in radii of the reference.
///
/// # Errors
/// A cloud is empty, not finite or a single spot, or the tolerance is not above zero.
///
/// ```
/// use densecloud_cli::{DEFAULT_TOLERANCE, score};
///
/// let square = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0]];
/// let same = score(&square, &square, None, DEFAULT_TOLERANCE)?;
/// assert_eq!((same.published.chamfer, same.corrected.f_score), (0.0, 1.0));
/// # Ok::<(), densecloud_cli::MetricError>(())
/// ```
pub fn score(
    prediction: &[Position],
    reference: &[Position],
    surface: Option<&SurfaceDistance>,
    tolerance: f64,
) -> Result<Scores, MetricError> {
    if tolerance.is_nan() || tolerance <= 0.0 {
        return Err(MetricError::Tolerance(tolerance));
    }
    let own = sphere(prediction).map_err(MetricError::Prediction)?;
    let shared = sphere(reference).map_err(MetricError::Reference)?;
    // Mean distance to the mesh, in the mesh's units.
    let to_mesh = surface.map(|surface| {
        let distances: Vec<f64> = prediction.par_iter().map(|p| surface.distance(*p)).collect();
        mean(&distances)
    });

    let reference = shared.normalise(reference);
    let reference_index = Nearest::new(&reference).map_err(MetricError::Reference)?;
    let by_own = Directed::between(&own.normalise(prediction), &reference, &reference_index)?;
    let published =
        Published { chamfer: by_own.chamfer(), hausdorff: by_own.largest_squared(), point_to_face: to_mesh };
    let by_shared = Directed::between(&shared.normalise(prediction), &reference, &reference_index)?;
    let corrected = Corrected {
        chamfer: by_shared.chamfer(),
        hausdorff: by_shared.percentile(1.0),
        hausdorff_95: by_shared.percentile(0.95),
        to_surface: to_mesh.map(|d| d / shared.radius),
        from_surface: mean(&by_shared.back),
        f_score: by_shared.f_score(tolerance),
        spacing_variation: variation(&by_shared.spacings),
    };
    Ok(Scores { published, corrected })
}

/// Nearest distances in both directions, in the order of the clouds.
struct Directed {
    /// Prediction to reference.
    forth: Vec<f64>,
    /// Reference to prediction.
    back: Vec<f64>,
    /// Prediction to its nearest other point.
    spacings: Vec<f64>,
}

impl Directed {
    fn between(
        prediction: &[Position],
        reference: &[Position],
        reference_index: &Nearest,
    ) -> Result<Self, MetricError> {
        let index = Nearest::new(prediction).map_err(MetricError::Prediction)?;
        Ok(Self {
            forth: reference_index.distances(prediction),
            back: index.distances(reference),
            spacings: index.spacings(),
        })
    }

    fn both(&self) -> [&[f64]; 2] {
        [&self.forth, &self.back]
    }

    /// Sum of the mean squares.
    fn chamfer(&self) -> f64 {
        self.both().map(|d| d.iter().map(|d| d * d).sum::<f64>() / d.len() as f64).iter().sum()
    }

    /// Sum of the largest squares.
    fn largest_squared(&self) -> f64 {
        self.both().map(|d| d.iter().fold(0.0, |m: f64, d| m.max(d * d))).iter().sum()
    }

    /// The larger of the two percentiles: the smallest value that a share of at least `q` of the
    /// distances does not exceed.
    fn percentile(&self, q: f64) -> f64 {
        let one = |distances: &[f64]| {
            let mut sorted = distances.to_vec();
            sorted.sort_unstable_by(f64::total_cmp);
            let rank = (q * sorted.len() as f64).ceil() as usize;
            sorted[rank.clamp(1, sorted.len()) - 1]
        };
        one(&self.forth).max(one(&self.back))
    }

    fn f_score(&self, tolerance: f64) -> f64 {
        let [precision, recall] =
            self.both().map(|d| d.iter().filter(|d| **d <= tolerance).count() as f64 / d.len() as f64);
        if precision + recall == 0.0 { 0.0 } else { 2.0 * precision * recall / (precision + recall) }
    }
}

/// The cloud's sphere, or the reason why it has none.
fn sphere(positions: &[Position]) -> Result<Sphere, FrameError> {
    Frame::fit(positions)?;
    Sphere::around(positions).ok_or(FrameError::TooLarge)
}

/// Of at least one value: clouds without points are refused before.
fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard deviation (of the population) over mean; infinite when all are 0.
fn variation(values: &[f64]) -> f64 {
    let mean = mean(values);
    if mean == 0.0 {
        return f64::INFINITY;
    }
    let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len() as f64;
    variance.sqrt() / mean
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_geometry::Mesh;

    fn close(a: f64, b: f64) {
        assert!((a - b).abs() <= 1e-12 * b.abs().max(1.0), "{a} where {b} was expected");
    }

    /// Four points at distance 1 (or `r`) from `centre`, in the plane z = centre[2].
    fn cross(centre: Position, r: f64) -> Vec<Position> {
        let [x, y, z] = centre;
        vec![[x + r, y, z], [x - r, y, z], [x, y + r, z], [x, y - r, z]]
    }

    #[test]
    fn published_scores_of_a_case_by_hand() {
        // Prediction: a cross. Reference: a cross and its centre. Both have centroid 0 and radius 1.
        // Forth: 0 each. Back: 0 four times, 1 for the centre. CD = 0 + 1/5, HD = 0 + 1.
        let prediction = cross([0.0; 3], 1.0);
        let reference = [cross([0.0; 3], 1.0), vec![[0.0; 3]]].concat();
        let scores = score(&prediction, &reference, None, 0.5).expect("scores").published;
        close(scores.chamfer, 0.2);
        close(scores.hausdorff, 1.0);
        assert_eq!(scores.point_to_face, None);
        // The other way round: the same sum, since both directions are added.
        let scores = score(&reference, &prediction, None, 0.5).expect("scores").published;
        close(scores.chamfer, 0.2);
        close(scores.hausdorff, 1.0);
    }

    #[test]
    fn directed_maxima_are_squared_and_added() {
        // On a line, both with centroid 0 and radius 1: prediction -1 -0.5 0 0.5 1 against reference
        // -1 0 1 (with weights that keep the centroid). Forth: 0 0.5 0 0.5 0. Back: 0 0 0.
        let line = |xs: &[f64]| xs.iter().map(|x| [*x, 0.0, 0.0]).collect::<Vec<_>>();
        let scores =
            score(&line(&[-1.0, -0.5, 0.0, 0.5, 1.0]), &line(&[-1.0, 0.0, 1.0]), None, 0.5).expect("scores");
        close(scores.published.chamfer, 2.0 * 0.25 / 5.0);
        close(scores.published.hausdorff, 0.25);
        // Prediction -1 0 1, reference -1 -0.3 0.3 1: forth 0 0.3 0, back 0 0.3 0.3 0.
        let scores =
            score(&line(&[-1.0, 0.0, 1.0]), &line(&[-1.0, -0.3, 0.3, 1.0]), None, 0.3).expect("scores");
        close(scores.published.chamfer, 0.09 / 3.0 + 2.0 * 0.09 / 4.0);
        close(scores.published.hausdorff, 0.09 + 0.09);
        close(scores.corrected.hausdorff, 0.3);
        close(scores.corrected.from_surface, 0.15);
    }

    #[test]
    fn only_the_corrected_block_sees_scale_and_place() {
        // The same cross, twice as large and moved: by its own sphere it is the reference.
        let scores =
            score(&cross([5.0, 0.0, 0.0], 4.0), &cross([5.0, 0.0, 0.0], 2.0), None, 0.01).expect("scores");
        close(scores.published.chamfer, 0.0);
        close(scores.published.hausdorff, 0.0);
        // In radii of the reference, every point is 1 away, each way.
        close(scores.corrected.chamfer, 2.0);
        close(scores.corrected.hausdorff, 1.0);
        close(scores.corrected.hausdorff_95, 1.0);
        close(scores.corrected.from_surface, 1.0);
        close(scores.corrected.f_score, 0.0);
        close(scores.corrected.spacing_variation, 0.0);
    }

    #[test]
    fn distances_to_the_mesh_are_in_its_units_and_in_radii() {
        // A large square in the plane z = 0; a cross of radius 2 half a unit above it.
        let mesh = Mesh {
            vertices: vec![[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [9.0, 9.0, 0.0], [-9.0, 9.0, 0.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let surface = SurfaceDistance::new(&mesh);
        let scores =
            score(&cross([0.0, 0.0, 0.5], 2.0), &cross([0.0; 3], 2.0), Some(&surface), 0.3).expect("scores");
        close(scores.published.point_to_face.expect("a mesh"), 0.5);
        close(scores.corrected.to_surface.expect("a mesh"), 0.25);
        close(scores.published.chamfer, 0.0);
        close(scores.corrected.chamfer, 2.0 * 0.0625);
        close(scores.corrected.f_score, 1.0);
    }

    #[test]
    fn percentile_f_score_and_variation_of_cases_by_hand() {
        let directed = Directed {
            forth: (1..=20).map(f64::from).collect(),
            back: vec![1.0, 2.0, 30.0, 40.0],
            spacings: vec![],
        };
        // 95 % of 20 values are 19 of them, of 4 values all.
        close(Directed { back: vec![0.0], ..directed }.percentile(0.95), 19.0);
        let directed = Directed { forth: vec![1.0, 2.0], back: vec![1.0, 2.0, 30.0, 40.0], spacings: vec![] };
        close(directed.percentile(0.95), 40.0);
        close(directed.percentile(1.0), 40.0);
        // Precision 1, recall 1/2.
        close(directed.f_score(2.0), 2.0 / 3.0);
        close(directed.f_score(0.5), 0.0);
        // Mean 2, deviations -1 and 1.
        close(variation(&[1.0, 3.0]), 0.5);
        close(variation(&[0.0, 0.0, 0.0, 4.0]), 3.0_f64.sqrt());
        assert_eq!(variation(&[0.0, 0.0]), f64::INFINITY);
    }

    #[test]
    fn clouds_without_extent_are_refused() {
        let good = cross([0.0; 3], 1.0);
        for bad in [vec![], vec![[1.0; 3]; 4], vec![[f64::NAN; 3], [0.0; 3]]] {
            assert!(matches!(score(&bad, &good, None, 0.1), Err(MetricError::Prediction(_))));
            assert!(matches!(score(&good, &bad, None, 0.1), Err(MetricError::Reference(_))));
        }
        for tolerance in [0.0, -1.0, f64::NAN] {
            assert!(matches!(score(&good, &good, None, tolerance), Err(MetricError::Tolerance(_))));
        }
    }
}
