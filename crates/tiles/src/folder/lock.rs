//! Who works in a folder: whoever holds its lock.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::path::Path;

use crate::TilesError;

/// The file that a program holds locked for as long as it works in a folder.
pub(super) const LOCK: &str = "lock";

/// Takes the lock of a folder to work in, which is held for as long as the file is open.
pub(super) fn locked(folder: &Path) -> Result<File, TilesError> {
    lock(folder, File::options().create(true))
}

/// Takes the lock of a folder to remove it: of one without a lock there is none to take, since whoever makes it is about to.
fn locked_as_it_is(folder: &Path) -> Result<File, TilesError> {
    lock(folder, &mut File::options())
}

fn lock(folder: &Path, options: &mut OpenOptions) -> Result<File, TilesError> {
    let path = folder.join(LOCK);
    let file = options.append(true).open(&path).map_err(TilesError::file(&path))?;
    match file.try_lock() {
        Ok(()) if is_at(&file, &path) => Ok(file),
        // Whoever removes a folder has its lock: it was just removed.
        Ok(()) => Err(TilesError::Busy(folder.to_owned())),
        Err(TryLockError::WouldBlock) => Err(TilesError::Busy(folder.to_owned())),
        Err(TryLockError::Error(why)) => Err(TilesError::File { path, why }),
    }
}

/// Whether the file is still the one of that name.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let same = |a: &fs::Metadata, b: &fs::Metadata| (a.dev(), a.ino()) == (b.dev(), b.ino());
    matches!((file.metadata(), fs::metadata(path)), (Ok(open), Ok(named)) if same(&open, &named))
}

/// Files that are open are not removed elsewhere.
#[cfg(not(unix))]
fn is_at(_: &File, path: &Path) -> bool {
    path.exists()
}

/// Removes a folder that nobody works in; another stays.
pub(super) fn discard_left(folder: &Path) -> Result<(), TilesError> {
    if !folder.join(LOCK).exists() {
        // Of a program that was killed as it made or removed it, and then it is empty; or of one that makes it now.
        let _ = fs::remove_dir(folder);
    } else if let Ok(lock) = locked_as_it_is(folder) {
        discard(folder)?;
        drop(lock);
    }
    Ok(())
}

/// Removes all of a folder, the lock last: what is left after a kill is still seen to be a leftover.
pub(super) fn discard(folder: &Path) -> Result<(), TilesError> {
    clear(folder)?;
    fs::remove_dir_all(folder).map_err(TilesError::file(folder))
}

/// Removes all that lies in a folder, but for the lock.
pub(super) fn clear(folder: &Path) -> Result<(), TilesError> {
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
