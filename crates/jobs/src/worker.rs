//! Running what is queued.

use std::collections::HashMap;
use std::io::{self, Write};
use std::panic::AssertUnwindSafe;
use std::path::PathBuf;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use tokio::sync::watch;

use super::files::Input;
use super::record::{Draft, Failure, Record, Time};
use super::store::{Bounds, Store, StoreError, Submitted};
use densecloud_engine::{EngineError, Outcome, Progress, ProgressHandle};

/// How jobs are kept and run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// The folder of database and files (`--data-dir`).
    pub folder: PathBuf,
    /// Jobs that run at a time (`--jobs-running`).
    pub running: usize,
    /// How long a job that has come to its end is kept (`--job-expiry`).
    pub expiry: Duration,
    /// Bytes of the disk that jobs may take (`--job-disk`).
    pub disk: u64,
    /// Jobs that may be queued or running (`--max-jobs`).
    pub queued: u64,
    /// The same of one client (`--client-jobs`).
    pub client_queued: u64,
    /// How often a job is started before it counts as failed (`--job-attempts`).
    pub attempts: u32,
}

impl Settings {
    /// One at a time, a thousand that wait, a hundred of them one client's, kept for a day, in at most 10 GiB.
    #[must_use]
    pub fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            running: 1,
            expiry: Duration::from_secs(24 * 3600),
            disk: 10 << 30,
            queued: 1000,
            client_queued: 100,
            attempts: 3,
        }
    }
}

/// What jobs are about.
pub trait Work: Send + Sync + 'static {
    /// Computes a job's result, writes it into `sink`, and gives what is to be told of it. Blocks.
    ///
    /// # Errors
    /// Why there is none.
    fn run(&self, job: &Record, input: Vec<u8>, task: &Task, sink: &mut dyn Write)
    -> Result<String, Stopped>;
}

/// Why a job that was started has no result.
#[derive(Debug)]
pub enum Stopped {
    /// It never will.
    Refused(String),
    /// There is no room for it at the moment.
    Later,
    /// It was cancelled.
    Cancelled,
    /// A bug.
    Crashed,
    /// Its result cannot be written.
    Storage(io::Error),
}

/// Whether a failure says nothing of the file: no descriptor was left, or no memory, or a signal came. What
/// runs beside will be over some time.
fn passes(error: &io::Error) -> bool {
    // ENFILE and EMFILE, on every Unix, have no kind of their own.
    let descriptors = cfg!(unix) && matches!(error.raw_os_error(), Some(23 | 24));
    descriptors || matches!(error.kind(), io::ErrorKind::OutOfMemory | io::ErrorKind::Interrupted)
}

impl From<io::Error> for Stopped {
    fn from(error: io::Error) -> Self {
        Self::Storage(error)
    }
}

/// A job that runs.
#[derive(Default)]
pub struct Task(Mutex<TaskState>);

#[derive(Default)]
struct TaskState {
    cancelled: bool,
    handle: Option<ProgressHandle>,
}

impl Task {
    fn lock(&self) -> MutexGuard<'_, TaskState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether nobody wants its result any more.
    pub fn cancelled(&self) -> bool {
        self.lock().cancelled
    }

    /// Waits for what the engine does for it; when the task is cancelled, the engine's work is.
    ///
    /// # Errors
    /// The engine's.
    pub fn wait(&self, job: densecloud_engine::Pending) -> Result<Outcome, EngineError> {
        {
            let mut state = self.lock();
            let handle = job.progress_handle();
            if state.cancelled {
                handle.cancel();
            }
            state.handle = Some(handle);
        }
        job.wait()
    }

    fn cancel(&self) {
        let mut state = self.lock();
        state.cancelled = true;
        if let Some(handle) = &state.handle {
            handle.cancel();
        }
    }

    /// How far it is; none while it is read or waits for the engine. Waits for nothing but a moment.
    pub fn progress(&self) -> Option<Progress> {
        self.lock().handle.as_ref().map(ProgressHandle::progress)
    }
}

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
    // Whoever changes a state that concerns a running job holds it, so that tasks and records agree.
    running: Mutex<Running>,
    // Wakes the threads.
    queued: Condvar,
    // Wakes the thread that looks for expired jobs, to end it.
    stopped: Condvar,
    // A watch channel, so that many can wait for a change of any job.
    changes: watch::Sender<()>,
}

#[derive(Default)]
struct Running {
    tasks: HashMap<String, (Record, Arc<Task>)>,
    /// Jobs whose end could not be written: they run in the database alone.
    lost: Vec<String>,
    threads: Vec<JoinHandle<()>>,
    stopping: bool,
}

/// How often expired jobs are looked for, at least.
const LOOK: Duration = Duration::from_secs(30);
/// Expired jobs that are forgotten at once: one wait for the disk each time, between which others have the
/// database.
const BATCH: u32 = 200;
/// Before a job that found no room is tried again.
const PAUSE: Duration = Duration::from_millis(500);
/// Before a database that could not be written is.
const BROKEN: Duration = Duration::from_secs(2);

/// The time.
#[must_use]
pub fn now() -> Time {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    since.as_millis().try_into().unwrap_or(Time::MAX)
}

impl Jobs {
    /// Opens the store. Nothing runs before [`Jobs::start`].
    ///
    /// # Errors
    /// As [`Store::open`].
    pub fn open(settings: Settings) -> Result<Self, StoreError> {
        let bounds =
            Bounds { disk: settings.disk, jobs: settings.queued, client_jobs: settings.client_queued };
        let store = Store::open(&settings.folder, bounds, settings.attempts, now())?;
        Ok(Self {
            store,
            settings,
            running: Mutex::default(),
            queued: Condvar::new(),
            stopped: Condvar::new(),
            changes: watch::Sender::new(()),
        })
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

    /// Starts the threads; they end with [`Jobs::stop`].
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start(self: &Arc<Self>, work: &Arc<dyn Work>) -> io::Result<()> {
        let mut running = self.lock();
        let named = |name: String| std::thread::Builder::new().name(name);
        for i in 0..self.settings.running {
            let (jobs, work) = (Arc::clone(self), Arc::clone(work));
            let thread = named(format!("densecloud-stored-{i}")).spawn(move || jobs.work(&*work))?;
            running.threads.push(thread);
        }
        let jobs = Arc::clone(self);
        running.threads.push(named("densecloud-expiry".to_owned()).spawn(move || jobs.expire())?);
        Ok(())
    }

    /// Keeps a job; see [`Store::insert`].
    ///
    /// # Errors
    /// As [`Store::insert`].
    pub fn insert(&self, draft: &Draft, input: Input) -> Result<Submitted, StoreError> {
        let submitted = self.store.insert(draft, input, now())?;
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
        let deleted = if self.store.cancel(id, now())? {
            if let Some((_, task)) = running.tasks.get(id) {
                task.cancel();
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
        self.lock().tasks.get(id).map(|(_, task)| Arc::clone(task))
    }

    /// Points that running jobs still have to make, beside one that may have begun since it was looked up.
    pub fn points_running(&self, beside: &str) -> u64 {
        let left = |(record, task): &(Record, Arc<Task>)| {
            let done = task.progress().map_or(0.0, |progress| progress.fraction);
            (record.points_out as f64 * (1.0 - done)) as u64
        };
        self.lock().tasks.values().filter(|(record, _)| record.id != beside).map(left).sum()
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
        for (id, (_, task)) in &running.tasks {
            task.cancel();
            match self.store.put_back(id) {
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

    fn work(&self, work: &dyn Work) {
        while let Some((job, task)) = self.next() {
            let stopped = self.run(&job, &task, work);
            self.changes.send_replace(());
            if let Err(Pause) = stopped {
                drop(self.queued.wait_timeout(self.lock(), PAUSE));
            }
        }
    }

    /// Waits for the next job; none once the store stops.
    fn next(&self) -> Option<(Record, Arc<Task>)> {
        let mut running = self.lock();
        while !running.stopping {
            let mut wait = LOOK;
            if !running.lost.is_empty() {
                running.lost.retain(|id| self.store.put_back(id).is_err());
                self.changes.send_replace(());
                wait = if running.lost.is_empty() { LOOK } else { BROKEN };
            }
            match self.store.claim(now()) {
                Ok(Some(job)) => {
                    let task = Arc::new(Task::default());
                    running.tasks.insert(job.id.clone(), (job.clone(), Arc::clone(&task)));
                    self.changes.send_replace(());
                    tracing::info!(
                        job = job.id,
                        request = job.request_id,
                        attempt = job.attempts,
                        "job started"
                    );
                    return Some((job, task));
                }
                Ok(None) => {}
                Err(error) => {
                    tracing::error!(%error, "no job can be started");
                    wait = BROKEN;
                }
            }
            running = self.queued.wait_timeout(running, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
        None
    }

    /// Forgets jobs when their time has come, on a thread of its own, since all others may be at work for long,
    /// and without the lock that they need.
    fn expire(&self) {
        let age = self.settings.expiry.as_millis().try_into().unwrap_or(Time::MAX);
        let mut running = self.lock();
        while !running.stopping {
            drop(running);
            let expired = self.store.expire(now().saturating_sub(age), BATCH);
            let more = expired.as_ref().is_ok_and(|ids| ids.len() == BATCH as usize);
            match expired {
                Ok(ids) if ids.is_empty() => {}
                Ok(ids) => {
                    ids.iter().for_each(|id| tracing::info!(job = id, "job expired"));
                    self.changes.send_replace(());
                }
                Err(error) => tracing::error!(%error, "expired jobs cannot be removed"),
            }
            running = self.lock();
            if !more && !running.stopping {
                let wait = LOOK.min(self.settings.expiry.max(PAUSE));
                running = self.stopped.wait_timeout(running, wait).unwrap_or_else(PoisonError::into_inner).0;
            }
        }
    }

    fn run(&self, job: &Record, task: &Task, work: &dyn Work) -> Result<(), Pause> {
        let id = &job.id;
        // A panic is a bug in one job; it must not take the thread, and all other jobs, with it.
        let made = std::panic::catch_unwind(AssertUnwindSafe(|| {
            let input = self.store.input(id)?;
            self.store.write_result(id, |sink| work.run(job, input, task, &mut Checked { sink, task }))
        }));
        // Against `stop` and `delete`, which may just now be at it.
        let mut running = self.lock();
        // Under the same lock as the state: once it is put back, another thread may start it anew.
        running.tasks.remove(id);
        let kept = match made.unwrap_or(Err(Stopped::Crashed)) {
            Ok(result) => self.store.done(id, &result, now()).inspect(|&done| {
                if done {
                    tracing::info!(job = id, request = job.request_id, bytes = result.bytes, "job done");
                }
            }),
            Err(_) if task.cancelled() => return Ok(()),
            Err(Stopped::Later | Stopped::Cancelled) => return Err(self.defer(running, id)),
            Err(Stopped::Refused(why)) => self.fail(job, &Failure::Refused(why)),
            Err(Stopped::Crashed) => self.fail(job, &Failure::Crashed),
            Err(Stopped::Storage(error)) if passes(&error) => {
                tracing::warn!(job = id, %error, "a job is tried again later");
                return Err(self.defer(running, id));
            }
            Err(Stopped::Storage(error)) => {
                tracing::error!(job = id, %error, "a job's file cannot be read or written");
                let full = StoreError::from(io::Error::from(error.kind())).is_full();
                self.fail(job, &Failure::Storage { why: error.to_string(), full })
            }
        };
        kept.map(|_| ()).map_err(|error| {
            self.lose(running, id, &error);
            Pause
        })
    }

    fn fail(&self, job: &Record, failure: &Failure) -> Result<bool, StoreError> {
        self.store.failed(&job.id, failure, now()).inspect(|&failed| {
            if failed {
                tracing::info!(job = job.id, request = job.request_id, ?failure, "job failed");
            }
        })
    }

    fn defer(&self, running: MutexGuard<'_, Running>, id: &str) -> Pause {
        if let Err(error) = self.store.defer(id) {
            self.lose(running, id, &error);
        }
        Pause
    }

    /// The database could not be written: the job is put back as soon as that works, or at the next start.
    fn lose(&self, mut running: MutexGuard<'_, Running>, id: &str, error: &StoreError) {
        tracing::error!(job = id, %error, "a job's state cannot be kept");
        running.lost.push(id.to_owned());
    }
}

/// The thread should wait before it tries the next job.
struct Pause;

/// A file that takes no more once its job is cancelled.
struct Checked<'a> {
    sink: &'a mut dyn Write,
    task: &'a Task,
}

impl Write for Checked<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.task.cancelled() {
            return Err(io::Error::other("cancelled"));
        }
        self.sink.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}
