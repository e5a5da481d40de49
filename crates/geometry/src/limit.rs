//! How many points indices of 32 bits can tell apart.

use std::ops::Range;

/// The most points that a tree, a sampling or a cascade takes. Indices have 32 bits, since they are half of what a cloud
/// takes; the last one stands for no point.
pub const MAX_POINTS: usize = u32::MAX as usize;

/// A cloud has more than [`MAX_POINTS`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{count} points are more than the {MAX_POINTS} that a cloud may have here; split it")]
pub struct TooManyPoints {
    /// How many there are.
    pub count: usize,
}

/// Checks a number of points, before anything is made of them.
///
/// ```
/// use densecloud_geometry::{MAX_POINTS, check_count};
///
/// assert!(check_count(MAX_POINTS).is_ok());
/// assert!(check_count(MAX_POINTS + 1).is_err());
/// ```
///
/// # Errors
/// [`TooManyPoints`].
pub fn check_count(count: usize) -> Result<(), TooManyPoints> {
    if count > MAX_POINTS { Err(TooManyPoints { count }) } else { Ok(()) }
}

/// The indices of so many points: `0..count`.
///
/// # Panics
/// Above [`MAX_POINTS`]: refused loudly, since indices that wrap would name other points. [`check_count`] tells beforehand.
#[must_use]
pub fn indices(count: usize) -> Range<u32> {
    match check_count(count) {
        Ok(()) => 0..count as u32,
        Err(error) => panic!("{error}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_end_where_they_would_wrap() {
        assert_eq!(indices(3), 0..3);
        assert_eq!(indices(MAX_POINTS).end, u32::MAX);
        let error = check_count(MAX_POINTS + 7).unwrap_err().to_string();
        assert_eq!(
            error,
            "4294967302 points are more than the 4294967295 that a cloud may have here; split it"
        );
    }

    #[test]
    #[should_panic(expected = "4294967296 points are more than")]
    fn more_is_no_range() {
        let _ = indices(MAX_POINTS + 1);
    }
}
