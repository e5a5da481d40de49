//! What a worker says of a step that it has a lease on, and the blobs that it reads and writes.

use std::io;
use std::sync::Arc;

use densecloud_blobs::BlobReader;

use super::Store;
use super::files::{Place, ResultWriter, input_name, result_name, shared_name};
use crate::error::StoreError;
use crate::record::{Failure, Record, ResultFile, Time};
use crate::records::{Lapsed, Lease};

impl Store {
    /// Starts the next job: the one whose turn is earliest, or one whose lease has run out. See
    /// [`Records::claim`](crate::Records::claim).
    ///
    /// # Errors
    /// What the storage says; no job has been started then.
    pub fn claim(&self, worker: &str, now: Time, until: Time) -> Result<Option<Lease>, StoreError> {
        self.lapse(now, now)?;
        self.records.claim(worker, now, until)
    }

    /// See [`Records::lapse`](crate::Records::lapse).
    pub(super) fn lapse(&self, time: Time, now: Time) -> Result<(), StoreError> {
        for Lapsed { id, tile, attempts, again } in self.records.lapse(time, now)? {
            tracing::warn!(job = id, tile, attempts, again, "job was interrupted");
            if !again {
                self.sweep(&id, self.has_tiles(&id)?, None)?;
            }
        }
        Ok(())
    }

    /// See [`Records::beat`](crate::Records::beat).
    ///
    /// # Errors
    /// What the database says.
    pub fn beat(&self, lease: &Lease, until: Time) -> Result<bool, StoreError> {
        self.records.beat(lease, until)
    }

    /// A step has failed of what is the matter with this machine; see [`Records::retry`](crate::Records::retry).
    ///
    /// # Errors
    /// What the storage says.
    pub fn retry(&self, lease: &Lease, failure: &Failure, now: Time) -> Result<Option<bool>, StoreError> {
        let waits = self.records.retry(lease, failure, now)?;
        if waits == Some(false) {
            self.sweep(&lease.record.id, lease.record.tiles.is_some(), None)?;
        }
        Ok(waits)
    }

    /// See [`Records::put_back`](crate::Records::put_back).
    ///
    /// # Errors
    /// What the storage says.
    pub fn put_back(&self, lease: &Lease) -> Result<bool, StoreError> {
        let put = self.records.put_back(lease)?;
        if put {
            // It may be there whole, where only the record could not be written.
            self.blobs.delete(&result_name(lease))?;
            self.discard(lease)?;
        }
        Ok(put)
    }

    /// See [`Records::defer`](crate::Records::defer).
    ///
    /// # Errors
    /// What the database says.
    pub fn defer(&self, lease: &Lease) -> Result<bool, StoreError> {
        self.records.defer(lease)
    }

    /// Where whoever has a lease puts blobs that other steps of the job need, and finds theirs.
    #[must_use]
    pub fn place(&self, lease: &Lease) -> Place {
        let plan = lease.record.tiles.as_ref().map(|tiles| tiles.plan.clone());
        let input = input_name(&lease.record.id);
        Place { blobs: Arc::clone(&self.blobs), input, own: shared_name(lease), plan }
    }

    /// Removes what an attempt has put into its [place](Self::place).
    ///
    /// # Errors
    /// What the storage says.
    pub fn discard(&self, lease: &Lease) -> io::Result<()> {
        let own = self.blobs.list(&shared_name(lease))?;
        own.iter().try_for_each(|blob| self.blobs.delete(&blob.name))
    }

    /// The plan of a job's tiles is in the place of the lease; see [`Records::split`](crate::Records::split). False,
    /// and the plan removed, where the lease is not the job's any more.
    ///
    /// # Errors
    /// What the storage says; the job still runs then.
    pub fn split(&self, lease: &Lease, sizes: &[u64], bytes: u64) -> Result<bool, StoreError> {
        let plan = shared_name(lease);
        let split = self.records.split(lease, &plan, sizes, bytes)?;
        if !split {
            // Unless it was split under this very lease, and whoever asks has not heard of it.
            let counts =
                self.records.get(&lease.record.id)?.and_then(|job| job.tiles).map(|tiles| tiles.plan);
            if counts.as_ref() != Some(&plan) {
                self.discard(lease)?;
            }
        }
        Ok(split)
    }

    /// A tile's part is in the place of the lease, and has so many points; see
    /// [`Records::tile_done`](crate::Records::tile_done). False, and the part removed, where the lease is not the
    /// tile's any more.
    ///
    /// # Errors
    /// What the storage says; the tile still runs then.
    pub fn tile_done(&self, lease: &Lease, points: u64) -> Result<bool, StoreError> {
        let part = shared_name(lease);
        let done = self.records.tile_done(lease, &part, points)?;
        if !done && !self.records.parts(&lease.record.id)?.iter().any(|(_, blob)| *blob == part) {
            self.discard(lease)?;
        }
        Ok(done)
    }

    /// See [`Records::parts`](crate::Records::parts).
    ///
    /// # Errors
    /// What the database says.
    pub fn parts(&self, id: &str) -> Result<Vec<(u32, String)>, StoreError> {
        self.records.parts(id)
    }

    /// See [`Records::unsplit`](crate::Records::unsplit).
    ///
    /// # Errors
    /// What the storage says.
    pub fn unsplit(&self, lease: &Lease) -> Result<bool, StoreError> {
        let unsplit = self.records.unsplit(lease)?;
        if unsplit {
            let blobs = self.blobs.list(&format!("{}.", lease.record.id))?;
            let input = input_name(&lease.record.id);
            blobs
                .iter()
                .filter(|blob| blob.name != input)
                .try_for_each(|blob| self.blobs.delete(&blob.name))?;
        }
        Ok(unsplit)
    }

    /// Opens a job's cloud.
    ///
    /// # Errors
    /// What the storage says.
    pub fn input(&self, id: &str) -> io::Result<Box<dyn BlobReader>> {
        self.blobs.open(&input_name(id))
    }

    /// Begins a job's result. Nobody sees it before [`Store::done`].
    ///
    /// # Errors
    /// What the storage says.
    pub fn result_writer(&self, lease: &Lease) -> io::Result<ResultWriter> {
        ResultWriter::create(&*self.blobs, result_name(lease))
    }

    /// A job is done; false, and the result removed, where the lease is not the job's any more.
    ///
    /// # Errors
    /// What the storage says; the job still runs then.
    pub fn done(&self, lease: &Lease, result: &ResultFile, now: Time) -> Result<bool, StoreError> {
        let Record { id, tiles, .. } = &lease.record;
        let done = self.records.done(lease, result, now)?;
        if done {
            self.sweep(id, tiles.is_some(), Some(&result.blob))?;
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
            self.sweep(&lease.record.id, lease.record.tiles.is_some(), None)?;
        }
        Ok(failed)
    }
}
