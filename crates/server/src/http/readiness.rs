//! Whether the server takes work: not yet, now, or no more.

use tokio::sync::watch;

use crate::problem::Problem;

/// The phases of a server's life, in order; it never goes back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Phase {
    WarmingUp,
    Ready,
    /// Takes work, but tells probes that it is about to stop taking it.
    Leaving,
    Draining,
}

/// A one-way latch over the phases. A watch channel rather than an atomic, so that what comes later
/// can wait for a change as well as ask.
#[derive(Debug)]
pub(crate) struct Readiness(watch::Sender<Phase>);

impl Readiness {
    /// Warming up.
    pub(crate) fn new() -> Self {
        Self(watch::Sender::new(Phase::WarmingUp))
    }

    /// Warm-up is done. Without effect once draining.
    pub(crate) fn ready(&self) {
        self.advance(Phase::Ready);
    }

    /// Probes are told that the end is near. False, and without effect, unless ready.
    pub(crate) fn leave(&self) -> bool {
        self.0.send_if_modified(|phase| {
            let ready = *phase == Phase::Ready;
            if ready {
                *phase = Phase::Leaving;
            }
            ready
        })
    }

    /// No more work is taken.
    pub(crate) fn drain(&self) {
        self.advance(Phase::Draining);
    }

    /// Whether work is taken, or why not.
    ///
    /// # Errors
    /// [`Problem::WarmingUp`] or [`Problem::Draining`].
    pub(crate) fn check(&self) -> Result<(), Problem> {
        match *self.0.borrow() {
            Phase::WarmingUp => Err(Problem::WarmingUp),
            Phase::Ready | Phase::Leaving => Ok(()),
            Phase::Draining => Err(Problem::Draining),
        }
    }

    /// Tells of each change of what [`Readiness::check`] and [`Readiness::probe`] say.
    pub(crate) fn changes(&self) -> watch::Receiver<Phase> {
        self.0.subscribe()
    }

    /// Resolves once the server stops.
    pub(crate) async fn draining(&self) {
        // Cannot fail: `self` holds the sender.
        let _ = self.0.subscribe().wait_for(|phase| *phase == Phase::Draining).await;
    }

    /// Whether work should be sent here, or why not: what probes are told.
    ///
    /// # Errors
    /// As [`Readiness::check`], and [`Problem::Draining`] already when leaving.
    pub(crate) fn probe(&self) -> Result<(), Problem> {
        match *self.0.borrow() {
            Phase::Leaving => Err(Problem::Draining),
            _ => self.check(),
        }
    }

    fn advance(&self, to: Phase) {
        self.0.send_if_modified(|phase| {
            let later = to > *phase;
            *phase = to.max(*phase);
            later
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_phases_only_go_forward() {
        let readiness = Readiness::new();
        assert_eq!(readiness.check(), Err(Problem::WarmingUp));
        readiness.ready();
        assert_eq!(readiness.check(), Ok(()));
        assert!(readiness.leave());
        readiness.ready();
        assert_eq!((readiness.check(), readiness.probe()), (Ok(()), Err(Problem::Draining)));
        readiness.drain();
        readiness.ready();
        assert!(!readiness.leave());
        assert_eq!(readiness.check(), Err(Problem::Draining));
    }

    #[test]
    fn a_server_stopped_while_warming_up_never_gets_ready() {
        let readiness = Readiness::new();
        assert!(!readiness.leave());
        readiness.drain();
        readiness.ready();
        assert_eq!(readiness.check(), Err(Problem::Draining));
    }
}
