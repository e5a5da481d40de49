//! Every way in which a request can fail, and the one table from these to statuses.
//!
//! | file | holds |
//! |---|---|
//! | `table` | each problem's status, name, title, words and setting: the only place where they stand |
//! | `from` | which problem an error of an inner layer is |
//! | `http`, `grpc` | a problem as an answer |
//!
//! Errors are part of the interface: bodies are `application/problem+json` (RFC 9457), the last
//! part of `type` is stable and is also the `outcome` label in `/metrics`, and `detail` names the
//! limit and the setting that lifts it.

mod from;
mod grpc;
mod http;
mod table;
#[cfg(test)]
mod tests;

use std::time::Duration;

use axum::http::StatusCode;

pub(super) use self::http::inference_error;
#[cfg(test)]
pub(super) use self::tests::every_problem;
use densecloud_engine::Refusal;

/// Why a request is not answered with a cloud.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Problem {
    /// No such path.
    NotFound,
    /// The path names a model, or a version, that is not there.
    UnknownModel(String),
    /// What would load or unload the model.
    FixedModel,
    /// A head that breaks HTTP's rules, or an inference request that breaks its protocol's, or whose tensors are not
    /// those of the model.
    MalformedRequest(String),
    /// The path exists, but not for this method.
    MethodNotAllowed,
    /// The body's length cannot be known.
    LengthRequired,
    /// The body is sent in a way that is not known.
    TransferCoding(String),
    /// A query parameter is missing, unknown, given twice, or out of range.
    Parameter {
        /// The parameter.
        name: String,
        /// What it may be.
        why: String,
    },
    /// The body ended early, or its framing is broken.
    Interrupted(String),
    /// The body is in a known format, but broken.
    Malformed(String),
    /// The body lost all its line ends and zero bytes before it was sent.
    Stripped,
    /// The client stopped sending.
    UploadStalled {
        /// How long was waited.
        limit: Duration,
    },
    /// The body has too many bytes.
    BodyTooLarge {
        /// The most it may have.
        limit: u64,
    },
    /// The input has, or claims to have, too many points.
    TooManyPointsIn {
        /// The claim or the count.
        points: u64,
        /// The most it may have.
        limit: u64,
    },
    /// The result would have too many points.
    TooManyPointsOut {
        /// What was asked for.
        points: u64,
        /// The most it may have.
        limit: u64,
    },
    /// The result alone is more than all results together may hold.
    ResultTooLarge {
        /// Points out.
        points: u64,
        /// What they would hold.
        bytes: u64,
        /// What all results may hold.
        limit: u64,
    },
    /// In no format that is read.
    UnsupportedFormat(String),
    /// The client takes no format that is written.
    NotAcceptable {
        /// The header.
        wanted: String,
    },
    /// The body is compressed in a way that is not read.
    UnsupportedEncoding(String),
    /// A readable cloud that cannot be upsampled: too few points, all equal.
    Impossible(String),
    /// Not ready yet.
    WarmingUp,
    /// About to stop.
    Draining,
    /// Keys are needed, and none came, or one that is not known.
    Unauthorized(&'static str),
    /// A browser sent it for a page of another site.
    CrossSite,
    /// The engine does not take it.
    Refused(Refusal),
    /// The system gave no memory.
    OutOfMemory(
        /// What was asked for.
        u64,
    ),
    /// As many jobs wait as may.
    JobsFull {
        /// How many there are.
        queued: u64,
        /// How many there may be.
        limit: u64,
        /// From the backlog of jobs.
        retry_after: Duration,
    },
    /// As many jobs of one client wait as may.
    ClientJobs {
        /// How many there are.
        queued: u64,
        /// How many there may be.
        limit: u64,
        /// From the backlog of jobs.
        retry_after: Duration,
    },
    /// Uploads and unsent results hold all the memory they may.
    HeldFull {
        /// What they hold.
        used: u64,
        /// What they may hold.
        limit: u64,
    },
    /// Long uploads and tiles take all of the disk that they may.
    TempFull {
        /// What they take.
        used: u64,
        /// What they may take.
        limit: u64,
    },
    /// The disk of the folder for temporary files has no room.
    TempSpace(String),
    /// The result was not complete in time.
    Deadline {
        /// How long the request might take.
        limit: Duration,
        /// How long it took for what.
        spent: String,
    },
    /// Nothing is kept here.
    JobsOff,
    /// Never was, is forgotten, or has expired.
    NoJob(String),
    /// The result of a job that has none, or none yet.
    JobNotDone {
        /// Where it is.
        state: &'static str,
    },
    /// An idempotency key that names another request.
    KeyReused,
    /// A part of a result that is not there.
    Range {
        /// Its bytes.
        length: u64,
    },
    /// Jobs take all of the disk that they may.
    JobDisk {
        /// What they take.
        used: u64,
        /// What this one would add: its cloud, and its result as a guess.
        wanted: u64,
        /// What they may take.
        limit: u64,
    },
    /// The jobs' database has no time for this request.
    JobsBusy(
        /// Why.
        &'static str,
    ),
    /// The disk is full.
    DiskFull(String),
    /// A job under which the program ended again and again.
    GaveUp {
        /// How often it was started.
        attempts: u32,
        /// Of a job in tiles, the one that it ended under.
        tile: Option<u32>,
    },
    /// A failure of the server's own.
    Internal(
        /// For the log only.
        String,
    ),
}

/// One row of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Row {
    status: StatusCode,
    /// Last part of `type`, and the `outcome` in metrics and logs.
    name: &'static str,
    title: &'static str,
    /// The setting that lifts the limit, where one does.
    setting: Option<&'static str>,
}

/// How long a client should wait where the backlog says nothing.
pub(super) const SOON: Duration = Duration::from_secs(5);

impl Problem {
    pub(super) fn parameter(name: &str, why: String) -> Self {
        Self::Parameter { name: name.to_owned(), why }
    }

    /// The status of an answer that says it.
    pub(super) fn status(&self) -> StatusCode {
        self.row().status
    }

    /// The outcome of the request, for metrics and logs.
    pub(super) fn outcome(&self) -> &'static str {
        self.row().name
    }

    /// The number that was passed, where the problem is a limit.
    fn limit(&self) -> Option<serde_json::Number> {
        let seconds = |limit: &Duration| serde_json::Number::from_f64(limit.as_secs_f64());
        match self {
            Self::BodyTooLarge { limit }
            | Self::TooManyPointsIn { limit, .. }
            | Self::TooManyPointsOut { limit, .. }
            | Self::ResultTooLarge { limit, .. }
            | Self::Refused(
                Refusal::Full { limit, .. } | Refusal::Share { limit, .. } | Refusal::TooBig { limit, .. },
            )
            | Self::JobsFull { limit, .. }
            | Self::ClientJobs { limit, .. }
            | Self::JobDisk { limit, .. }
            | Self::HeldFull { limit, .. }
            | Self::TempFull { limit, .. } => Some((*limit).into()),
            Self::GaveUp { attempts, .. } => Some((*attempts).into()),
            Self::UploadStalled { limit }
            | Self::Deadline { limit, .. }
            | Self::Refused(Refusal::Busy { limit, .. }) => seconds(limit),
            _ => None,
        }
    }

    fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Refused(refusal) => refusal.retry_after(),
            Self::JobsFull { retry_after, .. } | Self::ClientJobs { retry_after, .. } => Some(*retry_after),
            Self::WarmingUp
            | Self::Draining
            | Self::HeldFull { .. }
            | Self::TempFull { .. }
            | Self::JobsBusy(_) => Some(SOON),
            _ => None,
        }
    }
}
