//! How jobs are kept and run.

use std::path::PathBuf;
use std::time::Duration;

use crate::records::Bounds;

/// How jobs are kept and run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// The folder of database and files (`--data-dir`).
    pub folder: PathBuf,
    /// Jobs that run at a time (`--jobs-running`).
    pub running: usize,
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

impl Settings {
    /// One at a time, a thousand that wait, a hundred of them one client's, kept for a day, in at most 10 GiB.
    #[must_use]
    pub fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            running: 1,
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
