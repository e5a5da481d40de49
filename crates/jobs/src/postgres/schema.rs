//! The schema of the database, and how those of earlier versions become it.
//!
//! Programs of several versions share a database while they are replaced one by one. So a step to a later version only
//! adds: tables, columns with defaults, indexes. What it must not do is change what a program before it reads or
//! writes.
//! Where that cannot be, the step raises `oldest`: programs that know only earlier versions then refuse to start, and
//! must be ended before.

use deadpool_postgres::Transaction;

use super::trouble::Failed;
use crate::error::StoreError;

/// Of the schema.
const VERSION: i64 = 2;

/// Programs that know this version can still work with the newest.
const OLDEST: i64 = 1;

/// Steps to a version from the one before it: the first is that to version 1.
const STEPS: [&str; VERSION as usize] = [FIRST, SECOND];

/// Where there is no table of it, there is none of the others.
const VERSIONS: &str = "CREATE TABLE version (version BIGINT NOT NULL, oldest BIGINT NOT NULL);
    INSERT INTO version VALUES (0, 0)";

// As the schema of SQLite: the totals, one row, are kept by triggers, and whoever changes a job has locked them before.
// Rows of tiles are those of jobs that are not over. A job is done by programs of its kind alone. What concerns
// others is told to them when it is kept.
// A claim is a function, since all wait for it: between its statements nothing goes to and fro.
const FIRST: &str = "
    CREATE TABLE jobs (
        number BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
        id TEXT NOT NULL UNIQUE,
        state TEXT NOT NULL,
        request TEXT NOT NULL,
        owner TEXT NOT NULL,
        client TEXT NOT NULL,
        key TEXT,
        fingerprint TEXT NOT NULL,
        request_id TEXT NOT NULL,
        points_in BIGINT NOT NULL,
        points_out BIGINT NOT NULL,
        row_bytes BIGINT NOT NULL,
        bytes BIGINT NOT NULL,
        turn BIGINT NOT NULL,
        attempts INTEGER NOT NULL DEFAULT 0,
        created BIGINT NOT NULL,
        started BIGINT,
        finished BIGINT,
        result TEXT,
        failure TEXT,
        claims BIGINT NOT NULL DEFAULT 0,
        worker TEXT,
        until BIGINT,
        blob TEXT,
        waits BOOLEAN NOT NULL DEFAULT true,
        plan TEXT,
        tiles INTEGER,
        tiles_done INTEGER NOT NULL DEFAULT 0,
        points_done BIGINT NOT NULL DEFAULT 0,
        tile_bytes BIGINT NOT NULL DEFAULT 0,
        kind TEXT NOT NULL,
        UNIQUE (owner, key)
    );
    CREATE INDEX jobs_that_wait ON jobs (kind, turn, number) WHERE waits;
    CREATE INDEX jobs_that_run ON jobs (until) WHERE state = 'running';
    CREATE INDEX jobs_by_end ON jobs (finished);
    CREATE INDEX jobs_by_client ON jobs (client, turn) WHERE state IN ('queued', 'running');
    CREATE INDEX jobs_by_owner ON jobs (owner, number);
    CREATE TABLE tiles (
        job TEXT NOT NULL,
        tile INTEGER NOT NULL,
        state TEXT NOT NULL,
        attempts INTEGER NOT NULL DEFAULT 0,
        claims BIGINT NOT NULL DEFAULT 0,
        worker TEXT,
        until BIGINT,
        blob TEXT,
        PRIMARY KEY (job, tile)
    );
    CREATE INDEX tiles_that_wait ON tiles (job, tile) WHERE state = 'waiting';
    CREATE INDEX tiles_that_run ON tiles (until) WHERE state = 'running';
    CREATE TABLE processes (name TEXT PRIMARY KEY, kind TEXT NOT NULL, seen BIGINT NOT NULL);
    CREATE TABLE totals (used BIGINT NOT NULL, clock BIGINT NOT NULL);
    INSERT INTO totals VALUES (0, 0);

    CREATE FUNCTION jobs_come() RETURNS trigger LANGUAGE plpgsql SET search_path FROM CURRENT AS $$ BEGIN
        UPDATE totals SET used = used + new.bytes;
        PERFORM pg_notify(TG_TABLE_SCHEMA, 'waits');
        RETURN NULL;
    END $$;
    CREATE FUNCTION jobs_change() RETURNS trigger LANGUAGE plpgsql SET search_path FROM CURRENT AS $$ BEGIN
        UPDATE totals SET used = used + new.bytes - old.bytes;
        RETURN NULL;
    END $$;
    CREATE FUNCTION jobs_go() RETURNS trigger LANGUAGE plpgsql SET search_path FROM CURRENT AS $$ BEGIN
        UPDATE totals SET used = used - old.bytes;
        RETURN NULL;
    END $$;
    CREATE FUNCTION jobs_start() RETURNS trigger LANGUAGE plpgsql SET search_path FROM CURRENT AS $$ BEGIN
        UPDATE totals SET clock = greatest(clock, new.turn);
        RETURN NULL;
    END $$;
    CREATE FUNCTION jobs_end() RETURNS trigger LANGUAGE plpgsql SET search_path FROM CURRENT AS $$ BEGIN
        DELETE FROM tiles WHERE job = new.id;
        RETURN NULL;
    END $$;
    CREATE FUNCTION jobs_tell() RETURNS trigger LANGUAGE plpgsql SET search_path FROM CURRENT AS $$ BEGIN
        IF new.waits AND NOT old.waits THEN
            PERFORM pg_notify(TG_TABLE_SCHEMA, 'waits');
        END IF;
        IF new.state NOT IN ('queued', 'running') OR new.state = 'queued' AND old.state = 'running' THEN
            PERFORM pg_notify(TG_TABLE_SCHEMA, 'over ' || new.id);
        ELSE
            PERFORM pg_notify(TG_TABLE_SCHEMA, 'other');
        END IF;
        RETURN NULL;
    END $$;
    CREATE FUNCTION claim(of_kind TEXT, by_worker TEXT, at BIGINT, up_to BIGINT, OUT job jobs, OUT of_tile INTEGER)
        LANGUAGE plpgsql SET search_path FROM CURRENT AS $$
    #variable_conflict use_column
    DECLARE next jobs;
    BEGIN
        PERFORM FROM totals FOR UPDATE;
        SELECT * INTO next FROM jobs WHERE waits AND kind = of_kind ORDER BY turn, number LIMIT 1;
        SELECT min(tile) INTO of_tile FROM tiles WHERE state = 'waiting' AND job = next.id;
        IF of_tile IS NULL THEN
            UPDATE jobs SET state = 'running', attempts = attempts + 1,
                started = CASE WHEN tiles IS NULL THEN at ELSE started END,
                claims = claims + 1, worker = by_worker, until = up_to, waits = false
                WHERE id = next.id RETURNING jobs.* INTO job;
            RETURN;
        END IF;
        -- The clock goes on by the job's turn, which then is another.
        UPDATE jobs SET state = state, claims = claims + 1 WHERE id = next.id RETURNING jobs.* INTO job;
        UPDATE tiles SET state = 'running', attempts = attempts + 1, claims = next.claims + 1, worker = by_worker,
            until = up_to WHERE job = next.id AND tile = of_tile;
        UPDATE jobs SET waits = EXISTS (SELECT FROM tiles WHERE job = next.id AND state = 'waiting'),
            turn = 1 + greatest((SELECT clock FROM totals), (SELECT coalesce(max(turn), 0) FROM jobs
                WHERE client = next.client AND state IN ('queued', 'running')))
            WHERE id = next.id;
    END $$;
    CREATE TRIGGER jobs_come AFTER INSERT ON jobs FOR EACH ROW EXECUTE FUNCTION jobs_come();
    CREATE TRIGGER jobs_change AFTER UPDATE OF bytes ON jobs FOR EACH ROW EXECUTE FUNCTION jobs_change();
    CREATE TRIGGER jobs_go AFTER DELETE ON jobs FOR EACH ROW EXECUTE FUNCTION jobs_go();
    CREATE TRIGGER jobs_start AFTER UPDATE OF state ON jobs FOR EACH ROW
        WHEN (new.state = 'running') EXECUTE FUNCTION jobs_start();
    CREATE TRIGGER jobs_end AFTER UPDATE OF state ON jobs FOR EACH ROW
        WHEN (new.state NOT IN ('queued', 'running')) EXECUTE FUNCTION jobs_end();
    CREATE TRIGGER jobs_tell AFTER UPDATE OF state, waits, tiles_done ON jobs FOR EACH ROW
        EXECUTE FUNCTION jobs_tell();";

// All wait for a claim, and each who listens is woken by what is told: so a claim writes each row once, and of a job's
// tiles only each hundredth is told of.
const SECOND: &str = "
    CREATE OR REPLACE FUNCTION jobs_tell() RETURNS trigger LANGUAGE plpgsql SET search_path FROM CURRENT AS $$ BEGIN
        IF new.waits AND NOT old.waits THEN
            PERFORM pg_notify(TG_TABLE_SCHEMA, 'waits');
        END IF;
        IF new.state NOT IN ('queued', 'running') OR new.state = 'queued' AND old.state = 'running' THEN
            PERFORM pg_notify(TG_TABLE_SCHEMA, 'over ' || new.id);
        ELSIF new.state <> old.state
            OR 100::bigint * new.tiles_done / new.tiles IS DISTINCT FROM 100::bigint * old.tiles_done / old.tiles THEN
            PERFORM pg_notify(TG_TABLE_SCHEMA, 'other');
        END IF;
        RETURN NULL;
    END $$;
    CREATE OR REPLACE FUNCTION claim(of_kind TEXT, by_worker TEXT, at BIGINT, up_to BIGINT, OUT job jobs,
        OUT of_tile INTEGER) LANGUAGE plpgsql SET search_path FROM CURRENT AS $$
    #variable_conflict use_column
    DECLARE next jobs; others BOOLEAN;
    BEGIN
        PERFORM FROM totals FOR UPDATE;
        SELECT * INTO next FROM jobs WHERE waits AND kind = of_kind ORDER BY turn, number LIMIT 1;
        -- Two, in the order of an index, whatever is known of how many there are: of thousands each look would take longer.
        SELECT min(tile), count(*) > 1 INTO of_tile, others FROM
            (SELECT tile FROM tiles WHERE state = 'waiting' AND job = next.id ORDER BY job, tile LIMIT 2) AS two;
        IF of_tile IS NULL THEN
            UPDATE jobs SET state = 'running', attempts = attempts + 1,
                started = CASE WHEN tiles IS NULL THEN at ELSE started END,
                claims = claims + 1, worker = by_worker, until = up_to, waits = false
                WHERE id = next.id RETURNING jobs.* INTO job;
            RETURN;
        END IF;
        -- The clock goes on by the job's turn, which then is another.
        UPDATE totals SET clock = greatest(clock, next.turn);
        next.claims := next.claims + 1;
        UPDATE tiles SET state = 'running', attempts = attempts + 1, claims = next.claims, worker = by_worker,
            until = up_to WHERE job = next.id AND tile = of_tile;
        UPDATE jobs SET claims = next.claims, waits = others,
            turn = 1 + greatest((SELECT clock FROM totals), (SELECT coalesce(max(turn), 0) FROM jobs
                WHERE client = next.client AND state IN ('queued', 'running')))
            WHERE id = next.id;
        job := next;
    END $$;";

/// What makes the tables as the first version had them.
#[cfg(test)]
pub(super) fn first() -> String {
    format!("{VERSIONS}; {FIRST}; UPDATE version SET version = 1, oldest = 1")
}

/// Whether nothing is to be done: to see that, the right to read is enough.
///
/// # Errors
/// [`StoreError::Version`], or what the database says.
pub(super) async fn is_current(transaction: &Transaction<'_>, schema: &str) -> Result<bool, Failed> {
    Ok(version(transaction, schema).await?.is_some_and(|found| found >= VERSION))
}

/// Makes the tables where there are none, and brings older ones up to date. One process does so at a time. Nothing may
/// have been asked in this transaction before: the server remembers what it did not find until it next takes a lock.
///
/// # Errors
/// As [`is_current`].
pub(super) async fn migrate(transaction: &Transaction<'_>, schema: &str) -> Result<(), Failed> {
    let lock = "SELECT pg_advisory_xact_lock(hashtextextended('densecloud ' || $1, 0))";
    transaction.execute(lock, &[&schema]).await?;
    let found = match version(transaction, schema).await? {
        Some(found) => found,
        None => {
            let made = "SELECT FROM pg_namespace WHERE nspname = $1";
            if transaction.query_opt(made, &[&schema]).await?.is_none() {
                transaction.batch_execute(&format!("CREATE SCHEMA {schema}")).await?;
            }
            transaction.batch_execute(VERSIONS).await?;
            0
        }
    };
    // A newer schema that this program can work with is left as it is.
    for (step, version) in STEPS.iter().zip(1..).skip_while(|(_, version)| *version <= found) {
        transaction.batch_execute(step).await?;
        let sql = "UPDATE version SET version = $1, oldest = $2";
        transaction.execute(sql, &[&version, &OLDEST]).await?;
    }
    Ok(())
}

/// None where there are no tables.
async fn version(transaction: &Transaction<'_>, schema: &str) -> Result<Option<i64>, Failed> {
    let there = "SELECT FROM pg_class JOIN pg_namespace ON pg_namespace.oid = relnamespace \
                 WHERE nspname = $1 AND relname = 'version'";
    if transaction.query_opt(there, &[&schema]).await?.is_none() {
        return Ok(None);
    }
    let row = transaction.query_one("SELECT version, oldest FROM version", &[]).await?;
    let (found, oldest): (i64, i64) = (row.try_get(0)?, row.try_get(1)?);
    if oldest > VERSION {
        return Err(StoreError::Version { found, known: VERSION }.into());
    }
    Ok(Some(found))
}
