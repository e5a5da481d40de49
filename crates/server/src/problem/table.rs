//! The table of problems: a row is one problem, and nothing of it stands anywhere else.

use std::fmt;

use axum::http::StatusCode;
use densecloud_engine::Refusal;
use densecloud_formats::Format;

use super::{Problem, Row};

/// Makes [`Problem::row`] and `Display` from rows of
///
/// ```text
/// pattern => STATUS "name" "Title" ("--setting"): "words" with argument = value;
/// ```
///
/// The words may use what the pattern binds. Where a setting lifts the limit they name it as `{setting}`; words that
/// do not are an error of the compiler's, as an argument that is never used.
macro_rules! problems {
    ($(
        $problem:pat => $status:ident $name:literal $title:literal $(($setting:literal))?: $words:literal
        $(with $($argument:ident = $value:expr),+)?;
    )+) => {
        impl Problem {
            /// The problem's row of the table.
            #[expect(unused_variables, reason = "what patterns bind is for the words")]
            pub(super) fn row(&self) -> Row {
                match self {
                    $($problem => Row {
                        status: StatusCode::$status,
                        name: $name,
                        title: $title,
                        setting: [$($setting)?].first().copied(),
                    },)+
                }
            }
        }

        impl fmt::Display for Problem {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self {
                    $($problem => write!(f, $words $(, setting = $setting)? $($(, $argument = $value)+)?),)+
                }
            }
        }
    };
}

impl std::error::Error for Problem {}

problems! {
    // What the request says.
    Self::NotFound => NOT_FOUND "not-found" "No such path":
        "/openapi.json and /docs have all paths";
    Self::MethodNotAllowed => METHOD_NOT_ALLOWED "method-not-allowed" "Not for this method":
        "the Allow header has the methods of this path";
    Self::Parameter { name, why } => BAD_REQUEST "invalid-parameter" "Invalid parameter":
        "parameter {name}: {why}";
    Self::NotAcceptable { wanted } => NOT_ACCEPTABLE "not-acceptable" "No format that the client takes":
        "Accept: {wanted}: none of these is written; there are {all}, or */* for the format of the input"
        with all = Format::MEDIA_TYPES.join(", ");
    Self::UnknownModel(name) => NOT_FOUND "unknown-model" "No such model":
        "there is the model \"densecloud\" with version \"1\", not {name}";
    Self::FixedModel => CONFLICT "fixed-model" "The model does not change":
        "the model is a part of this server: it is neither loaded nor unloaded";
    Self::MalformedRequest(why) => BAD_REQUEST "malformed-request" "The request cannot be read":
        "{why}";

    Self::TransferCoding(coding) => NOT_IMPLEMENTED "unknown-transfer-coding" "Not a transfer coding that is known":
        "Transfer-Encoding {coding:?} is not supported; there is chunked, or send a Content-Length";
    Self::LengthRequired => LENGTH_REQUIRED "length-required" "A length is needed":
        "HTTP/1.0 tells where a body ends by its Content-Length alone, and there is none";

    // The body.
    Self::Interrupted(why) => BAD_REQUEST "interrupted-body" "The body broke off":
        "the body could not be read to its end: {why}";
    Self::UploadStalled { limit } => REQUEST_TIMEOUT "upload-stalled" "The upload stalled" ("--stall-timeout"):
        "nothing arrived for {seconds} s ({setting}) before the body was complete"
        with seconds = limit.as_secs_f64();
    Self::BodyTooLarge { limit } => PAYLOAD_TOO_LARGE "body-too-large" "The body is too large" ("--max-body-bytes"):
        "the body is larger than {limit} bytes; {setting} lifts this limit";
    Self::UnsupportedEncoding(coding) => UNSUPPORTED_MEDIA_TYPE "unsupported-encoding" "Not a compression that is read":
        "Content-Encoding {coding:?} is not supported; there are gzip, deflate and zstd, or send the body as it is";

    Self::Stripped => BAD_REQUEST "stripped-body" "The body lost its line ends":
        "the body has no line end and no zero byte, as when curl's -d (--data) sends a file; send it with \
         --data-binary @FILE or, as a form, with -F cloud=@FILE";

    // The cloud, and what is wanted of it.
    Self::UnsupportedFormat(why) => UNSUPPORTED_MEDIA_TYPE "unsupported-format" "Not a format that is read":
        "{why}";
    Self::Malformed(why) => BAD_REQUEST "malformed-cloud" "The cloud cannot be read":
        "{why}";
    Self::Impossible(why) => UNPROCESSABLE_ENTITY "impossible-cloud" "The cloud cannot be upsampled":
        "{why}";
    Self::TooManyPointsIn { points, limit } =>
        PAYLOAD_TOO_LARGE "too-many-points-in" "The cloud has too many points" ("--max-points-in"):
        "the cloud has {points} points, more than {limit}; {setting} lifts this limit";
    Self::TooManyPointsOut { points, limit } =>
        PAYLOAD_TOO_LARGE "too-many-points-out" "The result would have too many points" ("--max-points-out"):
        "the result would have {points} points, more than {limit}; {setting} lifts this limit";
    Self::ResultTooLarge { points, bytes, limit } =>
        PAYLOAD_TOO_LARGE "result-too-large" "The result would be too large" ("--max-held-bytes"):
        "{points} points with all their attributes take {bytes} bytes, more than {limit}; {setting} lifts this \
         limit, or leave attributes out with attributes=NAME:drop, or ask for fewer points";

    // Who asks.
    Self::Unauthorized(why) => UNAUTHORIZED "unauthorized" "A key is needed" ("--keys"):
        "{why}; send one that the server's {setting} has, as Authorization: Bearer KEY";
    Self::CrossSite => FORBIDDEN "cross-site" "Not for pages of other sites" ("--cors-origin"):
        "a page of another site sent this; {setting} names those that may";

    // The server's state.
    Self::WarmingUp => SERVICE_UNAVAILABLE "warming-up" "Not ready yet":
        "the model is being loaded; /readyz says when it is ready";
    Self::Draining => SERVICE_UNAVAILABLE "draining" "About to stop":
        "the server is stopping and takes no more work";
    Self::Refused(refusal @ Refusal::Full { .. }) =>
        SERVICE_UNAVAILABLE "queue-full" "The queue is full" ("--queue-points"):
        "{refusal}; {setting} lifts this limit";
    Self::Refused(refusal @ Refusal::Busy { own: false, .. }) =>
        SERVICE_UNAVAILABLE "queue-long" "The queue is too long" ("--queue-time"):
        "{refusal}; {setting} lifts this limit";
    Self::Refused(refusal @ Refusal::Busy { own: true, .. }) =>
        TOO_MANY_REQUESTS "client-time" "Your share of the queue's time is used" ("--queue-time"):
        "{refusal}; {setting} lifts this limit";
    Self::Refused(refusal @ Refusal::Share { .. }) =>
        TOO_MANY_REQUESTS "client-share" "Your share of the queue is used" ("--client-points"):
        "{refusal}; {setting} lifts this limit";
    Self::Refused(refusal @ Refusal::Late { .. }) =>
        SERVICE_UNAVAILABLE "too-late" "Not to be done in time" ("--request-timeout"):
        "{refusal}; come back later, or give it longer with X-Request-Timeout, of which {setting} is the most";
    Self::Refused(refusal @ Refusal::TooBig { .. }) =>
        INSUFFICIENT_STORAGE "too-big-for-memory" "The work would take too much memory" ("--max-memory"):
        "{refusal}; {setting} lifts this limit, or ask for fewer points";
    Self::HeldFull { used, limit } => SERVICE_UNAVAILABLE "memory-full" "The memory is in use" ("--max-held-bytes"):
        "uploads and unsent results hold {used} of {limit} bytes, which leaves too little for this request; {setting} \
         lifts this limit";
    Self::TempFull { used, limit } => SERVICE_UNAVAILABLE "temp-full" "The disk is in use" ("--max-temp-bytes"):
        "long uploads and the tiles of large clouds take {used} of {limit} bytes of the disk, which leaves too little for \
         this request; {setting} lifts this limit";
    Self::TempSpace(why) => INSUFFICIENT_STORAGE "temp-space" "The disk has no room" ("--temp-dir"):
        "{why}; {setting} names a folder on another disk";
    Self::OutOfMemory(bytes) => INSUFFICIENT_STORAGE "out-of-memory" "No memory is left":
        "the system had no {bytes} bytes of memory left for this request; ask for fewer points, or come back later";
    Self::Deadline { limit, spent } => GATEWAY_TIMEOUT "deadline" "It took too long" ("--request-timeout"):
        "the result was not complete after {seconds} s: {spent}; X-Request-Timeout sets this limit, of which \
         {setting} is the most"
        with seconds = limit.as_secs_f64();

    // Jobs.
    Self::JobsOff => NOT_IMPLEMENTED "jobs-off" "No jobs are kept here" ("--data-dir"):
        "this server keeps no jobs; {setting} gives it a folder for them";
    Self::JobsFull { queued, limit, .. } =>
        SERVICE_UNAVAILABLE "jobs-full" "As many jobs wait as may" ("--max-jobs"):
        "{queued} jobs are queued or running, and {limit} may be; {setting} lifts this limit";
    Self::ClientJobs { queued, limit, .. } =>
        TOO_MANY_REQUESTS "client-jobs" "As many of your jobs wait as may" ("--client-jobs"):
        "{queued} jobs of yours are queued or running, and {limit} may be; {setting} lifts this limit";
    Self::JobDisk { used, wanted, limit } =>
        INSUFFICIENT_STORAGE "job-disk-full" "Jobs take all the disk they may" ("--job-disk"):
        "jobs take {used} bytes of the disk and this one would take {wanted} more, above {limit}; {setting} lifts this \
         limit, and so does deleting jobs";
    Self::KeyReused => UNPROCESSABLE_ENTITY "idempotency-key-reused" "The key is another request's":
        "this Idempotency-Key came with another request before; give each request its own";
    Self::JobsBusy(why) => SERVICE_UNAVAILABLE "jobs-busy" "Jobs cannot be asked for now":
        "{why}; try again";
    Self::DiskFull(why) => INSUFFICIENT_STORAGE "disk-full" "The disk is full" ("--data-dir"):
        "the disk is full: {why}; make room there, or give {setting} a folder elsewhere";
    Self::NoJob(id) => NOT_FOUND "no-such-job" "No such job":
        "there is no job {id}";
    Self::JobNotDone { state } => CONFLICT "job-not-done" "The job is not done":
        "the job is {state}; only one that is done has a result";
    Self::Range { length } => RANGE_NOT_SATISFIABLE "range-not-satisfiable" "No such part of the result":
        "the result has {length} bytes; the range begins after them";
    Self::GaveUp { attempts, tile: Some(tile) } =>
        INTERNAL_SERVER_ERROR "job-gave-up" "The job was interrupted too often" ("--job-attempts"):
        "the server ended {attempts} times while it worked on tile {tile} of this job, and will not try again; {setting} \
         lifts this limit";
    Self::GaveUp { attempts, tile: None } =>
        INTERNAL_SERVER_ERROR "job-gave-up" "The job was interrupted too often" ("--job-attempts"):
        "the server ended {attempts} times while it worked on this job, and will not try again; {setting} lifts this \
         limit";

    // The cause is for the log only.
    Self::Internal(_) => INTERNAL_SERVER_ERROR "internal" "The server failed":
        "the server failed; its log tells more under this request's id";
}
