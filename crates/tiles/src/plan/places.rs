//! A few places of a cloud with all points that are there, for what only neighbours tell.

use densecloud_cloud::Position;
use densecloud_geometry::Partition;

/// Places of a cloud.
const PLACES: usize = 6;

/// Points that a place should have, and the most that it may.
const WANTED: f64 = 6000.0;
const MOST: usize = 24_000;

/// Fewer neighbours in a sample than this tell nothing of how large a place must be.
const ENOUGH: usize = 16;

/// Balls about points of a sample.
pub(super) struct Places(Vec<Place>);

struct Place {
    centre: Position,
    /// The square of the radius.
    square: f64,
    points: Vec<Position>,
}

impl Places {
    /// Chooses places by a sample of a cloud of so many points: each in the middle of as many points as the others. O(n log n).
    pub(super) fn choose(sample: &[Position], points: u64) -> Self {
        let coarse = Partition::cut(sample.to_vec(), PLACES);
        let mut cells: Vec<Vec<Position>> = vec![Vec::new(); coarse.len()];
        sample.iter().for_each(|p| cells[coarse.cell_of(*p) as usize].push(*p));
        let share = sample.len() as f64 / points.max(1) as f64;
        let place = |cell: Vec<Position>| {
            let mean: Position =
                std::array::from_fn(|a| cell.iter().map(|p| p[a] / cell.len() as f64).sum::<f64>());
            let centre = cell.into_iter().min_by(|p, q| square(*p, mean).total_cmp(&square(*q, mean)))?;
            Some(Place { centre, square: radius(sample, centre, share), points: Vec::new() })
        };
        Self(cells.into_iter().filter_map(place).collect())
    }

    /// Takes the points that lie there.
    pub(super) fn see(&mut self, positions: &[Position]) {
        for p in positions.iter().filter(|p| p.iter().all(|c| c.is_finite())) {
            let is_there = |place: &&mut Place| square(*p, place.centre) <= place.square;
            if let Some(place) = self.0.iter_mut().find(is_there) {
                place.points.push(*p);
                while place.points.len() > MOST && place.square > 0.0 {
                    place.square /= 2.0;
                    let Place { centre, square: most, points } = place;
                    points.retain(|p| square(*p, *centre) <= *most);
                }
                // Where very many coincide.
                place.points.truncate(MOST);
            }
        }
    }

    /// All points that are there.
    pub(super) fn positions(self) -> Vec<Position> {
        self.0.into_iter().flat_map(|place| place.points).collect()
    }
}

/// The square of the radius about a place that [`WANTED`] points of the whole lie in, where a sample has that share of them.
fn radius(sample: &[Position], centre: Position, share: f64) -> f64 {
    let mut squares: Vec<f64> = sample.iter().map(|p| square(*p, centre)).collect();
    let wanted = (WANTED * share).ceil();
    let nth = (wanted as usize).max(ENOUGH).min(squares.len()) - 1;
    let (_, square, _) = squares.select_nth_unstable_by(nth, f64::total_cmp);
    // Points lie on a surface.
    *square * (wanted / (nth + 1) as f64).min(1.0)
}

fn square(p: Position, q: Position) -> f64 {
    (0..3).map(|a| (p[a] - q[a]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_whole_and_far_from_each_other() {
        let grid: Vec<Position> =
            (0..250_000).map(|i| [f64::from(i % 500), f64::from(i / 500), 1.0]).collect();
        let sample: Vec<Position> = grid.iter().copied().step_by(23).collect();
        let mut places = Places::choose(&sample, 250_000);
        grid.chunks(1000).for_each(|block| places.see(block));
        assert_eq!(places.0.len(), PLACES);
        for place in &places.0 {
            assert!((4500..7500).contains(&place.points.len()), "{}", place.points.len());
            let all = grid.iter().filter(|p| square(**p, place.centre) <= place.square).count();
            assert_eq!(place.points.len(), all);
        }
        // A small cloud is all of it.
        let small = &grid[..3000];
        let mut places = Places::choose(small, 3000);
        places.see(small);
        assert_eq!(places.positions().len(), 3000);
    }

    #[test]
    fn a_place_that_is_fuller_than_it_seemed_shrinks() {
        let crowd: Vec<Position> =
            (0..200_000).map(|i| [f64::from(i % 447) / 447.0, f64::from(i / 447) / 447.0, 0.0]).collect();
        let far = vec![
            [0.0; 3],
            [100.0, 0.0, 0.0],
            [0.0, 100.0, 0.0],
            [100.0; 3],
            [50.0, 100.0, 7.0],
            [9.0, 8.0, 3.0],
        ];
        let mut places = Places::choose(&far, 6);
        places.see(&crowd);
        assert!(places.0.iter().all(|place| place.points.len() <= MOST));
        assert!(!places.positions().is_empty());
        let mut places = Places::choose(&far, 6);
        places.see(&vec![[0.0; 3]; 100_000]);
        assert!(places.positions().len() <= MOST);
    }
}
