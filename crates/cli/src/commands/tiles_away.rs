//! A plan at an address. What a step needs of it lies in a temporary folder meanwhile.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use densecloud_blobs::{Address, Blobs, Settings, open};
use densecloud_cascade::{LevelRunner, Silent};
use densecloud_tiles::{Folder, Shelf, TilesError, Tiling};

use super::places::refused;
use super::{CliError, tiled};

/// Where a step works on a plan that lies elsewhere.
#[derive(Debug, Clone, Args)]
pub(super) struct AwayArgs {
    /// Where temporary files lie if FOLDER is an address: those of the whole plan to plan it, of a tile to run it,
    /// and what LAZ and COPC are made in to join it [default: the system's folder for temporary files]
    #[arg(long, env = "DENSECLOUD_TEMP_DIR", value_name = "DIR")]
    temp_dir: Option<PathBuf>,
}

/// What a plan's names begin with.
const PLAN: &str = "plan";
/// The last of them that is written, and the first that is removed.
const MANIFEST: &str = "plan.manifest";
/// What a part's names begin with, before the tile's number.
const PART: &str = "part";

/// A plan at an address, and a folder for what is needed of it.
pub(super) struct Away {
    shelf: Shelf,
    blobs: Arc<dyn Blobs>,
    folder: Folder,
    address: PathBuf,
}

/// Where a plan lies.
pub(super) enum Work {
    /// In a folder.
    Here(PathBuf),
    /// At an address.
    Away(Away),
}

impl Work {
    pub(super) fn at(address: &Path, args: &AwayArgs) -> Result<Self, CliError> {
        let Some(text) = address.to_str() else { return Ok(Self::Here(address.to_owned())) };
        if let Address::Path(path) = Address::parse(text).map_err(refused)? {
            return Ok(Self::Here(path));
        }
        let blobs = open(text, &Settings::from_env()).map_err(refused)?;
        let parent = args.temp_dir.clone().unwrap_or_else(std::env::temp_dir);
        let folder = Folder::temporary(&parent).map_err(|why| tiled::failed(&parent, why))?;
        let shelf = Shelf::new(Arc::clone(&blobs), PLAN);
        Ok(Self::Away(Away { shelf, blobs, folder, address: address.to_owned() }))
    }
}

impl Away {
    pub(super) fn folder(&self) -> &Folder {
        &self.folder
    }

    fn fail(&self) -> impl Fn(TilesError) -> CliError {
        |why| tiled::failed(&self.address, why)
    }

    /// The names of all that was planned there and made of it. What another planning left that was stopped is among
    /// them.
    fn names(&self) -> Result<Vec<String>, CliError> {
        let listed = [PLAN, PART].map(|prefix| self.blobs.list(prefix));
        let mut names = Vec::new();
        for listed in listed {
            names.extend(
                listed.map_err(|why| CliError::file(&self.address, why))?.into_iter().map(|one| one.name),
            );
        }
        Ok(names)
    }

    /// Refuses a place that has a plan, or parts of one.
    pub(super) fn check_free(&self) -> Result<(), CliError> {
        match self.names()?.iter().any(|name| name == MANIFEST || name.starts_with(PART)) {
            true => Err(CliError::file(&self.address, "tiles are planned there already")),
            false => Ok(()),
        }
    }

    /// Removes the plan and all parts.
    pub(super) fn remove(&self) -> Result<(), CliError> {
        let mut names = self.names()?;
        if names.is_empty() {
            return Err(self.none());
        }
        // So that nobody goes on with what is half removed.
        names.sort_by_key(|name| name != MANIFEST);
        let removed = names.iter().try_for_each(|name| self.blobs.delete(name));
        removed.map_err(|why| CliError::file(&self.address, why))
    }

    fn none(&self) -> CliError {
        CliError::file(&self.address, "no tiles are planned there")
    }

    pub(super) fn put_plan(&self, tiling: Tiling) -> Result<(), CliError> {
        self.shelf.put_plan(tiling).map_err(self.fail())
    }

    /// The plan.
    pub(super) fn load(&self) -> Result<Tiling, CliError> {
        self.shelf.get_plan(&self.folder).map_err(self.fail())?;
        if !self.folder.has_plan() {
            return Err(self.none());
        }
        Tiling::load(&self.folder).map_err(self.fail())
    }

    /// The numbers of the tiles that have no part.
    pub(super) fn not_done(&self, tiling: &Tiling) -> Result<Vec<u32>, CliError> {
        let done: Vec<u32> = self.names()?.iter().filter_map(|name| done_tile(name)).collect();
        Ok((0..tiling.len()).filter(|tile| !done.contains(tile)).collect())
    }

    /// Makes the part of a tile, with the disk that one takes.
    pub(super) fn run(&self, tiling: &Tiling, tile: u32, runner: &dyn LevelRunner) -> Result<(), CliError> {
        let run = || {
            self.shelf.get_tile(tile, &self.folder)?;
            tiling.run(tile, runner, &Silent)?;
            self.shelf.put_part(&part(tile), tile, &self.folder)?;
            self.shelf.drop_tile(tile, &self.folder)
        };
        run().map_err(self.fail())
    }

    /// The plan, with all parts.
    pub(super) fn with_parts(&self) -> Result<Tiling, CliError> {
        let parts = (0..self.load()?.len()).map(part).collect();
        self.shelf.with_parts(parts, &self.folder).map_err(self.fail())
    }
}

fn part(tile: u32) -> String {
    format!("{PART}{tile}")
}

fn done_tile(name: &str) -> Option<u32> {
    name.strip_prefix(PART)?.strip_suffix(".done")?.parse().ok()
}
