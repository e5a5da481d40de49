//! Turns at parsing: as many at a time as there are processors, and fair among clients.
//!
//! Parsing comes before the engine knows what a request costs, and takes some times the memory of what it parses. So
//! uploads that are refused in the end neither hold up the requests of others nor pile up as half-read clouds.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::available_parallelism;

use tokio::sync::oneshot;

use densecloud_engine::{Client, Fair};

/// Fewest at a time, so that a long one does not hold up all others.
const LEAST: usize = 2;

/// Who parses, and who waits for it.
pub(crate) struct Parsing(Mutex<Turns>);

struct Turns {
    free: usize,
    waiting: Fair<oneshot::Sender<ParsingTurn>>,
}

/// A turn, until dropped.
#[must_use = "dropping a turn gives it to the next"]
pub(crate) struct ParsingTurn(Option<Arc<Parsing>>);

impl Parsing {
    pub(crate) fn new() -> Self {
        Self::of(available_parallelism().map_or(LEAST, usize::from).max(LEAST))
    }

    /// So many at a time.
    fn of(free: usize) -> Self {
        Self(Mutex::new(Turns { free, waiting: Fair::default() }))
    }

    /// Waits for a client's turn at parsing so many bytes; whoever stops waiting loses nothing but that.
    pub(crate) async fn turn(self: &Arc<Self>, client: &Client, bytes: u64) -> ParsingTurn {
        let turn = {
            let mut state = self.state();
            if state.free > 0 {
                state.free -= 1;
                return ParsingTurn(Some(Arc::clone(self)));
            }
            let (sender, turn) = oneshot::channel();
            state.waiting.push(client, sender, bytes);
            turn
        };
        // Cannot fail: the sender is kept until it has sent.
        turn.await.unwrap_or(ParsingTurn(None))
    }

    fn give_back(self: &Arc<Self>) {
        loop {
            let mut state = self.state();
            let Some(next) = state.waiting.pop() else {
                state.free += 1;
                return;
            };
            drop(state);
            match next.send(ParsingTurn(Some(Arc::clone(self)))) {
                Ok(()) => return,
                // Nobody waits for it any more. Not dropped as it is, which would come back here.
                Err(mut turn) => turn.0 = None,
            }
        }
    }

    /// Nothing panics while it is held.
    fn state(&self) -> MutexGuard<'_, Turns> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for ParsingTurn {
    fn drop(&mut self) {
        if let Some(parsing) = self.0.take() {
            parsing.give_back();
        }
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt;

    use super::*;

    #[tokio::test]
    async fn clients_take_turns_and_who_leaves_costs_none() {
        let parsing = Arc::new(Parsing::of(1));
        let (many, one) = (Client::new("many"), Client::new("one"));
        let first = parsing.turn(&many, 10).await;
        let mut queued: Vec<_> = (0..3).map(|_| Box::pin(parsing.turn(&many, 10))).collect();
        for turn in &mut queued {
            assert!(turn.now_or_never().is_none());
        }
        let mut other = Box::pin(parsing.turn(&one, 10));
        assert!((&mut other).now_or_never().is_none());
        // One that leaves in the queue, and one that leaves with its turn given but not taken.
        drop(queued.pop());
        drop(first);
        let mut second = queued.remove(0);
        let turn = (&mut second).now_or_never().expect("its turn");
        drop(turn);
        let turn = (&mut other).now_or_never().expect("before the last of the other client");
        drop(turn);
        drop(queued);
        let mut state = parsing.state();
        assert!(state.free == 1 && state.waiting.pop().is_none());
    }
}
