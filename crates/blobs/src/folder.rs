//! Blobs as files of one folder, there whole or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::blobs::{BlobReader, BlobWriter, Blobs, Listed, check};

/// Blobs as files of one folder. Any number of programs may use it, over a shared file system as well.
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
        let path = self.path(name)?;
        let (part, file) = self.part(name)?;
        let sink = BufWriter::with_capacity(BUFFER, file);
        Ok(Box::new(Writing { part, sink, folder: self.0.clone(), path }))
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn BlobReader>> {
        Ok(Box::new(File::open(self.path(name)?)?))
    }

    fn delete(&self, name: &str) -> io::Result<()> {
        check(name)?;
        remove(&self.0.join(name))
    }

    fn list(&self, prefix: &str) -> io::Result<Vec<Listed>> {
        let listed = fs::read_dir(&self.0)?.map(|entry| listed(&entry?, prefix));
        listed.filter_map(io::Result::transpose).collect()
    }

    fn keep(&self, name: &str, file: &Path) -> io::Result<()> {
        let path = self.path(name)?;
        File::open(file)?.sync_all()?;
        match fs::rename(file, &path) {
            Err(error) if error.kind() == io::ErrorKind::CrossesDevices => {
                let (part, mut copy) = self.part(name)?;
                io::copy(&mut File::open(file)?, &mut copy)?;
                copy.sync_all()?;
                fs::rename(&part.0, &path)?;
            }
            renamed => renamed?,
        }
        sync(&self.0)?;
        // It is still there where it was copied, or was a link to that very blob.
        remove(file)
    }

    fn fetch(&self, name: &str, to: &Path) -> io::Result<()> {
        let path = self.path(name)?;
        remove(to)?;
        match fs::hard_link(&path, to) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Err(error),
            // Across file systems, and on those that have no links.
            Err(_) => fs::copy(&path, to).map(drop).inspect_err(|_| {
                let _ = remove(to);
            }),
            Ok(()) => Ok(()),
        }
    }
}

impl Folder {
    /// Where a blob lies.
    fn path(&self, name: &str) -> io::Result<PathBuf> {
        check(name)?;
        if name.ends_with(PART) {
            let why = format!("{name:?} is the name of what is not finished");
            return Err(io::Error::new(io::ErrorKind::InvalidInput, why));
        }
        Ok(self.0.join(name))
    }

    /// A file that nobody else writes, for what will be the blob of this name.
    fn part(&self, name: &str) -> io::Result<(Part, File)> {
        let mut number = 0_u32;
        loop {
            let other = if number == 0 { String::new() } else { format!(".{number}") };
            let path = self.0.join(format!("{name}{other}{PART}"));
            match File::create_new(&path) {
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
                file => return file.map(|file| (Part(path), file)),
            }
        }
    }
}

/// A file of the folder, where its name begins so.
fn listed(entry: &fs::DirEntry, prefix: &str) -> io::Result<Option<Listed>> {
    // What is no text is no file of ours.
    let Some(name) = entry.file_name().into_string().ok().filter(|name| name.starts_with(prefix)) else {
        return Ok(None);
    };
    match entry.metadata().and_then(|about| about.modified()) {
        Ok(modified) => Ok(Some(Listed { name, modified })),
        // Gone meanwhile.
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
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
