//! Whether the server takes work: not yet, now, or no more.

use tokio::sync::watch;

use super::problem::Problem;

/// The three phases of a server's life, in order; it never goes back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Phase {
    WarmingUp,
    Ready,
    Draining,
}

/// A one-way latch over the phases. A watch channel rather than an atomic, so that what comes later
/// can wait for a change as well as ask.
#[derive(Debug)]
pub(super) struct Readiness(watch::Sender<Phase>);

impl Readiness {
    /// Warming up.
    pub(super) fn new() -> Self {
        Self(watch::Sender::new(Phase::WarmingUp))
    }

    /// Warm-up is done. Without effect once draining.
    pub(super) fn ready(&self) {
        self.advance(Phase::Ready);
    }

    /// No more work is taken.
    pub(super) fn drain(&self) {
        self.advance(Phase::Draining);
    }

    /// Whether work is taken, or why not.
    ///
    /// # Errors
    /// [`Problem::WarmingUp`] or [`Problem::Draining`].
    pub(super) fn check(&self) -> Result<(), Problem> {
        match *self.0.borrow() {
            Phase::WarmingUp => Err(Problem::WarmingUp),
            Phase::Ready => Ok(()),
            Phase::Draining => Err(Problem::Draining),
        }
    }

    /// Tells of each change of what [`Readiness::check`] says.
    pub(super) fn changes(&self) -> watch::Receiver<Phase> {
        self.0.subscribe()
    }

    /// Resolves once the server stops.
    pub(super) async fn draining(&self) {
        // Cannot fail: `self` holds the sender.
        let _ = self.0.subscribe().wait_for(|phase| *phase == Phase::Draining).await;
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
        readiness.drain();
        readiness.ready();
        assert_eq!(readiness.check(), Err(Problem::Draining));
    }

    #[test]
    fn a_server_stopped_while_warming_up_never_gets_ready() {
        let readiness = Readiness::new();
        readiness.drain();
        readiness.ready();
        assert_eq!(readiness.check(), Err(Problem::Draining));
    }
}
