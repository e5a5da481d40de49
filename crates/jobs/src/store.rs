//! The jobs on durable storage: a record a job, and blobs beside it.
//!
//! A blob is on the disk before the record that promises it, and a record is gone before its blobs are. So
//! whenever the program ends, what the records say is true, and blobs that they do not name are
//! leftovers, which the next start removes.
//!
//! Each attempt at a job writes a result of its own, and the record names the one that counts: two workers that both
//! believe to hold a job do not overwrite each other's.

use std::collections::HashSet;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;

use densecloud_blobs::{BlobReader, BlobWriter, Blobs, Folder};
use sha2::{Digest, Sha256};

use crate::error::StoreError;
use crate::record::{Draft, Failure, Record, ResultFile, State, Time};
use crate::records::{Admitted, Bounds, Forgotten, Lapsed, Lease, Load, Records, Submitted};
use crate::sqlite::Sqlite;

/// Jobs that outlive the program. Two stores over the same records and blobs are one store.
#[derive(Clone)]
pub struct Store {
    records: Arc<dyn Records>,
    blobs: Arc<dyn Blobs>,
}

/// A job, and its result where it is done.
pub type Found = (Record, Option<(ResultFile, Box<dyn BlobReader>)>);

fn input_name(id: &str) -> String {
    format!("{id}.in")
}

fn result_name(lease: &Lease) -> String {
    format!("{}.{}.out", lease.record.id, lease.attempt)
}

impl Store {
    /// Over any records and blobs. Others may be at work on them, so nothing is cleaned.
    #[must_use]
    pub fn new(records: Arc<dyn Records>, blobs: Arc<dyn Blobs>) -> Self {
        Self { records, blobs }
    }

    /// Opens a folder with an SQLite database and files beside it, made where it is missing, and brings an older
    /// database up to date. Jobs that were running are queued again, those that were started as often as they may be
    /// fail, and leftovers of files are removed: the folder is this program's alone.
    ///
    /// # Errors
    /// [`StoreError::Locked`], [`StoreError::Version`], or what the disk says.
    pub fn open(folder: &Path, bounds: Bounds, now: Time) -> Result<Self, StoreError> {
        let files = Folder::open(folder.join("files"))?;
        let store = Self::new(Arc::new(Sqlite::open(folder, bounds)?), Arc::new(files));
        // Whoever had a lease has ended.
        store.lapse(Time::MAX, now)?;
        store.clean()?;
        Ok(store)
    }

    /// Removes every blob that no record promises. Others' results that are being written would be among them.
    fn clean(&self) -> Result<(), StoreError> {
        let promised = self.records.promised()?;
        let kept: HashSet<String> =
            promised.into_iter().map(|(id, result)| result.unwrap_or_else(|| input_name(&id))).collect();
        let mut leftovers = self.blobs.list("")?;
        leftovers.retain(|blob| !kept.contains(&blob.name));
        leftovers.iter().try_for_each(|blob| self.blobs.delete(&blob.name))?;
        if !leftovers.is_empty() {
            tracing::info!(removed = leftovers.len(), "removed leftovers of jobs");
        }
        Ok(())
    }

    /// See [`Records::admit`].
    ///
    /// # Errors
    /// As there.
    pub fn admit(&self, draft: &Draft) -> Result<Admitted, StoreError> {
        self.records.admit(draft)
    }

    /// Brings the cloud of a job of this name to durable storage. O(bytes).
    ///
    /// # Errors
    /// What the storage says; nothing is left then.
    pub fn write_input(&self, id: &str, draft: &Draft) -> io::Result<Input> {
        let mut sink = self.blobs.create(&input_name(id))?;
        draft.input().copy_to(&mut sink)?;
        sink.finish()?;
        Ok(Input { id: id.to_owned(), blobs: Arc::clone(&self.blobs), kept: false })
    }

    /// Keeps a job whose cloud is there: when this returns it is on durable storage.
    ///
    /// # Errors
    /// As [`Store::admit`], since another may have been quicker; nothing is left then.
    pub fn insert(&self, draft: &Draft, mut input: Input, now: Time) -> Result<Submitted, StoreError> {
        let submitted = self.records.insert(&input.id, draft, now)?;
        input.kept = matches!(submitted, Submitted::New(_));
        Ok(submitted)
    }

    /// See [`Records::has_room`].
    ///
    /// # Errors
    /// As there.
    pub fn has_room(&self, client: &str) -> Result<(), StoreError> {
        self.records.has_room(client)
    }

    /// See [`Records::load`].
    ///
    /// # Errors
    /// What the database says.
    pub fn load(&self, client: &str) -> Result<Load, StoreError> {
        self.records.load(client)
    }

    /// See [`Records::get`].
    ///
    /// # Errors
    /// What the database says.
    pub fn get(&self, id: &str) -> Result<Option<Record>, StoreError> {
        self.records.get(id)
    }

    /// See [`Records::list`].
    ///
    /// # Errors
    /// What the database says.
    pub fn list(
        &self,
        before: Option<i64>,
        limit: u32,
        owner: Option<&str>,
    ) -> Result<Vec<Record>, StoreError> {
        self.records.list(before, limit, owner)
    }

    /// See [`Records::ahead`].
    ///
    /// # Errors
    /// What the database says.
    pub fn ahead(&self, job: &Record) -> Result<(u64, u64), StoreError> {
        self.records.ahead(job)
    }

    /// See [`Records::counts`].
    ///
    /// # Errors
    /// What the database says.
    pub fn counts(&self) -> Result<[(State, u64); 5], StoreError> {
        self.records.counts()
    }

    /// See [`Records::used`].
    ///
    /// # Errors
    /// What the database says.
    pub fn used(&self) -> Result<u64, StoreError> {
        self.records.used()
    }

    /// Starts the next job: the one whose turn is earliest, or one whose lease has run out. See [`Records::claim`].
    ///
    /// # Errors
    /// What the storage says; no job has been started then.
    pub fn claim(&self, worker: &str, now: Time, until: Time) -> Result<Option<Lease>, StoreError> {
        self.lapse(now, now)?;
        self.records.claim(worker, now, until)
    }

    /// See [`Records::lapse`].
    fn lapse(&self, time: Time, now: Time) -> Result<(), StoreError> {
        for Lapsed { id, attempts, again } in self.records.lapse(time, now)? {
            tracing::warn!(job = id, attempts, again, "job was interrupted");
            if !again {
                self.blobs.delete(&input_name(&id))?;
            }
        }
        Ok(())
    }

    /// See [`Records::beat`].
    ///
    /// # Errors
    /// What the database says.
    pub fn beat(&self, lease: &Lease, until: Time) -> Result<bool, StoreError> {
        self.records.beat(lease, until)
    }

    /// See [`Records::put_back`].
    ///
    /// # Errors
    /// What the storage says.
    pub fn put_back(&self, lease: &Lease) -> Result<bool, StoreError> {
        let put = self.records.put_back(lease)?;
        if put {
            // It may be there whole, where only the record could not be written.
            self.blobs.delete(&result_name(lease))?;
        }
        Ok(put)
    }

    /// See [`Records::defer`].
    ///
    /// # Errors
    /// What the database says.
    pub fn defer(&self, lease: &Lease) -> Result<bool, StoreError> {
        self.records.defer(lease)
    }

    /// Opens a job's cloud.
    ///
    /// # Errors
    /// What the storage says.
    pub fn input(&self, id: &str) -> io::Result<Box<dyn BlobReader>> {
        self.blobs.open(&input_name(id))
    }

    /// Writes a job's result with `fill`, which also gives what is to be told of it. Nobody sees it
    /// before [`Store::done`].
    ///
    /// # Errors
    /// What `fill` gives, or the storage says; nothing is left then.
    pub fn write_result<E: From<io::Error>>(
        &self,
        lease: &Lease,
        fill: impl FnOnce(&mut dyn Write) -> Result<String, E>,
    ) -> Result<ResultFile, E> {
        let blob = result_name(lease);
        let mut sink = Sink { blob: self.blobs.create(&blob)?, hash: Sha256::new(), bytes: 0 };
        let about = fill(&mut sink)?;
        let Sink { blob: writer, hash, bytes } = sink;
        writer.finish()?;
        Ok(ResultFile { blob, bytes, sha256: hex::encode(hash.finalize()), about })
    }

    /// A job is done; false, and the result removed, where the lease is not the job's any more.
    ///
    /// # Errors
    /// What the storage says; the job still runs then.
    pub fn done(&self, lease: &Lease, result: &ResultFile, now: Time) -> Result<bool, StoreError> {
        let id = &lease.record.id;
        let done = self.records.done(lease, result, now)?;
        if done {
            self.blobs.delete(&input_name(id))?;
        } else {
            // Unless it was done under this very lease, and whoever asks has not heard of it.
            let counts = self.records.get(id)?.and_then(|job| job.result).map(|result| result.blob);
            if counts.as_ref() != Some(&result.blob) {
                self.blobs.delete(&result.blob)?;
            }
        }
        Ok(done)
    }

    /// A job has failed; false where the lease is not the job's any more.
    ///
    /// # Errors
    /// What the storage says.
    pub fn failed(&self, lease: &Lease, failure: &Failure, now: Time) -> Result<bool, StoreError> {
        let failed = self.records.failed(lease, failure, now)?;
        if failed {
            self.blobs.delete(&input_name(&lease.record.id))?;
        }
        Ok(failed)
    }

    /// Cancels a job that is queued or running; false where it is neither.
    ///
    /// # Errors
    /// What the storage says.
    pub fn cancel(&self, id: &str, now: Time) -> Result<bool, StoreError> {
        let cancelled = self.records.cancel(id, now)?;
        if cancelled {
            self.blobs.delete(&input_name(id))?;
        }
        Ok(cancelled)
    }

    /// Forgets a job in a final state, and its result; false where there is none.
    ///
    /// # Errors
    /// What the storage says.
    pub fn delete(&self, id: &str) -> Result<bool, StoreError> {
        let Some(forgotten) = self.records.delete(id)? else { return Ok(false) };
        self.forget(&forgotten)?;
        Ok(true)
    }

    /// Forgets jobs that came to their end before `time`, `most` of them at once; says which.
    ///
    /// # Errors
    /// What the storage says.
    pub fn expire(&self, time: Time, most: u32) -> Result<Vec<String>, StoreError> {
        let expired = self.records.expire(time, most)?;
        // All of them, whatever becomes of one.
        let removed: Vec<_> = expired.iter().map(|one| self.forget(one)).collect();
        removed.into_iter().collect::<io::Result<()>>()?;
        Ok(expired.into_iter().map(|one| one.id).collect())
    }

    fn forget(&self, forgotten: &Forgotten) -> io::Result<()> {
        forgotten.blob.as_ref().map_or(Ok(()), |blob| self.blobs.delete(blob))
    }

    /// A job, and its result where it is done. An open result can be read to its end whatever becomes of the job.
    ///
    /// # Errors
    /// What the storage says.
    pub fn result(&self, id: &str) -> Result<Option<Found>, StoreError> {
        let Some(mut job) = self.records.get(id)? else { return Ok(None) };
        let Some(result) = job.result.take() else { return Ok(Some((job, None))) };
        match self.blobs.open(&result.blob) {
            Ok(reader) => Ok(Some((job, Some((result, reader))))),
            // The job may have been deleted between its record and its blob.
            Err(_) if self.records.get(id)?.is_none() => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}

/// A cloud that is there before the record that promises it; removed when dropped, unless the record has
/// come by then.
pub struct Input {
    id: String,
    blobs: Arc<dyn Blobs>,
    kept: bool,
}

impl Drop for Input {
    fn drop(&mut self) {
        if !self.kept {
            // What is left goes at the next start.
            let _ = self.blobs.delete(&input_name(&self.id));
        }
    }
}

/// Writes, counts and hashes.
struct Sink {
    blob: Box<dyn BlobWriter>,
    hash: Sha256,
    bytes: u64,
}

impl Write for Sink {
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
