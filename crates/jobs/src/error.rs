//! Why the store does not do what it is asked for.

use std::error::Error;
use std::io;

use crate::work::is_away;

/// Why the store does not do what it is asked for.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The jobs would take more of the disk than they may.
    #[error("jobs take {used} bytes of the disk and this one would take {wanted} more, above {limit}")]
    OverBudget {
        /// What all jobs take.
        used: u64,
        /// What this one would take.
        wanted: u64,
        /// What they may take.
        limit: u64,
    },
    /// As many jobs are queued or running as may.
    #[error("{queued} jobs are queued or running; {limit} may be")]
    Full {
        /// How many there are.
        queued: u64,
        /// How many there may be.
        limit: u64,
    },
    /// As many jobs of the client are queued or running as may.
    #[error("{queued} jobs of this client are queued or running; {limit} may be")]
    ClientFull {
        /// How many there are.
        queued: u64,
        /// How many there may be.
        limit: u64,
    },
    /// The key belongs to another request.
    #[error("the key belongs to another request")]
    OtherRequest,
    /// Another program has the folder open.
    #[error("another densecloud has this folder open")]
    Locked,
    /// Another version of the program made the database.
    #[error("the database has version {found}, not {known}")]
    Version {
        /// The version of its schema.
        found: i64,
        /// The newest one that this program reads.
        known: i64,
    },
    /// Reading or writing a blob failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Reading or writing the records failed.
    #[error("the database: {source}")]
    Database {
        /// What stands in the way, as far as the caller can do something about it.
        trouble: Trouble,
        /// What the database says. Its type depends on the database.
        source: Box<dyn Error + Send + Sync>,
    },
}

/// What stands in a database's way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Trouble {
    /// There is no room on its disk.
    Full,
    /// Another program kept it for itself for longer than a statement waits.
    Busy,
    /// It cannot be reached, or has not answered in time. What was asked for has not happened.
    Away,
    /// As [`Trouble::Away`], and it is not known whether what was asked for has happened: the connection was lost after
    /// the database was told to keep it, and before it said that it did.
    Unsure,
    /// Something else.
    Other,
}

impl StoreError {
    /// Whether there is no room on the disk, or for so large a file.
    #[must_use]
    pub fn is_full(&self) -> bool {
        match self {
            Self::Io(error) => {
                use io::ErrorKind as Kind;
                matches!(error.kind(), Kind::StorageFull | Kind::QuotaExceeded | Kind::FileTooLarge)
            }
            Self::Database { trouble, .. } => *trouble == Trouble::Full,
            _ => false,
        }
    }

    /// Whether the store of clouds and results does not answer.
    #[must_use]
    pub fn is_store_away(&self) -> bool {
        matches!(self, Self::Io(error) if is_away(error))
    }

    /// Whether another program kept the database for itself for longer than a statement waits.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        matches!(self, Self::Database { trouble: Trouble::Busy, .. })
    }

    /// Whether the database cannot be reached, or has not answered in time.
    #[must_use]
    pub fn is_away(&self) -> bool {
        matches!(self, Self::Database { trouble: Trouble::Away | Trouble::Unsure, .. })
    }

    /// Whether it is not known if what was asked for has happened.
    #[must_use]
    pub fn is_unsure(&self) -> bool {
        matches!(self, Self::Database { trouble: Trouble::Unsure, .. })
    }
}
