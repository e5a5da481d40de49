//! Every way in which a request can fail, and the one table from these to statuses.
//!
//! Errors are part of the interface: bodies are `application/problem+json` (RFC 9457), the last
//! part of `type` is stable and is also the `outcome` label in `/metrics`, and `detail` names the
//! limit and the setting that lifts it.

use std::collections::HashMap;
use std::time::Duration;

use axum::body::Body;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use super::decode::Coding;
use crate::cascade::CascadeError;
use crate::engine::EngineError;
use crate::formats::FormatError;
use crate::survey::GoalError;

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
        crate::formats::Format::MEDIA_TYPES.join(", ")
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
    /// The client's share of the engine's queue is used.
    #[error(
        "{used} points of yours are queued or being worked on, and this request would add {wanted}, above \
         your share of {limit}; --client-points lifts this limit"
    )]
    ClientShare {
        /// Points in this request's result.
        wanted: u64,
        /// Points in the results of all requests of the client before it.
        used: u64,
        /// The most there may be.
        limit: u64,
        /// From the client's own backlog.
        retry_after: Duration,
    },
    /// What waits takes so long that nothing more is taken, of this client or of anybody.
    #[error(
        "what {} waiting takes {:.1} s, and above {:.1} s no more is taken; --queue-time lifts this limit",
        if *own { "you have" } else { "is" }, waiting.as_secs_f64(), limit.as_secs_f64()
    )]
    Busy {
        /// Whether it is the client's own work.
        own: bool,
        /// How long that will take.
        waiting: Duration,
        /// The most it may take.
        limit: Duration,
        /// When there will be room.
        retry_after: Duration,
    },
    /// With what is queued, the deadline cannot be met.
    #[error(
        "with what is queued, this request would be done in about {:.1} s, and it has {:.1} s left; come back \
         later, or give it longer with X-Request-Timeout, of which --request-timeout is the most",
        needed.as_secs_f64(), left.as_secs_f64()
    )]
    Late {
        /// When it would be done.
        needed: Duration,
        /// Time to its deadline.
        left: Duration,
        /// When that would do.
        retry_after: Duration,
    },
    /// The work alone takes more memory than all work together may.
    #[error(
        "the work would take about {bytes} bytes of memory, more than {limit}; --max-memory lifts this limit, \
         or ask for fewer points"
    )]
    TooBig {
        /// The estimate.
        bytes: u64,
        /// The most it may take.
        limit: u64,
    },
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
    /// The engine's queue is full.
    #[error(
        "{queued} points are queued or being worked on, and this request would add {wanted}, above the \
         limit of {limit}; --queue-points lifts this limit"
    )]
    QueueFull {
        /// Points in this request's result.
        wanted: u64,
        /// Points in the results of all requests before it.
        queued: u64,
        /// The most there may be.
        limit: u64,
        /// From the backlog and the measured rate.
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
    /// Another program has the jobs' database for itself.
    #[error("another program has locked the jobs' database; nothing was changed, try again")]
    JobsBusy,
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
            EngineError::Full { wanted, queued, limit, retry_after } => {
                Self::QueueFull { wanted, queued, limit, retry_after }
            }
            EngineError::Share { wanted, used, limit, retry_after } => {
                Self::ClientShare { wanted, used, limit, retry_after }
            }
            EngineError::Busy { own, waiting, limit, retry_after } => {
                Self::Busy { own, waiting, limit, retry_after }
            }
            EngineError::TooBig { bytes, limit } => Self::TooBig { bytes, limit },
            EngineError::Late { needed, left, retry_after } => Self::Late { needed, left, retry_after },
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
                (S::BAD_REQUEST, "malformed-request", "The inference request cannot be read", None)
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
            Self::QueueFull { .. } => {
                (S::SERVICE_UNAVAILABLE, "queue-full", "The queue is full", Some("--queue-points"))
            }
            Self::Busy { own: false, .. } => {
                (S::SERVICE_UNAVAILABLE, "queue-long", "The queue is too long", Some("--queue-time"))
            }
            Self::Busy { own: true, .. } => (
                S::TOO_MANY_REQUESTS,
                "client-time",
                "Your share of the queue's time is used",
                Some("--queue-time"),
            ),
            Self::Unauthorized(_) => (S::UNAUTHORIZED, "unauthorized", "A key is needed", Some("--keys")),
            Self::ClientShare { .. } => (
                S::TOO_MANY_REQUESTS,
                "client-share",
                "Your share of the queue is used",
                Some("--client-points"),
            ),
            Self::Late { .. } => {
                (S::SERVICE_UNAVAILABLE, "too-late", "Not to be done in time", Some("--request-timeout"))
            }
            Self::TooBig { .. } => (
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
            Self::JobsBusy => (S::SERVICE_UNAVAILABLE, "jobs-busy", "The jobs' database is locked", None),
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
            | Self::QueueFull { limit, .. }
            | Self::ClientShare { limit, .. }
            | Self::TooBig { limit, .. }
            | Self::JobsFull { limit, .. }
            | Self::ClientJobs { limit, .. }
            | Self::JobDisk { limit, .. }
            | Self::HeldFull { limit, .. } => Some((*limit).into()),
            Self::GaveUp { attempts } => Some((*attempts).into()),
            Self::UploadStalled { limit } | Self::Deadline { limit, .. } | Self::Busy { limit, .. } => {
                seconds(limit)
            }
            _ => None,
        }
    }

    fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::QueueFull { retry_after, .. }
            | Self::ClientShare { retry_after, .. }
            | Self::Busy { retry_after, .. }
            | Self::Late { retry_after, .. }
            | Self::JobsFull { retry_after, .. }
            | Self::ClientJobs { retry_after, .. } => Some(*retry_after),
            Self::WarmingUp | Self::Draining | Self::HeldFull { .. } | Self::JobsBusy => Some(SOON),
            _ => None,
        }
    }

    /// The body, as JSON. A separate step from [`IntoResponse`], because only the outermost layer
    /// knows the request's id.
    pub(super) fn body(&self, request_id: &str) -> Body {
        // Strings and numbers only: there is nothing that JSON could not hold.
        let mut text = serde_json::to_vec(&self.document(request_id)).unwrap_or_default();
        // For people at a terminal.
        text.push(b'\n');
        Body::from(text)
    }

    /// The same, to be part of another document.
    pub(super) fn value(&self, request_id: &str) -> serde_json::Value {
        serde_json::to_value(self.document(request_id)).unwrap_or_default()
    }

    fn document<'a>(&'a self, request_id: &'a str) -> Document<'a> {
        let Row { status, name, title, setting } = self.row();
        Document {
            kind: format!("urn:densecloud:problem:{name}"),
            title,
            status: status.as_u16(),
            detail: self.to_string(),
            parameter: match self {
                Self::Parameter { name, .. } => Some(name),
                _ => None,
            },
            limit: self.limit(),
            setting,
            request_id,
        }
    }
}

/// The most characters of a problem's words in a gRPC status, which is sent as headers.
const LONGEST_STATUS: usize = 1000;

impl Problem {
    /// The same for gRPC. Its code follows from the status, so that there is one table.
    pub(super) fn grpc(&self, request_id: &str) -> Status {
        let Row { status, name, setting, .. } = self.row();
        let code = match (self, status.as_u16()) {
            // No such method, in gRPC's words.
            (Self::NotFound | Self::MethodNotAllowed, _) => Code::Unimplemented,
            (_, 400 | 406 | 415 | 422) => Code::InvalidArgument,
            (_, 401) => Code::Unauthenticated,
            (_, 403) => Code::PermissionDenied,
            (_, 404) => Code::NotFound,
            (_, 408 | 504) => Code::DeadlineExceeded,
            (_, 409) => Code::FailedPrecondition,
            (_, 413 | 429 | 507) => Code::ResourceExhausted,
            (_, 416) => Code::OutOfRange,
            (_, 501) => Code::Unimplemented,
            (_, 503) => Code::Unavailable,
            _ => Code::Internal,
        };
        let words = match self {
            Self::NotFound | Self::MethodNotAllowed => {
                "no such method; reflection lists those that there are".to_owned()
            }
            _ => self.to_string(),
        };
        let words: String = words.chars().take(LONGEST_STATUS).collect();
        let mut details = ErrorDetails::new();
        let told =
            [("limit", self.limit().map(|limit| limit.to_string())), ("setting", setting.map(str::to_owned))];
        let told = told.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?)));
        details.set_error_info(
            name.to_uppercase().replace('-', "_"),
            "densecloud",
            told.collect::<HashMap<_, _>>(),
        );
        details.set_request_info(request_id, "");
        if let Some(wait) = self.retry_after() {
            details.set_retry_info(Some(wait));
        }
        if let Self::Parameter { name, why } = self {
            details.add_bad_request_violation(name, why.chars().take(LONGEST_STATUS).collect::<String>());
        }
        Status::with_error_details(code, words, details)
    }
}

/// The body of an error under `/v2`, as the Open Inference Protocol has it.
pub(super) fn inference_error(problem: &Problem) -> Body {
    Body::from(serde_json::json!({ "error": problem.to_string() }).to_string())
}

/// The members of RFC 9457, then our own.
#[derive(Serialize)]
struct Document<'a> {
    #[serde(rename = "type")]
    kind: String,
    title: &'static str,
    status: u16,
    detail: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    parameter: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    limit: Option<serde_json::Number>,
    #[serde(skip_serializing_if = "Option::is_none")]
    setting: Option<&'static str>,
    request_id: &'a str,
}

impl IntoResponse for Problem {
    /// Status and headers; the problem itself goes along as an extension, for
    /// [`super::record`] to write its body.
    fn into_response(self) -> Response {
        let mut response = self.row().status.into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        if let Some(wait) = self.retry_after() {
            // Rounded up: one who comes back a moment early is refused again.
            let seconds = wait.as_secs() + u64::from(wait.subsec_nanos() > 0);
            headers.insert(header::RETRY_AFTER, seconds.max(1).into());
        }
        if let Self::Unauthorized(_) = self {
            // RFC 9110, section 15.5.2: says how to do it.
            let how = HeaderValue::from_static("Bearer realm=\"densecloud\"");
            headers.insert(header::WWW_AUTHENTICATE, how);
        }
        if let Self::UnsupportedEncoding(_) = self {
            // RFC 9110, section 15.5.16: says what would have been accepted.
            headers.insert(header::ACCEPT_ENCODING, HeaderValue::from_static(Coding::ACCEPTED));
        }
        if let Self::Range { length } = self {
            // RFC 9110, section 15.5.17: says what there is.
            let there = HeaderValue::from_str(&format!("bytes */{length}"));
            headers.insert(header::CONTENT_RANGE, there.unwrap_or(HeaderValue::from_static("bytes */*")));
        }
        response.extensions_mut().insert(self);
        response
    }
}

/// One of each, with its status and its name.
#[cfg(test)]
pub(super) fn every_problem() -> Vec<(Problem, u16, &'static str)> {
    let second = Duration::from_millis(1500);
    let busy = |own| Problem::Busy { own, waiting: second, limit: second, retry_after: second };
    vec![
        (Problem::NotFound, 404, "not-found"),
        (Problem::UnknownModel("x".into()), 404, "unknown-model"),
        (Problem::MalformedRequest("x".into()), 400, "malformed-request"),
        (Problem::MethodNotAllowed, 405, "method-not-allowed"),
        (Problem::parameter("ratio", "missing".into()), 400, "invalid-parameter"),
        (Problem::Interrupted("x".into()), 400, "interrupted-body"),
        (Problem::Malformed("x".into()), 400, "malformed-cloud"),
        (Problem::NotAcceptable { wanted: "x".into() }, 406, "not-acceptable"),
        (Problem::UploadStalled { limit: second }, 408, "upload-stalled"),
        (Problem::BodyTooLarge { limit: 5 }, 413, "body-too-large"),
        (Problem::TooManyPointsIn { points: 9, limit: 5 }, 413, "too-many-points-in"),
        (Problem::TooManyPointsOut { points: 9, limit: 5 }, 413, "too-many-points-out"),
        (Problem::ResultTooLarge { points: 9, bytes: 99, limit: 5 }, 413, "result-too-large"),
        (Problem::UnsupportedFormat("x".into()), 415, "unsupported-format"),
        (Problem::UnsupportedEncoding("gzip".into()), 415, "unsupported-encoding"),
        (Problem::Impossible("x".into()), 422, "impossible-cloud"),
        (Problem::WarmingUp, 503, "warming-up"),
        (Problem::Draining, 503, "draining"),
        (Problem::QueueFull { wanted: 1, queued: 5, limit: 5, retry_after: second }, 503, "queue-full"),
        (Problem::HeldFull { used: 4, limit: 5 }, 503, "memory-full"),
        (Problem::Deadline { limit: second, spent: "x".into() }, 504, "deadline"),
        (Problem::Unauthorized("x"), 401, "unauthorized"),
        (busy(false), 503, "queue-long"),
        (busy(true), 429, "client-time"),
        (Problem::ClientShare { wanted: 1, used: 5, limit: 5, retry_after: second }, 429, "client-share"),
        (Problem::Late { needed: second, left: second, retry_after: second }, 503, "too-late"),
        (Problem::TooBig { bytes: 9, limit: 5 }, 507, "too-big-for-memory"),
        (Problem::OutOfMemory(9), 507, "out-of-memory"),
        (Problem::JobsFull { queued: 5, limit: 5, retry_after: second }, 503, "jobs-full"),
        (Problem::ClientJobs { queued: 5, limit: 5, retry_after: second }, 429, "client-jobs"),
        (Problem::JobsOff, 501, "jobs-off"),
        (Problem::NoJob("x".into()), 404, "no-such-job"),
        (Problem::JobNotDone { state: "queued" }, 409, "job-not-done"),
        (Problem::KeyReused, 422, "idempotency-key-reused"),
        (Problem::Range { length: 5 }, 416, "range-not-satisfiable"),
        (Problem::JobDisk { used: 5, wanted: 1, limit: 5 }, 507, "job-disk-full"),
        (Problem::JobsBusy, 503, "jobs-busy"),
        (Problem::DiskFull("x".into()), 507, "disk-full"),
        (Problem::GaveUp { attempts: 3 }, 500, "job-gave-up"),
        (Problem::Internal("secret".into()), 500, "internal"),
    ]
}

#[cfg(test)]
mod tests {
    use super::every_problem as all;
    use super::*;

    async fn document(problem: &Problem) -> serde_json::Value {
        let bytes = axum::body::to_bytes(problem.body("id-1"), 10_000).await.expect("a body");
        serde_json::from_slice(&bytes).expect("JSON")
    }

    #[tokio::test]
    async fn the_table() {
        let mut names = std::collections::BTreeSet::new();
        for (problem, status, name) in all() {
            let body = document(&problem).await;
            assert_eq!(body["status"], status, "{problem:?}");
            assert_eq!(body["type"], format!("urn:densecloud:problem:{name}"));
            assert_eq!(body["request_id"], "id-1");
            assert!(!body["title"].as_str().expect("a title").is_empty());
            assert!(names.insert(name), "{name} names two problems");
            assert_eq!(problem.outcome(), name);
            let response = problem.into_response();
            assert_eq!(response.status().as_u16(), status);
            assert_eq!(response.headers()["content-type"], "application/problem+json");
            assert_eq!(response.headers().contains_key("retry-after"), matches!(status, 429 | 503));
            assert_eq!(response.headers().contains_key("www-authenticate"), status == 401);
        }
    }

    #[test]
    fn every_problem_has_a_grpc_status_with_the_same_words() {
        for (problem, status, name) in all() {
            let grpc = problem.grpc("id-1");
            let expected = match status {
                500 => Code::Internal,
                503 => Code::Unavailable,
                413 | 507 => Code::ResourceExhausted,
                408 | 504 => Code::DeadlineExceeded,
                501 | 405 => Code::Unimplemented,
                _ => grpc.code(),
            };
            assert_eq!(grpc.code(), expected, "{name}");
            assert!(
                grpc.code() != Code::Unknown && (status < 500) == (grpc.code() != Code::Internal)
                    || status > 500
            );
            let details = grpc.get_error_details();
            let info = details.error_info().expect("info");
            assert_eq!(info.reason.to_lowercase().replace('_', "-"), name);
            assert_eq!(info.metadata.get("setting").map(String::as_str), problem.row().setting);
            assert_eq!(details.request_info().expect("info").request_id, "id-1");
            assert_eq!(details.retry_info().is_some(), matches!(status, 429 | 503), "{name}");
            assert!(!grpc.message().contains("secret"));
        }
        let manual = include_str!("../../docs/grpc.md");
        let rows = manual.lines().filter(|line| line.starts_with("| `"));
        let rows: Vec<Vec<&str>> = rows.map(|row| row.split('|').map(str::trim).collect()).collect();
        for (problem, status, name) in
            all().into_iter().filter(|(_, status, _)| ![404, 409, 416].contains(status))
        {
            let row = rows.iter().find(|row| row[2].split(", ").any(|s| s == status.to_string()));
            let code = row.unwrap_or_else(|| panic!("no row for {name}"))[1].replace(['_', '`'], "");
            assert_eq!(code, format!("{:?}", problem.grpc("").code()).to_uppercase(), "{name}");
        }
        let long = Problem::parameter("attributes", "x".repeat(100_000)).grpc("id-1");
        assert!(long.details().len() + long.message().len() < 8000, "it fits into headers");
    }

    #[test]
    fn the_manual_has_the_same_table() {
        let manual = include_str!("../../docs/http.md");
        for (problem, status, name) in all() {
            let row = manual.lines().find(|line| line.starts_with(&format!("| {status} | `{name}` |")));
            let row = row.unwrap_or_else(|| panic!("no row for {status} {name}"));
            let setting = problem.row().setting.map_or("| |".into(), |setting| format!("| `{setting}` |"));
            assert!(row.ends_with(&setting), "{row}");
        }
    }

    #[tokio::test]
    async fn a_limit_is_told_with_its_number_and_the_setting_that_lifts_it() {
        for (problem, _, name) in all() {
            let row = problem.row();
            if let Some(setting) = row.setting {
                assert!(problem.to_string().contains(setting), "{name}: {problem}");
                assert_eq!(document(&problem).await["setting"], setting);
            }
            assert!(problem.limit().is_none() || row.setting.is_some(), "{name} has a limit but no setting");
        }
        assert_eq!(document(&Problem::TooManyPointsIn { points: 9, limit: 5 }).await["limit"], 5);
        assert_eq!(document(&Problem::parameter("ratio", "x".into())).await["parameter"], "ratio");
    }

    #[tokio::test]
    async fn what_failed_inside_stays_inside() {
        let body = document(&Problem::Internal("/srv/secret".into())).await;
        assert!(!body.to_string().contains("secret"), "{body}");
    }

    #[test]
    fn inner_errors_find_their_place_in_the_table() {
        use crate::backend::BackendError;
        use crate::cloud::FrameError;
        use crate::formats::Place;
        let name = |problem: Problem| problem.row().name;
        for (error, expected) in [
            (FormatError::Unrecognised { found: "a ZIP file".into() }, "unsupported-format"),
            (FormatError::Malformed { at: Place::Line(3), why: "x".into() }, "malformed-cloud"),
            (FormatError::Truncated { at: Place::Byte(3), why: "x".into() }, "malformed-cloud"),
            (FormatError::TooManyPoints { points: 9, limit: 5 }, "too-many-points-in"),
            (FormatError::TooLarge { bytes: 9, limit: 5 }, "body-too-large"),
            (FormatError::Empty("points"), "impossible-cloud"),
            (FormatError::WrongCount { promised: 1, written: 2 }, "internal"),
        ] {
            let text = error.to_string();
            assert_eq!(name(error.into()), expected, "{text}");
        }
        let run = BackendError::Run { unit: 1, why: "x".into() };
        for (error, expected) in [
            (CascadeError::Ratio(99.0), "invalid-parameter"),
            (CascadeError::Points { wanted: 1, from: 9 }, "impossible-cloud"),
            (CascadeError::TooFewPoints { distinct: 1, duplicates: 0, needed: 33 }, "impossible-cloud"),
            (CascadeError::TooManyDuplicates { distinct: 1, total: 99 }, "impossible-cloud"),
            (CascadeError::Frame(FrameError::Degenerate), "impossible-cloud"),
            (CascadeError::Backend(run), "internal"),
            (CascadeError::OutOfMemory(9), "out-of-memory"),
            (CascadeError::Cancelled, "draining"),
        ] {
            let text = error.to_string();
            assert_eq!(name(Problem::from_engine(EngineError::Cascade(error))), expected, "{text}");
        }
        let full = EngineError::Full { wanted: 1, queued: 5, limit: 5, retry_after: SOON };
        assert_eq!(Problem::from_engine(full).retry_after(), Some(SOON));
        assert_eq!(name(Problem::from_engine(EngineError::Internal("x".into()))), "internal");
    }

    #[test]
    fn retry_after_rounds_up_to_whole_seconds() {
        for (millis, seconds) in [(0, "1"), (1, "1"), (1000, "1"), (1001, "2"), (90_000, "90")] {
            let retry_after = Duration::from_millis(millis);
            let full = Problem::QueueFull { wanted: 1, queued: 5, limit: 5, retry_after };
            let response = full.into_response();
            assert_eq!(response.headers()["retry-after"], seconds, "{millis} ms");
        }
    }
}
