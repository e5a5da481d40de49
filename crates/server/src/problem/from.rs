//! Which problem an error of an inner layer is.

use std::io::ErrorKind;

use densecloud::PrepareError;
use densecloud_cascade::CascadeError;
use densecloud_engine::EngineError;
use densecloud_formats::FormatError;
use densecloud_jobs::StoreError;
use densecloud_tiles::TilesError;

use super::{Problem, SOON};

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
            | CascadeError::NoRoom { .. }
            | CascadeError::TooManyDuplicates { .. }
            | CascadeError::TooManyPoints(_)
            | CascadeError::NoneSure(_)
            | CascadeError::Frame(_) => Self::Impossible(error.to_string()),
            CascadeError::OutOfMemory(bytes) => Self::OutOfMemory(bytes),
            // Nobody but a stopping engine cancels a request that is still waited for.
            CascadeError::Cancelled => Self::Draining,
            // A backend that failed, or settings that the server sets itself.
            _ => Self::Internal(error.to_string()),
        }
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::OverBudget { used, wanted, limit } => Self::JobDisk { used, wanted, limit },
            StoreError::OtherRequest => Self::KeyReused,
            StoreError::Full { queued, limit } => Self::JobsFull { queued, limit, retry_after: SOON },
            StoreError::ClientFull { queued, limit } => Self::ClientJobs { queued, limit, retry_after: SOON },
            error if error.is_full() => Self::DiskFull(error.to_string()),
            error if error.is_busy() => {
                Self::JobsBusy("another program has locked the jobs' database; nothing was changed")
            }
            error if error.is_unsure() => Self::JobsBusy(
                "the jobs' database was lost before it said whether it kept this; with the same Idempotency-Key the request \
                 is the same job",
            ),
            error if error.is_away() => {
                Self::JobsBusy("the jobs' database does not answer; nothing was changed")
            }
            error if error.is_store_away() => {
                Self::JobsBusy("the store of jobs does not answer; nothing was changed")
            }
            error => Self::Internal(error.to_string()),
        }
    }
}

impl From<TilesError> for Problem {
    fn from(error: TilesError) -> Self {
        match error {
            TilesError::Format(error) => error.into(),
            TilesError::Prepare(error) => Self::from_prepare(error),
            TilesError::Cascade(error) => error.into(),
            TilesError::Tile { why, .. } => why.into(),
            TilesError::NotInParts { .. } => Self::Impossible(error.to_string()),
            TilesError::NoSpace { .. } => Self::TempSpace("the disk has no room for this work".into()),
            TilesError::File { ref why, .. } => Self::of_temp(why.kind(), error.to_string()),
            error => Self::Internal(error.to_string()),
        }
    }
}

impl Problem {
    /// What the disk says of a temporary file; where that lies is for the log only.
    pub(crate) fn of_temp(kind: ErrorKind, why: String) -> Self {
        match kind {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded => Self::TempSpace(kind.to_string()),
            _ => Self::Internal(why),
        }
    }

    /// Options that do not fit this cloud.
    pub(crate) fn from_prepare(error: PrepareError) -> Self {
        match error {
            PrepareError::UnknownAttribute { name, known } => {
                let there = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
                Self::parameter("attributes", format!("the cloud has no attribute {name:?}; it has {there}"))
            }
            error => Self::Impossible(error.to_string()),
        }
    }

    /// What the engine's refusal or failure is to a client.
    pub(crate) fn from_engine(error: EngineError) -> Self {
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
            other => Self::Internal(other.to_string()),
        }
    }
}
