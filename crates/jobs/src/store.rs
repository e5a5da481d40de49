//! The jobs on durable storage: a record a job, and blobs beside it.
//!
//! A blob is on the disk before the record that promises it, and a record is gone before its blobs are. So
//! whenever the program ends, what the records say is true, and blobs that they do not name are
//! leftovers, which the next start removes.
//!
//! Each attempt at a job writes a result of its own, and the record names the one that counts: two workers that both
//! believe to hold a job do not overwrite each other's. So it is with the plan of its tiles, and with the part of each.

use std::collections::HashSet;
use std::io::{self, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::SystemTime;

use densecloud_blobs::{BlobReader, BlobWriter, Blobs, Folder, Listed};
use sha2::{Digest, Sha256};

use crate::counted::{Counted, Traffic};
use crate::error::StoreError;
use crate::record::{Draft, Failure, Record, ResultFile, State, Time};
use crate::records::{
    Admitted, Bounds, Change, Forgotten, Lapsed, Lease, Load, Promised, Records, Step, Submitted, Waiting,
};
use crate::sqlite::Sqlite;

/// Jobs that outlive the program. Two stores over the same records and blobs are one store.
#[derive(Clone)]
pub struct Store {
    records: Arc<dyn Records>,
    blobs: Arc<dyn Blobs>,
    traffic: Arc<Traffic>,
}

/// A job, and its result where it is done.
pub type Found = (Record, Option<(ResultFile, Box<dyn BlobReader>)>);

fn input_name(id: &str) -> String {
    format!("{id}.in")
}

fn result_name(lease: &Lease) -> String {
    format!("{}.{}.out", lease.record.id, lease.attempt)
}

/// The job that a blob is of.
fn job_of(blob: &str) -> &str {
    blob.split_once('.').map_or(blob, |(id, _)| id)
}

/// What the names of the blobs begin with that an attempt writes for others: its plan, or its part.
fn shared_name(lease: &Lease) -> String {
    match lease.step {
        Step::Tile(tile) => format!("{}.{}.part{tile}", lease.record.id, lease.attempt),
        Step::Whole | Step::Join => format!("{}.{}.plan", lease.record.id, lease.attempt),
    }
}

impl Store {
    /// Over any records and blobs. Others may be at work on them, so nothing is cleaned.
    #[must_use]
    pub fn new(records: Arc<dyn Records>, blobs: Arc<dyn Blobs>) -> Self {
        let traffic = Arc::<Traffic>::default();
        let counted = Counted { blobs, traffic: Arc::clone(&traffic) };
        Self { records, blobs: Arc::new(counted), traffic }
    }

    /// Bytes that were read from and written to the blobs so far.
    #[must_use]
    pub fn traffic(&self) -> [u64; 2] {
        self.traffic.bytes()
    }

    /// Opens a folder with an SQLite database and files beside it, made where it is missing, and brings an older
    /// database up to date. Jobs that were running are queued again, those that were started as often as they may be
    /// fail, and leftovers of files are removed: the folder is this program's alone.
    ///
    /// # Errors
    /// [`StoreError::Locked`], [`StoreError::Version`], or what the disk says.
    pub fn open(folder: &Path, bounds: Bounds, now: Time) -> Result<Self, StoreError> {
        let files = Folder::open(folder.join("files"))?;
        Self::alone(Arc::new(Sqlite::open(folder, bounds)?), Arc::new(files), now)
    }

    /// Over records and blobs that are this program's alone.
    pub(crate) fn alone(
        records: Arc<dyn Records>,
        blobs: Arc<dyn Blobs>,
        now: Time,
    ) -> Result<Self, StoreError> {
        let store = Self::new(records, blobs);
        // Whoever had a lease has ended.
        store.lapse(Time::MAX, now)?;
        store.clean()?;
        Ok(store)
    }

    /// Removes every blob that no record promises. Others' results that are being written would be among them.
    fn clean(&self) -> Result<(), StoreError> {
        let (mut names, mut of_tiles) = (HashSet::new(), HashSet::new());
        for promised in self.records.promised()? {
            match promised {
                Promised::Input(id) => names.insert(input_name(&id)),
                Promised::Tiles(id) => of_tiles.insert(id),
                Promised::Result(blob) => names.insert(blob),
            };
        }
        self.remove_others(|blob| names.contains(&blob.name) || of_tiles.contains(job_of(&blob.name)))
    }

    /// Removes blobs that nobody needs, where others may be at work: those that are older than `before`, of jobs that are
    /// over or unknown, but for results.
    ///
    /// # Errors
    /// What the storage says.
    pub fn collect(&self, before: SystemTime) -> Result<(), StoreError> {
        let (mut results, mut open) = (HashSet::new(), HashSet::new());
        for promised in self.records.promised()? {
            match promised {
                Promised::Input(id) | Promised::Tiles(id) => open.insert(id),
                Promised::Result(blob) => results.insert(blob),
            };
        }
        self.remove_others(|blob| {
            blob.modified >= before || results.contains(&blob.name) || open.contains(job_of(&blob.name))
        })
    }

    fn remove_others(&self, is_kept: impl Fn(&Listed) -> bool) -> Result<(), StoreError> {
        let mut leftovers = self.blobs.list("")?;
        leftovers.retain(|blob| !is_kept(blob));
        leftovers.iter().try_for_each(|blob| self.blobs.delete(&blob.name))?;
        if !leftovers.is_empty() {
            tracing::info!(removed = leftovers.len(), "removed leftovers of jobs");
        }
        Ok(())
    }

    /// Removes the blobs of a job that is over, but for its result.
    fn sweep(&self, id: &str, has_tiles: bool, result: Option<&str>) -> io::Result<()> {
        if !has_tiles {
            return self.blobs.delete(&input_name(id));
        }
        let blobs = self.blobs.list(&format!("{id}."))?;
        let mut others = blobs.iter().filter(|blob| Some(&*blob.name) != result);
        others.try_for_each(|blob| self.blobs.delete(&blob.name))
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
    /// As [`Store::admit`], since another may have been quicker; nothing is left then, unless [`StoreError::is_unsure`].
    pub fn insert(&self, draft: &Draft, mut input: Input, now: Time) -> Result<Submitted, StoreError> {
        let submitted = self.records.insert(&input.id, draft, now);
        // The record may be there, and promises it then.
        input.kept = submitted.as_ref().is_err_and(StoreError::is_unsure);
        let submitted = submitted?;
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

    /// See [`Records::listen`].
    pub(crate) fn listen(&self, wake: Arc<dyn Fn(Change) + Send + Sync>) {
        self.records.listen(wake);
    }

    /// See [`Records::waiting`].
    ///
    /// # Errors
    /// What the database says.
    pub fn waiting(&self) -> Result<Waiting, StoreError> {
        self.records.waiting()
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
        for Lapsed { id, tile, attempts, again } in self.records.lapse(time, now)? {
            tracing::warn!(job = id, tile, attempts, again, "job was interrupted");
            if !again {
                self.sweep(&id, self.has_tiles(&id)?, None)?;
            }
        }
        Ok(())
    }

    fn has_tiles(&self, id: &str) -> Result<bool, StoreError> {
        Ok(self.records.get(id)?.is_some_and(|job| job.tiles.is_some()))
    }

    /// See [`Records::attend`].
    ///
    /// # Errors
    /// What the database says.
    pub fn attend(&self, process: &str, now: Time) -> Result<Vec<String>, StoreError> {
        self.records.attend(process, now)
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
            self.discard(lease)?;
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

    /// The plan of a job's tiles is in the place of the lease; see [`Records::split`]. False, and the plan removed, where
    /// the lease is not the job's any more.
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

    /// A tile's part is in the place of the lease, and has so many points; see [`Records::tile_done`]. False, and the part
    /// removed, where the lease is not the tile's any more.
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

    /// See [`Records::parts`].
    ///
    /// # Errors
    /// What the database says.
    pub fn parts(&self, id: &str) -> Result<Vec<(u32, String)>, StoreError> {
        self.records.parts(id)
    }

    /// See [`Records::unsplit`].
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
        let name = result_name(lease);
        Ok(ResultWriter { blob: self.blobs.create(&name)?, name, hash: Sha256::new(), bytes: 0 })
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

    /// Cancels a job that is queued or running; false where it is neither.
    ///
    /// # Errors
    /// What the storage says.
    pub fn cancel(&self, id: &str, now: Time) -> Result<bool, StoreError> {
        let cancelled = self.records.cancel(id, now)?;
        if cancelled {
            self.sweep(id, self.has_tiles(id)?, None)?;
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
