//! What went wrong, as the caller sees it.

use std::error::Error as _;
use std::io;

use tokio_postgres::Error;
use tokio_postgres::error::SqlState;

use crate::error::{StoreError, Trouble};

/// Why a call has no answer.
#[derive(Debug)]
pub(super) enum Failed {
    /// It is an answer: no.
    Refused(StoreError),
    /// The database.
    Database(Error),
}

impl From<StoreError> for Failed {
    fn from(error: StoreError) -> Self {
        Self::Refused(error)
    }
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self::Database(error)
    }
}

/// What of it the caller can do something about.
pub(super) fn trouble(error: &Error) -> Trouble {
    match error.code() {
        Some(&SqlState::DISK_FULL) => Trouble::Full,
        // Waited for too long, or others were always quicker.
        Some(code) if *code == SqlState::QUERY_CANCELED || *code == SqlState::LOCK_NOT_AVAILABLE => {
            Trouble::Busy
        }
        Some(code) if others_were_quicker(code) => Trouble::Busy,
        Some(code) if gone(code) => Trouble::Away,
        Some(_) => Trouble::Other,
        None if lost(error) => Trouble::Away,
        None => Trouble::Other,
    }
}

/// Whether the connection is no more: only then is it unknown what became of a statement.
pub(super) fn lost(error: &Error) -> bool {
    let io = || error.source().is_some_and(|source| source.downcast_ref::<io::Error>().is_some());
    error.code().map_or_else(|| error.is_closed() || io(), gone)
}

/// Whether it is worth to be tried again at once.
pub(super) fn passes(error: &Error) -> bool {
    lost(error) || error.code().is_some_and(others_were_quicker)
}

fn others_were_quicker(code: &SqlState) -> bool {
    *code == SqlState::T_R_SERIALIZATION_FAILURE || *code == SqlState::T_R_DEADLOCK_DETECTED
}

/// The server ends, starts, has no connection to spare, or is the copy of another and takes no changes.
fn gone(code: &SqlState) -> bool {
    let codes = [
        SqlState::ADMIN_SHUTDOWN,
        SqlState::CRASH_SHUTDOWN,
        SqlState::CANNOT_CONNECT_NOW,
        SqlState::TOO_MANY_CONNECTIONS,
        SqlState::READ_ONLY_SQL_TRANSACTION,
        SqlState::IDLE_SESSION_TIMEOUT,
        SqlState::IDLE_IN_TRANSACTION_SESSION_TIMEOUT,
    ];
    code.code().starts_with("08") || codes.contains(code)
}

pub(super) fn failed(error: Error) -> StoreError {
    StoreError::Database { trouble: trouble(&error), source: whole(&error).into() }
}

pub(super) fn away(why: impl ToString) -> StoreError {
    StoreError::Database { trouble: Trouble::Away, source: why.to_string().into() }
}

pub(super) fn unsure(why: impl ToString) -> StoreError {
    StoreError::Database { trouble: Trouble::Unsure, source: why.to_string().into() }
}

/// What an error says, with all that is behind it: the library's tell of themselves alone. In one line, where the database
/// says more in further ones.
pub(super) fn whole(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        text = format!("{text}: {cause}");
        next = cause.source();
    }
    text.replace('\n', "; ")
}
