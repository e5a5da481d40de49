//! Running what is queued.

use std::collections::HashMap;
use std::io;
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use tokio::sync::watch;

use crate::clock::{Clock, SystemClock};
use crate::error::StoreError;
use crate::record::{Draft, Failure, Record, Time};
use crate::records::{Lease, Submitted};
use crate::settings::Settings;
use crate::store::{Input, Store};
use crate::work::{Checked, Stopped, Task, Work, passes};

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
}

#[derive(Default)]
struct Running {
    tasks: HashMap<String, Run>,
    /// Jobs whose end could not be written: they run in the records alone.
    lost: Vec<Lease>,
    threads: Vec<JoinHandle<()>>,
    stopping: bool,
}

/// A job that one of the threads works at.
struct Run {
    lease: Lease,
    task: Arc<Task>,
}

/// How long a lease is, in milliseconds. It is extended when half of it is over, so a worker that ended is missed
/// after this time at most, and one that is slow for half of it loses nothing.
const LEASE: Time = 120_000;
/// How often leases, and expired jobs, are looked at, at least.
const LOOK: Duration = Duration::from_secs(30);
/// Expired jobs that are forgotten at once: one wait for the disk each time, between which others have the
/// database.
const BATCH: u32 = 200;
/// Before a job that found no room is tried again.
const PAUSE: Duration = Duration::from_millis(500);
/// Before a database that could not be written is.
const BROKEN: Duration = Duration::from_secs(2);

impl Jobs {
    /// Opens the store in the settings' folder, under the computer's clock. Nothing runs before [`Jobs::start`].
    ///
    /// # Errors
    /// As [`Store::open`].
    pub fn open(settings: Settings) -> Result<Self, StoreError> {
        let store = Store::open(&settings.folder, settings.bounds(), SystemClock.now())?;
        Ok(Self::new(store, settings, Arc::new(SystemClock)))
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
            let worker = format!("process {}, thread {i}", std::process::id());
            let thread = named(format!("densecloud-stored-{i}")).spawn(move || jobs.work(&worker, &*work))?;
            running.threads.push(thread);
        }
        let jobs = Arc::clone(self);
        running.threads.push(named("densecloud-upkeep".to_owned()).spawn(move || jobs.keep_up())?);
        Ok(())
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
            if let Some(run) = running.tasks.get(id) {
                run.task.cancel();
            }
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

    /// A running job.
    pub fn task(&self, id: &str) -> Option<Arc<Task>> {
        self.lock().tasks.get(id).map(|run| Arc::clone(&run.task))
    }

    /// Points that running jobs still have to make, beside one that may have begun since it was looked up.
    pub fn points_running(&self, beside: &str) -> u64 {
        let left = |(_, run): (&String, &Run)| {
            let done = run.task.progress().map_or(0.0, |progress| progress.fraction);
            (run.lease.record.points_out as f64 * (1.0 - done)) as u64
        };
        self.lock().tasks.iter().filter(|(id, _)| *id != beside).map(left).sum()
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
        for (id, Run { lease, task }) in &running.tasks {
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

    fn work(&self, worker: &str, work: &dyn Work) {
        while let Some((lease, task)) = self.next(worker) {
            let stopped = self.run(&lease, &task, work);
            self.changes.send_replace(());
            if let Err(Pause) = stopped {
                drop(self.queued.wait_timeout(self.lock(), PAUSE));
            }
        }
    }

    /// Waits for the next job; none once the store stops.
    fn next(&self, worker: &str) -> Option<(Lease, Arc<Task>)> {
        let mut running = self.lock();
        while !running.stopping {
            let wait = match self.claim(&mut running, worker) {
                Ok(Some(started)) => return Some(started),
                Ok(None) if running.lost.is_empty() => LOOK,
                Ok(None) => BROKEN,
                Err(error) => {
                    tracing::error!(%error, "no job can be started");
                    BROKEN
                }
            };
            running = self.queued.wait_timeout(running, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
        None
    }

    fn claim(&self, running: &mut Running, worker: &str) -> Result<Option<(Lease, Arc<Task>)>, StoreError> {
        if !running.lost.is_empty() {
            running.lost.retain(|lease| self.store.put_back(lease).is_err());
            self.changes.send_replace(());
        }
        // One time for both, and this first: else, after the computer has slept, a thread would take over the jobs of
        // those beside it.
        let now = self.now();
        self.renew(running, now)?;
        let Some(lease) = self.store.claim(worker, now, now.saturating_add(LEASE))? else { return Ok(None) };
        let task = Arc::new(Task::default());
        let run = Run { lease: lease.clone(), task: Arc::clone(&task) };
        running.tasks.insert(lease.record.id.clone(), run);
        self.changes.send_replace(());
        let Record { id, request_id, attempts, .. } = &lease.record;
        tracing::info!(job = id, request = request_id, attempt = attempts, "job started");
        Ok(Some((lease, task)))
    }

    /// Extends the leases of which half is over. Work at a job whose lease is another's is stopped.
    fn renew(&self, running: &mut Running, now: Time) -> Result<(), StoreError> {
        let until = now.saturating_add(LEASE);
        let mut taken = Vec::new();
        for (id, Run { lease, task }) in &mut running.tasks {
            if lease.until.saturating_sub(now) > LEASE / 2 {
                continue;
            }
            if self.store.beat(lease, until)? {
                lease.until = until;
            } else {
                tracing::warn!(job = id, "the lease of a job is another's");
                task.cancel();
                taken.push(id.clone());
            }
        }
        taken.iter().for_each(|id| drop(running.tasks.remove(id)));
        Ok(())
    }

    /// Extends leases, and forgets jobs when their time has come, on a thread of its own, since all others may be at
    /// work for long.
    fn keep_up(&self) {
        let mut running = self.lock();
        while !running.stopping {
            if let Err(error) = self.renew(&mut running, self.now()) {
                tracing::error!(%error, "leases of jobs cannot be extended");
            }
            drop(running);
            let more = self.expire();
            running = self.lock();
            if !more && !running.stopping {
                let wait = LOOK.min(self.settings.expiry.max(PAUSE));
                running = self.stopped.wait_timeout(running, wait).unwrap_or_else(PoisonError::into_inner).0;
            }
        }
    }

    /// Forgets some of the jobs whose time has come, without the lock that the other threads need; says whether there
    /// may be more.
    fn expire(&self) -> bool {
        let age = self.settings.expiry.as_millis().try_into().unwrap_or(Time::MAX);
        match self.store.expire(self.now().saturating_sub(age), BATCH) {
            Ok(ids) => {
                ids.iter().for_each(|id| tracing::info!(job = id, "job expired"));
                if !ids.is_empty() {
                    self.changes.send_replace(());
                }
                ids.len() == BATCH as usize
            }
            Err(error) => {
                tracing::error!(%error, "expired jobs cannot be removed");
                false
            }
        }
    }

    fn run(&self, lease: &Lease, task: &Task, work: &dyn Work) -> Result<(), Pause> {
        let job = &lease.record;
        let id = &job.id;
        // A panic is a bug in one job; it must not take the thread, and all other jobs, with it.
        let made = std::panic::catch_unwind(AssertUnwindSafe(|| {
            let input = self.store.input(id)?;
            self.store.write_result(lease, |sink| work.run(job, input, task, &mut Checked { sink, task }))
        }));
        // Against `stop` and `delete`, which may just now be at it.
        let mut running = self.lock();
        // Under the same lock as the state: once it is put back, another thread may start it anew.
        if running.tasks.get(id).is_some_and(|run| run.lease.attempt == lease.attempt) {
            running.tasks.remove(id);
        }
        let kept = match made.unwrap_or(Err(Stopped::Crashed)) {
            Ok(result) => self.store.done(lease, &result, self.now()).inspect(|&done| {
                if done {
                    tracing::info!(job = id, request = job.request_id, bytes = result.bytes, "job done");
                }
            }),
            Err(_) if task.cancelled() => return Ok(()),
            Err(Stopped::Later | Stopped::Cancelled) => return Err(self.defer(running, lease)),
            Err(Stopped::Refused(why)) => self.fail(lease, &Failure::Refused(why)),
            Err(Stopped::Crashed) => self.fail(lease, &Failure::Crashed),
            Err(Stopped::Storage(error)) if passes(&error) => {
                tracing::warn!(job = id, %error, "a job is tried again later");
                return Err(self.defer(running, lease));
            }
            Err(Stopped::Storage(error)) => {
                tracing::error!(job = id, %error, "a job's file cannot be read or written");
                let full = StoreError::from(io::Error::from(error.kind())).is_full();
                self.fail(lease, &Failure::Storage { why: error.to_string(), full })
            }
        };
        kept.map(|_| ()).map_err(|error| {
            lose(running, lease, &error);
            Pause
        })
    }

    fn fail(&self, lease: &Lease, failure: &Failure) -> Result<bool, StoreError> {
        self.store.failed(lease, failure, self.now()).inspect(|&failed| {
            if failed {
                let Record { id, request_id, .. } = &lease.record;
                tracing::info!(job = id, request = request_id, ?failure, "job failed");
            }
        })
    }

    fn defer(&self, running: MutexGuard<'_, Running>, lease: &Lease) -> Pause {
        if let Err(error) = self.store.defer(lease) {
            lose(running, lease, &error);
        }
        Pause
    }
}

/// The database could not be written: the job is put back as soon as that works, or at the next start.
fn lose(mut running: MutexGuard<'_, Running>, lease: &Lease, error: &StoreError) {
    tracing::error!(job = lease.record.id, %error, "a job's state cannot be kept");
    running.lost.push(lease.clone());
}

/// The thread should wait before it tries the next job.
struct Pause;
