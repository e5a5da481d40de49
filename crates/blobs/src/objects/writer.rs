//! An object that is written in parts, one sent while the next is filled.

use std::io::{self, Write};
use std::sync::Arc;

use object_store::path::Path;
use object_store::{MultipartUpload, ObjectStoreExt, PutPayload};

use super::Place;
use super::calls::Call;
use crate::blobs::BlobWriter;

/// Bytes of each of the first parts.
const PART: usize = 8 << 20;
/// So many of them; those after them are larger, since stores take 10,000 of an object.
const SMALL: u32 = 5000;
/// Bytes of each of those: 377 GB in all.
const LARGE: usize = 64 << 20;

/// Writes an object: at once where it is small, else in parts. Takes up to two parts of memory.
pub(super) struct Writer {
    place: Arc<Place>,
    path: Path,
    part: Vec<u8>,
    /// Parts that were sent.
    sent: u32,
    upload: Option<Box<dyn MultipartUpload>>,
    sending: Option<Call<()>>,
    /// A part is missing, so there is no object to come.
    failed: bool,
}

impl Writer {
    pub(super) fn new(place: Arc<Place>, path: Path) -> Self {
        Self { place, path, part: Vec::new(), sent: 0, upload: None, sending: None, failed: false }
    }

    fn size(&self) -> usize {
        if self.sent < SMALL { PART } else { LARGE }
    }

    /// Waits for the part that is on its way.
    fn arrived(&mut self) -> io::Result<()> {
        let sent = self.sending.take().map_or(Ok(()), Call::wait);
        self.failed |= sent.is_err();
        sent
    }

    /// Sends what is there as a part.
    fn send(&mut self) -> io::Result<()> {
        self.arrived()?;
        let mut upload = match self.upload.take() {
            Some(upload) => upload,
            None => {
                let (store, path) = (Arc::clone(&self.place.store), self.path.clone());
                let begun =
                    self.place.call(self.path.as_ref(), async move { store.put_multipart(&path).await });
                begun.inspect_err(|_| self.failed = true)?
            }
        };
        let part = upload.put_part(std::mem::take(&mut self.part).into());
        self.upload = Some(upload);
        self.sending = Some(self.place.begin(self.path.as_ref(), part));
        self.sent += 1;
        Ok(())
    }

    fn put(&mut self) -> io::Result<()> {
        let bytes = PutPayload::from(std::mem::take(&mut self.part));
        let (store, path) = (Arc::clone(&self.place.store), self.path.clone());
        self.place.call(self.path.as_ref(), async move { store.put(&path, bytes).await }).map(drop)
    }

    /// All parts become the object, or none.
    fn complete(&mut self, mut upload: Box<dyn MultipartUpload>) -> io::Result<()> {
        self.place.call(self.path.as_ref(), async move {
            match upload.complete().await {
                Ok(_) => Ok(()),
                Err(error) => {
                    // The first error is the one to report.
                    let _ = upload.abort().await;
                    Err(error)
                }
            }
        })
    }
}

impl Write for Writer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.failed {
            return Err(io::Error::other("a part of this blob was not written"));
        }
        let count = bytes.len().min(self.size() - self.part.len());
        self.part.extend_from_slice(&bytes[..count]);
        if self.part.len() == self.size() {
            self.send()?;
        }
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl BlobWriter for Writer {
    fn finish(mut self: Box<Self>) -> io::Result<()> {
        if self.failed {
            return Err(io::Error::other("a part of this blob was not written"));
        }
        if self.upload.is_none() {
            return self.put();
        }
        if !self.part.is_empty() {
            self.send()?;
        }
        self.arrived()?;
        self.upload.take().map_or(Ok(()), |upload| self.complete(upload))
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        if let Some(sending) = self.sending.take() {
            sending.cancel();
        }
        if let Some(mut upload) = self.upload.take() {
            // What is left then goes by the bucket's own rule.
            let _ = self.place.call(self.path.as_ref(), async move { upload.abort().await });
        }
    }
}
