//! Records as rows of an SQLite database, for one program at a time.

pub(crate) mod rows;
mod schema;

use std::fs::{File, TryLockError};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use rusqlite::{Connection, Params, Row, params};

use crate::error::StoreError;
use crate::record::{Draft, Failure, Record, ResultFile, State, Time};
use crate::records::{Admitted, Bounds, Forgotten, Lapsed, Lease, Load, Records, Submitted};
use rows::{
    COLUMNS, change, collect, failed, failure_text, find, integer, load, natural, one, result_text, select,
    used,
};

/// Records in an SQLite database.
#[derive(Debug)]
pub struct Sqlite {
    // A mutex: SQLite takes one writer at a time anyway, and each statement takes microseconds, or one
    // wait for the disk.
    connection: Mutex<Connection>,
    bounds: Bounds,
    // Held while the database is open: only then are all leases those of this program, and [`Records::lapse`] may
    // take all that it finds for lost.
    _lock: File,
}

/// Of the row that a lease is on: `?1` is its job, `?2` its attempt.
const HELD: &str = "id = ?1 AND claims = ?2 AND state = 'running'";

const FREE: &str = "worker = NULL, until = NULL";

impl Sqlite {
    /// Opens the database in a folder that is there, made where it is missing, and brings an older one up to date.
    ///
    /// # Errors
    /// [`StoreError::Locked`], [`StoreError::Version`], or what the disk says.
    pub fn open(folder: &Path, bounds: Bounds) -> Result<Self, StoreError> {
        let lock = File::create(folder.join("lock"))?;
        lock.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => StoreError::Locked,
            TryLockError::Error(error) => error.into(),
        })?;
        let connection = schema::open(&folder.join("jobs.sqlite"))?;
        Ok(Self { connection: Mutex::new(connection), bounds, _lock: lock })
    }

    /// Nothing panics while it is held, so a poisoned lock is still sound.
    fn database(&self) -> MutexGuard<'_, Connection> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The job that this request made earlier, or none where there is room for a new one.
    fn known(&self, database: &Connection, draft: &Draft) -> Result<Option<Record>, StoreError> {
        let (job, wanted) = (&draft.job, draft.bytes());
        if let Some(key) = &job.key {
            let sql = "SELECT id, fingerprint FROM jobs WHERE owner = ? AND key = ?";
            let pair = |row: &Row<'_>| Ok((row.get(0)?, row.get(1)?));
            let known: Option<(String, String)> = collect(database, sql, [&job.owner, key], pair)?.pop();
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

    /// Changes the row that a lease is on; false where it is on none any more.
    fn set(&self, set: &str, values: impl Params) -> Result<bool, StoreError> {
        change(&self.database(), &format!("UPDATE jobs SET {set} WHERE {HELD}"), values)
    }
}

impl Records for Sqlite {
    fn admit(&self, draft: &Draft) -> Result<Admitted, StoreError> {
        let database = self.database();
        if let Some(known) = self.known(&database, draft)? {
            return Ok(Admitted::Known(Box::new(known)));
        }
        let id = one(&database, "SELECT lower(hex(randomblob(16)))", [], |row| row.get(0))?;
        Ok(Admitted::New(id))
    }

    fn has_room(&self, client: &str) -> Result<(), StoreError> {
        self.check(&self.database(), client)
    }

    fn insert(&self, id: &str, draft: &Draft, now: Time) -> Result<Submitted, StoreError> {
        // One lock for question and insertion: no other job comes between.
        let database = self.database();
        if let Some(known) = self.known(&database, draft)? {
            return Ok(Submitted::Known(known));
        }
        let job = &draft.job;
        change(
            &database,
            "INSERT INTO jobs (id, state, request, owner, client, key, fingerprint, request_id, points_in, \
             points_out, row_bytes, bytes, created, turn) VALUES (?, 'queued', ?, ?, ?4, ?, ?, ?, ?, ?, ?, ?, ?, \
             1 + max((SELECT clock FROM totals), (SELECT coalesce(max(turn), 0) FROM jobs \
             WHERE client = ?4 AND state IN ('queued', 'running'))))",
            params![
                id,
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
        let new = select(&database, "WHERE id = ?", [id])?.pop();
        new.map(Submitted::New).ok_or_else(|| failed(rusqlite::Error::QueryReturnedNoRows))
    }

    fn claim(&self, worker: &str, now: Time, until: Time) -> Result<Option<Lease>, StoreError> {
        let sql = format!(
            "UPDATE jobs SET state = 'running', attempts = attempts + 1, started = ?2, claims = claims + 1, \
             worker = ?1, until = ?3 \
             WHERE id = (SELECT id FROM jobs WHERE state = 'queued' ORDER BY turn, number LIMIT 1) \
             RETURNING {COLUMNS}, claims, worker, until"
        );
        Ok(collect(&self.database(), &sql, params![worker, now, until], rows::lease)?.pop())
    }

    fn lapse(&self, time: Time, now: Time) -> Result<Vec<Lapsed>, StoreError> {
        let most = self.bounds.attempts;
        let mut database = self.database();
        // Most of the time there is none, and nothing to write.
        let sql = "SELECT id, attempts FROM jobs WHERE state = 'running' AND until <= ?";
        let lapsed = collect(&database, sql, [time], |row| {
            let attempts = row.get(1)?;
            Ok(Lapsed { id: row.get(0)?, attempts, again: attempts < most })
        })?;
        if lapsed.is_empty() {
            return Ok(lapsed);
        }
        let transaction = database.transaction().map_err(failed)?;
        for Lapsed { id, attempts, again } in &lapsed {
            if *again {
                let sql = format!("UPDATE jobs SET state = 'queued', {FREE} WHERE id = ?");
                change(&transaction, &sql, [id])?;
            } else {
                let failure = failure_text(&Failure::GaveUp { attempts: *attempts });
                let sql = "UPDATE jobs SET state = 'failed', finished = ?2, failure = ?3, \
                           bytes = row_bytes + octet_length(?3) WHERE id = ?1";
                change(&transaction, sql, params![id, now, failure])?;
            }
        }
        transaction.commit().map_err(failed)?;
        Ok(lapsed)
    }

    fn beat(&self, lease: &Lease, until: Time) -> Result<bool, StoreError> {
        self.set("until = ?3", params![lease.record.id, integer(lease.attempt), until])
    }

    fn done(&self, lease: &Lease, result: &ResultFile, now: Time) -> Result<bool, StoreError> {
        let set = "state = 'done', finished = ?3, result = ?4, blob = ?5, \
                   bytes = row_bytes + octet_length(?4) + ?6";
        let text = result_text(result);
        let (id, attempt, bytes) = (&lease.record.id, integer(lease.attempt), integer(result.bytes));
        self.set(set, params![id, attempt, now, text, result.blob, bytes])
    }

    fn failed(&self, lease: &Lease, failure: &Failure, now: Time) -> Result<bool, StoreError> {
        let set = "state = 'failed', finished = ?3, failure = ?4, bytes = row_bytes + octet_length(?4)";
        self.set(set, params![lease.record.id, integer(lease.attempt), now, failure_text(failure)])
    }

    fn put_back(&self, lease: &Lease) -> Result<bool, StoreError> {
        self.set(&put_back(), params![lease.record.id, integer(lease.attempt)])
    }

    fn defer(&self, lease: &Lease) -> Result<bool, StoreError> {
        let id = &lease.record.id;
        let mut database = self.database();
        let transaction = database.transaction().map_err(failed)?;
        let sql = format!("UPDATE jobs SET {} WHERE {HELD}", put_back());
        let put = change(&transaction, &sql, params![id, integer(lease.attempt)])?;
        if put {
            let sql = "UPDATE jobs SET turn = jobs.turn + totals.clock + 1 - this.turn
                FROM totals, (SELECT client, turn, number FROM jobs WHERE id = ?) AS this
                WHERE jobs.client = this.client AND jobs.state = 'queued' AND jobs.number >= this.number";
            change(&transaction, sql, [id])?;
        }
        transaction.commit().map_err(failed)?;
        Ok(put)
    }

    fn cancel(&self, id: &str, now: Time) -> Result<bool, StoreError> {
        let sql = "UPDATE jobs SET state = 'cancelled', finished = ?, bytes = row_bytes \
                   WHERE id = ? AND state IN ('queued', 'running')";
        change(&self.database(), sql, params![now, id])
    }

    fn delete(&self, id: &str) -> Result<Option<Forgotten>, StoreError> {
        let sql =
            "DELETE FROM jobs WHERE id = ? AND state IN ('done', 'failed', 'cancelled') RETURNING id, blob";
        Ok(collect(&self.database(), sql, [id], forgotten)?.pop())
    }

    fn expire(&self, time: Time, most: u32) -> Result<Vec<Forgotten>, StoreError> {
        let sql = "DELETE FROM jobs WHERE number IN (SELECT number FROM jobs WHERE finished < ? LIMIT ?)
            RETURNING id, blob";
        collect(&self.database(), sql, params![time, most], forgotten)
    }

    fn get(&self, id: &str) -> Result<Option<Record>, StoreError> {
        find(&self.database(), id)
    }

    fn list(&self, before: Option<i64>, limit: u32, owner: Option<&str>) -> Result<Vec<Record>, StoreError> {
        let before = before.unwrap_or(i64::MAX);
        let which = "WHERE number < ?1 AND (?3 IS NULL OR owner = ?3) ORDER BY number DESC LIMIT ?2";
        select(&self.database(), which, params![before, limit, owner])
    }

    fn ahead(&self, job: &Record) -> Result<(u64, u64), StoreError> {
        let sql = "SELECT count(*), coalesce(sum(points_out), 0) FROM jobs
            WHERE state = 'queued' AND (turn, number) < (?, ?)";
        one(&self.database(), sql, [job.turn, job.number], |row| {
            Ok((row.get(0).map(natural)?, row.get(1).map(natural)?))
        })
    }

    fn counts(&self) -> Result<[(State, u64); 5], StoreError> {
        let database = self.database();
        let mut counts = State::ALL.map(|state| (state, 0));
        for (state, count) in &mut counts {
            let sql = "SELECT count(*) FROM jobs WHERE state = ?";
            *count = one(&database, sql, [state.name()], |row| row.get(0).map(natural))?;
        }
        Ok(counts)
    }

    fn load(&self, client: &str) -> Result<Load, StoreError> {
        load(&self.database(), client)
    }

    fn used(&self) -> Result<u64, StoreError> {
        used(&self.database())
    }

    fn promised(&self) -> Result<Vec<(String, Option<String>)>, StoreError> {
        // Names alone: there may be many rows, and long ones.
        let sql = "SELECT id, blob FROM jobs WHERE state IN ('queued', 'running', 'done')";
        collect(&self.database(), sql, [], |row| Ok((row.get(0)?, row.get(1)?)))
    }
}

fn put_back() -> String {
    format!("state = 'queued', attempts = attempts - 1, started = NULL, {FREE}")
}

fn forgotten(row: &Row<'_>) -> rusqlite::Result<Forgotten> {
    Ok(Forgotten { id: row.get(0)?, blob: row.get(1)? })
}
