//! Every way in which a request can fail, and the one table from these to statuses.
//!
//! Errors are part of the interface: bodies are `application/problem+json` (RFC 9457), the last
//! part of `type` is stable and is also the `outcome` label in `/metrics`, and `detail` names the
//! limit and the setting that lifts it.

mod grpc;
mod http;
#[cfg(test)]
mod tests;

use std::time::Duration;

use axum::http::StatusCode;

pub(super) use self::http::inference_error;
#[cfg(test)]
pub(super) use self::tests::every_problem;
use densecloud::survey::GoalError;
use densecloud_cascade::CascadeError;
use densecloud_engine::{EngineError, Refusal};
use densecloud_formats::FormatError;

/// Why a request is not answered with a cloud.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(super) enum Problem {
    /// No such path.
    #[error("/openapi.json and /docs have all paths")]
    NotFound,
    /// The path names a model, or a version, that is not there.
    #[error("there is the model \"densecloud\" with version \"1\", not {0}")]
    UnknownModel(String),
    /// An inference request that breaks the protocol, or whose tensors are not those of the model.
    #[error("{0}")]
    MalformedRequest(String),
    /// The path exists, but not for this method.
    #[error("the Allow header has the methods of this path")]
    MethodNotAllowed,
    /// A query parameter is missing, unknown, given twice, or out of range.
    #[error("parameter {name}: {why}")]
    Parameter {
        /// The parameter.
        name: String,
        /// What it may be.
        why: String,
    },
    /// The body ended early, or its framing is broken.
    #[error("the body could not be read to its end: {0}")]
    Interrupted(String),
    /// The body is in a known format, but broken.
    #[error("{0}")]
    Malformed(String),
    /// The client stopped sending.
    #[error(
        "nothing arrived for {} s (--stall-timeout) before the body was complete", .limit.as_secs_f64()
    )]
    UploadStalled {
        /// How long was waited.
        limit: Duration,
    },
    /// The body has too many bytes.
    #[error("the body is larger than {limit} bytes; --max-body-bytes lifts this limit")]
    BodyTooLarge {
        /// The most it may have.
        limit: u64,
    },
    /// The input has, or claims to have, too many points.
    #[error("the cloud has {points} points, more than {limit}; --max-points-in lifts this limit")]
    TooManyPointsIn {
        /// The claim or the count.
        points: u64,
        /// The most it may have.
        limit: u64,
    },
    /// The result would have too many points.
    #[error("the result would have {points} points, more than {limit}; --max-points-out lifts this limit")]
    TooManyPointsOut {
        /// What was asked for.
        points: u64,
        /// The most it may have.
        limit: u64,
    },
    /// The result alone is more than all results together may hold.
    #[error(
        "{points} points with all their attributes take {bytes} bytes, more than {limit}; --max-held-bytes lifts this limit, or \
         leave attributes out with attributes=NAME:drop, or ask for fewer points"
    )]
    ResultTooLarge {
        /// Points out.
        points: u64,
        /// What they would hold.
        bytes: u64,
        /// What all results may hold.
        limit: u64,
    },
    /// In no format that is read.
    #[error("{0}")]
    UnsupportedFormat(String),
    /// The client takes no format that is written.
    #[error(
        "Accept: {wanted}: none of these is written; there are {}, or */* for the format of the input",
        densecloud_formats::Format::MEDIA_TYPES.join(", ")
    )]
    NotAcceptable {
        /// The header.
        wanted: String,
    },
    /// The body is compressed in a way that is not read.
    #[error(
        "Content-Encoding {0:?} is not supported; there are gzip, deflate and zstd, or send the body as it is"
    )]
    UnsupportedEncoding(String),
    /// A readable cloud that cannot be upsampled: too few points, all equal.
    #[error("{0}")]
    Impossible(String),
    /// Not ready yet.
    #[error("the model is being loaded; /readyz says when it is ready")]
    WarmingUp,
    /// About to stop.
    #[error("the server is stopping and takes no more work")]
    Draining,
    /// Keys are needed, and none came, or one that is not known.
    #[error("{0}; send one that the server's --keys has, as Authorization: Bearer KEY")]
    Unauthorized(&'static str),
    /// A browser sent it for a page of another site.
    #[error("a page of another site sent this; --cors-origin names those that may")]
    CrossSite,
    /// The engine does not take it.
    #[error("{0}; {hint}", hint = lifting(.0))]
    Refused(Refusal),
    /// The system gave no memory.
    #[error(
        "the system had no {0} bytes of memory left for this request; ask for fewer points, or come back later"
    )]
    OutOfMemory(
        /// What was asked for.
        u64,
    ),
    /// As many jobs wait as may.
    #[error("{queued} jobs are queued or running, and {limit} may be; --max-jobs lifts this limit")]
    JobsFull {
        /// How many there are.
        queued: u64,
        /// How many there may be.
        limit: u64,
        /// From the backlog of jobs.
        retry_after: Duration,
    },
    /// As many jobs of one client wait as may.
    #[error(
        "{queued} jobs of yours are queued or running, and {limit} may be; --client-jobs lifts this limit"
    )]
    ClientJobs {
        /// How many there are.
        queued: u64,
        /// How many there may be.
        limit: u64,
        /// From the backlog of jobs.
        retry_after: Duration,
    },
    /// Uploads and unsent results hold all the memory they may.
    #[error(
        "uploads and unsent results hold {used} of {limit} bytes, which leaves too little for this \
         request; --max-held-bytes lifts this limit"
    )]
    HeldFull {
        /// What they hold.
        used: u64,
        /// What they may hold.
        limit: u64,
    },
    /// The result was not complete in time.
    #[error(
        "the result was not complete after {} s: {spent}; X-Request-Timeout sets this limit, of which \
         --request-timeout is the most", .limit.as_secs_f64()
    )]
    Deadline {
        /// How long the request might take.
        limit: Duration,
        /// How long it took for what.
        spent: String,
    },
    /// Nothing is kept here.
    #[error("this server keeps no jobs; --data-dir gives it a folder for them")]
    JobsOff,
    /// Never was, is forgotten, or has expired.
    #[error("there is no job {0}")]
    NoJob(String),
    /// The result of a job that has none, or none yet.
    #[error("the job is {state}; only one that is done has a result")]
    JobNotDone {
        /// Where it is.
        state: &'static str,
    },
    /// An idempotency key that names another request.
    #[error("this Idempotency-Key came with another request before; give each request its own")]
    KeyReused,
    /// A part of a result that is not there.
    #[error("the result has {length} bytes; the range begins after them")]
    Range {
        /// Its bytes.
        length: u64,
    },
    /// Jobs take all of the disk that they may.
    #[error(
        "jobs take {used} bytes of the disk and this one would take {wanted} more, above {limit}; --job-disk \
         lifts this limit, and so does deleting jobs"
    )]
    JobDisk {
        /// What they take.
        used: u64,
        /// What this one would add: its cloud, and its result as a guess.
        wanted: u64,
        /// What they may take.
        limit: u64,
    },
    /// The jobs' database has no time for this request.
    #[error("{0}; nothing was changed, try again")]
    JobsBusy(
        /// Why.
        &'static str,
    ),
    /// The disk is full.
    #[error("the disk is full: {0}; make room there, or give --data-dir a folder elsewhere")]
    DiskFull(String),
    /// A job under which the program ended again and again.
    #[error(
        "the server ended {attempts} times while it worked on this job, and will not try again; \
         --job-attempts lifts this limit"
    )]
    GaveUp {
        /// How often it was started.
        attempts: u32,
    },
    /// A failure of the server's own.
    #[error("the server failed; its log tells more under this request's id")]
    Internal(
        /// For the log only.
        String,
    ),
}

/// What a client, or whoever runs the server, can do about a refusal.
fn lifting(refusal: &Refusal) -> &'static str {
    match refusal {
        Refusal::Full { .. } => "--queue-points lifts this limit",
        Refusal::Share { .. } => "--client-points lifts this limit",
        Refusal::Busy { .. } => "--queue-time lifts this limit",
        Refusal::TooBig { .. } => "--max-memory lifts this limit, or ask for fewer points",
        Refusal::Late { .. } => {
            "come back later, or give it longer with X-Request-Timeout, of which --request-timeout is the most"
        }
    }
}

impl From<FormatError> for Problem {
    fn from(error: FormatError) -> Self {
        match error {
            FormatError::Unrecognised { .. } => Self::UnsupportedFormat(error.to_string()),
            FormatError::Malformed { .. } | FormatError::Truncated { .. } => {
                Self::Malformed(error.to_string())
            }
            FormatError::TooManyPoints { points, limit } => Self::TooManyPointsIn { points, limit },
            FormatError::TooLarge { limit, .. } => Self::BodyTooLarge { limit },
            FormatError::Empty(_) => Self::Impossible(error.to_string()),
            // What only writers and mesh readers give, or what memory as a source cannot.
            _ => Self::Internal(error.to_string()),
        }
    }
}

impl From<CascadeError> for Problem {
    fn from(error: CascadeError) -> Self {
        match error {
            CascadeError::Ratio(_) => Self::parameter("ratio", error.to_string()),
            CascadeError::Points { .. }
            | CascadeError::TooFewPoints { .. }
            | CascadeError::TooManyDuplicates { .. }
            | CascadeError::Frame(_) => Self::Impossible(error.to_string()),
            CascadeError::Overlap(_)
            | CascadeError::Inner(_)
            | CascadeError::MaxDisplacement(_)
            | CascadeError::MaxDistance(_)
            | CascadeError::Backend(_) => Self::Internal(error.to_string()),
            CascadeError::OutOfMemory(bytes) => Self::OutOfMemory(bytes),
            // Nobody but a stopping engine cancels a request that is still waited for.
            CascadeError::Cancelled => Self::Draining,
        }
    }
}

impl Problem {
    /// A wish for spacing or density that cannot be met by this cloud.
    pub(super) fn from_goal(error: GoalError) -> Self {
        Self::Impossible(error.to_string())
    }

    /// What the engine's refusal or failure is to a client.
    pub(super) fn from_engine(error: EngineError) -> Self {
        match error {
            EngineError::Refused(refusal) => Self::Refused(refusal),
            EngineError::Deadline { waited, worked } => Self::Deadline {
                limit: waited + worked,
                spent: format!(
                    "{:.1} s in the queue, {:.1} s at work",
                    waited.as_secs_f64(),
                    worked.as_secs_f64()
                ),
            },
            EngineError::Cancelled => Self::Draining,
            EngineError::Cascade(error) => error.into(),
            EngineError::Internal(why) => Self::Internal(why),
        }
    }
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

    /// The outcome of the request, for metrics and logs.
    pub(super) fn outcome(&self) -> &'static str {
        self.row().name
    }

    /// The table.
    fn row(&self) -> Row {
        use StatusCode as S;
        let (status, name, title, setting) = match self {
            Self::NotFound => (S::NOT_FOUND, "not-found", "No such path", None),
            Self::UnknownModel(_) => (S::NOT_FOUND, "unknown-model", "No such model", None),
            Self::MalformedRequest(_) => {
                (S::BAD_REQUEST, "malformed-request", "The request cannot be read", None)
            }
            Self::MethodNotAllowed => {
                (S::METHOD_NOT_ALLOWED, "method-not-allowed", "Not for this method", None)
            }
            Self::Parameter { .. } => (S::BAD_REQUEST, "invalid-parameter", "Invalid parameter", None),
            Self::Interrupted(_) => (S::BAD_REQUEST, "interrupted-body", "The body broke off", None),
            Self::Malformed(_) => (S::BAD_REQUEST, "malformed-cloud", "The cloud cannot be read", None),
            Self::UploadStalled { .. } => {
                (S::REQUEST_TIMEOUT, "upload-stalled", "The upload stalled", Some("--stall-timeout"))
            }
            Self::BodyTooLarge { .. } => {
                (S::PAYLOAD_TOO_LARGE, "body-too-large", "The body is too large", Some("--max-body-bytes"))
            }
            Self::TooManyPointsIn { .. } => (
                S::PAYLOAD_TOO_LARGE,
                "too-many-points-in",
                "The cloud has too many points",
                Some("--max-points-in"),
            ),
            Self::TooManyPointsOut { .. } => (
                S::PAYLOAD_TOO_LARGE,
                "too-many-points-out",
                "The result would have too many points",
                Some("--max-points-out"),
            ),
            Self::ResultTooLarge { .. } => (
                S::PAYLOAD_TOO_LARGE,
                "result-too-large",
                "The result would be too large",
                Some("--max-held-bytes"),
            ),
            Self::UnsupportedFormat(_) => {
                (S::UNSUPPORTED_MEDIA_TYPE, "unsupported-format", "Not a format that is read", None)
            }
            Self::NotAcceptable { .. } => {
                (S::NOT_ACCEPTABLE, "not-acceptable", "No format that the client takes", None)
            }
            Self::UnsupportedEncoding(_) => {
                (S::UNSUPPORTED_MEDIA_TYPE, "unsupported-encoding", "Not a compression that is read", None)
            }
            Self::Impossible(_) => {
                (S::UNPROCESSABLE_ENTITY, "impossible-cloud", "The cloud cannot be upsampled", None)
            }
            Self::WarmingUp => (S::SERVICE_UNAVAILABLE, "warming-up", "Not ready yet", None),
            Self::Draining => (S::SERVICE_UNAVAILABLE, "draining", "About to stop", None),
            Self::Refused(Refusal::Full { .. }) => {
                (S::SERVICE_UNAVAILABLE, "queue-full", "The queue is full", Some("--queue-points"))
            }
            Self::Refused(Refusal::Busy { own: false, .. }) => {
                (S::SERVICE_UNAVAILABLE, "queue-long", "The queue is too long", Some("--queue-time"))
            }
            Self::Refused(Refusal::Busy { own: true, .. }) => (
                S::TOO_MANY_REQUESTS,
                "client-time",
                "Your share of the queue's time is used",
                Some("--queue-time"),
            ),
            Self::CrossSite => {
                (S::FORBIDDEN, "cross-site", "Not for pages of other sites", Some("--cors-origin"))
            }
            Self::Unauthorized(_) => (S::UNAUTHORIZED, "unauthorized", "A key is needed", Some("--keys")),
            Self::Refused(Refusal::Share { .. }) => (
                S::TOO_MANY_REQUESTS,
                "client-share",
                "Your share of the queue is used",
                Some("--client-points"),
            ),
            Self::Refused(Refusal::Late { .. }) => {
                (S::SERVICE_UNAVAILABLE, "too-late", "Not to be done in time", Some("--request-timeout"))
            }
            Self::Refused(Refusal::TooBig { .. }) => (
                S::INSUFFICIENT_STORAGE,
                "too-big-for-memory",
                "The work would take too much memory",
                Some("--max-memory"),
            ),
            Self::OutOfMemory(_) => (S::INSUFFICIENT_STORAGE, "out-of-memory", "No memory is left", None),
            Self::JobsFull { .. } => {
                (S::SERVICE_UNAVAILABLE, "jobs-full", "As many jobs wait as may", Some("--max-jobs"))
            }
            Self::ClientJobs { .. } => (
                S::TOO_MANY_REQUESTS,
                "client-jobs",
                "As many of your jobs wait as may",
                Some("--client-jobs"),
            ),
            Self::HeldFull { .. } => {
                (S::SERVICE_UNAVAILABLE, "memory-full", "The memory is in use", Some("--max-held-bytes"))
            }
            Self::Deadline { .. } => {
                (S::GATEWAY_TIMEOUT, "deadline", "It took too long", Some("--request-timeout"))
            }
            Self::JobsOff => (S::NOT_IMPLEMENTED, "jobs-off", "No jobs are kept here", Some("--data-dir")),
            Self::NoJob(_) => (S::NOT_FOUND, "no-such-job", "No such job", None),
            Self::JobNotDone { .. } => (S::CONFLICT, "job-not-done", "The job is not done", None),
            Self::KeyReused => {
                (S::UNPROCESSABLE_ENTITY, "idempotency-key-reused", "The key is another request's", None)
            }
            Self::Range { .. } => {
                (S::RANGE_NOT_SATISFIABLE, "range-not-satisfiable", "No such part of the result", None)
            }
            Self::JobDisk { .. } => (
                S::INSUFFICIENT_STORAGE,
                "job-disk-full",
                "Jobs take all the disk they may",
                Some("--job-disk"),
            ),
            Self::JobsBusy(_) => (S::SERVICE_UNAVAILABLE, "jobs-busy", "The jobs' database is busy", None),
            Self::DiskFull(_) => {
                (S::INSUFFICIENT_STORAGE, "disk-full", "The disk is full", Some("--data-dir"))
            }
            Self::GaveUp { .. } => (
                S::INTERNAL_SERVER_ERROR,
                "job-gave-up",
                "The job was interrupted too often",
                Some("--job-attempts"),
            ),
            Self::Internal(_) => (S::INTERNAL_SERVER_ERROR, "internal", "The server failed", None),
        };
        Row { status, name, title, setting }
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
            | Self::HeldFull { limit, .. } => Some((*limit).into()),
            Self::GaveUp { attempts } => Some((*attempts).into()),
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
            Self::WarmingUp | Self::Draining | Self::HeldFull { .. } | Self::JobsBusy(_) => Some(SOON),
            _ => None,
        }
    }
}
