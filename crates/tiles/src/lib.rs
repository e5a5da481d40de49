//! Clouds of any size in bounded memory: cut into tiles, which are worked on alone, and joined.
//!
//! 1. [`plan`] reads a cloud once and puts its points on the disk, tile by tile, with those around each. What is decided for
//!    the whole, from the model's view of it to the types of attributes, is decided there, and written beside the tiles.
//! 2. [`Tiling::run`] makes the part of the result that one tile gives: exactly as many points as planned. It needs nothing
//!    but the folder, so tiles may be run in any order, more than once, and by any number of programs.
//! 3. [`Tiling::join`] writes all parts into one file. [`Tiling::flow`] does so while tiles are still worked on, where the
//!    format's header is known from the plan; [`Tiling::run_into`] is both steps at once.
//!
//! Memory is that of one tile, whatever the cloud's size. The result depends on the cloud, the options, the model and the
//! points of a tile: not on threads, nor on the order of tiles.
//!
//! A cloud that one tile holds is none of ours: [`Input::read`] tells, and gives it as it is read anywhere else.

mod chunk;
mod disk;
mod error;
mod flow;
mod folder;
mod input;
mod join;
mod manifest;
mod origin;
mod part;
mod plan;
mod run;
mod shelf;
mod size;
#[cfg(test)]
mod tests;
mod tile;
mod tiling;

pub use error::TilesError;
pub use flow::Flow;
pub use folder::Folder;
pub use input::{Found, Input, Large};
pub use join::Join;
pub use part::{PartReader, Points};
pub use plan::plan;
pub use shelf::Shelf;
pub use size::{TILE_POINTS, TileSize, TooLittle};
pub use tiling::Tiling;

use densecloud::Options;
use densecloud::backends::ModelName;
use densecloud_cascade::{LevelRunner, Observer, Silent};

/// What is wanted of a cloud, and who does it.
#[derive(Clone, Copy)]
pub struct Work<'a> {
    /// What is wanted; the format of the result among it.
    pub options: &'a Options,
    /// The model's name and hash.
    pub model: &'a ModelName,
    /// What runs it.
    pub runner: &'a dyn LevelRunner,
    /// The most points of a tile, about ([`TileSize::points`]).
    pub tile_points: u64,
    /// Who hears how far it is.
    pub watch: &'a dyn Watch,
}

/// Hears how far a work in tiles is, and what each tile's cascade is at.
pub trait Watch: Observer {
    /// Another part of the work begins.
    fn step(&self, _step: Step) {}

    /// So many points of the input are read.
    fn read(&self, _points: u64) {}
}

impl Watch for Silent {}

/// The parts of a work in tiles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Reading the cloud.
    Read,
    /// Cutting it into tiles.
    Cut,
    /// Working on a tile.
    Tile {
        /// Tiles before it.
        done: u32,
        /// All tiles.
        of: u32,
        /// Points that the tiles before it gave.
        points: u64,
    },
}
