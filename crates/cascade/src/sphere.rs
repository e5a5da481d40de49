//! The frame in which a unit sees a patch.

use densecloud_cloud::Point;

/// The unit sphere of a patch: its centroid and the largest distance to it.
#[derive(Debug, Clone, Copy)]
pub struct Sphere {
    centre: [f64; 3],
    radius: f64,
}

impl Sphere {
    /// Fits the sphere to the points of a patch.
    #[must_use]
    pub fn around(points: impl Iterator<Item = Point> + Clone) -> Self {
        let mut centre = [0.0; 3];
        let mut count = 0.0;
        for p in points.clone() {
            count += 1.0;
            for a in 0..3 {
                centre[a] += f64::from(p[a]);
            }
        }
        centre = centre.map(|c| c / count);
        let squared = |p: Point| (0..3).map(|a| (f64::from(p[a]) - centre[a]).powi(2)).sum::<f64>();
        let radius = points.map(squared).fold(0.0, f64::max).sqrt();
        // Points that all coincide have no radius; any other value leaves them where they are.
        Self { centre, radius: if radius > 0.0 { radius } else { 1.0 } }
    }

    /// A point of the cloud in the patch's frame, at most 1 from its origin.
    #[must_use]
    pub fn normalise(&self, p: Point) -> Point {
        std::array::from_fn(|a| ((f64::from(p[a]) - self.centre[a]) / self.radius) as f32)
    }

    /// A point of the patch's frame in the cloud's.
    #[must_use]
    pub fn restore(&self, p: Point) -> Point {
        std::array::from_fn(|a| (f64::from(p[a]) * self.radius + self.centre[a]) as f32)
    }
}
