//! Records of jobs, wherever they are kept, and leases on the jobs that run.

use std::sync::Arc;

use crate::error::StoreError;
use crate::record::{Draft, Failure, Record, ResultFile, State, Time};

/// Keeps what is known of jobs. All that a word changes, it changes at once, and it is on durable storage when the
/// word returns.
///
/// A worker gets a job by [`Records::claim`], for a time. Whatever it says of the job afterwards shows its
/// [`Lease`], and is without effect, and answered with `false`, once the lease is not the job's any more: because
/// the job was cancelled, or put back, or claimed by another after the lease had run out. So of several workers
/// that believe to hold a job only one is right, and only its word counts.
///
/// A job is one step of work, or, where whoever has it says so ([`Records::split`]), many: a step for each of its tiles,
/// which workers may take at once, and then one that joins them. A lease is on a step. The job is running all the while,
/// and over at the first step that fails.
///
/// An implementation calls the disk or a network: each call blocks.
///
/// # Errors
/// Each word fails where the database does, and has changed nothing then; other errors stand beside the word.
pub trait Records: Send + Sync {
    /// Whether a job may come, and its name; to be asked before its cloud is written. Changes nothing.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::ClientFull`], [`StoreError::OverBudget`],
    /// [`StoreError::OtherRequest`], or what the database says.
    fn admit(&self, draft: &Draft) -> Result<Admitted, StoreError>;

    /// Whether one more job of a client may wait; to refuse it before its cloud has arrived.
    ///
    /// # Errors
    /// [`StoreError::Full`], [`StoreError::ClientFull`], or what the database says.
    fn has_room(&self, client: &str) -> Result<(), StoreError>;

    /// Queues a job under a name that [`Records::admit`] gave. Its cloud is in its blob already.
    ///
    /// # Errors
    /// As [`Records::admit`], since another job may have come between.
    fn insert(&self, id: &str, draft: &Draft, now: Time) -> Result<Submitted, StoreError>;

    /// Leases a step of the job whose turn is earliest to a worker until `until`; none where no step waits. Of the tiles
    /// that wait it is the first.
    ///
    /// Turns are fair queueing by start times, as live requests have it, with jobs all of one length: a job's turn is
    /// one after that of its client's job before it, and no earlier than one after the clock, which is the turn of
    /// the last job that was started. So clients take turns, and one that comes anew is served soon but not
    /// before those that wait: the turns that are left before a job's are taken by finitely many. A tile counts as a
    /// job: when one is claimed, and when the job is split, its next turn is as if it had come just now, after its client's
    /// others.
    ///
    /// # Errors
    /// What the database says.
    fn claim(&self, worker: &str, now: Time, until: Time) -> Result<Option<Lease>, StoreError>;

    /// Lets go of the steps whose leases ran out by `time`: they wait again, their jobs at their old turns, and the jobs
    /// of those that were started as often as they may be fail. Says which they were.
    ///
    /// # Errors
    /// What the database says.
    fn lapse(&self, time: Time, now: Time) -> Result<Vec<Lapsed>, StoreError>;

    /// Extends a lease to `until`. A lease that has run out can be extended as long as nobody let go of its job.
    ///
    /// # Errors
    /// What the database says.
    fn beat(&self, lease: &Lease, until: Time) -> Result<bool, StoreError>;

    /// The job is to be done in tiles, each of which gives so many points; their plan is in blobs, whose names begin with
    /// `plan`, and takes `bytes`, with the parts that will be made by it. The lease ends.
    ///
    /// # Errors
    /// What the database says.
    fn split(&self, lease: &Lease, plan: &str, sizes: &[u64], bytes: u64) -> Result<bool, StoreError>;

    /// A tile is done: it gave so many points, and its part is in this blob. The last one lets the job be joined.
    ///
    /// # Errors
    /// What the database says.
    fn tile_done(&self, lease: &Lease, part: &str, points: u64) -> Result<bool, StoreError>;

    /// The blobs of a job's parts that are done, by their tiles.
    ///
    /// # Errors
    /// What the database says.
    fn parts(&self, id: &str) -> Result<Vec<(u32, String)>, StoreError>;

    /// The job's tiles are of no use to whoever has the lease: it is queued again, as one that was never split.
    ///
    /// # Errors
    /// What the database says.
    fn unsplit(&self, lease: &Lease) -> Result<bool, StoreError>;

    /// The job is done, and this is its result.
    ///
    /// # Errors
    /// What the database says.
    fn done(&self, lease: &Lease, result: &ResultFile, now: Time) -> Result<bool, StoreError>;

    /// The job has failed.
    ///
    /// # Errors
    /// What the database says.
    fn failed(&self, lease: &Lease, failure: &Failure, now: Time) -> Result<bool, StoreError>;

    /// The step has failed of what is the matter with the machine that it ran on: it waits again at its old turn, as one
    /// whose lease ran out, or its job fails of that, where it was started as often as may be. Says whether it waits; none
    /// where the lease is on it no more.
    ///
    /// # Errors
    /// What the database says.
    fn retry(&self, lease: &Lease, failure: &Failure, now: Time) -> Result<Option<bool>, StoreError>;

    /// Puts the step back to its place in the queue, as if it had not been started.
    ///
    /// # Errors
    /// What the database says.
    fn put_back(&self, lease: &Lease) -> Result<bool, StoreError>;

    /// As [`Records::put_back`], for a job that finds no room at the moment: its turn has been taken, and it and its
    /// client's later ones go on to the next.
    ///
    /// # Errors
    /// What the database says.
    fn defer(&self, lease: &Lease) -> Result<bool, StoreError>;

    /// Cancels a job that is queued or running; false where it is neither.
    ///
    /// # Errors
    /// What the database says.
    fn cancel(&self, id: &str, now: Time) -> Result<bool, StoreError>;

    /// Forgets a job in a final state; none where there is none.
    ///
    /// # Errors
    /// What the database says.
    fn delete(&self, id: &str) -> Result<Option<Forgotten>, StoreError>;

    /// Forgets jobs that came to their end before `time`, `most` of them at once.
    ///
    /// # Errors
    /// What the database says.
    fn expire(&self, time: Time, most: u32) -> Result<Vec<Forgotten>, StoreError>;

    /// A job by its name.
    ///
    /// # Errors
    /// What the database says.
    fn get(&self, id: &str) -> Result<Option<Record>, StoreError>;

    /// The newest jobs, at most `limit`, before the one of number `before`; of one owner, if one is given.
    ///
    /// # Errors
    /// What the database says.
    fn list(&self, before: Option<i64>, limit: u32, owner: Option<&str>) -> Result<Vec<Record>, StoreError>;

    /// How many queued jobs are before this one, and their points out: those of its client, and as many of each
    /// other's.
    ///
    /// # Errors
    /// What the database says.
    fn ahead(&self, job: &Record) -> Result<(u64, u64), StoreError>;

    /// How many jobs there are in each state.
    ///
    /// # Errors
    /// What the database says.
    fn counts(&self) -> Result<[(State, u64); 5], StoreError>;

    /// What waits to be claimed, and how many processes work.
    ///
    /// # Errors
    /// What the database says.
    fn waiting(&self) -> Result<Waiting, StoreError>;

    /// What is queued or running.
    ///
    /// # Errors
    /// What the database says.
    fn load(&self, client: &str) -> Result<Load, StoreError>;

    /// Bytes on the disk that jobs take, records included, or will when they are done. O(1).
    ///
    /// # Errors
    /// What the database says.
    fn used(&self) -> Result<u64, StoreError>;

    /// To be said now and then by each process that works: it is there. Where several share the records, jobs that came to
    /// programs of another version or model wait for those; if none of these has been there for long, this one takes the
    /// jobs over, to be begun anew. Says which.
    ///
    /// # Errors
    /// What the database says.
    fn attend(&self, process: &str, now: Time) -> Result<Vec<String>, StoreError> {
        let _ = (process, now);
        Ok(Vec::new())
    }

    /// Has `wake` called whenever somebody changes something, this process or another, on a thread that may wait. Nobody
    /// may rely on it: what happens while the database cannot be reached is not told, but that something may have.
    fn listen(&self, wake: Arc<dyn Fn(Change) + Send + Sync>) {
        // Where one process has the records for itself, it knows what it does.
        drop(wake);
    }

    /// What blobs there should be.
    ///
    /// # Errors
    /// What the database says.
    fn promised(&self) -> Result<Vec<Promised>, StoreError>;
}

/// What somebody changed.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Change {
    /// A step waits to be claimed.
    Waits,
    /// The job of this name is over, or waits anew: whoever works at it should look at its lease.
    Over(String),
    /// Something else, of any job.
    Other,
}

/// Blobs that there should be of a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Promised {
    /// The cloud of the job of this name.
    Input(String),
    /// The same, and what its tiles are and give: whatever begins with its name.
    Tiles(String),
    /// This one, the result.
    Result(String),
}

/// What a lease is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Step {
    /// The job, which has no tiles so far.
    Whole,
    /// This tile of it.
    Tile(u32),
    /// Joining its tiles, all of which are done.
    Join,
}

impl Step {
    /// The tile that it is.
    #[must_use]
    pub fn tile(self) -> Option<u32> {
        match self {
            Self::Tile(tile) => Some(tile),
            Self::Whole | Self::Join => None,
        }
    }

    /// The name of its kind, in metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::Tile(_) => "tile",
            Self::Join => "join",
        }
    }
}

/// The right to work at a job for a while.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The job as it was when it was claimed.
    pub record: Record,
    /// What is to be done of it.
    pub step: Step,
    /// Counts the claims of this step. It grows with each, also after one that was put back, so it tells this lease
    /// from every other of the step. [`Record::attempts`], which users see, forgets those that were put back.
    pub attempt: u64,
    /// Who has it.
    pub worker: String,
    /// When it runs out.
    pub until: Time,
}

/// A step whose lease had run out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lapsed {
    /// The name of its job.
    pub id: String,
    /// The tile that it is.
    pub tile: Option<u32>,
    /// How often it was started.
    pub attempts: u32,
    /// Whether it waits again; else its job has failed as [`Failure::GaveUp`].
    pub again: bool,
}

/// A job that is not known any more.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Forgotten {
    /// Its name.
    pub id: String,
    /// The blob of its result, where it had one.
    pub blob: Option<String>,
}

/// What may be kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// Bytes that all jobs may take.
    pub disk: u64,
    /// Jobs that may be queued or running.
    pub jobs: u64,
    /// The same of one client.
    pub client_jobs: u64,
    /// How often a job is started before it counts as failed.
    pub attempts: u32,
}

/// What is queued or running.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Load {
    /// Jobs.
    pub jobs: u64,
    /// Their points out.
    pub points: u64,
    /// Clients that have one.
    pub clients: u64,
    /// Jobs of the client that asks.
    pub own: u64,
}

/// What waits to be claimed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Waiting {
    /// Jobs that are to be begun.
    pub whole: u64,
    /// Tiles.
    pub tiles: u64,
    /// Jobs that are to be joined.
    pub joins: u64,
    /// When the oldest of the jobs came that are to be begun.
    pub oldest: Option<Time>,
    /// Processes that have [said](Records::attend) of late that they are there.
    pub processes: u64,
}

/// Whether a job may come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Admitted {
    /// There is room for it; this will be its name.
    New(String),
    /// The job that the same request made earlier.
    Known(Box<Record>),
}

/// What became of a request for a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Submitted {
    /// A job that was not there before.
    New(Record),
    /// The job that the same request made earlier.
    Known(Record),
}
