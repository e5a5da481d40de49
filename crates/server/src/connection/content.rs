//! A body as it arrives: in memory while it is short, else in a temporary file without a name, with its beginning in memory.

use std::fs::File;
use std::io::{self, Cursor, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use axum::body::Bytes;

use densecloud_formats::{CloudReader, FormatError, Limits, Reading};

/// Most bytes that a body takes in memory where it may lie on the disk.
pub(crate) const IN_MEMORY: usize = 8 << 20;

/// What has arrived so far.
#[derive(Debug, Default)]
pub(crate) struct Arriving {
    /// All of it, or, where there is a file, its beginning.
    head: Vec<u8>,
    file: Option<File>,
    length: u64,
    /// Where such files lie; none where all is to stay in memory.
    temp: Option<PathBuf>,
}

/// All that arrived. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct Content {
    head: Bytes,
    file: Option<Arc<File>>,
    length: u64,
}

impl Arriving {
    /// Nothing yet. What is long goes to a file in this folder.
    pub(crate) fn new(temp: Option<&Path>) -> Self {
        Self { temp: temp.map(Path::to_owned), ..Self::default() }
    }

    /// The beginning of it, or all.
    pub(crate) fn head(&self) -> &[u8] {
        &self.head
    }

    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// Whether more of it goes to the disk, so that taking it blocks.
    pub(crate) fn is_on_disk(&self, more: usize) -> bool {
        self.file.is_some() || self.temp.is_some() && self.head.len() + more > IN_MEMORY
    }

    /// How much more memory so many bytes take; none where they go to the disk.
    pub(crate) fn grows(&self, more: usize) -> u64 {
        if self.is_on_disk(more) { 0 } else { more as u64 }
    }

    /// How much more of the disk so many bytes take, where the first of them take those before them there.
    pub(crate) fn grows_on_disk(&self, more: usize) -> u64 {
        match self.is_on_disk(more) {
            true if self.file.is_some() => more as u64,
            true => (self.head.len() + more) as u64,
            false => 0,
        }
    }

    /// Takes further bytes.
    ///
    /// # Errors
    /// [`io::ErrorKind::OutOfMemory`], or what the disk says.
    pub(crate) fn add(&mut self, bytes: &[u8]) -> io::Result<()> {
        match (&mut self.file, &self.temp) {
            (Some(file), _) => file.write_all(bytes)?,
            (None, Some(temp)) if self.head.len() + bytes.len() > IN_MEMORY => {
                std::fs::create_dir_all(temp)?;
                let mut file = tempfile::tempfile_in(temp)?;
                file.write_all(&self.head)?;
                file.write_all(bytes)?;
                self.file = Some(file);
            }
            _ => {
                self.head.try_reserve(bytes.len()).map_err(|_| io::ErrorKind::OutOfMemory)?;
                self.head.extend_from_slice(bytes);
            }
        }
        self.length += bytes.len() as u64;
        Ok(())
    }

    pub(crate) fn finish(self) -> Content {
        let Self { head, file, length, .. } = self;
        Content { head: head.into(), file: file.map(Into::into), length }
    }
}

impl Content {
    /// The beginning of it, or, where it is in memory, all.
    pub(crate) fn head(&self) -> &[u8] {
        &self.head
    }

    pub(crate) fn length(&self) -> u64 {
        self.length
    }

    /// Opens the cloud in it. There is one reader at a time.
    ///
    /// # Errors
    /// As [`CloudReader::open_as`] and [`CloudReader::open_file_as`].
    pub(crate) fn open(
        &self,
        limits: Limits,
        reading: &Reading,
    ) -> Result<CloudReader<'static>, FormatError> {
        let Some(file) = &self.file else {
            return CloudReader::open_as(Cursor::new(self.head.clone()), limits, reading);
        };
        let mut file = file.try_clone()?;
        file.rewind()?;
        CloudReader::open_file_as(file, limits, reading)
    }

    /// Writes all of it.
    ///
    /// # Errors
    /// The sink fails, or the disk.
    pub(crate) fn copy_to(&self, sink: &mut dyn Write) -> io::Result<()> {
        let Some(file) = &self.file else { return sink.write_all(&self.head) };
        let mut file = file.try_clone()?;
        file.rewind()?;
        io::copy(&mut file, sink).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_long_lies_on_the_disk_and_comes_back_whole() {
        let folder = tempfile::tempdir().expect("a folder");
        let piece: Vec<u8> = (0..IN_MEMORY / 4 + 1).map(|i| (i % 251) as u8).collect();
        for temp in [None, Some(folder.path())] {
            let (mut arriving, mut sent) = (Arriving::new(temp), Vec::new());
            let (mut held, mut on_disk) = (0, 0);
            for _ in 0..7 {
                held += arriving.grows(piece.len());
                on_disk += arriving.grows_on_disk(piece.len());
                arriving.add(&piece).expect("room");
                sent.extend_from_slice(&piece);
                assert_eq!(arriving.length(), sent.len() as u64);
                assert_eq!(held as usize, arriving.head().len());
            }
            assert_eq!(arriving.is_on_disk(1), temp.is_some());
            assert_eq!(on_disk, if temp.is_some() { sent.len() as u64 } else { 0 });
            assert!(temp.is_none() || held as usize <= IN_MEMORY);
            let content = arriving.finish();
            assert!(sent.starts_with(content.head()) && content.length() == sent.len() as u64);
            for _ in 0..2 {
                let mut all = Vec::new();
                content.copy_to(&mut all).expect("all of it");
                assert!(all == sent);
            }
        }
        // Nothing of it has a name.
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0);
    }
}
