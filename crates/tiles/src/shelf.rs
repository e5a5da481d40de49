//! A plan's files among blobs, so that each step may be done on another machine.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use densecloud_blobs::Blobs;

use crate::{Folder, TilesError, Tiling};

/// The files of one plan among blobs, under names that begin alike.
///
/// A plan is made in a folder, and [put](Self::put_plan) here. For a tile another folder [gets](Self::get_plan) what is of
/// the whole and what is [of the tile](Self::get_tile); its part is [put](Self::put_part) under a name of its own, so that
/// several attempts do not meet. Joining takes what is known of all parts into a folder, and [reads them](Self::with_parts)
/// one by one.
#[derive(Clone)]
pub struct Shelf {
    blobs: Arc<dyn Blobs>,
    plan: String,
}

impl Shelf {
    /// That of a plan whose names begin so.
    #[must_use]
    pub fn new(blobs: Arc<dyn Blobs>, plan: &str) -> Self {
        Self { blobs, plan: plan.to_owned() }
    }

    /// Moves a plan here. The manifest comes last: where that is, all is.
    ///
    /// # Errors
    /// What the storage says.
    pub fn put_plan(&self, tiling: Tiling) -> Result<(), TilesError> {
        let (folder, tiles) = (tiling.folder.clone(), tiling.len());
        drop(tiling);
        for tile in 0..tiles {
            self.put(&self.own(tile), &folder.own(tile))?;
            self.put(&self.around(tile), &folder.around(tile))?;
        }
        self.of_whole(&folder).into_iter().rev().try_for_each(|(name, file)| self.put(&name, &file))
    }

    /// Makes files of what is known of the whole.
    ///
    /// # Errors
    /// What the storage says.
    pub fn get_plan(&self, folder: &Folder) -> Result<(), TilesError> {
        folder.prepare()?;
        self.of_whole(folder).iter().try_for_each(|(name, file)| self.get(name, file))
    }

    /// Makes files of what a tile needs beside.
    ///
    /// # Errors
    /// What the storage says.
    pub fn get_tile(&self, tile: u32, folder: &Folder) -> Result<(), TilesError> {
        self.get(&self.own(tile), &folder.own(tile))?;
        self.get(&self.around(tile), &folder.around(tile))
    }

    /// Moves a tile's part from its folder to blobs whose names begin so.
    ///
    /// # Errors
    /// What the storage says.
    pub fn put_part(&self, part: &str, tile: u32, folder: &Folder) -> Result<(), TilesError> {
        self.put(&points(part), &folder.part(tile))?;
        self.put(&done(part), &folder.done(tile))
    }

    /// Removes from a folder what [was made there](Self::get_tile) of a tile.
    ///
    /// # Errors
    /// [`TilesError::File`].
    pub fn drop_tile(&self, tile: u32, folder: &Folder) -> Result<(), TilesError> {
        let files = [folder.own(tile), folder.around(tile)];
        files.iter().try_for_each(|file| match std::fs::remove_file(file) {
            Err(why) if why.kind() != io::ErrorKind::NotFound => Err(TilesError::file(file)(why)),
            _ => Ok(()),
        })
    }

    /// A plan all tiles of which are done, with their parts under these names, in the order of the tiles.
    ///
    /// # Errors
    /// As [`Tiling::load`], and what the storage says.
    pub fn with_parts(&self, parts: Vec<String>, folder: &Folder) -> Result<Tiling, TilesError> {
        self.get_plan(folder)?;
        for (tile, part) in (0..).zip(&parts) {
            self.get(&done(part), &folder.done(tile))?;
        }
        let blobs = Arc::clone(&self.blobs);
        let open = move |tile: u32| {
            let part = parts.get(tile as usize).ok_or(io::ErrorKind::NotFound)?;
            Ok(Box::new(blobs.open(&points(part))?) as Box<dyn io::Read + Send>)
        };
        Ok(Tiling::load(folder)?.with_parts(open))
    }

    fn own(&self, tile: u32) -> String {
        format!("{}.own{tile}", self.plan)
    }

    fn around(&self, tile: u32) -> String {
        format!("{}.around{tile}", self.plan)
    }

    /// Names and files of what every step needs; of some clouds not all are there.
    fn of_whole(&self, folder: &Folder) -> [(String, PathBuf); 4] {
        let named = |name, file| (format!("{}.{name}", self.plan), file);
        [
            named("manifest", folder.manifest()),
            named("origin", folder.origin()),
            named("example", folder.example()),
            named("whole", folder.whole()),
        ]
    }

    /// Moves a file, if it is there.
    fn put(&self, name: &str, file: &Path) -> Result<(), TilesError> {
        if !file.exists() {
            return Ok(());
        }
        self.blobs.keep(name, file).map_err(TilesError::file(file))
    }

    /// Makes a file of a blob, if it is there.
    fn get(&self, name: &str, file: &Path) -> Result<(), TilesError> {
        match self.blobs.fetch(name, file) {
            Err(why) if why.kind() == io::ErrorKind::NotFound => Ok(()),
            fetched => fetched.map_err(TilesError::file(file)),
        }
    }
}

fn points(part: &str) -> String {
    format!("{part}.points")
}

fn done(part: &str) -> String {
    format!("{part}.done")
}
