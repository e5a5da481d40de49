//! Values as the columns of a database have them, whichever it is.

use serde::{Deserialize, Serialize};

use crate::record::{Failure, ResultFile};

/// Those of a job that a [`Record`](crate::Record) has, in the order in which they are read.
pub(crate) const COLUMNS: &str = "number, id, state, request, owner, client, request_id, points_in, points_out, \
                                  turn, attempts, created, started, finished, result, failure, blob, \
                                  plan, tiles, tiles_done, points_done";

/// Those that a new job has, in the order of the values: all others have defaults, but for its state and its turn.
pub(crate) const NEW: &str = "id, request, owner, client, key, fingerprint, request_id, points_in, points_out, \
                              row_bytes, bytes, created";

/// Nobody has the step.
pub(crate) const FREE: &str = "worker = NULL, until = NULL";

/// The job is queued as one that was never split or begun.
pub(crate) const ANEW: &str = "state = 'queued', started = NULL, attempts = 0, claims = claims + 1, worker = NULL, \
                               until = NULL, waits = true, plan = NULL, tiles = NULL, tiles_done = 0, \
                               points_done = 0, bytes = bytes - tile_bytes, tile_bytes = 0";

/// Bytes that the row of a tile takes, about.
pub(crate) const TILE_ROW: u64 = 256;

/// A result as its column has it; its blob's name has a column of its own.
#[derive(Serialize, Deserialize)]
struct Made {
    bytes: u64,
    sha256: String,
    about: String,
}

/// A result as its column has it.
pub(crate) fn result_text(result: &ResultFile) -> String {
    let ResultFile { bytes, sha256, about, .. } = result.clone();
    json(&Made { bytes, sha256, about })
}

/// The result whose column has this text, in this blob.
pub(crate) fn result(text: Option<String>, blob: Option<String>) -> Option<ResultFile> {
    let made: Option<Made> = text.and_then(|text| serde_json::from_str(&text).ok());
    made.zip(blob).map(|(Made { bytes, sha256, about }, blob)| ResultFile { blob, bytes, sha256, about })
}

/// A failure as its column has it.
pub(crate) fn failure_text(failure: &Failure) -> String {
    json(failure)
}

/// The failure whose column has this text.
pub(crate) fn failure(text: Option<String>) -> Option<Failure> {
    text.and_then(|text| serde_json::from_str(&text).ok())
}

/// Strings and numbers only: there is nothing that JSON could not hold.
fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

/// Databases have signed numbers alone.
pub(crate) fn integer(number: u64) -> i64 {
    number.try_into().unwrap_or(i64::MAX)
}

pub(crate) fn natural(number: i64) -> u64 {
    number.try_into().unwrap_or(0)
}
