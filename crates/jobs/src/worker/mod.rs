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
use crate::records::{Change, Lease, Submitted};
use crate::settings::{Keeping, Settings};
use crate::shared;
use crate::store::{Input, Store};
use crate::work::Work;
pub use running::AtWork;

use running::Running;

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
    // Never held while records or blobs are asked, which may take long: what happens meanwhile is told by what it counts.
    running: Mutex<Running>,
    // Wakes the threads that run jobs.
    queued: Condvar,
    // Wakes those that look after leases and expired jobs.
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
            Keeping::Shared { database, password, store, kind, .. } => {
                shared::open(database, password.as_ref(), store, kind, settings.bounds())?
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
        let jobs = [(); 2].map(|()| Arc::clone(self));
        let [leases, upkeep] = jobs;
        running.threads.push(named("densecloud-leases".to_owned()).spawn(move || leases.keep_leases())?);
        running.threads.push(named("densecloud-upkeep".to_owned()).spawn(move || upkeep.keep_up())?);
        Ok(())
    }

    /// Another process changed something, or this one.
    fn hear(&self, change: &Change) {
        match change {
            Change::Waits => self.wake_all(),
            Change::Over(id) => self.doubt(id),
            Change::Other => {}
        }
        self.changes.send_replace(());
    }

    /// Steps came to wait.
    fn wake_all(&self) {
        self.lock().came += 1;
        self.queued.notify_all();
    }

    /// One did.
    fn wake_one(&self) {
        self.lock().came += 1;
        self.queued.notify_one();
    }

    /// A job is over, or waits anew: its leases are looked at now.
    fn doubt(&self, id: &str) {
        self.lock().doubt(id);
        self.stopped.notify_all();
    }

    /// Keeps a job; see [`Store::insert`].
    ///
    /// # Errors
    /// As [`Store::insert`].
    pub fn insert(&self, draft: &Draft, input: Input) -> Result<Submitted, StoreError> {
        let submitted = self.store.insert(draft, input, self.now())?;
        if let Submitted::New(Record { id, request_id, points_in, points_out, .. }) = &submitted {
            tracing::info!(job = id, request = request_id, points_in, points_out, "job queued");
            self.wake_one();
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
        let deleted = if self.store.cancel(id, self.now())? {
            self.cancel(id);
            tracing::info!(job = id, "job cancelled");
            Some(Deleted::Cancelled)
        } else if self.store.delete(id)? {
            tracing::info!(job = id, "job forgotten");
            Some(Deleted::Forgotten)
        } else {
            None
        };
        self.changes.send_replace(());
        Ok(deleted)
    }

    /// A job is over: what is done of it is of no use.
    fn cancel(&self, id: &str) {
        self.lock().of(id).for_each(|run| run.task.cancel());
        // One that is just being claimed is not there yet.
        self.doubt(id);
    }

    /// The steps of a job that are at work here.
    pub fn at_work(&self, id: &str) -> AtWork {
        AtWork(self.lock().of(id).map(|run| Arc::clone(&run.task)).collect())
    }

    /// Points that jobs at work here still have to make, beside one that may have begun since it was looked up.
    pub fn points_running(&self, beside: &str) -> u64 {
        let mut left: HashMap<String, f64> = HashMap::new();
        for run in self.lock().all() {
            let Record { id, points_out, tiles, .. } = &run.lease.record;
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
        let leases: Vec<Lease> = {
            let mut running = self.lock();
            running.stopping = true;
            running.at_work().for_each(|run| run.task.cancel());
            running.at_work().map(|run| run.lease.clone()).collect()
        };
        self.queued.notify_all();
        self.stopped.notify_all();
        leases.iter().for_each(|lease| self.put_back(lease));
        self.changes.send_replace(());
    }

    fn put_back(&self, lease: &Lease) {
        let id = &lease.record.id;
        match self.store.put_back(lease) {
            Ok(true) => tracing::info!(job = id, "job put back"),
            Ok(false) => {}
            // It will be found running, and so be queued, at the next start.
            Err(error) => tracing::error!(job = id, %error, "job not put back"),
        }
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
