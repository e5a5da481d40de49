//! What the engine takes for the time.

use std::fmt;
use std::time::Instant;

/// A source of the time: the system's, or one that a test moves. Deadlines of a [`Caller`](crate::Caller) are
/// moments of the engine's clock.
pub trait Clock: fmt::Debug + Send + Sync {
    /// The time now, never earlier than before.
    fn now(&self) -> Instant;
}

/// The system's monotonic clock.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now(&self) -> Instant {
        Instant::now()
    }
}
