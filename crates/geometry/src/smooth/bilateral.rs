//! The bilateral filter on heights over the local plane.

use super::{Place, decay, lifted};
use crate::Neighbour;
use crate::plane::Plane;
use densecloud_cloud::Point;

/// Width of the weights by distance, in multiples of the neighbourhood's reach.
const ACROSS: f64 = 0.4;
/// Width of those by height, in multiples of the noise.
const ALONG: f64 = 2.0;

/// The middle of the neighbourhood at the weighted mean height of its points.
pub(super) fn mean(points: &[Point], near: &[Neighbour], place: &Place) -> Point {
    let plane = Plane::fit(points, near);
    let origin = points[near[0].index as usize];
    let reach = f64::from(near[near.len() - 1].distance_squared).sqrt();
    let (wide, high) = (2.0 * (ACROSS * reach).powi(2), 2.0 * (ALONG * f64::from(place.residual)).powi(2));
    let (mut sum, mut total) = (0.0, 0.0);
    for n in near {
        let height = plane.height(origin, points[n.index as usize]);
        let weight =
            decay(f64::from(n.distance_squared) / wide + height * height / high.max(f64::MIN_POSITIVE));
        sum += weight * height;
        total += weight;
    }
    lifted(origin, plane.normal, sum / total)
}
