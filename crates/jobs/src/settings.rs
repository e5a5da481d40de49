//! How jobs are kept and run.

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::postgres::Password;
use crate::records::Bounds;

/// How jobs are kept and run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// Where they are kept.
    pub keeping: Keeping,
    /// Steps of jobs that run at a time (`--jobs-running`); none where others work on them.
    pub running: usize,
    /// How long a worker may be silent before its step is given to another (`--job-lease`).
    pub lease: Duration,
    /// How long a job that has come to its end is kept (`--job-expiry`).
    pub expiry: Duration,
    /// Bytes of the disk that jobs may take (`--job-disk`).
    pub disk: u64,
    /// Jobs that may be queued or running (`--max-jobs`).
    pub queued: u64,
    /// The same of one client (`--client-jobs`).
    pub client_queued: u64,
    /// How often a job is started before it counts as failed (`--job-attempts`).
    pub attempts: u32,
}

/// Where jobs are kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Keeping {
    /// A folder of database and files, of this program alone (`--data-dir`).
    Folder(PathBuf),
    /// A database and a store that programs on many machines share.
    Shared {
        /// The address of the database (`--database`).
        database: String,
        /// Its password (`--database-password-file`); without one it is in the environment, if there is one.
        password: Option<Password>,
        /// The address of the store (`--store`).
        store: String,
        /// The name of this process, unlike that of any other.
        process: String,
        /// What this program computes by: programs of which this is the same give the same bytes.
        kind: String,
    },
}

impl Settings {
    /// That of a program that has its jobs alone: it loses one only where it sleeps.
    pub const LEASE_ALONE: Duration = Duration::from_secs(120);

    /// The folder that they are kept in, of this program alone.
    #[must_use]
    pub fn folder(&self) -> Option<&Path> {
        match &self.keeping {
            Keeping::Folder(folder) => Some(folder),
            Keeping::Shared { .. } => None,
        }
    }

    /// One at a time, a thousand that wait, a hundred of them one client's, kept for a day, in at most 10 GiB.
    #[must_use]
    pub fn new(folder: PathBuf) -> Self {
        Self {
            keeping: Keeping::Folder(folder),
            running: 1,
            lease: Self::LEASE_ALONE,
            expiry: Duration::from_secs(24 * 3600),
            disk: 10 << 30,
            queued: 1000,
            client_queued: 100,
            attempts: 3,
        }
    }

    pub(crate) fn bounds(&self) -> Bounds {
        Bounds {
            disk: self.disk,
            jobs: self.queued,
            client_jobs: self.client_queued,
            attempts: self.attempts,
        }
    }
}
