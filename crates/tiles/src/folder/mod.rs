//! The folder that a work lies in: who may use it, and what becomes of it.

mod leftovers;
mod lock;
mod names;
#[cfg(test)]
mod tests;

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use crate::TilesError;
use leftovers::{TEMPORARY, kept_name, remove_leftovers};
use lock::{clear, discard, locked};

/// The number of the next temporary folder of this process.
static NUMBER: AtomicU32 = AtomicU32::new(0);

/// A folder for the tiles of a cloud. Clones are the same folder.
#[derive(Debug, Clone)]
pub struct Folder(Arc<Place>);

#[derive(Debug)]
struct Place {
    path: PathBuf,
    /// Held for as long as this lives; none where several programs may work at once.
    _lock: Option<File>,
    is_temporary: AtomicBool,
}

impl Folder {
    /// A new one inside of `parent`, which is removed when this, and its last clone, goes out of scope. Those that programs left behind that were
    /// killed are removed now.
    ///
    /// # Errors
    /// [`TilesError::File`].
    pub fn temporary(parent: &Path) -> Result<Self, TilesError> {
        fs::create_dir_all(parent).map_err(TilesError::file(parent))?;
        remove_leftovers(parent)?;
        let own = std::process::id();
        loop {
            // Counted in the process: its threads never want the same.
            let number = NUMBER.fetch_add(1, Ordering::Relaxed);
            let name = format!("{TEMPORARY}{own}-{number}");
            // Under another name until it is locked, so that one of its name always is.
            let (path, before) = (parent.join(&name), parent.join(format!(".{name}")));
            if path.exists() {
                continue;
            }
            match create_private(&before) {
                Ok(()) => {}
                Err(why) if why.kind() == std::io::ErrorKind::AlreadyExists => continue,
                Err(why) => return Err(TilesError::File { path: before, why }),
            }
            let lock = match locked(&before) {
                // Another program takes it for a leftover, or took it for one.
                Err(_) if !before.exists() => continue,
                Err(TilesError::Busy(_)) => continue,
                lock => lock?,
            };
            fs::rename(&before, &path).map_err(TilesError::file(&path))?;
            return Ok(Self::held(path, Some(lock), true));
        }
    }

    /// The one inside of `parent` for a work of that name, which stays until it is [removed](Self::remove).
    ///
    /// # Errors
    /// [`TilesError::Busy`], [`TilesError::File`].
    pub fn kept(parent: &Path, name: &str) -> Result<Self, TilesError> {
        let path = parent.join(kept_name(name));
        fs::create_dir_all(parent).map_err(TilesError::file(parent))?;
        match create_private(&path) {
            Err(why) if why.kind() != std::io::ErrorKind::AlreadyExists => {
                return Err(TilesError::File { path, why });
            }
            _ => {}
        }
        let lock = locked(&path)?;
        Ok(Self::held(path, Some(lock), false))
    }

    /// A new one at that very place, to plan tiles in; whatever works on them may do so at once.
    ///
    /// # Errors
    /// [`TilesError::NotEmpty`], [`TilesError::File`].
    pub fn new(path: &Path) -> Result<Self, TilesError> {
        fs::create_dir_all(path).map_err(TilesError::file(path))?;
        let mut entries = fs::read_dir(path).map_err(TilesError::file(path))?;
        if entries.next().is_some() {
            return Err(TilesError::NotEmpty(path.to_owned()));
        }
        Ok(Self::at(path))
    }

    /// That in which tiles are planned already.
    #[must_use]
    pub fn at(path: &Path) -> Self {
        Self::held(path.to_owned(), None, false)
    }

    fn held(path: PathBuf, lock: Option<File>, is_temporary: bool) -> Self {
        Self(Arc::new(Place { path, _lock: lock, is_temporary: is_temporary.into() }))
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0.path
    }

    /// Whether it goes with its last clone.
    pub(crate) fn is_temporary(&self) -> bool {
        self.0.is_temporary.load(Ordering::Relaxed)
    }

    /// Whether tiles are planned in it.
    #[must_use]
    pub fn has_plan(&self) -> bool {
        self.manifest().exists()
    }

    /// Removes it, whoever has a clone.
    ///
    /// # Errors
    /// [`TilesError::File`].
    pub fn remove(self) -> Result<(), TilesError> {
        // Its name may be another's by the time that the last clone goes.
        self.0.is_temporary.store(false, Ordering::Relaxed);
        // First, so that nobody goes on with what is half removed.
        match fs::remove_file(self.manifest()) {
            Err(why) if why.kind() != std::io::ErrorKind::NotFound => {
                Err(TilesError::File { path: self.manifest(), why })
            }
            _ => discard(self.path()),
        }
    }

    /// Removes what a plan and its parts are, and the folder where nothing else lies in it.
    ///
    /// # Errors
    /// [`TilesError::File`].
    pub fn remove_plan(self) -> Result<(), TilesError> {
        // In this order, so that nobody goes on with what is half removed.
        let files = [self.manifest(), self.origin(), self.example(), self.whole()];
        let folders = ["spill", "own", "around", "parts"].map(|name| self.path().join(name));
        let removed = files.iter().map(|file| (file, fs::remove_file(file)));
        let removed = removed.chain(folders.iter().map(|folder| (folder, fs::remove_dir_all(folder))));
        for (path, done) in removed {
            match done {
                Err(why) if why.kind() != std::io::ErrorKind::NotFound => {
                    return Err(TilesError::File { path: path.clone(), why });
                }
                _ => {}
            }
        }
        // What else lies there is its owner's.
        let _ = fs::remove_dir(self.path());
        Ok(())
    }

    /// Removes all that lies in it, but for the lock.
    pub(crate) fn clear(&self) -> Result<(), TilesError> {
        clear(self.path())
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        if *self.is_temporary.get_mut() {
            // The next one removes what is left.
            let _ = discard(&self.path);
        }
    }
}

/// Makes a folder that nobody else sees into: temporary ones lie where everybody may.
fn create_private(path: &Path) -> std::io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(path)
}
