//! Signs of life on one connection, so that a dead one does not stay open, nor a dead answer on one that lives.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, timeout, timeout_at};

use crate::config::Timeouts;

/// What one connection is busy with. Cheap to clone: requests share it.
///
/// A watch channel, because the connection's task must wake when anything changes and needs only
/// the latest state.
#[derive(Debug, Clone, Default)]
pub(crate) struct Activity(Arc<watch::Sender<Requests>>);

#[derive(Debug, Default)]
struct Requests {
    /// Requests whose response is not over, by number.
    in_flight: BTreeMap<u64, InFlight>,
    next: u64,
}

#[derive(Default)]
struct InFlight {
    /// When the connection last took a piece of the response, once that has begun.
    taken: Option<Instant>,
    /// Ends this response alone.
    end: Option<Arc<dyn Fn() + Send + Sync>>,
}

impl std::fmt::Debug for InFlight {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("InFlight").field("taken", &self.taken).finish_non_exhaustive()
    }
}

/// One request in flight, until dropped.
#[derive(Debug)]
pub(crate) struct Busy {
    activity: Activity,
    number: u64,
}

impl Activity {
    /// A request has arrived.
    pub(crate) fn begin(&self) -> Busy {
        let mut number = 0;
        self.0.send_modify(|state| {
            number = state.next;
            state.next += 1;
            state.in_flight.insert(number, InFlight::default());
        });
        Busy { activity: self.clone(), number }
    }

    /// Resolves when the connection should be closed: no request for [`Timeouts::head`], or no
    /// progress for [`Timeouts::stall`] in sending whatever it is busy with. A response without progress beside other
    /// requests in flight ends alone: they do not keep it alive, and it does not end them.
    ///
    /// hyper's own header timer starts only once it knows the protocol, so it never fires for a
    /// connection that sends nothing, or half of HTTP/2's preface; and it has none for a stalled
    /// reader. While a request is being received or worked on, its handler has the timers.
    pub(crate) async fn silence(&self, timeouts: &Timeouts) {
        let mut state = self.0.subscribe();
        loop {
            let (idle, stalled_at) = {
                let now = state.borrow_and_update();
                (now.in_flight.is_empty(), now.oldest().and_then(|oldest| oldest.checked_add(timeouts.stall)))
            };
            let changed = state.changed();
            let quiet = match stalled_at {
                _ if idle => timeout(timeouts.head, changed).await.is_err(),
                Some(at) => timeout_at(at, changed).await.is_err(),
                None => {
                    // Cannot fail: `self` holds the sender.
                    let _ = changed.await;
                    false
                }
            };
            if quiet && (idle || self.end_stalled(timeouts.stall)) {
                return;
            }
        }
    }

    /// Ends the stalled responses. Where all requests have stalled it ends none and returns true: then the connection
    /// is over.
    fn end_stalled(&self, limit: Duration) -> bool {
        let state = self.0.borrow();
        let stalled = |request: &&InFlight| request.taken.is_some_and(|taken| taken.elapsed() >= limit);
        let stalled: Vec<_> = state.in_flight.values().filter(stalled).collect();
        if stalled.len() == state.in_flight.len() {
            return true;
        }
        let ends: Vec<_> = stalled.into_iter().filter_map(|request| request.end.clone()).collect();
        // What ends leaves the state.
        drop(state);
        ends.iter().for_each(|end| end());
        false
    }
}

impl Requests {
    /// When the response that has waited longest for its reader last moved.
    fn oldest(&self) -> Option<Instant> {
        self.in_flight.values().filter_map(|request| request.taken).min()
    }
}

impl Busy {
    fn modify(&self, modify: impl FnOnce(&mut InFlight)) {
        self.activity.0.send_modify(|state| {
            if let Some(request) = state.in_flight.get_mut(&self.number) {
                modify(request);
            }
        });
    }

    /// The response begins.
    pub(crate) fn sending(&self) {
        self.modify(|request| {
            request.taken.get_or_insert_with(Instant::now);
        });
    }

    /// The connection has taken one more piece of the response.
    pub(crate) fn piece(&self) {
        self.modify(|request| {
            if let Some(taken) = &mut request.taken {
                *taken = Instant::now();
            }
        });
    }

    /// What ends this response alone, and gives back all that it holds, this `Busy` too.
    pub(crate) fn ended_by(&self, end: impl Fn() + Send + Sync + 'static) {
        self.modify(|request| request.end = Some(Arc::new(end)));
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.activity.0.send_modify(|state| {
            state.in_flight.remove(&self.number);
        });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    fn timeouts() -> Timeouts {
        Timeouts { head: Duration::from_secs(20), stall: Duration::from_secs(10), ..Timeouts::default() }
    }

    /// Whether the connection stays open for long.
    async fn stays(activity: &Activity) -> bool {
        timeout(timeouts().head * 5, activity.silence(&timeouts())).await.is_err()
    }

    #[tokio::test(start_paused = true)]
    async fn a_connection_ends_after_the_limit_and_never_while_a_handler_works() {
        let activity = Activity::default();
        let busy = activity.begin();
        assert!(stays(&activity).await, "a handler works");
        busy.sending();
        busy.piece();
        let start = Instant::now();
        activity.silence(&timeouts()).await;
        assert_eq!(start.elapsed().as_secs(), timeouts().stall.as_secs());
        let second = activity.begin();
        drop(busy);
        assert!(stays(&activity).await, "the other is still worked on");
        drop(second);
        let start = Instant::now();
        activity.silence(&timeouts()).await;
        assert_eq!(start.elapsed().as_secs(), timeouts().head.as_secs());
    }

    #[tokio::test(start_paused = true)]
    async fn a_stalled_response_ends_alone_beside_others() {
        let activity = Activity::default();
        let (working, stalled) = (activity.begin(), activity.begin());
        stalled.sending();
        let held = Arc::new(Mutex::new(None));
        let slot = Arc::downgrade(&held);
        stalled.ended_by(move || {
            slot.upgrade().expect("held").lock().expect("no panic").take();
        });
        *held.lock().expect("no panic") = Some(stalled);
        // What others do changes nothing for it.
        let pause = timeouts().stall / 5;
        let others = async {
            for _ in 0..30 {
                drop(activity.begin());
                tokio::time::sleep(pause).await;
            }
        };
        let timeouts = timeouts();
        tokio::select! {
            () = activity.silence(&timeouts) => panic!("the other request is worked on"),
            () = others => {}
        }
        assert!(held.lock().expect("no panic").is_none(), "ended");
        working.sending();
        activity.silence(&timeouts).await;
    }
}
