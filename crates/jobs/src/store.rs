//! The jobs on disk: a database with a row a job, and files beside it.
//!
//! A file is on the disk before the row that promises it, and a row is gone before its files are. So
//! whenever the program ends, what the database says is true, and files that it does not name are
//! leftovers, which the next start removes.

use std::collections::HashSet;
use std::ffi::OsString;
use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use rusqlite::{Connection, ErrorCode, OptionalExtension, params};
use sha2::{Digest, Sha256};

use super::database::{self, find, integer, json, load, natural, select, used};
use super::files::{self, Files, Input};
use super::record::{Draft, Failure, Record, ResultFile, State, Time};
use densecloud::provenance::hexadecimal;

/// Jobs that outlive the program.
#[derive(Debug)]
pub struct Store {
    // A mutex: SQLite takes one writer at a time anyway, and each statement takes microseconds, or one
    // wait for the disk.
    connection: Mutex<Connection>,
    files: Files,
    bounds: Bounds,
    // Held while the store is open: two programs would run the same jobs.
    _lock: File,
}

/// What a store may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// Bytes that all jobs may take.
    pub disk: u64,
    /// Jobs that may be queued or running.
    pub jobs: u64,
    /// The same of one client.
    pub client_jobs: u64,
}

/// What is queued or running.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Load {
    /// Jobs.
    pub jobs: u64,
    /// Their points out.
    pub points: u64,
    /// Clients that have one.
    pub clients: u64,
    /// Jobs of the client that asks.
    pub own: u64,
}

/// Whether a job may come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Admitted {
    /// There is room for it; this will be its name.
    New(String),
    /// The job that the same request made earlier.
    Known(Box<Record>),
}

/// A job, and its result where it is done.
pub type Found = (Record, Option<(ResultFile, File)>);

/// What became of a request for a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Submitted {
    /// A job that was not there before.
    New(Record),
    /// The job that the same request made earlier.
    Known(Record),
}

/// Why the store does not do what it is asked for.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The jobs would take more of the disk than they may.
    #[error("jobs take {used} bytes of the disk and this one would take {wanted} more, above {limit}")]
    OverBudget {
        /// What all jobs take.
        used: u64,
        /// What this one would take.
        wanted: u64,
        /// What they may take.
        limit: u64,
    },
    /// As many jobs are queued or running as may.
    #[error("{queued} jobs are queued or running; {limit} may be")]
    Full {
        /// How many there are.
        queued: u64,
        /// How many there may be.
        limit: u64,
    },
    /// As many jobs of the client are queued or running as may.
    #[error("{queued} jobs of this client are queued or running; {limit} may be")]
    ClientFull {
        /// How many there are.
        queued: u64,
        /// How many there may be.
        limit: u64,
    },
    /// The key belongs to another request.
    #[error("the key belongs to another request")]
    OtherRequest,
    /// Another program has the folder open.
    #[error("another densecloud has this folder open")]
    Locked,
    /// Another version of the program made the database.
    #[error("the database has version {0}, not {current}", current = database::VERSION)]
    Version(i64),
    /// Reading or writing a file failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Reading or writing the database failed.
    #[error("the database: {0}")]
    Database(#[from] rusqlite::Error),
}

impl StoreError {
    /// Whether there is no room on the disk, or for so large a file.
    #[must_use]
    pub fn is_full(&self) -> bool {
        match self {
            Self::Io(error) => {
                use io::ErrorKind as Kind;
                matches!(error.kind(), Kind::StorageFull | Kind::QuotaExceeded | Kind::FileTooLarge)
            }
            Self::Database(error) => error.sqlite_error_code() == Some(ErrorCode::DiskFull),
            _ => false,
        }
    }

    /// Whether another program kept the database for itself for longer than a statement waits.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        matches!(self, Self::Database(error) if matches!(
            error.sqlite_error_code(), Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked)
        ))
    }
}

impl Store {
    /// Opens the folder, made where it is missing, and brings an older database up to date. Jobs that were
    /// running are queued again, those that were started `attempts` times already fail, and leftovers of
    /// files are removed.
    ///
    /// # Errors
    /// [`StoreError::Locked`], [`StoreError::Version`], or what the disk says.
    pub fn open(folder: &Path, bounds: Bounds, attempts: u32, now: Time) -> Result<Self, StoreError> {
        let files = Files::open(folder.join("files"))?;
        let lock = File::create(folder.join("lock"))?;
        lock.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => StoreError::Locked,
            TryLockError::Error(error) => error.into(),
        })?;
        let connection = database::open(&folder.join("jobs.sqlite"))?;
        let store = Self { connection: Mutex::new(connection), files, bounds, _lock: lock };
        store.recover(attempts, now)?;
        Ok(store)
    }

    fn recover(&self, attempts: u32, now: Time) -> Result<(), StoreError> {
        let database = self.database();
        // Names alone: there may be many rows, and long ones.
        let pairs = |sql| {
            let mut statement = database.prepare(sql)?;
            let rows = statement.query_map([], |row| Ok((row.get(0)?, row.get(1)?)))?;
            rows.collect::<Result<Vec<(String, u32)>, _>>()
        };
        for (id, made) in pairs("SELECT id, attempts FROM jobs WHERE state = 'running'")? {
            if made < attempts {
                database.execute("UPDATE jobs SET state = 'queued' WHERE id = ?", [&id])?;
            } else {
                let failure = json(&Failure::GaveUp { attempts: made });
                database.execute(FAIL, params![now, failure, id])?;
            }
            tracing::warn!(job = id, attempts = made, again = made < attempts, "job was interrupted");
        }
        let promised = pairs("SELECT id, state = 'done' FROM jobs WHERE state IN ('queued', 'done')")?;
        let file = |(id, done): &(String, u32)| match done {
            0 => self.files.input(id),
            _ => self.files.result(id),
        };
        let kept: HashSet<OsString> =
            promised.iter().filter_map(|one| file(one).file_name().map(OsString::from)).collect();
        let removed = self.files.keep(&kept)?;
        if removed > 0 {
            tracing::info!(removed, "removed leftovers of jobs");
        }
        Ok(())
    }

    /// Nothing panics while it is held, so a poisoned lock is still sound.
    fn database(&self) -> MutexGuard<'_, Connection> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a job may come: to be asked before its cloud is written.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::ClientFull`], [`StoreError::OverBudget`],
    /// [`StoreError::OtherRequest`], or what the database says.
    pub fn admit(&self, draft: &Draft) -> Result<Admitted, StoreError> {
        let database = self.database();
        if let Some(known) = self.known(&database, draft)? {
            return Ok(Admitted::Known(Box::new(known)));
        }
        let id = database.query_row("SELECT lower(hex(randomblob(16)))", [], |row| row.get(0))?;
        Ok(Admitted::New(id))
    }

    /// Brings the cloud of a job of this name to the disk. O(bytes).
    ///
    /// # Errors
    /// What the disk says; nothing is left then.
    pub fn write_input(&self, id: &str, draft: &Draft) -> io::Result<Input> {
        self.files.write_input(id, draft.input())
    }

    /// Keeps a job whose cloud is there: when this returns it is on the disk.
    ///
    /// # Errors
    /// As [`Store::admit`], since another may have been quicker; nothing is left then.
    pub fn insert(&self, draft: &Draft, mut input: Input, now: Time) -> Result<Submitted, StoreError> {
        // One lock for question and insertion: no other job comes between.
        let database = self.database();
        if let Some(known) = self.known(&database, draft)? {
            return Ok(Submitted::Known(known));
        }
        let job = &draft.job;
        database.execute(
            "INSERT INTO jobs (id, state, request, owner, client, key, fingerprint, request_id, points_in, \
             points_out, row_bytes, bytes, created, turn) VALUES (?, 'queued', ?, ?, ?4, ?, ?, ?, ?, ?, ?, ?, ?, \
             1 + max((SELECT clock FROM totals), (SELECT coalesce(max(turn), 0) FROM jobs \
             WHERE client = ?4 AND state IN ('queued', 'running'))))",
            params![
                input.id,
                job.request,
                job.owner,
                job.client,
                job.key,
                draft.fingerprint,
                job.request_id,
                integer(job.points_in),
                integer(job.points_out),
                integer(draft.row_bytes),
                integer(draft.bytes()),
                now
            ],
        )?;
        input.keep();
        let new = find(&database, &input.id)?.ok_or(rusqlite::Error::QueryReturnedNoRows)?;
        Ok(Submitted::New(new))
    }

    /// The job that this request made earlier, or none where there is room for a new one.
    fn known(&self, database: &Connection, draft: &Draft) -> Result<Option<Record>, StoreError> {
        let (job, wanted) = (&draft.job, draft.bytes());
        if let Some(key) = &job.key {
            let known: Option<(String, String)> = database
                .query_row(
                    "SELECT id, fingerprint FROM jobs WHERE owner = ? AND key = ?",
                    [&job.owner, key],
                    |row| Ok((row.get(0)?, row.get(1)?)),
                )
                .optional()?;
            match known {
                Some((id, same)) if same == draft.fingerprint => return find(database, &id),
                Some(_) => return Err(StoreError::OtherRequest),
                None => {}
            }
        }
        self.check(database, &job.client)?;
        let (used, limit) = (used(database)?, self.bounds.disk);
        if used.saturating_add(wanted) > limit {
            return Err(StoreError::OverBudget { used, wanted, limit });
        }
        Ok(None)
    }

    fn check(&self, database: &Connection, client: &str) -> Result<(), StoreError> {
        let Load { jobs, own, .. } = load(database, client)?;
        let Bounds { jobs: limit, client_jobs, .. } = self.bounds;
        if own >= client_jobs {
            return Err(StoreError::ClientFull { queued: own, limit: client_jobs });
        }
        if jobs >= limit {
            return Err(StoreError::Full { queued: jobs, limit });
        }
        Ok(())
    }

    /// Whether one more job of a client may wait; to refuse it before its cloud has arrived.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::ClientFull`], or what the database says.
    pub fn has_room(&self, client: &str) -> Result<(), StoreError> {
        self.check(&self.database(), client)
    }

    /// What is queued or running.
    ///
    /// # Errors
    /// What the database says.
    pub fn load(&self, client: &str) -> Result<Load, StoreError> {
        load(&self.database(), client)
    }

    /// A job by its name.
    ///
    /// # Errors
    /// What the database says.
    pub fn get(&self, id: &str) -> Result<Option<Record>, StoreError> {
        find(&self.database(), id)
    }

    /// The newest jobs, at most `limit`, before the one of number `before`; of one owner, if one is given.
    ///
    /// # Errors
    /// What the database says.
    pub fn list(
        &self,
        before: Option<i64>,
        limit: u32,
        owner: Option<&str>,
    ) -> Result<Vec<Record>, StoreError> {
        let before = before.unwrap_or(i64::MAX);
        let which = "WHERE number < ?1 AND (?3 IS NULL OR owner = ?3) ORDER BY number DESC LIMIT ?2";
        select(&self.database(), which, params![before, limit, owner])
    }

    /// How many queued jobs are before this one, and their points out: those of its client, and as many of each
    /// other's.
    ///
    /// # Errors
    /// What the database says.
    pub fn ahead(&self, job: &Record) -> Result<(u64, u64), StoreError> {
        let sql = "SELECT count(*), coalesce(sum(points_out), 0) FROM jobs
            WHERE state = 'queued' AND (turn, number) < (?, ?)";
        let ahead = self.database().query_row(sql, [job.turn, job.number], |row| {
            Ok((row.get(0).map(natural)?, row.get(1).map(natural)?))
        })?;
        Ok(ahead)
    }

    /// How many jobs there are in each state.
    ///
    /// # Errors
    /// What the database says.
    pub fn counts(&self) -> Result<[(State, u64); 5], StoreError> {
        let database = self.database();
        let mut counts = State::ALL.map(|state| (state, 0));
        for (state, count) in &mut counts {
            let sql = "SELECT count(*) FROM jobs WHERE state = ?";
            *count = database.query_row(sql, [state.name()], |row| row.get(0).map(natural))?;
        }
        Ok(counts)
    }

    /// Bytes on the disk that jobs take, rows included, or will when they are done. O(1).
    ///
    /// # Errors
    /// What the database says.
    pub fn used(&self) -> Result<u64, StoreError> {
        used(&self.database())
    }

    /// Starts the next job: the one whose turn is earliest.
    ///
    /// Fair queueing by start times, as live requests have it, with jobs all of one length: a job's turn is one
    /// after that of its client's job before it, and no earlier than one after the clock, which is the turn of
    /// the last job that was started. So clients take turns, and one that comes anew is served soon but not
    /// before those that wait: the turns that are left before a job's are taken by finitely many.
    ///
    /// # Errors
    /// What the database says; no job has been started then.
    pub fn claim(&self, now: Time) -> Result<Option<Record>, StoreError> {
        let database = self.database();
        let which = "WHERE state = 'queued' ORDER BY turn, number LIMIT 1";
        let Some(next) = select(&database, which, [])?.pop() else { return Ok(None) };
        database.execute(
            "UPDATE jobs SET state = 'running', attempts = attempts + 1, started = ? WHERE id = ?",
            params![now, next.id],
        )?;
        find(&database, &next.id)
    }

    /// Puts a running job back to its place in the queue, as if it had not been started.
    ///
    /// # Errors
    /// What the database says.
    pub fn put_back(&self, id: &str) -> Result<bool, StoreError> {
        Ok(self.database().execute(PUT_BACK, [id])? > 0)
    }

    /// As [`Store::put_back`], for one that finds no room at the moment: its turn has been taken, and it and its
    /// client's later ones go on to the next.
    ///
    /// # Errors
    /// What the database says.
    pub fn defer(&self, id: &str) -> Result<bool, StoreError> {
        let mut database = self.database();
        let transaction = database.transaction()?;
        let put = transaction.execute(PUT_BACK, [id])? > 0;
        if put {
            let sql = "UPDATE jobs SET turn = jobs.turn + totals.clock + 1 - this.turn
                FROM totals, (SELECT client, turn, number FROM jobs WHERE id = ?) AS this
                WHERE jobs.client = this.client AND jobs.state = 'queued' AND jobs.number >= this.number";
            transaction.execute(sql, [id])?;
        }
        transaction.commit()?;
        Ok(put)
    }

    /// The file of a job's cloud.
    ///
    /// # Errors
    /// What the disk says.
    pub fn input(&self, id: &str) -> io::Result<Vec<u8>> {
        fs::read(self.files.input(id))
    }

    /// Writes a job's result with `fill`, which also gives what is to be told of it. Nobody sees the file
    /// before [`Store::done`].
    ///
    /// # Errors
    /// What `fill` gives, or the disk says; nothing is left then.
    pub fn write_result<E: From<io::Error>>(
        &self,
        id: &str,
        fill: impl FnOnce(&mut dyn Write) -> Result<String, E>,
    ) -> Result<ResultFile, E> {
        self.files.write(&self.files.result(id), |file| {
            let mut sink = Sink { file, hash: Sha256::new(), bytes: 0 };
            let about = fill(&mut sink)?;
            Ok(ResultFile { bytes: sink.bytes, sha256: hexadecimal(&sink.hash.finalize()), about })
        })
    }

    /// A running job is done; false, and its result removed, where it does not run any more.
    ///
    /// # Errors
    /// What the disk says; the job still runs then.
    pub fn done(&self, id: &str, result: &ResultFile, now: Time) -> Result<bool, StoreError> {
        let done = self.database().execute(
            "UPDATE jobs SET state = 'done', finished = ?1, result = ?2, \
             bytes = row_bytes + octet_length(?2) + ?3 WHERE id = ?4 AND state = 'running'",
            params![now, json(result), integer(result.bytes), id],
        )? > 0;
        // What is left of a job that was put back is its cloud.
        if done {
            files::remove(&self.files.input(id))?;
        } else {
            files::remove(&self.files.result(id))?;
        }
        Ok(done)
    }

    /// A running job has failed; false where it does not run any more.
    ///
    /// # Errors
    /// What the disk says.
    pub fn failed(&self, id: &str, failure: &Failure, now: Time) -> Result<bool, StoreError> {
        let failed = self.database().execute(FAIL, params![now, json(failure), id])? > 0;
        if failed {
            files::remove(&self.files.input(id))?;
        }
        Ok(failed)
    }

    /// Cancels a job that is queued or running; false where it is neither.
    ///
    /// # Errors
    /// What the disk says.
    pub fn cancel(&self, id: &str, now: Time) -> Result<bool, StoreError> {
        let cancelled = self.database().execute(
            "UPDATE jobs SET state = 'cancelled', finished = ?, bytes = row_bytes \
             WHERE id = ? AND state IN ('queued', 'running')",
            params![now, id],
        )? > 0;
        if cancelled {
            files::remove(&self.files.input(id))?;
        }
        Ok(cancelled)
    }

    /// Forgets a job in a final state, and its result; false where there is none.
    ///
    /// # Errors
    /// What the disk says.
    pub fn delete(&self, id: &str) -> Result<bool, StoreError> {
        let sql = "DELETE FROM jobs WHERE id = ? AND state IN ('done', 'failed', 'cancelled')";
        let deleted = self.database().execute(sql, [id])? > 0;
        if deleted {
            files::remove(&self.files.result(id))?;
        }
        Ok(deleted)
    }

    /// Forgets jobs that came to their end before `time`, `most` of them at once; says which.
    ///
    /// # Errors
    /// What the disk says.
    pub fn expire(&self, time: Time, most: u32) -> Result<Vec<String>, StoreError> {
        let sql = "DELETE FROM jobs WHERE number IN (SELECT number FROM jobs WHERE finished < ? LIMIT ?)
            RETURNING id";
        let expired = {
            let database = self.database();
            let mut statement = database.prepare_cached(sql)?;
            let rows = statement.query_map(params![time, most], |row| row.get(0))?;
            rows.collect::<Result<Vec<String>, _>>()?
        };
        // All of them, whatever becomes of one.
        let removed: Vec<_> = expired.iter().map(|id| files::remove(&self.files.result(id))).collect();
        removed.into_iter().collect::<io::Result<()>>()?;
        Ok(expired)
    }

    /// A job, and its result where it is done. An open file can be read to its end whatever becomes of the job.
    ///
    /// # Errors
    /// What the disk says.
    pub fn result(&self, id: &str) -> Result<Option<Found>, StoreError> {
        // The lock keeps the job from being deleted between its row and its file.
        let database = self.database();
        let Some(mut job) = find(&database, id)? else { return Ok(None) };
        let result = match job.result.take() {
            Some(result) => Some((result, File::open(self.files.result(id))?)),
            None => None,
        };
        Ok(Some((job, result)))
    }
}

const PUT_BACK: &str = "UPDATE jobs SET state = 'queued', attempts = attempts - 1, started = NULL \
                        WHERE id = ? AND state = 'running'";

const FAIL: &str = "UPDATE jobs SET state = 'failed', finished = ?1, failure = ?2, \
                    bytes = row_bytes + octet_length(?2) WHERE id = ?3 AND state = 'running'";

/// Writes, counts and hashes.
struct Sink<'a> {
    file: &'a mut dyn Write,
    hash: Sha256,
    bytes: u64,
}

impl Write for Sink<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.hash.update(&bytes[..count]);
        self.bytes += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
