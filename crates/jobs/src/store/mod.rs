//! The jobs on durable storage: a record a job, and blobs beside it.
//!
//! A blob is on the disk before the record that promises it, and a record is gone before its blobs are. So
//! whenever the program ends, what the records say is true, and blobs that they do not name are
//! leftovers, which the next start removes.
//!
//! Each attempt at a job writes a result of its own, and the record names the one that counts: two workers that both
//! believe to hold a job do not overwrite each other's. So it is with the plan of its tiles, and with the part of each.
//!
//! | file | holds |
//! |---|---|
//! | `files` | the blobs of a job, and how they are named |
//! | `leases` | what a worker says of a step that it has a lease on |
//! | `leftovers` | blobs that nobody needs any more |

mod files;
mod leases;
mod leftovers;

use std::io;
use std::path::Path;
use std::sync::Arc;

use densecloud_blobs::{BlobReader, Blobs, Folder};

use crate::counted::{Counted, Traffic};
use crate::error::StoreError;
use crate::record::{Draft, Record, ResultFile, State, Time};
use crate::records::{Admitted, Bounds, Change, Forgotten, Load, Records, Submitted, Waiting};
use crate::sqlite::Sqlite;
pub use files::{Input, Place, ResultWriter};

use files::input_name;

/// Jobs that outlive the program. Two stores over the same records and blobs are one store.
#[derive(Clone)]
pub struct Store {
    records: Arc<dyn Records>,
    blobs: Arc<dyn Blobs>,
    traffic: Arc<Traffic>,
}

/// A job, and its result where it is done.
pub type Found = (Record, Option<(ResultFile, Box<dyn BlobReader>)>);

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

    /// See [`Records::attend`].
    ///
    /// # Errors
    /// What the database says.
    pub fn attend(&self, process: &str, now: Time) -> Result<Vec<String>, StoreError> {
        self.records.attend(process, now)
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

    fn has_tiles(&self, id: &str) -> Result<bool, StoreError> {
        Ok(self.records.get(id)?.is_some_and(|job| job.tiles.is_some()))
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
