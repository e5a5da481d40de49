//! Files of jobs, wherever they are kept.

use std::fs::File;
use std::io::{self, Read, Seek, Write};

/// Keeps the clouds and the results of jobs under names. Names are ASCII letters, digits and dots.
///
/// An implementation calls the disk or a network: each call blocks.
pub trait Blobs: Send + Sync {
    /// Begins a blob. It replaces one of the same name when it is finished, and not before.
    ///
    /// # Errors
    /// What the storage says.
    fn create(&self, name: &str) -> io::Result<Box<dyn BlobWriter>>;

    /// Opens a blob. It can be read to its end even if it is deleted meanwhile.
    ///
    /// # Errors
    /// [`io::ErrorKind::NotFound`] where there is none of this name, or what the storage says.
    fn open(&self, name: &str) -> io::Result<Box<dyn BlobReader>>;

    /// Deletes a blob. It is no error if there is none of this name.
    ///
    /// # Errors
    /// What the storage says.
    fn delete(&self, name: &str) -> io::Result<()>;

    /// The names of all blobs, and of the remains of those that were never finished. [`Blobs::delete`] takes both.
    ///
    /// # Errors
    /// What the storage says.
    fn list(&self) -> io::Result<Vec<String>>;
}

/// A blob that is being written. Nobody sees it before [`BlobWriter::finish`]; dropped before, it leaves nothing.
pub trait BlobWriter: Write {
    /// Brings the blob to durable storage under its name: it is there whole, whatever happens after this returns.
    ///
    /// # Errors
    /// What the storage says; there is no such blob then.
    fn finish(self: Box<Self>) -> io::Result<()>;
}

/// A blob that is read: from its beginning, or from wherever it is sought.
pub trait BlobReader: Read + Seek + Send {
    /// Its length in bytes.
    ///
    /// # Errors
    /// What the storage says.
    fn length(&self) -> io::Result<u64>;
}

impl BlobReader for File {
    fn length(&self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }
}
