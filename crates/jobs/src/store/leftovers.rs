//! Blobs that nobody needs any more.

use std::collections::HashSet;
use std::io;
use std::time::SystemTime;

use densecloud_blobs::Listed;

use super::Store;
use super::files::{input_name, job_of};
use crate::error::StoreError;
use crate::records::Promised;

impl Store {
    /// Removes every blob that no record promises. Others' results that are being written would be among them.
    pub(super) fn clean(&self) -> Result<(), StoreError> {
        let (mut names, mut of_tiles) = (HashSet::new(), HashSet::new());
        for promised in self.records.promised()? {
            match promised {
                Promised::Input(id) => names.insert(input_name(&id)),
                Promised::Tiles(id) => of_tiles.insert(id),
                Promised::Result(blob) => names.insert(blob),
            };
        }
        self.remove_others(|blob| names.contains(&blob.name) || of_tiles.contains(job_of(&blob.name)))
    }

    /// Removes blobs that nobody needs, where others may be at work: those that are older than `before`, of jobs that are
    /// over or unknown, but for results.
    ///
    /// # Errors
    /// What the storage says.
    pub fn collect(&self, before: SystemTime) -> Result<(), StoreError> {
        let (mut results, mut open) = (HashSet::new(), HashSet::new());
        for promised in self.records.promised()? {
            match promised {
                Promised::Input(id) | Promised::Tiles(id) => open.insert(id),
                Promised::Result(blob) => results.insert(blob),
            };
        }
        self.remove_others(|blob| {
            blob.modified >= before || results.contains(&blob.name) || open.contains(job_of(&blob.name))
        })
    }

    fn remove_others(&self, is_kept: impl Fn(&Listed) -> bool) -> Result<(), StoreError> {
        let mut leftovers = self.blobs.list("")?;
        leftovers.retain(|blob| !is_kept(blob));
        leftovers.iter().try_for_each(|blob| self.blobs.delete(&blob.name))?;
        if !leftovers.is_empty() {
            tracing::info!(removed = leftovers.len(), "removed leftovers of jobs");
        }
        Ok(())
    }

    /// Removes the blobs of a job that is over, but for its result.
    pub(super) fn sweep(&self, id: &str, has_tiles: bool, result: Option<&str>) -> io::Result<()> {
        if !has_tiles {
            return self.blobs.delete(&input_name(id));
        }
        let blobs = self.blobs.list(&format!("{id}."))?;
        let mut others = blobs.iter().filter(|blob| Some(&*blob.name) != result);
        others.try_for_each(|blob| self.blobs.delete(&blob.name))
    }
}
