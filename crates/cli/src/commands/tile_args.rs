//! Options of a work in tiles.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::Args;
use densecloud_tiles::TILE_POINTS;

/// Points of a tile that may be asked for: fewer have too few neighbours, more cannot be told apart.
pub(super) const TILE_POINTS_RANGE: RangeInclusive<u64> = 1000..=u32::MAX as u64;

/// How large tiles are, and where they lie.
#[derive(Debug, Clone, Args)]
pub(super) struct TileArgs {
    /// Work on a cloud of more points than that in tiles of about as many, one after another, in memory that does not grow
    /// with the cloud
    #[arg(
        long,
        value_name = "N",
        default_value_t = TILE_POINTS,
        value_parser = clap::value_parser!(u64).range(TILE_POINTS_RANGE),
    )]
    pub(super) tile_points: u64,

    /// Where the tiles of such a cloud lie until the work is done [default: the system's folder for temporary files]
    #[arg(long, env = "DENSECLOUD_TEMP_DIR", value_name = "DIR")]
    pub(super) temp_dir: Option<PathBuf>,
}

impl TileArgs {
    /// The folder for temporary ones.
    pub(super) fn parent(&self) -> PathBuf {
        self.temp_dir.clone().unwrap_or_else(std::env::temp_dir)
    }
}
