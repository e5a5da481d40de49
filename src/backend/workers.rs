//! The worker threads: a pool in which each thread owns one session and its buffers.

use std::sync::{Arc, Mutex, PoisonError};

use super::{Backend, BackendError, Output, Session, UnitShape};

/// A thread pool of fixed size over one backend.
///
/// Geometry runs on the same threads, so that a program started with `--threads 4` uses four.
pub struct Workers {
    pool: rayon::ThreadPool,
    // A mutex rather than thread-local storage: it belongs to this pool and is dropped with it.
    // Never contended, since a thread only takes its own; nothing that could make rayon steal
    // another task may run while it is held.
    slots: Vec<Mutex<Worker>>,
    backend: Arc<dyn Backend>,
}

/// What one thread owns.
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
    /// Starts `threads` threads and opens a session for each.
    ///
    /// # Errors
    /// What [`Backend::open`] gives, or [`BackendError::Library`] when threads cannot be started.
    pub fn new(backend: Arc<dyn Backend>, threads: usize) -> Result<Self, BackendError> {
        let threads = threads.max(1);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("densecloud-{i}"))
            .build()
            .map_err(|e| BackendError::Library { why: format!("cannot start {threads} threads: {e}") })?;
        let slots = (0..threads)
            .map(|_| {
                Ok(Mutex::new(Worker {
                    session: backend.open()?,
                    output: Output::default(),
                    points: Vec::new(),
                    skip_indices: Vec::new(),
                    skip_distances: Vec::new(),
                }))
            })
            .collect::<Result<_, _>>()?;
        Ok(Self { pool, slots, backend })
    }

    /// Runs `work` on the pool, where rayon's parallel iterators use these threads.
    pub fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        self.pool.install(work)
    }

    /// Gives `work` the current thread's worker. Call it inside [`Workers::install`] only; outside
    /// the first thread's worker is used.
    pub fn with_worker<R>(&self, work: impl FnOnce(&mut Worker) -> R) -> R {
        let thread = self.pool.current_thread_index().unwrap_or(0);
        // A poisoned lock holds nothing but buffers, which every run overwrites.
        work(&mut self.slots[thread].lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// How many threads there are.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.slots.len()
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
