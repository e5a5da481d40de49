//! Sessions that all requests share, lent patch by patch.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use densecloud_cascade::{Backend, BackendError, Sessions, Workspace};

/// A fixed number of sessions, lent first come first served: so the lanes advance alike, and no more units than sessions
/// run at a time.
pub(super) struct Turns {
    state: Mutex<State>,
    // A lock that whoever has it may take again at once would leave the other lane waiting.
    changed: Condvar,
}

struct State {
    free: Vec<Workspace>,
    waiting: VecDeque<u64>,
    next_number: u64,
}

impl Turns {
    /// Opens `count` sessions.
    ///
    /// # Errors
    /// What [`Backend::open`] gives.
    pub(super) fn open(backend: &dyn Backend, count: usize) -> Result<Self, BackendError> {
        let free = (0..count).map(|_| Workspace::open(backend)).collect::<Result<_, _>>()?;
        let state = State { free, waiting: VecDeque::new(), next_number: 0 };
        Ok(Self { state: Mutex::new(state), changed: Condvar::new() })
    }

    /// Nothing panics while it is held.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self) -> Workspace {
        let mut state = self.lock();
        let number = state.next_number;
        state.next_number += 1;
        state.waiting.push_back(number);
        loop {
            if state.waiting.front() == Some(&number)
                && let Some(workspace) = state.free.pop()
            {
                state.waiting.pop_front();
                if !state.waiting.is_empty() && !state.free.is_empty() {
                    self.changed.notify_all();
                }
                return workspace;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn give(&self, workspace: Workspace) {
        let mut state = self.lock();
        state.free.push(workspace);
        if !state.waiting.is_empty() {
            self.changed.notify_all();
        }
    }
}

impl Sessions for Turns {
    fn lend<R>(&self, work: impl FnOnce(&mut Workspace) -> R) -> Result<R, BackendError> {
        let mut loan = Loan { turns: self, workspace: Some(self.take()) };
        // Taken back by the loan alone.
        Ok(work(loan.workspace.as_mut().expect("a loan has its workspace")))
    }
}

/// Gives a workspace back, also when the work panics: it holds nothing but buffers, which every run overwrites.
struct Loan<'a> {
    turns: &'a Turns,
    workspace: Option<Workspace>,
}

impl Drop for Loan<'_> {
    fn drop(&mut self) {
        if let Some(workspace) = self.workspace.take() {
            self.turns.give(workspace);
        }
    }
}
