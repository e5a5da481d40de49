//! Steps of jobs: whose turn is next, and how a lease begins and ends.

use deadpool_postgres::Transaction;
use tokio_postgres::Row;

use super::rows::{self, change, collect, small};
use super::trouble::Failed;
use crate::columns::{COLUMNS, FREE, failure_text, integer};
use crate::record::{Failure, State, Time};
use crate::records::{Lapsed, Lease, Step};

/// Of the job that a lease is on: `$1` is its name, `$2` the attempt.
pub(super) const HELD: &str = "id = $1 AND claims = $2 AND state = 'running' AND worker IS NOT NULL";
/// Of the tile that a lease is on: the same.
pub(super) const TILE_HELD: &str = "job = $1 AND claims = $2 AND state = 'running'";
/// Of the job of such a tile.
pub(super) const BY_TILE: &str = "id = $1 AND state = 'running' AND EXISTS (SELECT FROM tiles \
                       WHERE job = $1 AND tiles.claims = $2 AND tiles.state = 'running')";

/// A job that has tiles is running all the while.
const WAITS: &str = "waits = true, state = CASE WHEN tiles IS NULL THEN 'queued' ELSE 'running' END";

/// `$3` is the time, `$4` the failure.
const FAILED: &str = "state = 'failed', finished = $3, failure = $4, waits = false, \
                      bytes = row_bytes + octet_length($4::text)";

/// A turn after the clock and all of a client's.
pub(super) fn next_turn(client: &str) -> String {
    format!(
        "1 + greatest((SELECT clock FROM totals), (SELECT coalesce(max(turn), 0) FROM jobs \
         WHERE client = {client} AND state IN ('queued', 'running')))"
    )
}

/// The values that [`HELD`] and [`TILE_HELD`] ask for.
pub(super) fn held(lease: &Lease) -> (&str, i64) {
    (&lease.record.id, integer(lease.attempt))
}

/// Lets go of a step; false where its job is over by the step before.
pub(super) async fn lapse(database: &Transaction<'_>, lapsed: &Lapsed, now: Time) -> Result<bool, Failed> {
    let Lapsed { id, tile, attempts, again } = lapsed;
    match (tile, again) {
        (_, false) => {
            let failure = failure_text(&Failure::GaveUp { attempts: *attempts, tile: *tile });
            let sql = format!("UPDATE jobs SET {FAILED} WHERE id = $1 AND state = $2");
            change(database, &sql, &[id, &State::Running.name(), &now, &failure]).await
        }
        (tile, true) => free(database, id, *tile).await,
    }
}

/// Has a step wait again that is leased.
pub(super) async fn free(database: &Transaction<'_>, id: &str, tile: Option<u32>) -> Result<bool, Failed> {
    let Some(tile) = tile else {
        let sql = format!("UPDATE jobs SET {WAITS}, {FREE} WHERE id = $1");
        return change(database, &sql, &[&id]).await;
    };
    let sql = format!("UPDATE tiles SET state = 'waiting', {FREE} WHERE job = $1 AND tile = $2");
    let waits = change(database, &sql, &[&id, &(tile as i32)]).await?;
    Ok(waits && wake(database, id).await?)
}

/// How often the step of a lease was started; none where the lease is on it no more.
pub(super) async fn attempts(database: &Transaction<'_>, lease: &Lease) -> Result<Option<u32>, Failed> {
    let (id, attempt) = held(lease);
    let from = match lease.step {
        Step::Tile(_) => format!("tiles WHERE {TILE_HELD}"),
        Step::Whole | Step::Join => format!("jobs WHERE {HELD}"),
    };
    let sql = format!("SELECT attempts FROM {from}");
    let read = |row: &Row| Ok(row.try_get(0).map(small)?);
    Ok(collect(database, &sql, &[&id, &attempt], read).await?.pop())
}

/// The job of a lease has failed.
pub(super) async fn fail(
    database: &Transaction<'_>,
    lease: &Lease,
    failure: &Failure,
    now: Time,
) -> Result<bool, Failed> {
    let which = if let Step::Tile(_) = lease.step { BY_TILE } else { HELD };
    let (id, attempt) = held(lease);
    let sql = format!("UPDATE jobs SET {FAILED} WHERE {which}");
    change(database, &sql, &[&id, &attempt, &now, &failure_text(failure)]).await
}

async fn wake(database: &Transaction<'_>, id: &str) -> Result<bool, Failed> {
    change(database, "UPDATE jobs SET waits = true WHERE id = $1", &[&id]).await
}

/// Lets go of a step as if it had not been started.
pub(super) async fn put_back(database: &Transaction<'_>, lease: &Lease) -> Result<bool, Failed> {
    let (id, attempt) = held(lease);
    if let Step::Tile(_) = lease.step {
        let sql =
            format!("UPDATE tiles SET state = 'waiting', attempts = attempts - 1, {FREE} WHERE {TILE_HELD}");
        let put = change(database, &sql, &[&id, &attempt]).await?;
        return Ok(put && wake(database, id).await?);
    }
    let sql = format!(
        "UPDATE jobs SET {WAITS}, attempts = attempts - 1, \
         started = CASE WHEN tiles IS NULL THEN NULL ELSE started END, {FREE} WHERE {HELD}"
    );
    change(database, &sql, &[&id, &attempt]).await
}

/// Lets the turn pass of a step that has been put back.
pub(super) async fn pass(database: &Transaction<'_>, lease: &Lease) -> Result<(), Failed> {
    let id = &lease.record.id;
    if lease.step == Step::Whole {
        let sql = "UPDATE jobs SET turn = jobs.turn + totals.clock + 1 - this.turn
            FROM totals, (SELECT client, turn, number FROM jobs WHERE id = $1) AS this
            WHERE jobs.client = this.client AND jobs.state = 'queued' AND jobs.number >= this.number";
        change(database, sql, &[id]).await?;
    } else {
        let sql = format!("UPDATE jobs SET turn = {} WHERE id = $1", next_turn("$2"));
        change(database, &sql, &[id, &lease.record.client]).await?;
    }
    Ok(())
}

/// Gives a worker, `$2`, the step of a kind, `$1`, whose turn it is, at `$3` until `$4`.
pub(super) fn claim() -> String {
    let columns = COLUMNS.replace(", ", ", (job).");
    format!(
        "SELECT (job).{columns}, (job).claims, of_tile FROM claim($1, $2, $3, $4) WHERE (job).id IS NOT NULL"
    )
}

/// What a row of [`claim`] leases.
pub(super) fn claimed(row: &Row, worker: &str, until: Time) -> Result<Lease, Failed> {
    let (count, tile): (Option<i32>, Option<i32>) = (row.try_get(18)?, row.try_get(22)?);
    let of_tiles = || tile.map(small).map_or(Step::Join, Step::Tile);
    rows::lease(row, if count.is_none() { Step::Whole } else { of_tiles() }, worker, until)
}
