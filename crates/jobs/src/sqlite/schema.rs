//! The schema of the database, and how those of earlier versions become it.

use std::path::Path;
use std::time::Duration;

use rusqlite::Connection;

use super::rows::failed;
use crate::error::StoreError;

/// Of the schema.
const VERSION: i64 = 5;

// The totals, one row, are kept by triggers: whatever changes a job changes them with it. `used` is the sum of
// all `bytes`, which a sum over so many rows would take too long for; `clock` is the turn of the last job
// that was started. `claims`, `worker` and `until` are those of the lease, `blob` is the name of the result. A job
// `waits` while a step of it can be claimed. `tiles` is null until it is split; `tile_bytes` are those of `bytes` that its
// tiles take.
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
        claims INTEGER NOT NULL DEFAULT 0,
        worker TEXT,
        until INTEGER,
        blob TEXT,
        waits INTEGER NOT NULL DEFAULT 1,
        plan TEXT,
        tiles INTEGER,
        tiles_done INTEGER NOT NULL DEFAULT 0,
        points_done INTEGER NOT NULL DEFAULT 0,
        tile_bytes INTEGER NOT NULL DEFAULT 0,
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
        BEGIN UPDATE totals SET clock = max(clock, new.turn); END;";

// Rows of a job that is not over. The number of a tile's last claim is one of its job's, so that a lease on a tile of an
// earlier plan is on none of a later one.
const TILES: &str = "
    CREATE TABLE tiles (
        job TEXT NOT NULL,
        tile INTEGER NOT NULL,
        state TEXT NOT NULL,
        attempts INTEGER NOT NULL DEFAULT 0,
        claims INTEGER NOT NULL DEFAULT 0,
        worker TEXT,
        until INTEGER,
        blob TEXT,
        PRIMARY KEY (job, tile)
    ) STRICT, WITHOUT ROWID;
    CREATE INDEX tiles_by_state ON tiles (state, job, tile);
    CREATE INDEX jobs_that_wait ON jobs (turn, number) WHERE waits;
    CREATE TRIGGER jobs_end AFTER UPDATE OF state ON jobs WHEN new.state NOT IN ('queued', 'running')
        BEGIN DELETE FROM tiles WHERE job = new.id; END;
    PRAGMA user_version = 5;";

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

/// Version 3 knew no leases, and one name for the results of all attempts.
const COLUMNS: &str = "
    ALTER TABLE jobs ADD COLUMN claims INTEGER NOT NULL DEFAULT 0;
    ALTER TABLE jobs ADD COLUMN worker TEXT;
    ALTER TABLE jobs ADD COLUMN until INTEGER;
    ALTER TABLE jobs ADD COLUMN blob TEXT;";

/// What was running then has no lease any more.
const FROM_3: &str = "
    UPDATE jobs SET until = 0 WHERE state = 'running';
    UPDATE jobs SET blob = id || '.out' WHERE state = 'done';";

/// Version 4 knew no tiles.
const TILE_COLUMNS: &str = "
    ALTER TABLE jobs ADD COLUMN waits INTEGER NOT NULL DEFAULT 1;
    ALTER TABLE jobs ADD COLUMN plan TEXT;
    ALTER TABLE jobs ADD COLUMN tiles INTEGER;
    ALTER TABLE jobs ADD COLUMN tiles_done INTEGER NOT NULL DEFAULT 0;
    ALTER TABLE jobs ADD COLUMN points_done INTEGER NOT NULL DEFAULT 0;
    ALTER TABLE jobs ADD COLUMN tile_bytes INTEGER NOT NULL DEFAULT 0;";

/// What waits was queued then.
const FROM_4: &str = "UPDATE jobs SET waits = state = 'queued';";

/// How long a statement waits for another program that has the database for itself, which no backup does.
const BUSY: Duration = Duration::from_millis(500);

/// Opens the file, made where it is missing, and brings an older one up to date.
///
/// # Errors
/// [`StoreError::Version`], or what the database says.
pub(super) fn open(path: &Path) -> Result<Connection, StoreError> {
    match migrated(path).map_err(failed)? {
        Ok(connection) => Ok(connection),
        Err(found) => Err(StoreError::Version { found, known: VERSION }),
    }
}

/// Or the version of a schema that is not known.
fn migrated(path: &Path) -> rusqlite::Result<Result<Connection, i64>> {
    let mut connection = Connection::open(path)?;
    connection.busy_timeout(BUSY)?;
    connection.pragma_update(None, "journal_mode", "WAL")?;
    // A job that was accepted is on the disk, whatever happens next.
    connection.pragma_update(None, "synchronous", "FULL")?;
    let transaction = connection.transaction()?;
    let steps: &[&str] = match transaction.query_row("PRAGMA user_version", [], |row| row.get(0))? {
        0 => &[SCHEMA, TILES],
        1 => &[RENAME, FROM_1, SCHEMA, FROM_2, FROM_3, FROM_4, TILES],
        2 => &[RENAME, SCHEMA, FROM_2, FROM_3, FROM_4, TILES],
        3 => &[COLUMNS, FROM_3, TILE_COLUMNS, FROM_4, TILES],
        4 => &[TILE_COLUMNS, FROM_4, TILES],
        VERSION => &[],
        found => return Ok(Err(found)),
    };
    steps.iter().try_for_each(|step| transaction.execute_batch(step))?;
    transaction.commit()?;
    Ok(Ok(connection))
}
