//! Options of a work in tiles.

use std::path::{Path, PathBuf};

use clap::Args;
use densecloud::Options;
use densecloud_formats::Header;
use densecloud_tiles::TileSize;

use super::CliError;
use super::memory::{self, Memory};

/// How large tiles are.
#[derive(Debug, Clone, Args)]
pub(super) struct SizeArgs {
    /// Instead of --tile-points, the bytes of memory that the work may take, as estimated; auto is by the machine's
    /// memory, and gives other points on another machine
    #[arg(long, value_name = "N", value_parser = memory::parse, conflicts_with = "tile_points")]
    max_memory: Option<Memory>,
}

impl SizeArgs {
    /// Points of a tile of a cloud with that header.
    pub(super) fn points(&self, options: &Options, header: &Header) -> Result<u64, CliError> {
        let size = self.max_memory.map_or(TileSize::of(options), |memory| TileSize::Memory(memory.bytes(0)));
        size.points(options.goal, header).map_err(|why| CliError::Usage(format!("--max-memory: {why}")))
    }
}

/// How large tiles are, and where they lie.
#[derive(Debug, Clone, Args)]
pub(super) struct TileArgs {
    #[command(flatten)]
    pub(super) size: SizeArgs,

    /// Where temporary files lie until the work is done: the tiles of such a cloud, copies of LAS and E57 that come by a pipe, and
    /// what LAZ, COPC and E57 are made in [default: the system's folder for temporary files]
    #[arg(long, env = "DENSECLOUD_TEMP_DIR", value_name = "DIR")]
    pub(super) temp_dir: Option<PathBuf>,
}

impl TileArgs {
    /// Has all temporary files in their folder.
    pub(super) fn settle(&self) -> Result<(), CliError> {
        self.temp_dir.as_deref().map_or(Ok(()), temp_files_in)
    }

    /// The folder for temporary ones.
    pub(super) fn parent(&self) -> PathBuf {
        self.temp_dir.clone().unwrap_or_else(std::env::temp_dir)
    }
}

/// Has temporary files without a name in a folder.
pub(super) fn temp_files_in(folder: &Path) -> Result<(), CliError> {
    densecloud_formats::set_temp_folder(folder).map_err(|why| CliError::file(folder, why))
}
