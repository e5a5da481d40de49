//! Why the engine takes no request.

use std::time::Duration;

/// Why a request was not admitted.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The queue is full.
    #[error(
        "{queued} points are queued or being worked on, and this request would add at least {wanted}, above the limit \
         of {limit}"
    )]
    Full {
        /// Points out that this request would give, or the fewest that it can.
        wanted: u64,
        /// Points out already admitted.
        queued: u64,
        /// The limit.
        limit: u64,
        /// When there will be room, by the backlog.
        retry_after: Duration,
    },
    /// The client's share of the queue is used up.
    #[error(
        "{used} points of yours are queued or being worked on, and this request would add at least {wanted}, above \
         your share of {limit}"
    )]
    Share {
        /// Points out that this request would give, or the fewest that it can.
        wanted: u64,
        /// Points out that the client has admitted.
        used: u64,
        /// Its share.
        limit: u64,
        /// When there will be room, by the client's own backlog.
        retry_after: Duration,
    },
    /// What waits takes so long that a further request would wait too long.
    #[error(
        "what {} waiting takes {:.1} s, and above {:.1} s no more is taken",
        if *own { "you have" } else { "is" }, waiting.as_secs_f64(), limit.as_secs_f64()
    )]
    Busy {
        /// Whether it is the client's own work, and its share of the time, or everybody's.
        own: bool,
        /// How long that will take.
        waiting: Duration,
        /// The most it may take.
        limit: Duration,
        /// When there will be room.
        retry_after: Duration,
    },
    /// More memory than all requests together may take.
    #[error("the work would take about {bytes} bytes of memory, more than {limit}")]
    TooBig {
        /// The estimate.
        bytes: u64,
        /// The limit.
        limit: u64,
    },
    /// It would be done after its deadline, since other work is before it.
    #[error(
        "with what is queued, this request would be done in about {:.1} s, and it has {:.1} s left",
        needed.as_secs_f64(), left.as_secs_f64()
    )]
    Late {
        /// How long it would take.
        needed: Duration,
        /// Time to the deadline.
        left: Duration,
        /// When it could be done in that time, by the backlog.
        retry_after: Duration,
    },
}

impl Refusal {
    /// The same, with a time that is no sooner than this.
    pub(super) fn no_sooner(mut self, than: Option<Duration>) -> Self {
        if let (
            Self::Full { retry_after, .. }
            | Self::Share { retry_after, .. }
            | Self::Busy { retry_after, .. }
            | Self::Late { retry_after, .. },
            Some(than),
        ) = (&mut self, than)
        {
            *retry_after = than.max(*retry_after);
        }
        self
    }

    /// When the same request may be taken; nothing where it never will be.
    #[must_use]
    pub fn retry_after(&self) -> Option<Duration> {
        match *self {
            Self::Full { retry_after, .. }
            | Self::Share { retry_after, .. }
            | Self::Busy { retry_after, .. }
            | Self::Late { retry_after, .. } => Some(retry_after),
            Self::TooBig { .. } => None,
        }
    }
}
