//! Steps of jobs: whose turn is next, and how a lease begins and ends.

use rusqlite::{Connection, Row, params};

use super::rows::{self, change, collect};
use crate::columns::{COLUMNS, FREE, failure_text, integer};
use crate::error::StoreError;
use crate::record::{Failure, State, Time};
use crate::records::{Lapsed, Lease, Step};

/// Of the job that a lease is on: `?1` is its name, `?2` the attempt.
pub(super) const HELD: &str = "id = ?1 AND claims = ?2 AND state = 'running' AND worker IS NOT NULL";
/// Of the tile that a lease is on: the same.
pub(super) const TILE_HELD: &str = "job = ?1 AND claims = ?2 AND state = 'running'";
/// Of the job of such a tile.
pub(super) const BY_TILE: &str = "id = ?1 AND state = 'running' AND EXISTS (SELECT * FROM tiles \
                       WHERE job = ?1 AND tiles.claims = ?2 AND tiles.state = 'running')";

/// Of the job `?1`.
const TILE_WAITS: &str = "EXISTS (SELECT * FROM tiles WHERE job = ?1 AND state = 'waiting')";

/// A turn after the clock and all of a client's.
pub(super) fn next_turn(client: &str) -> String {
    format!(
        "1 + max((SELECT clock FROM totals), (SELECT coalesce(max(turn), 0) FROM jobs \
         WHERE client = {client} AND state IN ('queued', 'running')))"
    )
}

/// `?3` is the time, `?4` the failure.
const FAILED: &str = "state = 'failed', finished = ?3, failure = ?4, waits = 0, \
                      bytes = row_bytes + octet_length(?4)";

/// Lets go of a step; false where its job is over by the step before.
pub(super) fn lapse(database: &Connection, lapsed: &Lapsed, now: Time) -> Result<bool, StoreError> {
    let Lapsed { id, tile, attempts, again } = lapsed;
    match (tile, again) {
        (_, false) => {
            let failure = failure_text(&Failure::GaveUp { attempts: *attempts, tile: *tile });
            let sql = format!("UPDATE jobs SET {FAILED} WHERE id = ?1 AND state = ?2");
            change(database, &sql, params![id, State::Running.name(), now, failure])
        }
        (tile, true) => free(database, id, *tile),
    }
}

/// Has a step wait again that is leased.
pub(super) fn free(database: &Connection, id: &str, tile: Option<u32>) -> Result<bool, StoreError> {
    let Some(tile) = tile else {
        return change(database, &format!("UPDATE jobs SET {WAITS}, {FREE} WHERE id = ?"), [id]);
    };
    let sql = format!("UPDATE tiles SET state = 'waiting', {FREE} WHERE job = ? AND tile = ?");
    let waits = change(database, &sql, params![id, tile])?;
    Ok(waits && change(database, "UPDATE jobs SET waits = 1 WHERE id = ?", [id])?)
}

/// How often the step of a lease was started; none where the lease is on it no more.
pub(super) fn attempts(database: &Connection, lease: &Lease) -> Result<Option<u32>, StoreError> {
    let (id, attempt) = held(lease);
    let from = match lease.step {
        Step::Tile(_) => format!("tiles WHERE {TILE_HELD}"),
        Step::Whole | Step::Join => format!("jobs WHERE {HELD}"),
    };
    let sql = format!("SELECT attempts FROM {from}");
    Ok(collect(database, &sql, params![id, attempt], |row| row.get(0))?.pop())
}

/// The job of a lease has failed.
pub(super) fn fail(
    database: &Connection,
    lease: &Lease,
    failure: &Failure,
    now: Time,
) -> Result<bool, StoreError> {
    let which = if let Step::Tile(_) = lease.step { BY_TILE } else { HELD };
    let (id, attempt) = held(lease);
    let sql = format!("UPDATE jobs SET {FAILED} WHERE {which}");
    change(database, &sql, params![id, attempt, now, failure_text(failure)])
}

/// A job that has tiles is running all the while.
const WAITS: &str = "waits = 1, state = iif(tiles IS NULL, 'queued', 'running')";

/// Lets go of a step as if it had not been started.
pub(super) fn put_back(database: &Connection, lease: &Lease) -> Result<bool, StoreError> {
    let (id, attempt) = held(lease);
    if let Step::Tile(_) = lease.step {
        let sql =
            format!("UPDATE tiles SET state = 'waiting', attempts = attempts - 1, {FREE} WHERE {TILE_HELD}");
        let put = change(database, &sql, params![id, attempt])?;
        return Ok(put && change(database, "UPDATE jobs SET waits = 1 WHERE id = ?", [id])?);
    }
    let sql = format!(
        "UPDATE jobs SET {WAITS}, attempts = attempts - 1, started = iif(tiles IS NULL, NULL, started), {FREE} \
         WHERE {HELD}"
    );
    change(database, &sql, params![id, attempt])
}

/// The values that [`HELD`] and [`TILE_HELD`] ask for.
pub(super) fn held(lease: &Lease) -> (&str, i64) {
    (&lease.record.id, integer(lease.attempt))
}

/// The step whose turn it is, and its job.
pub(super) fn next(database: &Connection) -> Result<Option<(String, Step)>, StoreError> {
    let sql = "SELECT id, tiles, tiles_done, (SELECT min(tile) FROM tiles WHERE state = 'waiting' AND job = id) \
               FROM jobs WHERE waits ORDER BY turn, number LIMIT 1";
    let row = |row: &Row<'_>| {
        let (count, tile): (Option<u32>, Option<u32>) = (row.get(1)?, row.get(3)?);
        let step = if count.is_none() { Step::Whole } else { tile.map_or(Step::Join, Step::Tile) };
        Ok((row.get(0)?, step))
    };
    Ok(collect(database, sql, [], row)?.pop())
}

/// Gives a worker a job as a whole, or its tiles to join.
pub(super) fn start(
    database: &Connection,
    id: &str,
    step: Step,
    worker: &str,
    times: [Time; 2],
) -> Result<Option<Lease>, StoreError> {
    let sql = format!(
        "UPDATE jobs SET state = 'running', attempts = attempts + 1, started = iif(tiles IS NULL, ?2, started), \
         claims = claims + 1, worker = ?3, until = ?4, waits = 0 WHERE id = ?1 RETURNING {COLUMNS}, claims"
    );
    let [now, until] = times;
    let lease = |row: &Row<'_>| rows::lease(row, step, worker, until);
    Ok(collect(database, &sql, params![id, now, worker, until], lease)?.pop())
}

/// Gives a worker a tile, and its job the next turn.
pub(super) fn start_tile(
    database: &Connection,
    id: &str,
    tile: u32,
    worker: &str,
    until: Time,
) -> Result<Option<Lease>, StoreError> {
    // The clock goes on by its turn, which then is another.
    let sql = format!(
        "UPDATE jobs SET state = state, claims = claims + 1 WHERE id = ?1 RETURNING {COLUMNS}, claims"
    );
    let lease = |row: &Row<'_>| rows::lease(row, Step::Tile(tile), worker, until);
    let Some(lease) = collect(database, &sql, [id], lease)?.pop() else { return Ok(None) };
    let sql = "UPDATE tiles SET state = 'running', attempts = attempts + 1, claims = ?3, worker = ?4, until = ?5 \
               WHERE job = ?1 AND tile = ?2";
    change(database, sql, params![id, tile, integer(lease.attempt), worker, until])?;
    let sql = format!("UPDATE jobs SET waits = {TILE_WAITS}, turn = {} WHERE id = ?1", next_turn("?2"));
    change(database, &sql, [id, &lease.record.client])?;
    Ok(Some(lease))
}
