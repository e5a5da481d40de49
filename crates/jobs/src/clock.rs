//! The time of day, as a value that can be replaced.

use std::time::SystemTime;

use crate::record::Time;

/// Tells the time at which jobs come, start and end, and until when they are leased.
pub trait Clock: Send + Sync {
    /// Milliseconds since 1970. It may go back, as a computer's clock does when it is set.
    fn now(&self) -> Time;
}

/// The computer's clock.
#[derive(Debug, Clone, Copy, Default)]
pub struct SystemClock;

impl Clock for SystemClock {
    fn now(&self) -> Time {
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        since.as_millis().try_into().unwrap_or(Time::MAX)
    }
}
