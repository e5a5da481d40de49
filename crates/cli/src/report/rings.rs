//! How much denser each distance has become.

use densecloud::survey::Place;
use densecloud_cloud::Position;

/// Rings, each of which has as many of the input's measured points.
const RINGS: usize = 10;

/// Densities in rings about a place.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Rings {
    /// The place.
    pub(super) centre: Position,
    /// Whether a sensor stood there; it is the middle of the input otherwise.
    pub(super) is_sensor: bool,
    /// From the nearest to the furthest.
    pub(super) rings: Vec<Ring>,
}

/// What lies between two distances.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub(crate) struct Ring {
    /// From here, in the cloud's units.
    pub(super) near: f64,
    /// To here.
    pub(super) far: f64,
    /// Median of points a square unit in the input; none where it has no measured point.
    pub(super) input: Option<f64>,
    /// The same of the result.
    pub(super) output: Option<f64>,
}

impl Ring {
    /// How many times denser the result is.
    pub(super) fn ratio(&self) -> Option<f64> {
        Some(self.output? / self.input?)
    }
}

impl Rings {
    /// Of what was measured of both clouds.
    pub(super) fn of(
        sensor: Option<Position>,
        bounds: [Position; 2],
        input: &[Place],
        output: &[Place],
    ) -> Self {
        let middle: Position = std::array::from_fn(|a| f64::midpoint(bounds[0][a], bounds[1][a]));
        let centre = sensor.unwrap_or(middle);
        let (input, output) = (by_distance(centre, input), by_distance(centre, output));
        let mut edges: Vec<f64> =
            (0..=RINGS).filter_map(|i| Some(input.get(i * input.len().checked_sub(1)? / RINGS)?.0)).collect();
        edges.dedup();
        let ring = |edge: &[f64]| {
            let (near, far) = (edge[0], edge[1]);
            Ring { near, far, input: median(&input, near, far), output: median(&output, near, far) }
        };
        Self { centre, is_sensor: sensor.is_some(), rings: edges.windows(2).map(ring).collect() }
    }
}

/// Distances and densities, from the nearest to the furthest.
fn by_distance(centre: Position, places: &[Place]) -> Vec<(f64, f64)> {
    let distance = |p: Position| (0..3).map(|a| (p[a] - centre[a]).powi(2)).sum::<f64>().sqrt();
    let mut found: Vec<(f64, f64)> = places.iter().map(|p| (distance(p.at), p.density)).collect();
    found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    found
}

/// Of those from `near` to `far`.
fn median(places: &[(f64, f64)], near: f64, far: f64) -> Option<f64> {
    let from = places.partition_point(|p| p.0 < near);
    let to = places.partition_point(|p| p.0 <= far);
    let mut densities: Vec<f64> = places[from..to].iter().map(|p| p.1).collect();
    densities.sort_unstable_by(f64::total_cmp);
    densities.get(densities.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_ring_has_the_density_of_its_points() {
        let place = |x: f64, density: f64| Place { at: [x, 0.0, 0.0], spacing: 1.0, density };
        let input: Vec<Place> = (1..=100).map(|i| place(f64::from(i), 100.0 / f64::from(i))).collect();
        // Four times denser near the sensor, twice far away.
        let output: Vec<Place> = (1..=100)
            .map(|i| place(f64::from(i), 100.0 / f64::from(i) * if i <= 50 { 4.0 } else { 2.0 }))
            .collect();
        let rings = Rings::of(Some([0.0; 3]), [[0.0; 3]; 2], &input, &output);
        assert!(rings.is_sensor && rings.rings.len() == RINGS);
        assert_eq!((rings.rings[0].near, rings.rings[9].far), (1.0, 100.0));
        assert_eq!((rings.rings[0].ratio(), rings.rings[9].ratio()), (Some(4.0), Some(2.0)));
        // A result that lacks a side has no density there.
        let half = Rings::of(None, [[0.0; 3], [2.0, 0.0, 0.0]], &input, &output[..30]);
        assert_eq!((half.centre, half.is_sensor, half.rings[9].output), ([1.0, 0.0, 0.0], false, None));
        assert!(Rings::of(None, [[0.0; 3]; 2], &[], &output).rings.is_empty());
    }
}
