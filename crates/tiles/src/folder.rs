//! The folder that a work lies in: names of its files, who may use it, and what becomes of it.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::TilesError;

/// What the names of folders that are removed at the end begin with.
const TEMPORARY: &str = "densecloud-tiles-";

/// What those begin with that are gone on with.
const KEPT: &str = "densecloud-resume-";

/// The file that a program holds locked for as long as it works in a folder.
const LOCK: &str = "lock";

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
        let mut number = 0_u32;
        loop {
            let name = format!("{TEMPORARY}{own}-{number}");
            // Under another name until it is locked, so that one of its name always is.
            let (path, before) = (parent.join(&name), parent.join(format!(".{name}")));
            number += 1;
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

    /// Removes those inside of `parent` that [are kept](Self::kept) for works of other names than these, and that nobody works
    /// in.
    ///
    /// # Errors
    /// [`TilesError::File`].
    pub fn keep_only<'a>(parent: &Path, names: impl Iterator<Item = &'a str>) -> Result<(), TilesError> {
        let names: Vec<String> = names.map(kept_name).collect();
        if !parent.exists() {
            return Ok(());
        }
        for entry in fs::read_dir(parent).map_err(TilesError::file(parent))? {
            let entry = entry.map_err(TilesError::file(parent))?;
            let is_left = |name: &str| name.starts_with(KEPT) && !names.iter().any(|kept| kept == name);
            if !entry.file_name().to_str().is_some_and(is_left) {
                continue;
            }
            if let Ok(lock) = locked(&entry.path()) {
                discard(&entry.path())?;
                drop(lock);
            }
        }
        Ok(())
    }

    /// Removes the [temporary](Self::temporary) ones inside of `parent` that this process made, whoever works in them: for
    /// when it ends, and nobody waits any more for threads that do.
    pub fn remove_own(parent: &Path) {
        let (named, own) = (format!("{TEMPORARY}{}-", std::process::id()), fs::read_dir(parent));
        for entry in own.into_iter().flatten().flatten() {
            let is_own = |name: &str| name.trim_start_matches('.').starts_with(&named);
            if entry.file_name().to_str().is_some_and(is_own) {
                // The next one removes what is left.
                let _ = discard(&entry.path());
            }
        }
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

impl Drop for Place {
    fn drop(&mut self) {
        if *self.is_temporary.get_mut() {
            // The next one removes what is left.
            let _ = discard(&self.path);
        }
    }
}

/// Removes all of a folder, the lock last: what is left after a kill is still seen to be a leftover.
fn discard(folder: &Path) -> Result<(), TilesError> {
    clear(folder)?;
    fs::remove_dir_all(folder).map_err(TilesError::file(folder))
}

fn clear(folder: &Path) -> Result<(), TilesError> {
    for entry in fs::read_dir(folder).map_err(TilesError::file(folder))? {
        let path = entry.map_err(TilesError::file(folder))?.path();
        let removed = match path.is_dir() {
            true => fs::remove_dir_all(&path),
            false if path.file_name() == Some(LOCK.as_ref()) => Ok(()),
            false => fs::remove_file(&path),
        };
        removed.map_err(TilesError::file(&path))?;
    }
    Ok(())
}

/// Makes a folder that nobody else sees into: temporary ones lie where everybody may.
fn create_private(path: &Path) -> std::io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(path)
}

/// The name of a folder that is kept for a work of that name.
fn kept_name(name: &str) -> String {
    format!("{KEPT}{:08x}", crc32fast::hash(name.as_bytes()))
}

fn locked(folder: &Path) -> Result<File, TilesError> {
    let path = folder.join(LOCK);
    let file = File::options().create(true).append(true).open(&path).map_err(TilesError::file(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(TilesError::Busy(folder.to_owned())),
        Err(TryLockError::Error(why)) => Err(TilesError::File { path, why }),
    }
}

/// Removes the temporary folders that nobody works in.
fn remove_leftovers(parent: &Path) -> Result<(), TilesError> {
    for entry in fs::read_dir(parent).map_err(TilesError::file(parent))? {
        let Ok(entry) = entry else { continue };
        let is_ours = |name: &str| name.trim_start_matches('.').starts_with(TEMPORARY);
        let is_ours = entry.file_name().to_str().is_some_and(is_ours);
        if !is_ours {
            continue;
        }
        // Others' folders that cannot be removed are not in the way.
        if !entry.path().join(LOCK).exists() {
            // Of a program that was killed as it made or removed it: it is empty.
            let _ = fs::remove_dir(entry.path());
        } else if let Ok(lock) = locked(&entry.path()) {
            let _ = discard(&entry.path());
            drop(lock);
        }
    }
    Ok(())
}

/// Writes a file so that it is there whole or not at all, even where the machine is switched off.
pub(crate) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), TilesError> {
    let before = path.with_extension("new");
    let write = || {
        let mut file = File::create(&before)?;
        std::io::Write::write_all(&mut file, bytes)?;
        file.sync_all()?;
        fs::rename(&before, path)
    };
    write().map_err(TilesError::file(path))
}

/// Bytes that are free on the disk of a folder; none where the system does not tell.
pub(crate) fn free_space(folder: &Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let told = rustix::fs::statvfs(folder).ok()?;
        Some(told.f_bavail.saturating_mul(told.f_frsize))
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(parent: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(parent)
            .expect("a folder")
            .map(|entry| entry.expect("an entry").file_name().into_string().expect("UTF-8"))
            .collect();
        names.sort();
        names
    }

    #[test]
    fn temporary_folders_go_and_so_do_those_of_killed_programs() {
        let parent = tempfile::tempdir().expect("a folder");
        let first = Folder::temporary(parent.path()).expect("a folder");
        fs::write(first.manifest(), "x").expect("a file");
        // As one that was killed leaves it.
        let left = parent.path().join(format!("{TEMPORARY}0-0"));
        fs::create_dir(&left).expect("a folder");
        fs::write(left.join(LOCK), "").expect("a file");
        // As one that was killed while it removed its own.
        fs::create_dir(parent.path().join(format!("{TEMPORARY}0-1"))).expect("a folder");
        fs::create_dir(parent.path().join("densecloud-tiles")).expect("another's folder");
        let second = Folder::temporary(parent.path()).expect("a folder");
        assert!(first.manifest().exists() && !left.exists() && first.path() != second.path());
        drop((first, second));
        assert_eq!(names(parent.path()), ["densecloud-tiles"]);
    }

    #[test]
    fn a_process_that_ends_takes_its_folders_along() {
        let parent = tempfile::tempdir().expect("a folder");
        let own = Folder::temporary(parent.path()).expect("a folder");
        fs::write(own.manifest(), "x").expect("a file");
        let others = parent.path().join(format!("{TEMPORARY}{}0-0", std::process::id()));
        fs::create_dir(&others).expect("a folder");
        Folder::remove_own(parent.path());
        assert!(!own.path().exists() && others.exists());
        drop(own);
        assert_eq!(names(parent.path()).len(), 1);
        Folder::remove_own(&parent.path().join("none"));
    }

    #[test]
    fn a_folder_that_is_gone_on_with_stays_and_is_one_programs() {
        let parent = tempfile::tempdir().expect("a folder");
        let first = Folder::kept(parent.path(), "dense.ply").expect("a folder");
        let path = first.path().to_owned();
        assert!(matches!(Folder::kept(parent.path(), "dense.ply"), Err(TilesError::Busy(_))));
        assert_ne!(Folder::kept(parent.path(), "other.ply").expect("a folder").path(), path);
        drop(first);
        Folder::temporary(parent.path()).expect("a folder");
        assert!(path.exists());
        let folder = Folder::kept(parent.path(), "dense.ply").expect("a folder");
        fs::write(folder.manifest(), "x").expect("a file");
        assert!(folder.has_plan());
        // Of two others one is worked in.
        let other = Folder::kept(parent.path(), "other.ply").expect("a folder");
        drop(Folder::kept(parent.path(), "third.ply").expect("a folder"));
        Folder::keep_only(parent.path(), ["dense.ply"].into_iter()).expect("the others are removed");
        assert_eq!(names(parent.path()).len(), 2);
        drop(other);
        Folder::keep_only(parent.path(), ["dense.ply"].into_iter()).expect("the others are removed");
        assert_eq!(names(parent.path()), [kept_name("dense.ply")]);
        folder.remove().expect("removed");
        assert!(!path.exists());
    }

    #[test]
    #[cfg(unix)]
    fn nobody_else_sees_into_a_temporary_folder() {
        use std::os::unix::fs::PermissionsExt;
        let parent = tempfile::tempdir().expect("a folder");
        let temporary = Folder::temporary(parent.path()).expect("a folder");
        let kept = Folder::kept(parent.path(), "dense.ply").expect("a folder");
        for folder in [&temporary, &kept] {
            let mode = fs::metadata(folder.path()).expect("a folder").permissions().mode();
            assert_eq!(mode & 0o777, 0o700);
        }
    }

    #[test]
    fn the_disk_tells_what_is_free() {
        let folder = tempfile::tempdir().expect("a folder");
        assert!(cfg!(not(unix)) || free_space(folder.path()).is_some_and(|free| free > 0));
    }
}
