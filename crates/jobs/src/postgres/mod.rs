//! Records as rows of a Postgres database, which many programs on many machines share.
//!
//! | file | holds |
//! |---|---|
//! | `address`, `password`, `tls` | where the database is, and how it is reached |
//! | `connection` | connections |
//! | `calls` | calls that end by a deadline, whatever becomes of the database |
//! | `trouble` | what went wrong, as the caller sees it |
//! | `admission` | whether a job may come, and its row |
//! | `happened` | whether a change was kept of which nobody heard |
//! | `schema` | the tables, and how those of earlier versions become them |
//! | `rows`, `steps` | rows as values; steps of jobs |
//! | `kinds` | programs of several versions or models side by side |
//! | `clock`, `connector`, `listen` | the database's time, and what it tells |

mod address;
mod admission;
mod calls;
mod clock;
mod connection;
mod connector;
mod happened;
mod kinds;
mod listen;
mod password;
mod rows;
mod schema;
mod steps;
mod tls;
mod trouble;

use std::cell::RefCell;
use std::sync::Arc;

use deadpool_postgres::Client;
use tokio_postgres::Row;

use crate::clock::Clock;
use crate::columns::{ANEW, FREE, TILE_ROW, integer, natural, result_text};
use crate::error::StoreError;
use crate::record::{Draft, Failure, Record, ResultFile, State, Time};
use crate::records::{
    Admitted, Bounds, Change, Forgotten, Lapsed, Lease, Load, Promised, Records, Step, Submitted, Waiting,
};
pub use address::{Address, AddressError};
pub use connection::Limits;
pub use password::Password;

use connection::Database;
use rows::{change, collect, find, load, one, select, small, used};
use steps::{
    BY_TILE, HELD, TILE_HELD, attempts, claim, claimed, fail, free, held, lapse, next_turn, pass, put_back,
};
use trouble::Failed;

/// Records in a Postgres database. Each call ends by a deadline: where the database is not there by then, as an error
/// that [`StoreError::is_away`].
///
/// What changes a row comes one after another, over all programs, by a lock that each transaction takes first. So turns and
/// limits are as exact as in one program, and nothing waits in a circle.
pub struct Postgres {
    database: Database,
    kind: String,
    bounds: Bounds,
}

impl Postgres {
    /// Connects, makes the tables where there are none, and brings older ones up to date. Programs of a kind give the
    /// same bytes: what comes to one of them is done by those alone.
    ///
    /// # Errors
    /// [`StoreError::Version`], or what the database says, or the system.
    pub fn open(
        address: &Address,
        password: Option<&Password>,
        limits: Limits,
        kind: &str,
        bounds: Bounds,
    ) -> Result<Self, StoreError> {
        let database = Database::new(address, password, limits)?;
        let schema = &address.schema;
        if !database.prepare(async |transaction| schema::is_current(transaction, schema).await)? {
            database.prepare(async |transaction| schema::migrate(transaction, schema).await)?;
        }
        // The time, and whether there is the right to change anything, and to wait for the disk.
        database.set("SELECT 1", &[], async |_| Ok(true))?;
        Ok(Self { database, kind: kind.to_owned(), bounds })
    }

    /// The database's clock, by which leases go: it is the same for all machines.
    #[must_use]
    pub fn clock(&self) -> Arc<dyn Clock> {
        Arc::clone(&self.database.clock) as Arc<dyn Clock>
    }

    /// Has a database do statements.
    #[cfg(test)]
    pub(crate) fn execute(address: &Address, password: &Password, sql: &str) -> Result<(), StoreError> {
        let database = Database::new(address, Some(password), Limits::default())?;
        database.prepare(async |transaction| Ok(transaction.batch_execute(sql).await?))
    }

    /// What makes the tables as the first version had them.
    #[cfg(test)]
    pub(crate) fn first() -> String {
        schema::first()
    }

    /// What anybody may ask whose answer is one number.
    #[cfg(test)]
    pub(crate) fn ask(&self, sql: &str) -> i64 {
        let read = |row: &Row| Ok(row.try_get(0)?);
        self.database.read(async |database| one(database, sql, &[], read).await).expect("a number")
    }

    /// Forgets jobs in a final state. What was found, and is not there any more though this never heard of its end, it
    /// takes for its own: whoever forgot it, nobody needs its blob.
    fn forget(&self, which: &str, values: rows::Values<'_>) -> Result<Vec<Forgotten>, StoreError> {
        let earlier: RefCell<Vec<Forgotten>> = RefCell::default();
        self.database.write(async |database, _| {
            let found =
                collect(database, &format!("SELECT id, blob FROM jobs WHERE {which}"), values, forgotten)
                    .await?;
            let ids: Vec<&str> = found.iter().map(|one| &*one.id).collect();
            change(database, "DELETE FROM jobs WHERE id = ANY($1)", &[&ids]).await?;
            let mut all = earlier.borrow_mut();
            all.retain(|one| !ids.contains(&&*one.id));
            all.extend(found);
            Ok(all.clone())
        })
    }
}

impl Records for Postgres {
    fn admit(&self, draft: &Draft) -> Result<Admitted, StoreError> {
        self.database.look(async |database| {
            if let Some(known) = self.known(database, draft).await? {
                return Ok(Admitted::Known(Box::new(known)));
            }
            // Of 122 random bits.
            let sql = "SELECT replace(gen_random_uuid()::text, '-', '')";
            one(database, sql, &[], |row| Ok(Admitted::New(row.try_get(0)?))).await
        })
    }

    fn has_room(&self, client: &str) -> Result<(), StoreError> {
        self.database.read(async |database| self.check(database, client).await)
    }

    fn insert(&self, id: &str, draft: &Draft, now: Time) -> Result<Submitted, StoreError> {
        self.database.write(async |database, again| {
            if again && let Some(own) = find(database, id).await? {
                return Ok(Submitted::New(own));
            }
            if let Some(known) = self.known(database, draft).await? {
                return Ok(Submitted::Known(known));
            }
            self.put(database, id, draft, now).await.map(Submitted::New)
        })
    }

    // A lease that nobody heard of runs out.
    fn claim(&self, worker: &str, now: Time, until: Time) -> Result<Option<Lease>, StoreError> {
        let lease = |row: &Row| claimed(row, worker, until);
        Ok(self.database.take(&claim(), &[&self.kind, &worker, &now, &until], lease)?.pop())
    }

    fn lapse(&self, time: Time, now: Time) -> Result<Vec<Lapsed>, StoreError> {
        let most = self.bounds.attempts;
        let sql = "SELECT id, NULL::integer, attempts FROM jobs WHERE state = 'running' AND until <= $1 \
                   UNION ALL SELECT job, tile, attempts FROM tiles WHERE state = 'running' AND until <= $1";
        let read = |row: &Row| {
            let (tile, attempts) = (row.try_get::<_, Option<i32>>(1)?.map(small), row.try_get(2).map(small)?);
            Ok(Lapsed { id: row.try_get(0)?, tile, attempts, again: attempts < most })
        };
        // Most of the time there is none, and nobody has to wait.
        if self.database.read(async |database| collect(database, sql, &[&time], read).await)?.is_empty() {
            return Ok(Vec::new());
        }
        self.database.write(async |database, _| {
            let mut kept = Vec::new();
            for one in collect(database, sql, &[&time], read).await? {
                if lapse(database, &one, now).await? {
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
        let sql = format!("UPDATE {table} SET until = $3 WHERE {held_by} RETURNING 1");
        self.database.set(&sql, &[&id, &attempt, &until], async |_| Ok(false))
    }

    fn split(&self, lease: &Lease, plan: &str, sizes: &[u64], bytes: u64) -> Result<bool, StoreError> {
        let (id, attempt) = held(lease);
        let count = i32::try_from(sizes.len()).unwrap_or(i32::MAX);
        let bytes = integer(bytes.saturating_add(sizes.len() as u64 * TILE_ROW));
        let sql = format!(
            "UPDATE jobs SET {FREE}, claims = claims + 1, attempts = 0, waits = true, plan = $3, tiles = $4, \
             tiles_done = 0, points_done = 0, tile_bytes = $5, bytes = bytes + $5, turn = {} WHERE {HELD}",
            next_turn("$6")
        );
        self.database.write(async |database, again| {
            if !change(database, &sql, &[&id, &attempt, &plan, &count, &bytes, &lease.record.client]).await? {
                return Ok(again && happened::split(database, lease, plan).await?);
            }
            let sql = "INSERT INTO tiles (job, tile, state) \
                       SELECT $1, tile, 'waiting' FROM generate_series(0, $2 - 1) tile";
            change(database, sql, &[&id, &count]).await?;
            Ok(true)
        })
    }

    fn tile_done(&self, lease: &Lease, part: &str, points: u64) -> Result<bool, StoreError> {
        let ((id, attempt), points) = (held(lease), integer(points));
        let sql = format!(
            "WITH done AS (UPDATE tiles SET state = 'done', blob = $3, {FREE} WHERE {TILE_HELD} RETURNING job) \
             UPDATE jobs SET tiles_done = tiles_done + 1, points_done = points_done + $4, \
             waits = waits OR tiles_done + 1 = tiles FROM done WHERE id = done.job RETURNING 1"
        );
        let happened = async |database: &Client| happened::tile_done(database, lease, part).await;
        self.database.set(&sql, &[&id, &attempt, &part, &points], happened)
    }

    fn parts(&self, id: &str) -> Result<Vec<(u32, String)>, StoreError> {
        let sql = "SELECT tile, blob FROM tiles WHERE job = $1 AND state = 'done' ORDER BY tile";
        let read = |row: &Row| Ok((row.try_get(0).map(small)?, row.try_get(1)?));
        self.database.read(async |database| collect(database, sql, &[&id], read).await)
    }

    fn unsplit(&self, lease: &Lease) -> Result<bool, StoreError> {
        let (id, attempt) = held(lease);
        let which = if let Step::Tile(_) = lease.step { BY_TILE } else { HELD };
        let sql = format!("UPDATE jobs SET {ANEW} WHERE {which}");
        self.database.write(async |database, again| {
            if !change(database, &sql, &[&id, &attempt]).await? {
                return Ok(again && happened::unsplit(database, lease).await?);
            }
            change(database, "DELETE FROM tiles WHERE job = $1", &[&id]).await?;
            Ok(true)
        })
    }

    fn done(&self, lease: &Lease, result: &ResultFile, now: Time) -> Result<bool, StoreError> {
        let sql = format!(
            "UPDATE jobs SET state = 'done', finished = $3, result = $4, blob = $5, waits = false, \
             bytes = row_bytes + octet_length($4::text) + $6 WHERE {HELD}"
        );
        let text = result_text(result);
        let ((id, attempt), bytes) = (held(lease), integer(result.bytes));
        self.database.write(async |database, again| {
            let done = change(database, &sql, &[&id, &attempt, &now, &text, &result.blob, &bytes]).await?;
            Ok(done || again && happened::done(database, lease, result).await?)
        })
    }

    fn failed(&self, lease: &Lease, failure: &Failure, now: Time) -> Result<bool, StoreError> {
        self.database.write(async |database, again| {
            let failed = fail(database, lease, failure, now).await?;
            Ok(failed || again && happened::failed(database, lease, failure).await?)
        })
    }

    fn retry(&self, lease: &Lease, failure: &Failure, now: Time) -> Result<Option<bool>, StoreError> {
        self.database.write(async |database, again| {
            let Some(attempts) = attempts(database, lease).await? else {
                return if again { happened::retried(database, lease, failure).await } else { Ok(None) };
            };
            let waits = attempts < self.bounds.attempts;
            let changed = if waits {
                free(database, &lease.record.id, lease.step.tile()).await?
            } else {
                fail(database, lease, failure, now).await?
            };
            Ok(changed.then_some(waits))
        })
    }

    fn put_back(&self, lease: &Lease) -> Result<bool, StoreError> {
        self.database.write(async |database, again| {
            Ok(put_back(database, lease).await? || again && happened::put_back(database, lease).await?)
        })
    }

    fn defer(&self, lease: &Lease) -> Result<bool, StoreError> {
        self.database.write(async |database, again| {
            if !put_back(database, lease).await? {
                return Ok(again && happened::put_back(database, lease).await?);
            }
            pass(database, lease).await?;
            Ok(true)
        })
    }

    fn cancel(&self, id: &str, now: Time) -> Result<bool, StoreError> {
        let sql = "UPDATE jobs SET state = 'cancelled', finished = $1, bytes = row_bytes, waits = false \
                   WHERE id = $2 AND state IN ('queued', 'running')";
        self.database.write(async |database, again| {
            Ok(change(database, sql, &[&now, &id]).await?
                || again && happened::cancelled(database, id).await?)
        })
    }

    fn delete(&self, id: &str) -> Result<Option<Forgotten>, StoreError> {
        let which = "id = $1 AND state IN ('done', 'failed', 'cancelled')";
        Ok(self.forget(which, &[&id])?.pop())
    }

    fn expire(&self, time: Time, most: u32) -> Result<Vec<Forgotten>, StoreError> {
        self.forget("finished < $1 ORDER BY finished, number LIMIT $2", &[&time, &i64::from(most)])
    }

    fn get(&self, id: &str) -> Result<Option<Record>, StoreError> {
        self.database.read(async |database| find(database, id).await)
    }

    fn list(&self, before: Option<i64>, limit: u32, owner: Option<&str>) -> Result<Vec<Record>, StoreError> {
        let (before, limit) = (before.unwrap_or(i64::MAX), i64::from(limit));
        let which = "WHERE number < $1 AND ($3::text IS NULL OR owner = $3) ORDER BY number DESC LIMIT $2";
        self.database.read(async |database| select(database, which, &[&before, &limit, &owner]).await)
    }

    fn ahead(&self, job: &Record) -> Result<(u64, u64), StoreError> {
        let sql = "SELECT count(*), coalesce(sum(points_out - points_done), 0)::bigint FROM jobs
            WHERE waits AND (turn, number) < ($1, $2)";
        let read = |row: &Row| Ok((row.try_get(0).map(natural)?, row.try_get(1).map(natural)?));
        self.database.read(async |database| one(database, sql, &[&job.turn, &job.number], read).await)
    }

    fn counts(&self) -> Result<[(State, u64); 5], StoreError> {
        let sql = "SELECT state, count(*) FROM jobs GROUP BY state";
        let read = |row: &Row| Ok((row.try_get::<_, String>(0)?, row.try_get(1).map(natural)?));
        let found = self.database.read(async |database| collect(database, sql, &[], read).await)?;
        let count =
            |state: State| found.iter().find(|(name, _)| name == state.name()).map_or(0, |(_, count)| *count);
        Ok(State::ALL.map(|state| (state, count(state))))
    }

    fn waiting(&self) -> Result<Waiting, StoreError> {
        let sql = "SELECT count(*) FILTER (WHERE tiles IS NULL), \
                   (SELECT count(*) FROM tiles WHERE state = 'waiting'), \
                   count(*) FILTER (WHERE tiles_done = tiles), \
                   min(created) FILTER (WHERE tiles IS NULL), \
                   (SELECT count(*) FROM processes WHERE seen > $1) FROM jobs WHERE waits";
        let read = |row: &Row| {
            let number = |column: usize| row.try_get(column).map(natural);
            let (whole, tiles, joins) = (number(0)?, number(1)?, number(2)?);
            Ok(Waiting { whole, tiles, joins, oldest: row.try_get(3)?, processes: number(4)? })
        };
        let late = self.database.clock.now().saturating_sub(kinds::LATE);
        self.database.read(async |database| one(database, sql, &[&late], read).await)
    }

    fn load(&self, client: &str) -> Result<Load, StoreError> {
        self.database.read(async |database| load(database, client).await)
    }

    fn used(&self) -> Result<u64, StoreError> {
        self.database.read(async |database| used(database).await)
    }

    fn attend(&self, process: &str, now: Time) -> Result<Vec<String>, StoreError> {
        self.database.write(async |database, _| kinds::attend(database, process, &self.kind, now).await)
    }

    fn promised(&self) -> Result<Vec<Promised>, StoreError> {
        // Names alone: there may be many rows, and long ones.
        let sql = "SELECT id, tiles IS NOT NULL, blob FROM jobs WHERE state IN ('queued', 'running', 'done')";
        let read = |row: &Row| {
            let (id, tiles, blob): (_, bool, Option<String>) =
                (row.try_get(0)?, row.try_get(1)?, row.try_get(2)?);
            let no_result = || if tiles { Promised::Tiles(id) } else { Promised::Input(id) };
            Ok(blob.map_or_else(no_result, Promised::Result))
        };
        self.database.read(async |database| collect(database, sql, &[], read).await)
    }

    fn listen(&self, wake: Arc<dyn Fn(Change) + Send + Sync>) {
        listen::start(&self.database, wake);
    }
}

fn forgotten(row: &Row) -> Result<Forgotten, Failed> {
    Ok(Forgotten { id: row.try_get(0)?, blob: row.try_get(1)? })
}
