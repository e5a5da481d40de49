//! Durations as they are typed.

use std::time::Duration;

/// The longest that a duration can be set to, ten years: clocks cannot tell a time that is too far off.
pub(super) const LONGEST: Duration = Duration::from_secs(10 * 365 * 24 * 60 * 60);

/// A duration in seconds, decimals allowed.
pub(in crate::commands) fn seconds(text: &str) -> Result<Duration, String> {
    text.parse()
        .ok()
        .and_then(|seconds| Duration::try_from_secs_f64(seconds).ok())
        .filter(|duration| *duration <= LONGEST)
        .ok_or_else(|| format!("not a number of seconds from 0 to {} (ten years)", LONGEST.as_secs()))
}
