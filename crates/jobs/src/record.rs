//! What is known of one job.

use std::fmt;
use std::io::{self, Write};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Milliseconds since 1970.
pub type Time = i64;

/// Bytes that the record of a job takes beside its texts, about.
const ROW: u64 = 1024;

/// The state of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum State {
    /// Waits for its turn.
    Queued,
    /// Is being worked on.
    Running,
    /// Its result is there.
    Done,
    /// Has no result and never will.
    Failed,
    /// Somebody wanted no result.
    Cancelled,
}

impl State {
    /// All, in the order of a job's life.
    pub const ALL: [Self; 5] = [Self::Queued, Self::Running, Self::Done, Self::Failed, Self::Cancelled];

    /// Its name in the database, in answers and in metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether it is final: a job never leaves it.
    #[must_use]
    pub fn is_final(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }

    pub(crate) fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.name() == name)
    }
}

/// A cloud's file on its way to the store, in memory or elsewhere.
pub trait CloudFile: Send + Sync {
    /// Its bytes.
    fn length(&self) -> u64;

    /// Writes all of it.
    ///
    /// # Errors
    /// The sink fails, or the file cannot be read.
    fn copy_to(&self, sink: &mut dyn Write) -> io::Result<()>;
}

impl CloudFile for Vec<u8> {
    fn length(&self) -> u64 {
        self.len() as u64
    }

    fn copy_to(&self, sink: &mut dyn Write) -> io::Result<()> {
        sink.write_all(self)
    }
}

impl fmt::Debug for dyn CloudFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} bytes", self.length())
    }
}

/// What somebody wants done.
#[derive(Debug, Clone)]
pub struct NewJob {
    /// What is asked for beside the cloud, as text that [`Work`](crate::Work) understands.
    pub request: String,
    /// The sender's name for the request: a second request of the same owner with the same key is the same job.
    pub key: Option<String>,
    /// The only one who may see it, and whose keys are told from others'; empty where everybody may.
    pub owner: String,
    /// Who sends it, for shares and turns.
    pub client: String,
    /// The name of the request that brought it, for the log.
    pub request_id: String,
    /// Points in the cloud.
    pub points_in: u64,
    /// Points in the result.
    pub points_out: u64,
    /// Bytes that the result will take on the disk, about.
    pub result_bytes: u64,
    /// The cloud's file.
    pub input: Arc<dyn CloudFile>,
}

/// A new job, with what is computed from it before it is kept.
#[derive(Debug, Clone)]
pub struct Draft {
    pub(crate) job: NewJob,
    /// The same for the same request with the same cloud.
    pub(crate) fingerprint: String,
    /// Bytes that its record takes, in whatever state.
    pub(crate) row_bytes: u64,
}

/// Hashes what is written.
struct Hashing(Sha256);

impl Write for Hashing {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Draft {
    /// O(bytes of the cloud).
    ///
    /// # Errors
    /// The cloud's file cannot be read.
    pub fn new(job: NewJob) -> io::Result<Self> {
        let mut hash = Sha256::new();
        hash.update((job.request.len() as u64).to_le_bytes());
        hash.update(&job.request);
        let mut hash = Hashing(hash);
        job.input.copy_to(&mut hash)?;
        let fingerprint = hex::encode(hash.0.finalize());
        let NewJob { request, owner, client, request_id, .. } = &job;
        let key = job.key.as_ref().map_or(0, String::len);
        let texts = request.len() + owner.len() + client.len() + request_id.len() + key;
        Ok(Self { fingerprint, row_bytes: ROW + texts as u64, job })
    }

    /// Its cloud's file.
    #[must_use]
    pub fn input(&self) -> &dyn CloudFile {
        &*self.job.input
    }

    /// Bytes that the job takes until it is over: its cloud, its result and its record.
    pub(crate) fn bytes(&self) -> u64 {
        let files = self.job.input.length().saturating_add(self.job.result_bytes);
        files.saturating_add(self.row_bytes)
    }
}

/// What is known of one job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    /// Jobs of one client are run in this order.
    pub number: i64,
    /// Its name: 32 hexadecimal digits, not to be guessed.
    pub id: String,
    /// Its state.
    pub state: State,
    /// See [`NewJob::request`].
    pub request: String,
    /// See [`NewJob::owner`].
    pub owner: String,
    /// See [`NewJob::client`].
    pub client: String,
    /// See [`NewJob::request_id`].
    pub request_id: String,
    /// Points in the cloud.
    pub points_in: u64,
    /// Points in the result.
    pub points_out: u64,
    /// Its place on the clock by which clients take turns; of equal ones the lower number is first.
    pub turn: i64,
    /// How often it was started; a stop of the server in good order does not count.
    pub attempts: u32,
    /// When it came.
    pub created: Time,
    /// When it was last started; none where it has been put back since.
    pub started: Option<Time>,
    /// When it came to its final state.
    pub finished: Option<Time>,
    /// Of a job that is worked on in tiles, once these are planned.
    pub tiles: Option<Tiles>,
    /// Of a job that is done.
    pub result: Option<ResultFile>,
    /// Of a job that has failed.
    pub failure: Option<Failure>,
}

/// The tiles of a job, and how far they are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tiles {
    /// What the names of the plan's blobs begin with: several attempts may have written one, and this is the one that
    /// counts.
    pub plan: String,
    /// How many there are.
    pub count: u32,
    /// How many of them are done.
    pub done: u32,
    /// Points of the result that those gave.
    pub points: u64,
}

/// The result of a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ResultFile {
    /// The name of its blob: several attempts may have written one, and this is the one that counts.
    pub blob: String,
    /// Its length.
    pub bytes: u64,
    /// Its SHA-256 in hexadecimal digits.
    pub sha256: String,
    /// What [`Work`](crate::Work) says of it beside, as text.
    pub about: String,
}

/// Why a job has no result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Failure {
    /// Its cloud cannot be upsampled; this is what [`Work`](crate::Work) says of it.
    Refused(String),
    /// Its files could not be read or written.
    Storage {
        /// What the system says.
        why: String,
        /// There was no room.
        full: bool,
    },
    /// The program ended under it too often.
    GaveUp {
        /// How often it was started.
        attempts: u32,
        /// Of a job in tiles, the one that it ended under.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        tile: Option<u32>,
    },
    /// A bug; other jobs are not affected.
    Crashed,
}
