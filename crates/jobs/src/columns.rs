//! Values as the columns of a database have them, whichever it is.

use serde::{Deserialize, Serialize};

use crate::record::{Failure, ResultFile};

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
