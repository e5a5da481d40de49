//! Rows of the database as values, and back.

use rusqlite::{Connection, ErrorCode, Params, Row};

use crate::columns::{self, COLUMNS, natural};
use crate::error::{StoreError, Trouble};
use crate::record::{Record, State, Tiles, Time};
use crate::records::{Lease, Load, Step};

/// Not a `From`, which would be public.
pub(super) fn failed(error: rusqlite::Error) -> StoreError {
    let trouble = match error.sqlite_error_code() {
        Some(ErrorCode::DiskFull) => Trouble::Full,
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => Trouble::Busy,
        _ => Trouble::Other,
    };
    StoreError::Database { trouble, source: error.into() }
}

pub(super) fn used(database: &Connection) -> Result<u64, StoreError> {
    one(database, "SELECT used FROM totals", [], |row| row.get(0).map(natural))
}

pub(super) fn load(database: &Connection, client: &str) -> Result<Load, StoreError> {
    let sql = "SELECT count(*), coalesce(sum(points_out), 0), count(DISTINCT client), \
               coalesce(sum(client = ?), 0) FROM jobs WHERE state IN ('queued', 'running')";
    let number = |row: &Row<'_>, column: usize| row.get(column).map(natural);
    one(database, sql, [client], |row| {
        let (jobs, points) = (number(row, 0)?, number(row, 1)?);
        Ok(Load { jobs, points, clients: number(row, 2)?, own: number(row, 3)? })
    })
}

pub(super) fn find(database: &Connection, id: &str) -> Result<Option<Record>, StoreError> {
    Ok(select(database, "WHERE id = ?", [id])?.pop())
}

pub(super) fn select(
    database: &Connection,
    which: &str,
    values: impl Params,
) -> Result<Vec<Record>, StoreError> {
    collect(database, &format!("SELECT {COLUMNS} FROM jobs {which}"), values, record)
}

/// All rows that a statement gives, read to the end: only then is what it changes on the disk.
pub(super) fn collect<T>(
    database: &Connection,
    sql: &str,
    values: impl Params,
    read: impl Fn(&Row<'_>) -> rusqlite::Result<T>,
) -> Result<Vec<T>, StoreError> {
    let rows = || -> rusqlite::Result<_> {
        database.prepare_cached(sql)?.query_map(values, |row| read(row))?.collect()
    };
    rows().map_err(failed)
}

/// The only row that a statement gives.
pub(super) fn one<T>(
    database: &Connection,
    sql: &str,
    values: impl Params,
    read: impl FnOnce(&Row<'_>) -> rusqlite::Result<T>,
) -> Result<T, StoreError> {
    let row = || database.prepare_cached(sql)?.query_row(values, read);
    row().map_err(failed)
}

/// Whether a statement changes anything.
pub(super) fn change(database: &Connection, sql: &str, values: impl Params) -> Result<bool, StoreError> {
    let changed = || database.prepare_cached(sql)?.execute(values);
    Ok(changed().map_err(failed)? > 0)
}

/// Of a row with [`COLUMNS`].
fn record(row: &Row<'_>) -> rusqlite::Result<Record> {
    let state: String = row.get(2)?;
    let text = |column: usize| row.get::<_, Option<String>>(column);
    Ok(Record {
        number: row.get(0)?,
        id: row.get(1)?,
        // Cannot be another: only this module writes it.
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
        tiles: tiles(row)?,
        result: columns::result(text(14)?, text(16)?),
        failure: columns::failure(text(15)?),
    })
}

/// Of a row with [`COLUMNS`].
fn tiles(row: &Row<'_>) -> rusqlite::Result<Option<Tiles>> {
    let (plan, count): (Option<String>, Option<u32>) = (row.get(17)?, row.get(18)?);
    let Some((plan, count)) = plan.zip(count) else { return Ok(None) };
    Ok(Some(Tiles { plan, count, done: row.get(19)?, points: row.get(20).map(natural)? }))
}

/// On a step of a row with [`COLUMNS`] and then `claims`.
pub(super) fn lease(row: &Row<'_>, step: Step, worker: &str, until: Time) -> rusqlite::Result<Lease> {
    let attempt = row.get(21).map(natural)?;
    Ok(Lease { record: record(row)?, step, attempt, worker: worker.to_owned(), until })
}
