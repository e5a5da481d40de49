//! Who works in a folder: whoever holds its lock.

use std::fs::{self, File, TryLockError};
use std::path::Path;

use crate::TilesError;

/// The file that a program holds locked for as long as it works in a folder.
pub(super) const LOCK: &str = "lock";

/// Takes a folder's lock, which is held for as long as the file is open.
pub(super) fn locked(folder: &Path) -> Result<File, TilesError> {
    let path = folder.join(LOCK);
    let file = File::options().create(true).append(true).open(&path).map_err(TilesError::file(&path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(TilesError::Busy(folder.to_owned())),
        Err(TryLockError::Error(why)) => Err(TilesError::File { path, why }),
    }
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
