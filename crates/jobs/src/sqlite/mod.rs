//! Records as rows of an SQLite database, for one program at a time.

mod rows;
mod schema;
mod steps;

use std::fs::{File, TryLockError};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};

use rusqlite::{Connection, Params, Row, params};

use crate::columns::{ANEW, FREE, NEW, TILE_ROW, integer, natural, result_text};
use crate::error::StoreError;
use crate::record::{Draft, Failure, Record, ResultFile, State, Time};
use crate::records::{
    Admitted, Bounds, Forgotten, Lapsed, Lease, Load, Promised, Records, Step, Submitted, Waiting,
};
use rows::{change, collect, failed, find, load, one, select, used};
use steps::{
    BY_TILE, HELD, TILE_HELD, attempts, fail, free, held, lapse, next, next_turn, put_back, start, start_tile,
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

    /// Changes the job that a lease is on; false where it is on none any more.
    fn set(&self, set: &str, values: impl Params) -> Result<bool, StoreError> {
        change(&self.database(), &format!("UPDATE jobs SET {set} WHERE {HELD}"), values)
    }

    /// Changes several rows at once, or none.
    fn together<T>(
        &self,
        change: impl FnOnce(&Connection) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        let mut database = self.database();
        let transaction = database.transaction().map_err(failed)?;
        let changed = change(&transaction)?;
        transaction.commit().map_err(failed)?;
        Ok(changed)
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
        let sql = format!(
            "INSERT INTO jobs ({NEW}, state, turn) VALUES (?, ?, ?, ?4, ?, ?, ?, ?, ?, ?, ?, ?, 'queued', {})",
            next_turn("?4")
        );
        change(
            &database,
            &sql,
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
        self.together(|database| match next(database)? {
            None => Ok(None),
            Some((id, Step::Tile(tile))) => start_tile(database, &id, tile, worker, until),
            Some((id, step)) => start(database, &id, step, worker, [now, until]),
        })
    }

    fn lapse(&self, time: Time, now: Time) -> Result<Vec<Lapsed>, StoreError> {
        let most = self.bounds.attempts;
        self.together(|database| {
            let sql = "SELECT id, NULL, attempts FROM jobs WHERE state = 'running' AND until <= ?1 \
                       UNION ALL SELECT job, tile, attempts FROM tiles WHERE state = 'running' AND until <= ?1";
            // Most of the time there is none, and nothing to write.
            let mut lapsed = collect(database, sql, [time], |row| {
                let attempts = row.get(2)?;
                Ok(Lapsed { id: row.get(0)?, tile: row.get(1)?, attempts, again: attempts < most })
            })?;
            let mut kept = Vec::new();
            for one in lapsed.drain(..) {
                if lapse(database, &one, now)? {
                    kept.push(one);
                }
            }
            Ok(kept)
        })
    }

    fn beat(&self, lease: &Lease, until: Time) -> Result<bool, StoreError> {
        let (table, held_by) = match lease.step {
            Step::Tile(_) => ("tiles", TILE_HELD),
            Step::Whole | Step::Join => ("jobs", HELD),
        };
        let (id, attempt) = held(lease);
        let sql = format!("UPDATE {table} SET until = ?3 WHERE {held_by}");
        change(&self.database(), &sql, params![id, attempt, until])
    }

    fn split(&self, lease: &Lease, plan: &str, sizes: &[u64], bytes: u64) -> Result<bool, StoreError> {
        let (id, attempt) = held(lease);
        self.together(|database| {
            let sql = format!(
                "UPDATE jobs SET {FREE}, claims = claims + 1, attempts = 0, waits = 1, plan = ?3, tiles = ?4, \
                 tiles_done = 0, points_done = 0, tile_bytes = ?5, bytes = bytes + ?5, turn = {} WHERE {HELD}",
                next_turn("?6")
            );
            let count = sizes.len() as u32;
            let bytes = integer(bytes.saturating_add(u64::from(count) * TILE_ROW));
            let split = change(database, &sql, params![id, attempt, plan, count, bytes, lease.record.client])?;
            for tile in 0..if split { count } else { 0 } {
                let sql = "INSERT INTO tiles (job, tile, state) VALUES (?, ?, 'waiting')";
                change(database, sql, params![id, tile])?;
            }
            Ok(split)
        })
    }

    fn tile_done(&self, lease: &Lease, part: &str, points: u64) -> Result<bool, StoreError> {
        let (id, attempt) = held(lease);
        self.together(|database| {
            let sql = format!("UPDATE tiles SET state = 'done', blob = ?3, {FREE} WHERE {TILE_HELD}");
            let done = change(database, &sql, params![id, attempt, part])?;
            if done {
                let sql = "UPDATE jobs SET tiles_done = tiles_done + 1, points_done = points_done + ?2, \
                           waits = max(waits, tiles_done + 1 = tiles) WHERE id = ?1";
                change(database, sql, params![id, integer(points)])?;
            }
            Ok(done)
        })
    }

    fn parts(&self, id: &str) -> Result<Vec<(u32, String)>, StoreError> {
        let sql = "SELECT tile, blob FROM tiles WHERE job = ? AND state = 'done' ORDER BY tile";
        collect(&self.database(), sql, [id], |row| Ok((row.get(0)?, row.get(1)?)))
    }

    fn unsplit(&self, lease: &Lease) -> Result<bool, StoreError> {
        let (id, attempt) = held(lease);
        let which = if let Step::Tile(_) = lease.step { BY_TILE } else { HELD };
        self.together(|database| {
            let sql = format!("UPDATE jobs SET {ANEW} WHERE {which}");
            let unsplit = change(database, &sql, params![id, attempt])?;
            if unsplit {
                change(database, "DELETE FROM tiles WHERE job = ?", [id])?;
            }
            Ok(unsplit)
        })
    }

    fn done(&self, lease: &Lease, result: &ResultFile, now: Time) -> Result<bool, StoreError> {
        let set = "state = 'done', finished = ?3, result = ?4, blob = ?5, waits = 0, \
                   bytes = row_bytes + octet_length(?4) + ?6";
        let text = result_text(result);
        let (id, attempt, bytes) = (&lease.record.id, integer(lease.attempt), integer(result.bytes));
        self.set(set, params![id, attempt, now, text, result.blob, bytes])
    }

    fn failed(&self, lease: &Lease, failure: &Failure, now: Time) -> Result<bool, StoreError> {
        fail(&self.database(), lease, failure, now)
    }

    fn retry(&self, lease: &Lease, failure: &Failure, now: Time) -> Result<Option<bool>, StoreError> {
        self.together(|database| {
            let Some(attempts) = attempts(database, lease)? else { return Ok(None) };
            let again = attempts < self.bounds.attempts;
            let changed = if again {
                free(database, &lease.record.id, lease.step.tile())?
            } else {
                fail(database, lease, failure, now)?
            };
            Ok(changed.then_some(again))
        })
    }

    fn put_back(&self, lease: &Lease) -> Result<bool, StoreError> {
        self.together(|database| put_back(database, lease))
    }

    fn defer(&self, lease: &Lease) -> Result<bool, StoreError> {
        let id = &lease.record.id;
        self.together(|database| {
            let put = put_back(database, lease)?;
            if put && lease.step == Step::Whole {
                let sql = "UPDATE jobs SET turn = jobs.turn + totals.clock + 1 - this.turn
                    FROM totals, (SELECT client, turn, number FROM jobs WHERE id = ?) AS this
                    WHERE jobs.client = this.client AND jobs.state = 'queued' AND jobs.number >= this.number";
                change(database, sql, [id])?;
            } else if put {
                let sql = format!("UPDATE jobs SET turn = {} WHERE id = ?1", next_turn("?2"));
                change(database, &sql, [id, &lease.record.client])?;
            }
            Ok(put)
        })
    }

    fn cancel(&self, id: &str, now: Time) -> Result<bool, StoreError> {
        let sql = "UPDATE jobs SET state = 'cancelled', finished = ?, bytes = row_bytes, waits = 0 \
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
        let sql = "SELECT count(*), coalesce(sum(points_out - points_done), 0) FROM jobs
            WHERE waits AND (turn, number) < (?, ?)";
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

    fn waiting(&self) -> Result<Waiting, StoreError> {
        let sql = "SELECT count(*) FILTER (WHERE tiles IS NULL), \
                   (SELECT count(*) FROM tiles WHERE state = 'waiting'), \
                   count(*) FILTER (WHERE tiles_done = tiles), \
                   min(created) FILTER (WHERE tiles IS NULL) FROM jobs WHERE waits";
        one(&self.database(), sql, [], |row| {
            let number = |column: usize| row.get(column).map(natural);
            let (whole, tiles, joins) = (number(0)?, number(1)?, number(2)?);
            // The lock is its own alone.
            Ok(Waiting { whole, tiles, joins, oldest: row.get(3)?, processes: 1 })
        })
    }

    fn load(&self, client: &str) -> Result<Load, StoreError> {
        load(&self.database(), client)
    }

    fn used(&self) -> Result<u64, StoreError> {
        used(&self.database())
    }

    fn promised(&self) -> Result<Vec<Promised>, StoreError> {
        // Names alone: there may be many rows, and long ones.
        let sql = "SELECT id, tiles, blob FROM jobs WHERE state IN ('queued', 'running', 'done')";
        collect(&self.database(), sql, [], |row| {
            let (id, tiles, blob): (_, Option<u32>, Option<String>) = (row.get(0)?, row.get(1)?, row.get(2)?);
            let no_result = || if tiles.is_some() { Promised::Tiles(id) } else { Promised::Input(id) };
            Ok(blob.map_or_else(no_result, Promised::Result))
        })
    }
}

fn forgotten(row: &Row<'_>) -> rusqlite::Result<Forgotten> {
    Ok(Forgotten { id: row.get(0)?, blob: row.get(1)? })
}
