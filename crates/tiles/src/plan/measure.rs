//! What a cloud is like, by its tiles.

use densecloud::survey::{Parts, Survey};
use densecloud_cloud::{Frame, Position};

use super::spill::Spilled;
use crate::tile::points_of;
use crate::{Folder, TilesError};

/// Tiles that are looked at where a few will do.
const SOME: usize = 8;

/// A survey, and the area of the surface in each tile that was looked at.
pub(super) struct Measured {
    pub(super) survey: Survey,
    pub(super) areas: Vec<f64>,
}

/// Measures about `sample` points, of `all` tiles or of some that are spread over the cloud. Each tile is read once.
pub(super) fn measure(
    folder: &Folder,
    counts: &[[u64; 2]],
    spilled: &Spilled,
    sample: usize,
    all: bool,
) -> Result<Measured, TilesError> {
    let tiles: Vec<usize> = match all || counts.len() <= SOME {
        true => (0..counts.len()).collect(),
        false => (0..SOME).map(|i| i * counts.len() / SOME).collect(),
    };
    let points: u64 = tiles.iter().map(|tile| counts[*tile][0]).sum();
    let (mut parts, mut areas) = (Parts::default(), Vec::new());
    for tile in tiles {
        let share = sample as f64 * counts[tile][0] as f64 / points.max(1) as f64;
        areas.push(add(&mut parts, folder, tile as u32, share.ceil() as usize)?);
    }
    let (finite, points) = (spilled.finite as usize, spilled.points as usize);
    Ok(Measured { survey: parts.survey(finite, points - finite, spilled.bounds), areas })
}

fn add(parts: &mut Parts, folder: &Folder, tile: u32, sample: usize) -> Result<f64, TilesError> {
    let (own, around) = points_of(folder, tile)?;
    let count = own.positions.len();
    let mut positions: Vec<Position> = own.positions;
    positions.extend(around.positions);
    // Points that are all the same have no surface.
    let Ok(frame) = Frame::fit(&positions) else { return Ok(0.0) };
    Ok(parts.add(&positions, count, &frame, sample))
}
