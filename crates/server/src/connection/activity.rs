//! Signs of life on one connection, so that a dead one does not stay open, nor a dead answer on one that lives.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, timeout_at};

use crate::config::Timeouts;

/// What one connection is busy with. Cheap to clone: requests share it.
///
/// A watch channel, because the connection's task must wake when anything changes and needs only
/// the latest state.
#[derive(Debug, Clone, Default)]
pub(crate) struct Activity(Arc<watch::Sender<Requests>>);

#[derive(Debug)]
struct Requests {
    /// Requests whose response is not over, by number.
    in_flight: BTreeMap<u64, InFlight>,
    next: u64,
    /// Requests whose body is not over, be it that one which has been answered is still thrown away.
    bodies: usize,
    /// Since when there is neither, and nothing more of the last response was sent.
    idle: Instant,
    /// Whether some of that may not have been.
    unsent: bool,
    /// Since when the head of the next one is waited for: the first from the connection's beginning, the others from
    /// their first byte.
    head: Option<Instant>,
    /// Whether the client has closed its sending side.
    half_closed: bool,
}

impl Default for Requests {
    fn default() -> Self {
        let now = Instant::now();
        let in_flight = BTreeMap::new();
        Self { in_flight, next: 0, bodies: 0, idle: now, unsent: false, head: Some(now), half_closed: false }
    }
}

#[derive(Default)]
struct InFlight {
    /// Whether the response has begun.
    begun: bool,
    /// Since when the connection has not taken the piece of the response that is there; none while the next is made.
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
            state.head = None;
        });
        Busy { activity: self.clone(), number }
    }

    /// A request's body begins.
    pub(crate) fn receiving(&self) -> Receiving {
        self.0.send_modify(|state| state.bodies += 1);
        Receiving(self.clone())
    }

    /// Bytes have arrived on HTTP/1: of a head, where no request is in flight and no body is left, and then this is how
    /// many requests there were before.
    pub(crate) fn received(&self) -> Option<u64> {
        let mut before = None;
        self.0.send_if_modified(|state| {
            if !state.in_flight.is_empty() || state.bodies > 0 {
                return false;
            }
            before = Some(state.next);
            let begins = state.head.is_none();
            state.head.get_or_insert_with(Instant::now);
            begins
        });
        before
    }

    /// Bytes of a response were given to the system: `all` that there were, or some of them.
    pub(crate) fn sent(&self, all: bool) {
        self.0.send_if_modified(|state| {
            let moved = state.unsent;
            if moved {
                state.idle = Instant::now();
                state.unsent = !all;
            }
            moved
        });
    }

    /// The client has closed its sending side.
    pub(crate) fn half_closed(&self) {
        self.0.send_modify(|state| state.half_closed = true);
    }

    /// Whether it has; then only what is sent to it shows whether it is still there.
    pub(crate) fn is_half_closed(&self) -> bool {
        self.0.borrow().half_closed
    }

    /// Whether no request is in flight.
    pub(crate) fn is_idle(&self) -> bool {
        self.0.borrow().in_flight.is_empty()
    }

    /// Whether one request is in flight, and nothing of its response is.
    pub(crate) fn is_waited_for(&self) -> bool {
        let state = self.0.borrow();
        state.in_flight.len() == 1 && state.in_flight.values().all(|request| !request.begun)
    }

    /// Requests so far.
    pub(crate) fn count(&self) -> u64 {
        self.0.borrow().next
    }

    /// Resolves when the connection should be closed: no whole head for [`Timeouts::head`] after its first byte or the
    /// connection's beginning, nothing at all for [`Timeouts::keep_alive`] after a response, or no
    /// progress for [`Timeouts::stall`] in sending whatever it is busy with. A response without progress beside other
    /// requests in flight ends alone: they do not keep it alive, and it does not end them.
    ///
    /// hyper's own header timer knows one time for both, starts only once it knows the protocol, so that it never
    /// fires for a connection that sends nothing, or half of HTTP/2's preface, and has none for a stalled
    /// reader. While a request is being received or worked on, its handler has the timers; while a piece of its response is
    /// made, nobody has.
    pub(crate) async fn silence(&self, timeouts: &Timeouts) {
        let mut state = self.0.subscribe();
        loop {
            let (idle, end) = {
                let now = state.borrow_and_update();
                (now.in_flight.is_empty(), now.end(timeouts))
            };
            let changed = state.changed();
            let quiet = match end {
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
    /// Until when something must happen.
    fn end(&self, timeouts: &Timeouts) -> Option<Instant> {
        match self.head {
            _ if !self.in_flight.is_empty() => self.oldest()?.checked_add(timeouts.stall),
            // Whoever throws it away has a limit of its own.
            _ if self.bodies > 0 => None,
            Some(begun) => begun.checked_add(timeouts.head),
            None => self.idle.checked_add(timeouts.keep_alive),
        }
    }

    /// Since when the response that has waited longest for its reader has.
    fn oldest(&self) -> Option<Instant> {
        self.in_flight.values().filter_map(|request| request.taken).min()
    }
}

impl Busy {
    /// `modify` says whether it changed anything.
    fn modify(&self, modify: impl FnOnce(&mut InFlight) -> bool) {
        self.activity.0.send_if_modified(|state| state.in_flight.get_mut(&self.number).is_some_and(modify));
    }

    /// The response begins.
    pub(crate) fn sending(&self) {
        self.modify(|request| {
            if !std::mem::replace(&mut request.begun, true) {
                request.taken = Some(Instant::now());
            }
            true
        });
    }

    /// The connection has taken one more piece of the response.
    pub(crate) fn piece(&self) {
        self.modify(|request| {
            request.taken = request.begun.then(Instant::now);
            request.begun
        });
    }

    /// The connection would take the next piece, and it is still being made.
    pub(crate) fn making(&self) {
        // Tells nobody where nothing changes: who is told asks for the piece again.
        self.modify(|request| request.taken.take().is_some());
    }

    /// What ends this response alone, and gives back all that it holds, this `Busy` too.
    pub(crate) fn ended_by(&self, end: impl Fn() + Send + Sync + 'static) {
        self.modify(|request| {
            request.end = Some(Arc::new(end));
            true
        });
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.activity.0.send_modify(|state| {
            state.in_flight.remove(&self.number);
            (state.idle, state.unsent) = (Instant::now(), true);
        });
    }
}

/// A request's body, until dropped.
#[derive(Debug)]
pub(crate) struct Receiving(Activity);

impl Drop for Receiving {
    fn drop(&mut self) {
        self.0.0.send_modify(|state| {
            state.bodies -= 1;
            state.idle = Instant::now();
        });
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use tokio::time::{sleep, timeout};

    use super::*;

    fn timeouts() -> Timeouts {
        let [head, keep_alive, stall] = [20, 75, 10].map(Duration::from_secs);
        Timeouts { head, keep_alive, stall, ..Timeouts::default() }
    }

    /// Whether the connection stays open for long.
    async fn stays(activity: &Activity) -> bool {
        timeout(timeouts().head * 5, activity.silence(&timeouts())).await.is_err()
    }

    /// Seconds until it is closed.
    async fn closes(activity: &Activity) -> u64 {
        let start = Instant::now();
        activity.silence(&timeouts()).await;
        start.elapsed().as_secs()
    }

    #[tokio::test(start_paused = true)]
    async fn a_head_has_its_time_from_its_first_byte_and_an_idle_connection_another() {
        let activity = Activity::default();
        assert_eq!(activity.received(), Some(0));
        sleep(Duration::from_secs(5)).await;
        // Each byte further changes nothing.
        activity.received();
        assert_eq!(closes(&activity).await, 15, "the first, from the connection's beginning");
        let busy = activity.begin();
        assert_eq!(activity.received(), None, "its body");
        drop(busy);
        sleep(Duration::from_secs(70)).await;
        assert_eq!(activity.received(), Some(1));
        sleep(Duration::from_secs(15)).await;
        activity.received();
        assert_eq!(closes(&activity).await, 5, "the second");
        drop(activity.begin());
        assert_eq!(closes(&activity).await, 75, "idle");
    }

    #[tokio::test(start_paused = true)]
    async fn the_rest_of_a_body_is_no_head() {
        let activity = Activity::default();
        let (body, busy) = (activity.receiving(), activity.begin());
        drop(busy);
        assert_eq!(activity.received(), None, "it is answered, and its client still sends");
        assert!(stays(&activity).await, "whoever throws it away says when it is over");
        drop(body);
        assert_eq!(closes(&activity).await, 75, "idle");
        assert_eq!(activity.received(), Some(1));
        assert_eq!(closes(&activity).await, 20, "the next head");
    }

    #[tokio::test(start_paused = true)]
    async fn a_connection_is_idle_from_when_the_last_byte_was_sent() {
        let activity = Activity::default();
        drop(activity.begin());
        for _ in 0..3 {
            sleep(Duration::from_secs(50)).await;
            activity.sent(false);
        }
        sleep(Duration::from_secs(50)).await;
        activity.sent(true);
        sleep(Duration::from_secs(50)).await;
        // Of nothing.
        activity.sent(true);
        assert_eq!(closes(&activity).await, 25);
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
        assert_eq!(closes(&activity).await, timeouts().keep_alive.as_secs());
    }

    #[tokio::test(start_paused = true)]
    async fn a_piece_may_take_its_time_to_be_made_and_not_to_be_taken() {
        let activity = Activity::default();
        let busy = activity.begin();
        busy.making();
        assert!(activity.is_waited_for(), "nothing has begun");
        busy.sending();
        busy.making();
        assert!(!activity.is_waited_for(), "its head is on its way");
        assert!(stays(&activity).await, "the server has yet to make the first");
        busy.piece();
        assert_eq!(closes(&activity).await, timeouts().stall.as_secs());
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
