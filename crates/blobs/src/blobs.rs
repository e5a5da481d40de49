//! Files under names, wherever they are kept.

use std::fs::{self, File};
use std::io::{self, Read, Seek, Write};
use std::path::Path;
use std::time::SystemTime;

/// Keeps files under names. Names are ASCII letters, digits and dots, and do not end in `.part`. Several programs may
/// use the same ones at once.
///
/// An implementation calls the disk or a network: each call blocks.
pub trait Blobs: Send + Sync {
    /// Begins a blob. It replaces one of the same name when it is finished, and not before; of two that are written
    /// at once the later to be finished stays.
    ///
    /// # Errors
    /// [`io::ErrorKind::InvalidInput`] for what is no name, or what the storage says.
    fn create(&self, name: &str) -> io::Result<Box<dyn BlobWriter>>;

    /// Opens a blob. If it is deleted or replaced meanwhile, reading goes on with what was opened, or ends in an error.
    ///
    /// # Errors
    /// [`io::ErrorKind::NotFound`] where there is none of this name, or what the storage says.
    fn open(&self, name: &str) -> io::Result<Box<dyn BlobReader>>;

    /// Deletes a blob. It is no error if there is none of this name.
    ///
    /// # Errors
    /// What the storage says.
    fn delete(&self, name: &str) -> io::Result<()>;

    /// All blobs whose names begin with `prefix`, in no order, and the remains of those that were never finished.
    /// [`Blobs::delete`] takes both.
    ///
    /// # Errors
    /// What the storage says.
    fn list(&self, prefix: &str) -> io::Result<Vec<Listed>>;

    /// Takes a local file over as the blob of this name, which is on durable storage when this returns, and the file
    /// gone. O(bytes), but where it can be moved.
    ///
    /// # Errors
    /// Of the file, or what the storage says; the file is there still, or the blob is.
    fn keep(&self, name: &str, file: &Path) -> io::Result<()> {
        let mut sink = self.create(name)?;
        io::copy(&mut File::open(file)?, &mut sink)?;
        sink.finish()?;
        fs::remove_file(file)
    }

    /// Makes a local file of a blob, instead of what is there. It is only to be read: it may be the blob itself.
    /// O(bytes), but where it can be linked.
    ///
    /// # Errors
    /// As [`Blobs::open`], or what the disk says; there is no such file then.
    fn fetch(&self, name: &str, to: &Path) -> io::Result<()> {
        let mut blob = self.open(name)?;
        let mut file = File::create(to)?;
        io::copy(&mut blob, &mut file).map(drop).inspect_err(|_| {
            // The first error is the one to report.
            let _ = fs::remove_file(to);
        })
    }
}

/// A blob, or the remains of one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listed {
    /// Its name.
    pub name: String,
    /// When it was written, by the clock of the storage.
    pub modified: SystemTime,
}

/// A blob that is being written. Nobody sees it before [`BlobWriter::finish`]; dropped before, it leaves nothing.
pub trait BlobWriter: Write + Send {
    /// Brings the blob to durable storage under its name: it is there whole, whatever happens after this returns.
    ///
    /// # Errors
    /// What the storage says. The name has what it had before then, or, where the storage's answer did not come, the
    /// whole blob.
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

/// Refuses a name that could lead out of where blobs are kept.
pub(crate) fn check(name: &str) -> io::Result<()> {
    let leads_away = |byte: u8| matches!(byte, b'/' | b'\\') || byte.is_ascii_control();
    if matches!(name, "" | "." | "..") || name.bytes().any(leads_away) {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{name:?} is no name of a blob")));
    }
    Ok(())
}
