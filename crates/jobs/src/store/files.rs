//! The blobs of a job, and how they are named.

use std::io::{self, Write};
use std::sync::Arc;

use densecloud_blobs::{BlobWriter, Blobs};
use sha2::{Digest, Sha256};

use crate::record::ResultFile;
use crate::records::{Lease, Step};

pub(super) fn input_name(id: &str) -> String {
    format!("{id}.in")
}

pub(super) fn result_name(lease: &Lease) -> String {
    format!("{}.{}.out", lease.record.id, lease.attempt)
}

/// The job that a blob is of.
pub(super) fn job_of(blob: &str) -> &str {
    blob.split_once('.').map_or(blob, |(id, _)| id)
}

/// What the names of the blobs begin with that an attempt writes for others: its plan, or its part.
pub(super) fn shared_name(lease: &Lease) -> String {
    match lease.step {
        Step::Tile(tile) => format!("{}.{}.part{tile}", lease.record.id, lease.attempt),
        Step::Whole | Step::Join => format!("{}.{}.plan", lease.record.id, lease.attempt),
    }
}

/// A cloud that is there before the record that promises it; removed when dropped, unless the record has
/// come by then.
pub struct Input {
    pub(super) id: String,
    pub(super) blobs: Arc<dyn Blobs>,
    pub(super) kept: bool,
}

impl Drop for Input {
    fn drop(&mut self) {
        if !self.kept {
            // What is left goes at the next start.
            let _ = self.blobs.delete(&input_name(&self.id));
        }
    }
}

/// Blobs of one job, that its steps leave for each other.
#[derive(Clone)]
pub struct Place {
    /// Where they are.
    pub blobs: Arc<dyn Blobs>,
    /// The name of the job's cloud.
    pub input: String,
    /// What the names of those begin with that this step writes: those of the plan, or of the tile's part.
    pub own: String,
    /// The same of the plan that is worked by.
    pub plan: Option<String>,
}

/// A result that is being written, counted and hashed; dropped before it is finished, it leaves nothing.
pub struct ResultWriter {
    name: String,
    blob: Box<dyn BlobWriter>,
    hash: Sha256,
    bytes: u64,
}

impl ResultWriter {
    pub(super) fn create(blobs: &dyn Blobs, name: String) -> io::Result<Self> {
        Ok(Self { blob: blobs.create(&name)?, name, hash: Sha256::new(), bytes: 0 })
    }

    /// Brings it to durable storage, with what is to be told of it.
    ///
    /// # Errors
    /// What the storage says; nothing is left then.
    pub fn finish(self, about: String) -> io::Result<ResultFile> {
        let Self { name: blob, blob: writer, hash, bytes } = self;
        writer.finish()?;
        Ok(ResultFile { blob, bytes, sha256: hex::encode(hash.finalize()), about })
    }
}

impl Write for ResultWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.blob.write(bytes)?;
        self.hash.update(&bytes[..count]);
        self.bytes += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.blob.flush()
    }
}
