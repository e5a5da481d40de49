//! The memory that requests hold outside the engine.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counts the bytes of uploads not yet parsed and of results not yet sent, against one limit.
///
/// An atomic rather than a semaphore: nobody waits here. A request that does not fit is refused,
/// since waiting with half an upload in memory is what the limit is there to prevent.
#[derive(Debug, Clone)]
pub(crate) struct Budget {
    used: Arc<AtomicU64>,
    limit: u64,
}

/// A share of a [`Budget`], given back when dropped.
#[derive(Debug)]
pub(crate) struct Held {
    budget: Budget,
    bytes: u64,
}

impl Budget {
    pub(crate) fn new(limit: u64) -> Self {
        Self { used: Arc::default(), limit }
    }

    /// Bytes held at the moment.
    pub(crate) fn used(&self) -> u64 {
        self.used.load(Ordering::Relaxed)
    }

    /// A share of `bytes`, or nothing when the rest does not suffice.
    pub(crate) fn hold(&self, bytes: u64) -> Option<Held> {
        let mut held = Held { budget: self.clone(), bytes: 0 };
        held.grow(bytes).then_some(held)
    }
}

impl Held {
    /// Another share of the same budget.
    pub(crate) fn beside(&self, bytes: u64) -> Option<Self> {
        self.budget.hold(bytes)
    }

    /// Bytes of the share.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Takes `bytes` more; false, and nothing taken, when the rest does not suffice.
    pub(crate) fn grow(&mut self, bytes: u64) -> bool {
        let Budget { used, limit } = &self.budget;
        let fits = |used: u64| used.checked_add(bytes).filter(|sum| sum <= limit);
        let taken = used.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).is_ok();
        if taken {
            self.bytes += bytes;
        }
        taken
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.budget.used.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_share_grows_to_the_limit_and_comes_back_when_dropped() {
        let budget = Budget::new(10);
        let mut first = budget.hold(4).expect("room");
        assert!(first.grow(6));
        assert!(!first.grow(1));
        assert!(budget.hold(1).is_none());
        assert!(!first.grow(u64::MAX), "no overflow");
        assert_eq!(budget.used(), 10);
        drop(first);
        assert_eq!(budget.used(), 0);
    }

    proptest! {
        #[test]
        fn what_is_taken_is_given_back(steps in prop::collection::vec((any::<bool>(), 0_u64..40), 0..50)) {
            let budget = Budget::new(100);
            let mut shares = Vec::new();
            for (take, bytes) in steps {
                if take {
                    shares.extend(budget.hold(bytes));
                } else {
                    shares.pop();
                }
                prop_assert!(budget.used() <= 100);
                prop_assert_eq!(budget.used(), shares.iter().map(|s: &Held| s.bytes).sum::<u64>());
            }
            drop(shares);
            prop_assert_eq!(budget.used(), 0);
        }
    }
}
