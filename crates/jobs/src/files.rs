//! Files that are there whole or not at all.

use std::collections::HashSet;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// The folder with the clouds and the results of jobs.
#[derive(Debug)]
pub(super) struct Files(PathBuf);

/// What a name ends in while its file is being written.
const PART: &str = ".part";

impl Files {
    /// Makes the folder where it is missing.
    pub(super) fn open(folder: PathBuf) -> io::Result<Self> {
        fs::create_dir_all(&folder)?;
        if let Some(parent) = folder.parent() {
            sync(parent)?;
        }
        Ok(Self(folder))
    }

    pub(super) fn input(&self, id: &str) -> PathBuf {
        self.0.join(format!("{id}.in"))
    }

    pub(super) fn result(&self, id: &str) -> PathBuf {
        self.0.join(format!("{id}.out"))
    }

    /// Writes a file under another name, brings it to the disk and renames it; the name is on the disk,
    /// too, when this returns. A failure leaves nothing.
    pub(super) fn write<T, E: From<io::Error>>(
        &self,
        path: &Path,
        fill: impl FnOnce(&mut dyn Write) -> Result<T, E>,
    ) -> Result<T, E> {
        let mut name = path.as_os_str().to_owned();
        name.push(PART);
        let part = Part(name.into());
        let mut sink = BufWriter::with_capacity(1 << 20, File::create(&part.0)?);
        let value = fill(&mut sink)?;
        sink.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        fs::rename(&part.0, path)?;
        sync(&self.0).inspect_err(|_| {
            // The first error is the one to report; what is left goes at the next start.
            let _ = remove(path);
        })?;
        Ok(value)
    }

    /// Writes a job's cloud. O(bytes), and waits for the disk.
    pub(super) fn write_input(&self, id: &str, bytes: &[u8]) -> io::Result<Input> {
        let path = self.input(id);
        self.write::<_, io::Error>(&path, |sink| sink.write_all(bytes))?;
        Ok(Input { id: id.to_owned(), path, kept: false })
    }

    /// Removes every file but these.
    pub(super) fn keep(&self, names: &HashSet<OsString>) -> io::Result<usize> {
        let mut removed = 0;
        for entry in fs::read_dir(&self.0)? {
            let entry = entry?;
            if !names.contains(&entry.file_name()) {
                remove(&entry.path())?;
                removed += 1;
            }
        }
        Ok(removed)
    }
}

/// A file that is being written; removed when dropped, unless it has got its name by then.
struct Part(PathBuf);

impl Drop for Part {
    fn drop(&mut self) {
        // As above.
        let _ = remove(&self.0);
    }
}

/// A cloud that is on the disk before the row that promises it; removed when dropped, unless the row has
/// come by then.
#[derive(Debug)]
pub struct Input {
    pub(super) id: String,
    path: PathBuf,
    kept: bool,
}

impl Input {
    pub(super) fn keep(&mut self) {
        self.kept = true;
    }
}

impl Drop for Input {
    fn drop(&mut self) {
        if !self.kept {
            // What is left goes at the next start.
            let _ = remove(&self.path);
        }
    }
}

/// Removes a file that may be gone already.
pub(super) fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// A name is on the disk once its folder is.
fn sync(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_leaves_no_file_of_any_name() {
        let dir = tempfile::tempdir().expect("a folder");
        let files = Files::open(dir.path().join("files")).expect("a folder");
        let path = files.result("a");
        let failed: io::Result<()> = files.write(&path, |sink| {
            sink.write_all(b"half")?;
            Err(io::ErrorKind::StorageFull.into())
        });
        assert_eq!(failed.expect_err("full").kind(), io::ErrorKind::StorageFull);
        assert_eq!(fs::read_dir(&files.0).expect("a folder").count(), 0);
        files.write(&path, |sink| sink.write_all(b"whole")).expect("a file");
        assert_eq!(fs::read(&path).expect("a file"), b"whole");
        assert_eq!(files.keep(&HashSet::new()).expect("tidied"), 1);
        assert_eq!(fs::read_dir(&files.0).expect("a folder").count(), 0);
    }
}
