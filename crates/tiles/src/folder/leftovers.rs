//! Folders of works that are over, or of programs that were killed.

use std::fs;
use std::path::Path;

use super::Folder;
use super::lock::{discard, discard_left};
use crate::TilesError;

/// What the names of folders that are removed at the end begin with.
pub(super) const TEMPORARY: &str = "densecloud-tiles-";

/// What those begin with that are gone on with.
const KEPT: &str = "densecloud-resume-";

impl Folder {
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
            discard_left(&entry.path())?;
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
}

/// The name of a folder that is kept for a work of that name.
pub(super) fn kept_name(name: &str) -> String {
    format!("{KEPT}{:08x}", crc32fast::hash(name.as_bytes()))
}

/// Removes the temporary folders that nobody works in.
pub(super) fn remove_leftovers(parent: &Path) -> Result<(), TilesError> {
    for entry in fs::read_dir(parent).map_err(TilesError::file(parent))? {
        let Ok(entry) = entry else { continue };
        let is_ours = |name: &str| name.trim_start_matches('.').starts_with(TEMPORARY);
        let is_ours = entry.file_name().to_str().is_some_and(is_ours);
        if !is_ours {
            continue;
        }
        // Others' folders that cannot be removed are not in the way.
        let _ = discard_left(&entry.path());
    }
    Ok(())
}
