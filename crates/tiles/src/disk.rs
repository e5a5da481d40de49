//! What is asked of the disk.

use std::fs::{self, File};
use std::path::Path;

use crate::TilesError;

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

    #[test]
    fn the_disk_tells_what_is_free() {
        let folder = tempfile::tempdir().expect("a folder");
        assert!(cfg!(not(unix)) || free_space(folder.path()).is_some_and(|free| free > 0));
    }
}
