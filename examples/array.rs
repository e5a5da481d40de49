//! Positions in memory in, positions out, with a value a point: for a program that has its points already.
//!
//! ```sh
//! cargo run --release --example array
//! ```

use std::error::Error;

use densecloud::cloud::{Attribute, Cloud, Values};
use densecloud::{Dense, Options, Upsampler};

fn main() -> Result<(), Box<dyn Error>> {
    let dense = upsample(30)?;
    println!("{} points; the first lies at {:?}", dense.positions.len(), dense.positions[0]);
    Ok(())
}

/// A wavy sheet of `side` x `side` points, three times as dense.
pub(crate) fn upsample(side: u32) -> Result<Dense, Box<dyn Error>> {
    let at = |i: u32| f64::from(i) / f64::from(side);
    let positions: Vec<[f64; 3]> = (0..side * side)
        .map(|i| (at(i % side), at(i / side)))
        .map(|(x, y)| [x, y, 0.1 * (6.0 * x).sin() * (5.0 * y).cos()])
        .collect();
    let heights = positions.iter().map(|[_, _, z]| *z as f32).collect();
    let attributes = vec![Attribute { name: "height".into(), values: Values::F32(heights) }];
    let cloud = Cloud { attributes, ..Cloud::from(positions) };
    Ok(Upsampler::new()?.upsample(cloud, Options::parse(&[("ratio", "3")])?)?)
}
