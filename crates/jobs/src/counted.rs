//! Blobs, with a count of the bytes that are read and written.

use std::fs;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use densecloud_blobs::{BlobReader, BlobWriter, Blobs, Listed};

/// Bytes that were read and written.
#[derive(Debug, Default)]
pub(crate) struct Traffic {
    read: AtomicU64,
    written: AtomicU64,
}

impl Traffic {
    /// Those read, and those written.
    pub(crate) fn bytes(&self) -> [u64; 2] {
        [&self.read, &self.written].map(|bytes| bytes.load(Ordering::Relaxed))
    }
}

/// Blobs whose bytes are counted.
pub(crate) struct Counted {
    pub(crate) blobs: Arc<dyn Blobs>,
    pub(crate) traffic: Arc<Traffic>,
}

impl Blobs for Counted {
    fn create(&self, name: &str) -> io::Result<Box<dyn BlobWriter>> {
        Ok(Box::new(Writer { blob: self.blobs.create(name)?, traffic: Arc::clone(&self.traffic) }))
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn BlobReader>> {
        Ok(Box::new(Reader { blob: self.blobs.open(name)?, traffic: Arc::clone(&self.traffic) }))
    }

    fn delete(&self, name: &str) -> io::Result<()> {
        self.blobs.delete(name)
    }

    fn list(&self, prefix: &str) -> io::Result<Vec<Listed>> {
        self.blobs.list(prefix)
    }

    fn keep(&self, name: &str, file: &Path) -> io::Result<()> {
        let bytes = fs::metadata(file)?.len();
        self.blobs.keep(name, file)?;
        self.traffic.written.fetch_add(bytes, Ordering::Relaxed);
        Ok(())
    }

    fn fetch(&self, name: &str, to: &Path) -> io::Result<()> {
        self.blobs.fetch(name, to)?;
        self.traffic.read.fetch_add(fs::metadata(to)?.len(), Ordering::Relaxed);
        Ok(())
    }
}

struct Writer {
    blob: Box<dyn BlobWriter>,
    traffic: Arc<Traffic>,
}

impl Write for Writer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.blob.write(bytes)?;
        self.traffic.written.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.blob.flush()
    }
}

impl BlobWriter for Writer {
    fn finish(self: Box<Self>) -> io::Result<()> {
        self.blob.finish()
    }
}

struct Reader {
    blob: Box<dyn BlobReader>,
    traffic: Arc<Traffic>,
}

impl Read for Reader {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = self.blob.read(bytes)?;
        self.traffic.read.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }
}

impl Seek for Reader {
    fn seek(&mut self, place: SeekFrom) -> io::Result<u64> {
        self.blob.seek(place)
    }
}

impl BlobReader for Reader {
    fn length(&self) -> io::Result<u64> {
        self.blob.length()
    }
}
