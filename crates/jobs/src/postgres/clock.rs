//! The database's time.

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use crate::clock::{Clock, SystemClock};
use crate::record::Time;

/// The time as the database told it with the last change, and what has gone by since: what becomes of this machine's
/// own time of day does not matter.
#[derive(Debug)]
pub(super) struct DatabaseClock(Mutex<(Time, Instant)>);

/// The question.
pub(super) const TIME: &str = "SELECT (extract(epoch FROM clock_timestamp()) * 1000)::bigint";

impl Default for DatabaseClock {
    /// This machine's, until the database tells its own.
    fn default() -> Self {
        Self(Mutex::new((SystemClock.now(), Instant::now())))
    }
}

impl DatabaseClock {
    /// What the database told when it was asked then. It may have waited for others before it answered.
    pub(super) fn set(&self, time: Time, asked: Instant) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = (time, asked);
    }
}

impl Clock for DatabaseClock {
    fn now(&self) -> Time {
        let (time, asked) = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        time.saturating_add(asked.elapsed().as_millis().try_into().unwrap_or(Time::MAX))
    }
}
