//! Signs of life on one connection, so that a dead one does not stay open.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::timeout;

use super::config::Timeouts;

/// What one connection is busy with. Cheap to clone: requests share it.
///
/// A watch channel, because the connection's task must wake when anything changes and needs only
/// the latest state.
#[derive(Debug, Clone, Default)]
pub(super) struct Activity(Arc<watch::Sender<State>>);

#[derive(Debug, Clone, Copy, Default)]
struct State {
    /// Requests whose response is not over.
    in_flight: usize,
    /// Those among them whose response has begun.
    sending: usize,
    /// Grows with each piece of a response that the connection takes.
    pieces: u64,
}

/// One request in flight, until dropped.
#[derive(Debug)]
pub(super) struct Busy {
    activity: Activity,
    sending: bool,
}

impl Activity {
    /// A request has arrived.
    pub(super) fn begin(&self) -> Busy {
        self.0.send_modify(|state| state.in_flight += 1);
        Busy { activity: self.clone(), sending: false }
    }

    /// Resolves when the connection should be closed: no request for [`Timeouts::head`], or no
    /// progress in sending for [`Timeouts::stall`].
    ///
    /// hyper's own header timer starts only once it knows the protocol, so it never fires for a
    /// connection that sends nothing, or half of HTTP/2's preface; and it has none for a stalled
    /// reader. While a request is being received or worked on, its handler has the timers.
    pub(super) async fn silence(&self, timeouts: &Timeouts) {
        let mut state = self.0.subscribe();
        loop {
            let now = *state.borrow_and_update();
            let Some(limit) = now.limit(timeouts) else {
                // Cannot fail: `self` holds the sender.
                let _ = state.changed().await;
                continue;
            };
            if timeout(limit, state.changed()).await.is_err() {
                return;
            }
        }
    }
}

impl State {
    /// How long nothing may change, or no limit while a handler is at work.
    fn limit(self, timeouts: &Timeouts) -> Option<Duration> {
        match self {
            Self { in_flight: 0, .. } => Some(timeouts.head),
            Self { sending: 0, .. } => None,
            Self { .. } => Some(timeouts.stall),
        }
    }
}

impl Busy {
    /// The response begins.
    pub(super) fn sending(&mut self) {
        if !self.sending {
            self.sending = true;
            self.activity.0.send_modify(|state| state.sending += 1);
        }
    }

    /// The connection has taken one more piece of the response.
    pub(super) fn piece(&self) {
        self.activity.0.send_modify(|state| state.pieces += 1);
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.activity.0.send_modify(|state| {
            state.in_flight -= 1;
            state.sending -= usize::from(self.sending);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::Instant;

    fn timeouts() -> Timeouts {
        Timeouts { head: Duration::from_millis(20), stall: Duration::from_millis(10), ..Timeouts::default() }
    }

    fn limit(activity: &Activity) -> Option<Duration> {
        activity.0.borrow().limit(&timeouts())
    }

    #[test]
    fn each_phase_of_a_request_has_its_own_limit() {
        let activity = Activity::default();
        assert_eq!(limit(&activity), Some(timeouts().head), "waiting for a request");
        let mut first = activity.begin();
        assert_eq!(limit(&activity), None, "working on one");
        first.sending();
        first.sending();
        assert_eq!(limit(&activity), Some(timeouts().stall), "sending");
        let second = activity.begin();
        drop(first);
        assert_eq!(limit(&activity), None, "the other is still worked on");
        drop(second);
        assert_eq!(limit(&activity), Some(timeouts().head), "waiting for the next");
    }

    #[tokio::test]
    async fn a_connection_ends_after_the_limit_and_never_while_a_handler_works() {
        let activity = Activity::default();
        let mut busy = activity.begin();
        assert!(timeout(timeouts().head * 5, activity.silence(&timeouts())).await.is_err());
        busy.sending();
        busy.piece();
        let start = Instant::now();
        activity.silence(&timeouts()).await;
        assert!(start.elapsed() >= timeouts().stall);
        drop(busy);
        let start = Instant::now();
        activity.silence(&timeouts()).await;
        assert!(start.elapsed() >= timeouts().head);
    }
}
