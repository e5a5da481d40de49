//! Whether a job may come, and its row.

use deadpool_postgres::{GenericClient, Transaction};
use tokio_postgres::Row;

use super::Postgres;
use super::rows::{collect, load, one, record, used};
use super::steps::next_turn;
use super::trouble::Failed;
use crate::columns::{COLUMNS, NEW, integer};
use crate::error::StoreError;
use crate::record::{Draft, NewJob, Record, Time};
use crate::records::{Bounds, Load};

impl Postgres {
    /// The job that this request made earlier, or none where there is room for a new one.
    pub(super) async fn known(
        &self,
        database: &impl GenericClient,
        draft: &Draft,
    ) -> Result<Option<Record>, Failed> {
        let (job, wanted) = (&draft.job, draft.bytes());
        if let Some(key) = &job.key {
            let sql = format!("SELECT {COLUMNS}, fingerprint FROM jobs WHERE owner = $1 AND key = $2");
            let read = |row: &Row| Ok((record(row)?, row.try_get::<_, String>(21)?));
            match collect(database, &sql, &[&job.owner, key], read).await?.pop() {
                Some((known, same)) if same == draft.fingerprint => return Ok(Some(known)),
                Some(_) => return Err(StoreError::OtherRequest.into()),
                None => {}
            }
        }
        self.check(database, &job.client).await?;
        let (used, limit) = (used(database).await?, self.bounds.disk);
        if used.saturating_add(wanted) > limit {
            return Err(StoreError::OverBudget { used, wanted, limit }.into());
        }
        Ok(None)
    }

    pub(super) async fn check(&self, database: &impl GenericClient, client: &str) -> Result<(), Failed> {
        let Load { jobs, own, .. } = load(database, client).await?;
        let Bounds { jobs: limit, client_jobs, .. } = self.bounds;
        if own >= client_jobs {
            return Err(StoreError::ClientFull { queued: own, limit: client_jobs }.into());
        }
        if jobs >= limit {
            return Err(StoreError::Full { queued: jobs, limit }.into());
        }
        Ok(())
    }

    pub(super) async fn put(
        &self,
        database: &Transaction<'_>,
        id: &str,
        draft: &Draft,
        now: Time,
    ) -> Result<Record, Failed> {
        let job = &draft.job;
        let sql = format!(
            "INSERT INTO jobs ({NEW}, kind, state, turn) \
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, 'queued', {}) RETURNING {COLUMNS}",
            next_turn("$4")
        );
        let (points_in, points_out) = (integer(job.points_in), integer(job.points_out));
        let (row_bytes, bytes) = (integer(draft.row_bytes), integer(draft.bytes()));
        let NewJob { request, owner, client, key, request_id, .. } = job;
        one(
            database,
            &sql,
            &[
                &id,
                request,
                owner,
                client,
                key,
                &draft.fingerprint,
                request_id,
                &points_in,
                &points_out,
                &row_bytes,
                &bytes,
                &now,
                &self.kind,
            ],
            record,
        )
        .await
    }
}
