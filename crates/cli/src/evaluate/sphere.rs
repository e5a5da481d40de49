//! The normalisation of the field's metrics.

use densecloud_cloud::Position;

/// A cloud's centroid and its largest distance to it: what maps the cloud into the unit sphere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Sphere {
    /// The mean of the points.
    pub(crate) centroid: Position,
    /// The largest distance of a point to the centroid, in the cloud's units.
    pub(crate) radius: f64,
}

impl Sphere {
    /// The sphere of a cloud; `None` if that is empty, not finite, or a single spot. O(n).
    #[must_use]
    pub(crate) fn around(positions: &[Position]) -> Option<Self> {
        let mut centroid = [0.0; 3];
        for p in positions {
            for a in 0..3 {
                centroid[a] += p[a] / positions.len() as f64;
            }
        }
        let radius = positions.iter().map(|p| distance(*p, centroid)).fold(0.0, f64::max);
        let usable = radius > 0.0 && radius.is_finite() && centroid.iter().all(|c| c.is_finite());
        usable.then_some(Self { centroid, radius })
    }

    /// Maps positions so that the centroid becomes the origin and the radius 1.
    #[must_use]
    pub(crate) fn normalise(&self, positions: &[Position]) -> Vec<Position> {
        let map = |p: &Position| std::array::from_fn(|a| (p[a] - self.centroid[a]) / self.radius);
        positions.iter().map(map).collect()
    }
}

/// Euclidean distance.
pub(super) fn distance(a: Position, b: Position) -> f64 {
    let d: Position = std::array::from_fn(|i| a[i] - b[i]);
    d.iter().map(|c| c * c).sum::<f64>().sqrt()
}
