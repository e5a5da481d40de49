//! Blobs as files of one folder, there whole or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::blobs::{BlobReader, BlobWriter, Blobs};

/// Blobs as files of one folder.
#[derive(Debug)]
pub struct Folder(PathBuf);

/// What a name ends in while its file is being written.
const PART: &str = ".part";
/// Bytes that are written at a time.
const BUFFER: usize = 1 << 20;

impl Folder {
    /// Makes the folder where it is missing.
    ///
    /// # Errors
    /// What the disk says.
    pub fn open(folder: PathBuf) -> io::Result<Self> {
        fs::create_dir_all(&folder)?;
        if let Some(parent) = folder.parent() {
            sync(parent)?;
        }
        Ok(Self(folder))
    }
}

impl Blobs for Folder {
    fn create(&self, name: &str) -> io::Result<Box<dyn BlobWriter>> {
        let part = Part(self.0.join(format!("{name}{PART}")));
        let sink = BufWriter::with_capacity(BUFFER, File::create(&part.0)?);
        Ok(Box::new(Writing { part, sink, folder: self.0.clone(), path: self.0.join(name) }))
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn BlobReader>> {
        Ok(Box::new(File::open(self.0.join(name))?))
    }

    fn delete(&self, name: &str) -> io::Result<()> {
        remove(&self.0.join(name))
    }

    fn list(&self) -> io::Result<Vec<String>> {
        let names = fs::read_dir(&self.0)?.map(|entry| Ok(entry?.file_name().into_string().ok()));
        // What is no text is no file of ours.
        names.filter_map(io::Result::transpose).collect()
    }
}

/// A file that is written under another name, brought to the disk and then renamed.
struct Writing {
    // Before its guard, so that the file is closed when that removes it.
    sink: BufWriter<File>,
    part: Part,
    folder: PathBuf,
    path: PathBuf,
}

impl Write for Writing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.sink.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}

impl BlobWriter for Writing {
    fn finish(self: Box<Self>) -> io::Result<()> {
        let Self { sink, part, folder, path } = *self;
        sink.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        fs::rename(&part.0, &path)?;
        // The new name is on the disk, too, when this returns.
        sync(&folder).inspect_err(|_| {
            // The first error is the one to report; what is left goes at the next start.
            let _ = remove(&path);
        })
    }
}

/// The name of a file that is being written; removed when dropped, unless the file has got its own by then.
struct Part(PathBuf);

impl Drop for Part {
    fn drop(&mut self) {
        // What is left goes at the next start.
        let _ = remove(&self.0);
    }
}

/// Removes a file that may be gone already.
fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// A name is on the disk once its folder is.
#[cfg(unix)]
fn sync(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

/// Windows opens no folder as a file; NTFS keeps names in its own journal.
#[cfg(not(unix))]
fn sync(_folder: &Path) -> io::Result<()> {
    Ok(())
}
