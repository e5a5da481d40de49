//! Rows of the database as values, and questions that give them.

use deadpool_postgres::GenericClient;
use tokio_postgres::Row;
use tokio_postgres::types::ToSql;

use super::trouble::Failed;
use crate::columns::{COLUMNS, failure, natural, result};
use crate::error::{StoreError, Trouble};
use crate::record::{Record, State, Tiles, Time};
use crate::records::{Lease, Load, Step};

/// What stands for `$1`, `$2` and so on.
pub(super) type Values<'a> = &'a [&'a (dyn ToSql + Sync)];

/// All rows that a statement gives.
pub(super) async fn collect<T>(
    database: &impl GenericClient,
    sql: &str,
    values: Values<'_>,
    read: impl Fn(&Row) -> Result<T, Failed>,
) -> Result<Vec<T>, Failed> {
    let statement = database.prepare_cached(sql).await?;
    database.query(&statement, values).await?.iter().map(read).collect()
}

/// Whether a statement changes anything.
pub(super) async fn change(
    database: &impl GenericClient,
    sql: &str,
    values: Values<'_>,
) -> Result<bool, Failed> {
    let statement = database.prepare_cached(sql).await?;
    Ok(database.execute(&statement, values).await? > 0)
}

pub(super) async fn select(
    database: &impl GenericClient,
    which: &str,
    values: Values<'_>,
) -> Result<Vec<Record>, Failed> {
    collect(database, &format!("SELECT {COLUMNS} FROM jobs {which}"), values, record).await
}

pub(super) async fn find(database: &impl GenericClient, id: &str) -> Result<Option<Record>, Failed> {
    Ok(select(database, "WHERE id = $1", &[&id]).await?.pop())
}

pub(super) async fn used(database: &impl GenericClient) -> Result<u64, Failed> {
    one(database, "SELECT used FROM totals", &[], |row| Ok(natural(row.try_get(0)?))).await
}

pub(super) async fn load(database: &impl GenericClient, client: &str) -> Result<Load, Failed> {
    let sql = "SELECT count(*), coalesce(sum(points_out), 0)::bigint, count(DISTINCT client), \
               count(*) FILTER (WHERE client = $1) FROM jobs WHERE state IN ('queued', 'running')";
    one(database, sql, &[&client], |row| {
        let number = |column: usize| row.try_get(column).map(natural);
        Ok(Load { jobs: number(0)?, points: number(1)?, clients: number(2)?, own: number(3)? })
    })
    .await
}

/// The only row that a statement gives.
pub(super) async fn one<T>(
    database: &impl GenericClient,
    sql: &str,
    values: Values<'_>,
    read: impl Fn(&Row) -> Result<T, Failed>,
) -> Result<T, Failed> {
    collect(database, sql, values, read).await?.pop().ok_or_else(|| strange("a row is missing"))
}

/// Of a row with [`COLUMNS`].
pub(super) fn record(row: &Row) -> Result<Record, Failed> {
    let state: &str = row.try_get(2)?;
    Ok(Record {
        number: row.try_get(0)?,
        id: row.try_get(1)?,
        state: State::of_name(state).ok_or_else(|| strange("a job has a state that is not known"))?,
        request: row.try_get(3)?,
        owner: row.try_get(4)?,
        client: row.try_get(5)?,
        request_id: row.try_get(6)?,
        points_in: row.try_get(7).map(natural)?,
        points_out: row.try_get(8).map(natural)?,
        turn: row.try_get(9)?,
        attempts: row.try_get(10).map(small)?,
        created: row.try_get(11)?,
        started: row.try_get(12)?,
        finished: row.try_get(13)?,
        tiles: tiles(row)?,
        result: result(row.try_get(14)?, row.try_get(16)?),
        failure: failure(row.try_get(15)?),
    })
}

/// Of a row with [`COLUMNS`].
fn tiles(row: &Row) -> Result<Option<Tiles>, Failed> {
    let (plan, count): (Option<String>, Option<i32>) = (row.try_get(17)?, row.try_get(18)?);
    let Some((plan, count)) = plan.zip(count.map(small)) else { return Ok(None) };
    Ok(Some(Tiles { plan, count, done: row.try_get(19).map(small)?, points: row.try_get(20).map(natural)? }))
}

/// On a step of a row with [`COLUMNS`] and then `claims`.
pub(super) fn lease(row: &Row, step: Step, worker: &str, until: Time) -> Result<Lease, Failed> {
    let attempt = row.try_get(21).map(natural)?;
    Ok(Lease { record: record(row)?, step, attempt, worker: worker.to_owned(), until })
}

/// Postgres has signed numbers alone.
pub(super) fn small(number: i32) -> u32 {
    number.try_into().unwrap_or(0)
}

/// Only a program of another version could have written it.
pub(super) fn strange(what: &str) -> Failed {
    Failed::Refused(StoreError::Database { trouble: Trouble::Other, source: what.into() })
}
