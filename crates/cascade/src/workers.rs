//! The worker threads: two pools over one set of sessions.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use crate::backend::{Backend, BackendError, Output, Session, UnitShape};

/// Which pool a request runs on: large ones must not keep small ones waiting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lane {
    /// Small requests, seconds of work at most.
    Express,
    /// All others.
    Bulk,
}

impl Lane {
    /// Requests of up to this many points out are small.
    pub const EXPRESS: u64 = 100_000;

    /// By the number of points out.
    #[must_use]
    pub fn of(points_out: u64) -> Self {
        if points_out <= Self::EXPRESS { Self::Express } else { Self::Bulk }
    }
}

/// Threads over one backend, and as many sessions.
///
/// Each lane has a pool of `threads` threads, on which geometry runs too, so that a program started
/// with `--threads 4` uses four. While both lanes have work, their threads take turns at the sessions,
/// first come first served, patch by patch: so the lanes advance alike, and no more than `threads`
/// units run at a time.
pub struct Workers {
    bulk: rayon::ThreadPool,
    express: rayon::ThreadPool,
    sessions: Turns,
    threads: usize,
    backend: Arc<dyn Backend>,
}

/// Workers that are free, and who waits for one.
struct Turns {
    state: Mutex<State>,
    // A lock that whoever has it may take again at once would leave the other lane waiting.
    changed: Condvar,
}

struct State {
    free: Vec<Worker>,
    waiting: VecDeque<u64>,
    next_number: u64,
}

impl Turns {
    /// Nothing panics while it is held.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self) -> Worker {
        let mut state = self.lock();
        let number = state.next_number;
        state.next_number += 1;
        state.waiting.push_back(number);
        loop {
            if state.waiting.front() == Some(&number)
                && let Some(worker) = state.free.pop()
            {
                state.waiting.pop_front();
                if !state.waiting.is_empty() && !state.free.is_empty() {
                    self.changed.notify_all();
                }
                return worker;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn give(&self, worker: Worker) {
        let mut state = self.lock();
        state.free.push(worker);
        if !state.waiting.is_empty() {
            self.changed.notify_all();
        }
    }
}

/// Gives a worker back, also when the work panics: it holds nothing but buffers, which every run overwrites.
struct Loan<'a> {
    turns: &'a Turns,
    worker: Option<Worker>,
}

impl Drop for Loan<'_> {
    fn drop(&mut self) {
        if let Some(worker) = self.worker.take() {
            self.turns.give(worker);
        }
    }
}

/// What a thread needs to run units.
pub struct Worker {
    /// Its way into the backend.
    pub session: Box<dyn Session>,
    /// Output of the last run.
    pub output: Output,
    /// Input buffers, reused.
    pub points: Vec<f32>,
    /// Input buffer for skip rows.
    pub skip_indices: Vec<i64>,
    /// Input buffer for skip distances.
    pub skip_distances: Vec<f32>,
}

impl Workers {
    /// Opens `threads` sessions and starts as many threads a lane.
    ///
    /// # Errors
    /// What [`Backend::open`] gives, or [`BackendError::Library`] when threads cannot be started.
    pub fn new(backend: Arc<dyn Backend>, threads: usize) -> Result<Self, BackendError> {
        let threads = threads.max(1);
        let pool = |name: &'static str| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .thread_name(move |i| format!("{name}-{i}"))
                .build()
                .map_err(|e| BackendError::Library { why: format!("cannot start {threads} threads: {e}") })
        };
        let free = (0..threads)
            .map(|_| {
                Ok(Worker {
                    session: backend.open()?,
                    output: Output::default(),
                    points: Vec::new(),
                    skip_indices: Vec::new(),
                    skip_distances: Vec::new(),
                })
            })
            .collect::<Result<_, _>>()?;
        let state = State { free, waiting: VecDeque::new(), next_number: 0 };
        Ok(Self {
            bulk: pool("densecloud")?,
            express: pool("densecloud-x")?,
            sessions: Turns { state: Mutex::new(state), changed: Condvar::new() },
            threads,
            backend,
        })
    }

    /// Runs `work` on the pool of `lane`, where rayon's parallel iterators use its threads.
    pub fn install<R: Send>(&self, lane: Lane, work: impl FnOnce() -> R + Send) -> R {
        match lane {
            Lane::Bulk => self.bulk.install(work),
            Lane::Express => self.express.install(work),
        }
    }

    /// Lends `work` a session and its buffers, when it is the caller's turn. Nothing that waits for
    /// another thread may run inside.
    pub fn with_worker<R>(&self, work: impl FnOnce(&mut Worker) -> R) -> R {
        let mut loan = Loan { turns: &self.sessions, worker: Some(self.sessions.take()) };
        // Taken back by the loan alone.
        work(loan.worker.as_mut().expect("a loan has its worker"))
    }

    /// How many threads there are.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.threads
    }

    /// The sizes that the backend's units share.
    #[must_use]
    pub fn shape(&self) -> UnitShape {
        self.backend.shape()
    }

    /// The backend.
    #[must_use]
    pub fn backend(&self) -> &dyn Backend {
        &*self.backend
    }
}
