//! Where the points of a result go, by the real model: to each region of an uneven cloud its share.

use std::f64::consts::TAU;

use densecloud::{Input, Options, Upsampler};
use densecloud_cloud::{Attribute, Cloud, Position, Values};
use densecloud_formats::Format;
use densecloud_geometry::Rng;

/// A cloud whose points have the number of their region.
#[derive(Default)]
struct Regions {
    positions: Vec<Position>,
    region: Vec<u8>,
}

impl Regions {
    fn add(&mut self, region: u8, points: impl IntoIterator<Item = Position>) {
        self.positions.extend(points);
        self.region.resize(self.positions.len(), region);
    }

    /// For each region, points at four times as many for each point before; and the result.
    fn times(self) -> (Vec<f64>, Vec<Position>) {
        let count = |regions: &[f64]| {
            let last = regions.iter().fold(0.0, |a: f64, b| a.max(*b)) as usize;
            (0..=last).map(|r| regions.iter().filter(|q| **q == r as f64).count() as f64).collect::<Vec<_>>()
        };
        let before = count(&self.region.iter().map(|r| f64::from(*r)).collect::<Vec<_>>());
        let attributes = vec![Attribute { name: "region".into(), values: Values::U8(self.region) }];
        let cloud = Cloud { positions: self.positions, attributes, ..Cloud::default() };
        let options = Options::parse(&[("ratio", "4")]).expect("options");
        let upsampler = Upsampler::new().expect("a model");
        let dense = upsampler.upsample(Input { cloud, format: Format::TEXT }, options).expect("a result");
        let values = &dense.attributes[0].values;
        let after = count(&(0..values.len()).map(|i| values.get(i)).collect::<Vec<_>>());
        (after.iter().zip(before).map(|(after, before)| after / before).collect(), dense.positions)
    }
}

/// Random points of a torus about the z axis, by area.
fn torus(n: usize, radius: f64, thick: f64, at: Position, random: &mut Rng) -> Vec<Position> {
    let mut points = Vec::new();
    while points.len() < n {
        let (around, across) = (TAU * random.f64(), TAU * random.f64());
        let out = radius + thick * across.cos();
        if random.f64() * (radius + thick) < out {
            points.push([
                at[0] + out * around.cos(),
                at[1] + out * around.sin(),
                at[2] + thick * across.sin(),
            ]);
        }
    }
    points
}

#[test]
fn a_part_that_is_ten_times_as_large_takes_nothing_from_the_small_one() {
    let (mut regions, mut random) = (Regions::default(), Rng::new(1));
    regions.add(0, torus(800, 10.0, 3.0, [0.0; 3], &mut random));
    regions.add(1, torus(800, 1.0, 0.3, [30.0, 0.0, 0.0], &mut random));
    let (times, _) = regions.times();
    assert!(times.iter().all(|t| (3.5..4.5).contains(t)), "{times:?} times the points");
}

#[test]
fn what_is_near_a_street_scanner_becomes_as_much_denser_as_what_is_far() {
    let (mut regions, mut random) = (Regions::default(), Rng::new(2));
    let mut noise = |p: Position| p.map(|c| c + 0.004 * random.normal());
    let turn = |k: u32| TAU * f64::from(k) / 360.0;
    // Rings on the ground by beams that look down, ever further apart, two walls, and a box on the ground.
    let ground = |k: u32, beam: u32| {
        let out = 1.7 / (0.02 + 0.02 * f64::from(beam)).tan();
        [out * turn(k).cos(), out * turn(k).sin(), -1.7]
    };
    regions.add(0, (0..14).flat_map(|beam| (0..180).map(move |k| ground(2 * k, beam))).map(&mut noise));
    let wall = |side: f64, k: u32, beam: u32| [0.4 * f64::from(k) - 20.0, side, 0.7 * f64::from(beam)];
    for side in [-18.0, 18.0] {
        regions.add(1, (0..8).flat_map(|beam| (0..100).map(move |k| wall(side, k, beam))).map(&mut noise));
    }
    let face = |k: u32, row: u32| [10.0, 0.06 * f64::from(k) - 0.9, 0.15 * f64::from(row) - 1.6];
    regions.add(2, (0..8).flat_map(|row| (0..30).map(move |k| face(k, row))).map(&mut noise));
    let (times, _) = regions.times();
    assert!(
        times.iter().all(|t| (3.2..5.0).contains(t)),
        "{times:?} times the points on ground, walls and box"
    );
}

#[test]
fn a_floor_stays_flat() {
    let (mut regions, mut random) = (Regions::default(), Rng::new(3));
    regions.add(0, (0..1600).map(|_| [40.0 * random.f64(), 40.0 * random.f64(), 0.0]));
    let (_, dense) = regions.times();
    let worst = dense.iter().map(|p| p[2].abs()).fold(0.0, f64::max);
    assert!(worst < 0.01, "{worst} spacings off a floor whose points are not");
}
