//! The database of jobs: its schema, and what rows are in memory.

use std::path::Path;
use std::time::Duration;

use rusqlite::{Connection, Row};

use super::record::{Record, State};
use super::store::{Load, StoreError};

/// Of the schema.
pub(super) const VERSION: i64 = 3;

/// Bytes that a row takes beside its texts, with its places in the indices, about.
pub(super) const ROW: u64 = 1024;

// The totals, one row, are kept by triggers: whatever changes a job changes them with it. `used` is the sum of
// all `bytes`, which a sum over so many rows would take too long for; `clock` is the turn of the last job
// that was started.
const SCHEMA: &str = "
    CREATE TABLE jobs (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        state TEXT NOT NULL,
        request TEXT NOT NULL,
        owner TEXT NOT NULL,
        client TEXT NOT NULL,
        key TEXT,
        fingerprint TEXT NOT NULL,
        request_id TEXT NOT NULL,
        points_in INTEGER NOT NULL,
        points_out INTEGER NOT NULL,
        row_bytes INTEGER NOT NULL,
        bytes INTEGER NOT NULL,
        turn INTEGER NOT NULL,
        attempts INTEGER NOT NULL DEFAULT 0,
        created INTEGER NOT NULL,
        started INTEGER,
        finished INTEGER,
        result TEXT,
        failure TEXT,
        UNIQUE (owner, key)
    ) STRICT;
    CREATE INDEX jobs_by_turn ON jobs (state, turn, number);
    CREATE INDEX jobs_by_end ON jobs (finished);
    CREATE INDEX jobs_by_client ON jobs (client, state, turn);
    CREATE TABLE totals (used INTEGER NOT NULL, clock INTEGER NOT NULL) STRICT;
    INSERT INTO totals VALUES (0, 0);
    CREATE TRIGGER jobs_come AFTER INSERT ON jobs
        BEGIN UPDATE totals SET used = used + new.bytes; END;
    CREATE TRIGGER jobs_change AFTER UPDATE OF bytes ON jobs
        BEGIN UPDATE totals SET used = used + new.bytes - old.bytes; END;
    CREATE TRIGGER jobs_go AFTER DELETE ON jobs
        BEGIN UPDATE totals SET used = used - old.bytes; END;
    CREATE TRIGGER jobs_start AFTER UPDATE OF state ON jobs WHEN new.state = 'running'
        BEGIN UPDATE totals SET clock = max(clock, new.turn); END;
    PRAGMA user_version = 3;";

/// Makes way for the schema.
const RENAME: &str = "
    ALTER TABLE jobs RENAME TO old;
    DROP INDEX jobs_by_state;
    DROP INDEX jobs_by_end;
    DROP INDEX IF EXISTS jobs_by_client;";

/// Version 1 knew no clients: its jobs are nobody's, so whoever has to show a key does not see them.
const FROM_1: &str = "
    ALTER TABLE old ADD COLUMN owner TEXT NOT NULL DEFAULT '';
    ALTER TABLE old ADD COLUMN client TEXT NOT NULL DEFAULT '';";

/// From version 2, whose rows were not counted, and which told turns by the times of starts.
const FROM_2: &str = "
    INSERT INTO jobs (number, id, state, request, owner, client, key, fingerprint, request_id, points_in,
        points_out, row_bytes, bytes, turn, attempts, created, started, finished, result, failure)
    SELECT number, id, state, request, owner, client, key, fingerprint, request_id, points_in, points_out,
        1024 + octet_length(request) + octet_length(owner) + octet_length(client)
            + coalesce(octet_length(key), 0) + octet_length(request_id),
        bytes, 0, attempts, created, started, finished, result, failure FROM old;
    DROP TABLE old;
    UPDATE jobs SET bytes = bytes + row_bytes + coalesce(octet_length(result), 0)
        + coalesce(octet_length(failure), 0);
    UPDATE jobs SET turn = (
        SELECT count(*) FROM jobs earlier WHERE earlier.client = jobs.client AND earlier.number <= jobs.number
            AND earlier.state IN ('queued', 'running')
    ) WHERE state IN ('queued', 'running');";

const COLUMNS: &str = "number, id, state, request, owner, client, request_id, points_in, points_out, turn, attempts, \
                       created, started, finished, result, failure";

/// How long a statement waits for another program that has the database for itself, which no backup does.
const BUSY: Duration = Duration::from_millis(500);

/// Opens the file, made where it is missing, and brings an older one up to date.
///
/// # Errors
/// [`StoreError::Version`], or what the database says.
pub(super) fn open(path: &Path) -> Result<Connection, StoreError> {
    let mut connection = Connection::open(path)?;
    connection.busy_timeout(BUSY)?;
    connection.pragma_update(None, "journal_mode", "WAL")?;
    // A job that was accepted is on the disk, whatever happens next.
    connection.pragma_update(None, "synchronous", "FULL")?;
    let transaction = connection.transaction()?;
    match transaction.query_row("PRAGMA user_version", [], |row| row.get(0))? {
        0 => transaction.execute_batch(SCHEMA)?,
        1 => migrate(&transaction, &[RENAME, FROM_1, SCHEMA, FROM_2])?,
        2 => migrate(&transaction, &[RENAME, SCHEMA, FROM_2])?,
        VERSION => {}
        other => return Err(StoreError::Version(other)),
    }
    transaction.commit()?;
    Ok(connection)
}

fn migrate(database: &Connection, steps: &[&str]) -> rusqlite::Result<()> {
    steps.iter().try_for_each(|step| database.execute_batch(step))
}

pub(super) fn used(database: &Connection) -> Result<u64, StoreError> {
    Ok(database.query_row("SELECT used FROM totals", [], |row| row.get(0).map(natural))?)
}

pub(super) fn load(database: &Connection, client: &str) -> Result<Load, StoreError> {
    let sql = "SELECT count(*), coalesce(sum(points_out), 0), count(DISTINCT client), \
               coalesce(sum(client = ?), 0) FROM jobs WHERE state IN ('queued', 'running')";
    let number = |row: &Row<'_>, column: usize| row.get(column).map(natural);
    Ok(database.query_row(sql, [client], |row| {
        let (jobs, points) = (number(row, 0)?, number(row, 1)?);
        Ok(Load { jobs, points, clients: number(row, 2)?, own: number(row, 3)? })
    })?)
}

pub(super) fn find(database: &Connection, id: &str) -> Result<Option<Record>, StoreError> {
    Ok(select(database, "WHERE id = ?", [id])?.pop())
}

pub(super) fn select(
    database: &Connection,
    which: &str,
    values: impl rusqlite::Params,
) -> Result<Vec<Record>, StoreError> {
    let mut statement = database.prepare_cached(&format!("SELECT {COLUMNS} FROM jobs {which}"))?;
    let rows = statement.query_map(values, record)?;
    Ok(rows.collect::<Result<_, _>>()?)
}

fn record(row: &Row<'_>) -> rusqlite::Result<Record> {
    let state: String = row.get(2)?;
    let text = |column: usize| row.get::<_, Option<String>>(column);
    Ok(Record {
        number: row.get(0)?,
        id: row.get(1)?,
        // Cannot be another: only this file writes it.
        state: State::of_name(&state).ok_or(rusqlite::Error::InvalidQuery)?,
        request: row.get(3)?,
        owner: row.get(4)?,
        client: row.get(5)?,
        request_id: row.get(6)?,
        points_in: row.get(7).map(natural)?,
        points_out: row.get(8).map(natural)?,
        turn: row.get(9)?,
        attempts: row.get(10)?,
        created: row.get(11)?,
        started: row.get(12)?,
        finished: row.get(13)?,
        result: text(14)?.and_then(|text| serde_json::from_str(&text).ok()),
        failure: text(15)?.and_then(|text| serde_json::from_str(&text).ok()),
    })
}

/// Strings and numbers only: there is nothing that JSON could not hold.
pub(super) fn json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// SQLite has signed numbers alone.
pub(super) fn integer(number: u64) -> i64 {
    number.try_into().unwrap_or(i64::MAX)
}

pub(super) fn natural(number: i64) -> u64 {
    number.try_into().unwrap_or(0)
}
