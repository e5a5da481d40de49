//! The names of the files in a folder.

use std::fs;
use std::path::PathBuf;

use super::Folder;
use crate::TilesError;

impl Folder {
    pub(crate) fn manifest(&self) -> PathBuf {
        self.path().join("manifest.json")
    }

    pub(crate) fn origin(&self) -> PathBuf {
        self.path().join("origin.json")
    }

    /// A small file of the input's format, for what only that knows.
    pub(crate) fn example(&self) -> PathBuf {
        self.path().join("example")
    }

    pub(crate) fn whole(&self) -> PathBuf {
        self.path().join("whole")
    }

    /// The input's points, file after file.
    pub(crate) fn spill(&self, number: u32) -> PathBuf {
        self.path().join("spill").join(number.to_string())
    }

    /// A tile's own points.
    pub(crate) fn own(&self, tile: u32) -> PathBuf {
        self.path().join("own").join(tile.to_string())
    }

    /// The points around them.
    pub(crate) fn around(&self, tile: u32) -> PathBuf {
        self.path().join("around").join(tile.to_string())
    }

    /// What was made of a tile.
    pub(crate) fn part(&self, tile: u32) -> PathBuf {
        self.path().join("parts").join(format!("{tile}.part"))
    }

    /// That it is done.
    pub(crate) fn done(&self, tile: u32) -> PathBuf {
        self.path().join("parts").join(format!("{tile}.json"))
    }

    /// Makes the folders inside.
    pub(crate) fn prepare(&self) -> Result<(), TilesError> {
        for name in ["spill", "own", "around", "parts"] {
            let path = self.path().join(name);
            fs::create_dir_all(&path).map_err(TilesError::file(&path))?;
        }
        Ok(())
    }
}
