//! Running what is queued.
//!
//! | file | holds |
//! |---|---|
//! | `running` | the steps that threads of this process are at |
//! | `thread` | a thread that takes one step after another |
//! | `outcome` | a step that is done, and what becomes of it |
//! | `upkeep` | leases that are to be extended, jobs that expire, leftovers |

mod outcome;
mod running;
mod thread;
mod upkeep;

use std::collections::HashMap;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;

use crate::clock::{Clock, SystemClock};
use crate::error::StoreError;
use crate::record::{Draft, Record, Time};
use crate::records::{Change, Submitted};
use crate::settings::{Keeping, Settings};
use crate::shared;
use crate::store::{Input, Store};
use crate::work::Work;
pub use running::AtWork;

use running::{Run, Running};

/// What deleting did to a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Deleted {
    /// It was queued or running, and is neither any more.
    Cancelled,
    /// It had come to its end, and is forgotten.
    Forgotten,
}

/// The store, and the threads that run what is in it.
pub struct Jobs {
    store: Store,
    settings: Settings,
    clock: Arc<dyn Clock>,
    // Whoever changes a state that concerns a running job holds it, so that tasks and records agree.
    running: Mutex<Running>,
    // Wakes the threads that run jobs.
    queued: Condvar,
    // Wakes the thread that looks after leases and expired jobs, to end it.
    stopped: Condvar,
    // A watch channel, so that many can wait for a change of any job.
    changes: watch::Sender<()>,
    beats_failed: AtomicU64,
}

impl Jobs {
    /// Opens the store where the settings say, under the clock that counts there. Nothing runs before [`Jobs::start`].
    ///
    /// # Errors
    /// As [`Store::open`].
    pub fn open(settings: Settings) -> Result<Self, StoreError> {
        let (store, clock): (Store, Arc<dyn Clock>) = match &settings.keeping {
            Keeping::Folder(folder) => {
                (Store::open(folder, settings.bounds(), SystemClock.now())?, Arc::new(SystemClock))
            }
            Keeping::Shared { database, store, kind, .. } => {
                shared::open(database, store, kind, settings.bounds())?
            }
        };
        Ok(Self::new(store, settings, clock))
    }

    /// Over any store, which may be shared with others, and any clock. Nothing runs before [`Jobs::start`].
    #[must_use]
    pub fn new(store: Store, settings: Settings, clock: Arc<dyn Clock>) -> Self {
        Self {
            store,
            settings,
            clock,
            running: Mutex::default(),
            queued: Condvar::new(),
            stopped: Condvar::new(),
            changes: watch::Sender::new(()),
            beats_failed: AtomicU64::new(0),
        }
    }

    /// What is kept.
    #[must_use]
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// How jobs are kept and run.
    #[must_use]
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// How often leases could not be extended, since the database did not answer.
    pub fn beats_failed(&self) -> u64 {
        self.beats_failed.load(Ordering::Relaxed)
    }

    /// The time on the jobs' clock.
    #[must_use]
    pub fn now(&self) -> Time {
        self.clock.now()
    }

    /// Starts the threads; they end with [`Jobs::stop`].
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(self: &Arc<Self>, work: &Arc<dyn Work>) -> io::Result<()> {
        let mut running = self.lock();
        let named = |name: String| std::thread::Builder::new().name(name);
        for i in 0..self.settings.running {
            let (jobs, work) = (Arc::clone(self), Arc::clone(work));
            let worker = match &self.settings.keeping {
                Keeping::Shared { process, .. } => format!("{process}, thread {i}"),
                Keeping::Folder(_) => format!("process {}, thread {i}", std::process::id()),
            };
            let thread = named(format!("densecloud-stored-{i}")).spawn(move || jobs.work(&worker, &*work))?;
            running.threads.push(thread);
        }
        let jobs = Arc::downgrade(self);
        self.store.listen(Arc::new(move |change| {
            jobs.upgrade().into_iter().for_each(|jobs| jobs.hear(&change));
        }));
        let jobs = Arc::clone(self);
        running.threads.push(named("densecloud-upkeep".to_owned()).spawn(move || jobs.keep_up())?);
        Ok(())
    }

    /// Another process changed something, or this one.
    fn hear(&self, change: &Change) {
        let mut running = self.lock();
        match change {
            Change::Waits => self.queued.notify_all(),
            Change::Over(id) => {
                // Its leases are looked at now.
                for (_, run) in running.tasks.iter_mut().filter(|((job, _), _)| job == id) {
                    run.lease.until = Time::MIN;
                    self.stopped.notify_all();
                }
            }
            Change::Other => {}
        }
        drop(running);
        self.changes.send_replace(());
    }

    /// Keeps a job; see [`Store::insert`].
    ///
    /// # Errors
    /// As [`Store::insert`].
    pub fn insert(&self, draft: &Draft, input: Input) -> Result<Submitted, StoreError> {
        let submitted = self.store.insert(draft, input, self.now())?;
        if let Submitted::New(Record { id, request_id, points_in, points_out, .. }) = &submitted {
            tracing::info!(job = id, request = request_id, points_in, points_out, "job queued");
            // Under the lock, or a thread that is just about to wait would miss it.
            let _running = self.lock();
            self.queued.notify_one();
            self.changes.send_replace(());
        }
        Ok(submitted)
    }

    /// Cancels a job that waits or runs, forgets one that has come to its end; nothing where there is none.
    /// Work stops within one batch of patches.
    ///
    /// # Errors
    /// What the disk says.
    pub fn delete(&self, id: &str) -> Result<Option<Deleted>, StoreError> {
        let running = self.lock();
        let deleted = if self.store.cancel(id, self.now())? {
            running.of(id).for_each(|run| run.task.cancel());
            tracing::info!(job = id, "job cancelled");
            Some(Deleted::Cancelled)
        } else if self.store.delete(id)? {
            tracing::info!(job = id, "job forgotten");
            Some(Deleted::Forgotten)
        } else {
            None
        };
        drop(running);
        self.changes.send_replace(());
        Ok(deleted)
    }

    /// The steps of a job that are at work here.
    pub fn at_work(&self, id: &str) -> AtWork {
        AtWork(self.lock().of(id).map(|run| Arc::clone(&run.task)).collect())
    }

    /// Points that jobs at work here still have to make, beside one that may have begun since it was looked up.
    pub fn points_running(&self, beside: &str) -> u64 {
        let mut left: HashMap<String, f64> = HashMap::new();
        for ((id, _), run) in &self.lock().tasks {
            let Record { points_out, tiles, .. } = &run.lease.record;
            let before = tiles.as_ref().map_or(0, |tiles| tiles.points);
            let made = run.task.progress().map_or(0.0, |progress| progress.fraction) * *points_out as f64;
            *left.entry(id.clone()).or_insert(points_out.saturating_sub(before) as f64) -= made;
        }
        left.iter().filter(|(id, _)| *id != beside).map(|(_, left)| left.max(0.0) as u64).sum()
    }

    /// Changes with the state of any job.
    pub fn changes(&self) -> watch::Receiver<()> {
        self.changes.subscribe()
    }

    /// Puts running jobs back into the queue, on the disk, and starts no more. What the threads still do is
    /// without effect; [`Jobs::join`] waits for it.
    pub fn stop(&self) {
        let mut running = self.lock();
        running.stopping = true;
        for ((id, _), Run { lease, task }) in &running.tasks {
            task.cancel();
            match self.store.put_back(lease) {
                Ok(true) => tracing::info!(job = id, "job put back"),
                Ok(false) => {}
                // It will be found running, and so be queued, at the next start.
                Err(error) => tracing::error!(job = id, %error, "job not put back"),
            }
        }
        drop(running);
        self.queued.notify_all();
        self.stopped.notify_all();
        self.changes.send_replace(());
    }

    /// Waits for the threads to end after [`Jobs::stop`]: as long as a batch of patches, or as a result that
    /// is being written.
    pub fn join(&self) {
        let threads = std::mem::take(&mut self.lock().threads);
        for thread in threads {
            // A thread's panic is in the log already.
            let _ = thread.join();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Running> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
