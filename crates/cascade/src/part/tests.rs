use std::sync::Arc;

use super::*;
use crate::measured::Measured;
use crate::{Fake, Patchwise, Quality, Silent, Spread};
use densecloud_geometry::{KdTree, Rng, farthest_point_sampling};

fn runner() -> impl LevelRunner {
    Patchwise::new(Arc::new(Fake::new()))
}

/// Points of a wavy square, as even as farthest point sampling makes them.
fn square(n: usize, side: f64, seed: u64) -> Vec<Position> {
    let mut random = Rng::new(seed);
    let mut next = || side * random.f64();
    let many: Vec<Position> = (0..6 * n)
        .map(|_| {
            let (x, y) = (next(), next());
            [x, y, 0.2 * (0.5 * x).sin()]
        })
        .collect();
    let local: Vec<Point> = many.iter().map(|p| p.map(|c| c as f32)).collect();
    farthest_point_sampling(&local, n, 0).iter().map(|&i| many[i as usize]).collect()
}

/// A cloud cut into cells.
struct Cut {
    cloud: Vec<Position>,
    partition: Partition,
    whole: Whole,
    options: CascadeOptions,
    ratio: f64,
    /// How far a halo reaches.
    reach: f64,
}

impl Cut {
    fn new(cloud: Vec<Position>, cells: usize, ratio: f64, options: CascadeOptions) -> Self {
        let finite: Vec<Position> =
            cloud.iter().copied().filter(|p| p.iter().all(|c| c.is_finite())).collect();
        let mut bounds = [finite[0], finite[0]];
        for p in &finite {
            for a in 0..3 {
                bounds[0][a] = bounds[0][a].min(p[a]);
                bounds[1][a] = bounds[1][a].max(p[a]);
            }
        }
        let survey = Survey {
            bounds,
            finite: finite.len() as u64,
            sample: &finite.iter().step_by(8).copied().collect::<Vec<_>>(),
            places: &finite[..finite.len().min(2000)],
            ratio,
        };
        let whole = Whole::survey(&survey, &options, &runner(), &Silent).unwrap();
        let spacing = (bounds[1][0] - bounds[0][0]) / (finite.len() as f64).sqrt();
        let (partition, reach) = (Partition::cut(finite, cells), halo(&whole) * spacing);
        Self { cloud, partition, whole, options, ratio, reach }
    }

    fn positions(&self, cell: u32) -> Vec<Position> {
        let near = |p: &&Position| self.partition.distance(cell, **p) <= self.reach;
        self.cloud.iter().filter(near).copied().collect()
    }

    fn size(&self, cell: u32) -> u64 {
        let finite = self.cloud.iter().filter(|p| p.iter().all(|c| c.is_finite()));
        let own = finite.filter(|p| self.partition.cell_of(**p) == cell).count();
        (self.ratio * own as f64).round() as u64
    }

    fn made(&self, cell: u32) -> Result<UpsampledPart, CascadeError> {
        let positions = self.positions(cell);
        let Self { partition, whole, .. } = self;
        let part = Part { positions: &positions, partition, cell, whole, size: self.size(cell) };
        upsample_part(&part, &self.options, &runner(), &Silent)
    }

    fn cells(&self) -> impl Iterator<Item = u32> + use<> {
        0..self.partition.len() as u32
    }

    fn within<'a>(&'a self, cell: u32, positions: &'a [Position]) -> Within<'a> {
        let part =
            Part { positions, partition: &self.partition, cell, whole: &self.whole, size: self.size(cell) };
        let mut globals = self.whole.globals().clone();
        let together = Measured::of(&Input::of(&part, &globals).points);
        let handover = Handover::input(together, self.options.spread, &mut globals).unwrap();
        let input = (&handover.sites.points[..], handover.local.as_deref());
        Within::new(&part, &globals, self.ratio, part.size as usize, input)
    }
}

#[test]
fn every_cell_gives_exactly_its_points() {
    let options = CascadeOptions::default();
    let mut odd = square(1500, 20.0, 1);
    odd.extend(odd.clone().into_iter().step_by(7));
    odd.extend([[f64::NAN; 3], [3.0, 4.0, 30.0], [15.0, 4.0, -20.0], [f64::INFINITY, 0.0, 0.0]]);
    for (ratio, options) in [
        (1.0, options),
        (2.7, options),
        (4.0, CascadeOptions { polish: false, ..options }),
        (4.0, CascadeOptions { spread: Spread::Area, ..options }),
        (2.0, CascadeOptions { quality: Quality::Best, ..options }),
        (9.0, options),
    ] {
        let cut = Cut::new(odd.clone(), 5, ratio, options);
        let (mut duplicates, mut apart) = (0, 0);
        for cell in cut.cells() {
            let made = cut.made(cell).unwrap_or_else(|e| panic!("cell {cell} at {ratio}, {options:?}: {e}"));
            assert_eq!(made.positions.len() as u64, cut.size(cell), "cell {cell} at {ratio}");
            assert!(made.positions.as_flattened().iter().all(|c| c.is_finite()));
            (duplicates, apart) = (duplicates + made.duplicates, apart + made.apart);
        }
        assert_eq!((duplicates, apart), (1500_usize.div_ceil(7), 2), "at {ratio}");
    }
}

#[test]
fn without_a_polish_cells_have_points_enough_at_any_ratio() {
    let options = CascadeOptions { polish: false, ..CascadeOptions::default() };
    for (ratio, cells) in [(1.5, 4), (1.9, 4), (2.0, 12), (4.0, 4)] {
        let cut = Cut::new(square(800, 15.0, 8), cells, ratio, options);
        for cell in cut.cells() {
            let made = cut.made(cell).unwrap_or_else(|e| panic!("cell {cell} of {cells} at {ratio}: {e}"));
            assert_eq!(made.positions.len() as u64, cut.size(cell), "cell {cell} of {cells} at {ratio}");
        }
    }
}

#[test]
fn both_sides_of_a_border_choose_the_same_points_there() {
    // Among the points of a lattice many are equally near.
    let lattice = (0..4096).map(|i| [0.5 * f64::from(i % 64), 0.5 * f64::from(i / 64), 0.0]).collect();
    for cloud in [square(4000, 30.0, 2), lattice] {
        let cut = Cut::new(cloud, 6, 4.0, CascadeOptions::default());
        let positions: Vec<Vec<Position>> = cut.cells().map(|cell| cut.positions(cell)).collect();
        let withins: Vec<Within<'_>> =
            cut.cells().zip(&positions).map(|(cell, positions)| cut.within(cell, positions)).collect();
        let bits = |points: &[Point]| points.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
        let all: std::collections::HashSet<[u32; 3]> =
            withins.iter().flat_map(|within| bits(within.settled_inside())).collect();
        let (mut shared, mut strange) = (0, 0);
        for within in &withins {
            let settled = within.settled();
            for outside in bits(&settled[within.settled_inside().len()..]) {
                strange += usize::from(!all.contains(&outside));
                shared += 1;
            }
        }
        assert!(shared > 500 && strange == 0, "{strange} of {shared} beyond borders not chosen there");
    }
}

#[test]
fn a_border_is_not_to_be_found_in_the_result() {
    let side = 30.0;
    let cut = Cut::new(square(4000, side, 3), 6, 2.0, CascadeOptions::default());
    let made: Vec<Position> = cut.cells().flat_map(|cell| cut.made(cell).unwrap().positions).collect();
    let local: Vec<Point> = made.iter().map(|p| p.map(|c| c as f32)).collect();
    let tree = KdTree::new(&local);
    let spacing = side / (made.len() as f64).sqrt();
    let (mut near, mut far) = (Vec::new(), Vec::new());
    let mut found = Vec::new();
    for (p, at) in made.iter().zip(&local) {
        tree.nearest(*at, 9, &mut found);
        let lengths = [1, 8].map(|k| f64::from(found[k].distance_squared.sqrt()) / spacing);
        let rim = (0..2).map(|a| p[a].min(side - p[a])).fold(f64::INFINITY, f64::min);
        match cut.partition.border_distance(*p) / spacing {
            _ if rim < 4.0 * spacing => {}
            border if border < 2.0 => near.push(lengths),
            border if border > 6.0 => far.push(lengths),
            _ => {}
        }
    }
    assert!(near.len() > 500 && far.len() > 2000, "{} and {}", near.len(), far.len());
    for k in 0..2 {
        let mean = |of: &[[f64; 2]]| of.iter().map(|l| l[k]).sum::<f64>() / of.len() as f64;
        let spread = |of: &[[f64; 2]]| {
            let usual = mean(of);
            (of.iter().map(|l| (l[k] - usual).powi(2)).sum::<f64>() / of.len() as f64).sqrt()
        };
        assert!((mean(&near) - mean(&far)).abs() < spread(&far), "{} and {}", mean(&near), mean(&far));
        assert!(spread(&near) < 1.3 * spread(&far), "{} and {}", spread(&near), spread(&far));
    }
    let closest = |of: &[[f64; 2]]| of.iter().map(|l| l[0]).fold(f64::INFINITY, f64::min);
    assert!(closest(&near) > 0.6 * closest(&far), "{} and {}: a double row", closest(&near), closest(&far));
}

#[test]
fn gaps_between_scan_lines_are_closed_across_borders() {
    // Forty lines one apart, with ten points each to a gap.
    let mut random = Rng::new(7);
    let mut cloud = Vec::new();
    for line in 0..40 {
        let phase = random.f64();
        cloud.extend((0..400).map(|k| [0.1 * (f64::from(k) + phase), f64::from(line), 0.0]));
    }
    let cut = Cut::new(cloud, 4, 4.0, CascadeOptions::default());
    for cell in cut.cells() {
        let made = cut.made(cell).unwrap().positions;
        assert_eq!(made.len() as u64, cut.size(cell));
        let between = made.iter().filter(|p| (p[1] - p[1].round()).abs() > 0.4).count();
        let share = between as f64 / made.len() as f64;
        assert!((0.4..0.6).contains(&share), "{share} of cell {cell} between lines");
        assert!(made.iter().all(|p| cut.partition.distance(cell, *p) < 1e-3), "a point of another cell");
    }
}

#[test]
fn the_number_of_threads_changes_no_part() {
    let cut = Cut::new(square(1500, 20.0, 4), 4, 4.0, CascadeOptions::default());
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| cut.made(2).unwrap())
    };
    let made = on(1);
    assert_eq!(made, on(3));
    assert!(!made.rim.is_empty());
    assert!(made.rim.iter().all(|p| cut.partition.distance(2, *p) < 2.0));
}

#[test]
fn what_is_known_of_the_whole_can_be_handed_on() {
    let whole = Cut::new(square(1500, 20.0, 5), 2, 4.0, CascadeOptions::default()).whole;
    let bytes = whole.to_bytes();
    assert_eq!(Whole::from_bytes(&bytes), Ok(whole));
    for end in [0, 7, 8, 60, bytes.len() / 2, bytes.len() - 1] {
        assert_eq!(Whole::from_bytes(&bytes[..end]), Err(WholeError));
    }
    assert_eq!(Whole::from_bytes(&[bytes.as_slice(), &[0]].concat()), Err(WholeError));
    let mut odd = bytes.clone();
    odd[8..16].copy_from_slice(&f64::NAN.to_le_bytes());
    assert_eq!(Whole::from_bytes(&odd), Err(WholeError));
    odd = bytes;
    odd[0] = b'W';
    assert_eq!(Whole::from_bytes(&odd), Err(WholeError));
}

#[test]
fn a_part_that_cannot_be_worked_on_is_an_error() {
    let cut = Cut::new(square(1500, 20.0, 6), 2, 4.0, CascadeOptions::default());
    let positions = &cut.positions(0)[..5];
    let Cut { partition, whole, .. } = &cut;
    let part = Part { positions, partition, cell: 0, whole, size: 20 };
    let why = upsample_part(&part, &cut.options, &runner(), &Silent).unwrap_err();
    assert!(matches!(why, CascadeError::TooFewPoints { .. }), "{why}");
    // More than there are places for.
    let positions = cut.positions(0);
    let within = cut.within(0, &positions);
    assert!(within.suffices(within.unsettled()).is_ok());
    let why = within.suffices(within.unsettled() - 1).unwrap_err();
    assert!(why.to_string().contains("ask for fewer points"), "{why}");
}
