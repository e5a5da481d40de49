//! Whether a change was kept of which nobody heard: the connection was lost before the database said so. Whoever tries
//! it again finds nothing to change then, and asks here.

use deadpool_postgres::{GenericClient, Transaction};

use super::rows::{Values, collect};
use super::steps::held;
use super::trouble::Failed;
use crate::columns::{failure_text, result_text};
use crate::record::{Failure, ResultFile};
use crate::records::{Lease, Step};

async fn is(database: &impl GenericClient, from: &str, values: Values<'_>) -> Result<bool, Failed> {
    let found = collect(database, &format!("SELECT FROM {from}"), values, |_| Ok(())).await?;
    Ok(!found.is_empty())
}

/// The job is done under this lease.
pub(super) async fn done(
    database: &Transaction<'_>,
    lease: &Lease,
    result: &ResultFile,
) -> Result<bool, Failed> {
    let (id, attempt) = held(lease);
    let from = "jobs WHERE id = $1 AND claims = $2 AND state = 'done' AND blob = $3 AND result = $4";
    is(database, from, &[&id, &attempt, &result.blob, &result_text(result)]).await
}

/// The job has failed, for this reason.
pub(super) async fn failed(
    database: &Transaction<'_>,
    lease: &Lease,
    failure: &Failure,
) -> Result<bool, Failed> {
    let from = "jobs WHERE id = $1 AND state = 'failed' AND failure = $2";
    is(database, from, &[&lease.record.id, &failure_text(failure)]).await
}

/// The tile is done under this lease, and its job is not over.
pub(super) async fn tile_done(
    database: &impl GenericClient,
    lease: &Lease,
    part: &str,
) -> Result<bool, Failed> {
    let (id, attempt) = held(lease);
    let from = "tiles WHERE job = $1 AND claims = $2 AND state = 'done' AND blob = $3";
    is(database, from, &[&id, &attempt, &part]).await
}

/// The step waits, and nobody has had it since.
pub(super) async fn put_back(database: &Transaction<'_>, lease: &Lease) -> Result<bool, Failed> {
    let (id, attempt) = held(lease);
    let from = match lease.step {
        Step::Tile(_) => "tiles WHERE job = $1 AND claims = $2 AND state = 'waiting'",
        Step::Whole | Step::Join => "jobs WHERE id = $1 AND claims = $2 AND waits AND worker IS NULL",
    };
    is(database, from, &[&id, &attempt]).await
}

/// The step waits again, or its job has failed for this reason.
pub(super) async fn retried(
    database: &Transaction<'_>,
    lease: &Lease,
    failure: &Failure,
) -> Result<Option<bool>, Failed> {
    if put_back(database, lease).await? {
        return Ok(Some(true));
    }
    Ok(failed(database, lease, failure).await?.then_some(false))
}

/// The job is in tiles by this plan.
pub(super) async fn split(database: &Transaction<'_>, lease: &Lease, plan: &str) -> Result<bool, Failed> {
    is(database, "jobs WHERE id = $1 AND plan = $2", &[&lease.record.id, &plan]).await
}

/// The job is one that was never split, and nobody has had it since.
pub(super) async fn unsplit(database: &Transaction<'_>, lease: &Lease) -> Result<bool, Failed> {
    let from = "jobs WHERE id = $1 AND state = 'queued' AND tiles IS NULL AND claims > $2";
    let (id, attempt) = held(lease);
    is(database, from, &[&id, &attempt]).await
}

/// Somebody cancelled it.
pub(super) async fn cancelled(database: &Transaction<'_>, id: &str) -> Result<bool, Failed> {
    is(database, "jobs WHERE id = $1 AND state = 'cancelled'", &[&id]).await
}
