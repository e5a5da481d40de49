//! Programs of several versions or models side by side: each does what came to its own kind.

use deadpool_postgres::Transaction;

use super::rows::{change, collect};
use super::trouble::Failed;
use crate::columns::ANEW;
use crate::record::Time;

/// After so many milliseconds of silence a process is not counted among those that work.
pub(super) const LATE: Time = 60_000;
/// And after so many it has ended, and its kind with the last of it: longer than programs take to be replaced one by
/// one, each waiting for the one before.
pub(super) const GONE: Time = 600_000;

/// A process is there. Jobs of kinds that are gone become its kind's, and begin anew.
pub(super) async fn attend(
    database: &Transaction<'_>,
    process: &str,
    kind: &str,
    now: Time,
) -> Result<Vec<String>, Failed> {
    let sql = "INSERT INTO processes (name, kind, seen) VALUES ($1, $2, $3) \
               ON CONFLICT (name) DO UPDATE SET kind = $2, seen = $3";
    change(database, sql, &[&process, &kind, &now]).await?;
    change(database, "DELETE FROM processes WHERE seen < $1", &[&now.saturating_sub(GONE)]).await?;
    let sql = format!(
        "UPDATE jobs SET kind = $1, {ANEW} \
         WHERE state IN ('queued', 'running') AND kind <> $1 AND kind NOT IN (SELECT kind FROM processes) RETURNING id"
    );
    let taken = collect(database, &sql, &[&kind], |row| Ok(row.try_get::<_, String>(0)?)).await?;
    if !taken.is_empty() {
        change(database, "DELETE FROM tiles WHERE job = ANY($1)", &[&taken]).await?;
    }
    Ok(taken)
}
