//! Running what is queued.

use std::collections::HashMap;
use std::io;
use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};

use densecloud_engine::Progress;
use tokio::sync::watch;

use crate::clock::{Clock, SystemClock};
use crate::error::StoreError;
use crate::record::{Draft, Failure, Record, ResultFile, Time};
use crate::records::{Change, Lease, Step, Submitted};
use crate::settings::{Keeping, Settings};
use crate::shared;
use crate::store::{Input, Store};
use crate::work::{Begun, Checked, How, Parts, Stopped, Task, Work, passes};

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

#[derive(Default)]
struct Running {
    tasks: HashMap<(String, Step), Run>,
    /// Steps whose end could not be written: they run in the records alone.
    lost: Vec<Lease>,
    threads: Vec<JoinHandle<()>>,
    stopping: bool,
}

/// A step that one of the threads works at.
struct Run {
    lease: Lease,
    task: Arc<Task>,
}

/// The steps of a job that threads here are at.
#[derive(Clone, Default)]
pub struct AtWork(Vec<Arc<Task>>);

impl AtWork {
    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// How far the job is by them, beside its tiles that are done; none while none has begun.
    #[must_use]
    pub fn progress(&self) -> Option<Progress> {
        let add = |sum: Progress, one: Progress| Progress { fraction: sum.fraction + one.fraction, ..sum };
        self.0.iter().filter_map(|task| task.progress()).reduce(add)
    }
}

/// What became of a step.
enum Ended {
    Result(ResultFile),
    Split { sizes: Vec<u64>, bytes: u64 },
    Tile(u64),
}

/// How often leases, and expired jobs, are looked at, at least.
const LOOK: Duration = Duration::from_secs(30);
/// How often blobs are looked for that nobody needs, where several programs share them, and how old those are: older than
/// what is written before the record that promises it.
const COLLECT: Duration = Duration::from_secs(3600);
/// Expired jobs that are forgotten at once: one wait for the disk each time, between which others have the
/// database.
const BATCH: u32 = 200;
/// Before a job that found no room is tried again.
const PAUSE: Duration = Duration::from_millis(500);
/// Before a database that could not be written is.
const BROKEN: Duration = Duration::from_secs(2);

impl Running {
    /// The steps of a job.
    fn of<'a>(&'a self, id: &'a str) -> impl Iterator<Item = &'a Run> {
        self.tasks.iter().filter(move |((job, _), _)| job == id).map(|(_, run)| run)
    }
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

    fn work(&self, worker: &str, work: &dyn Work) {
        while let Some((lease, task)) = self.next(worker) {
            let start = Instant::now();
            let (how, pause) = self.run(&lease, &task, work);
            work.ended(lease.step, how, start.elapsed());
            self.changes.send_replace(());
            if pause {
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
                Ok(None) if running.lost.is_empty() => self.look(),
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
        let until = now.saturating_add(self.lease());
        let Some(lease) = self.store.claim(worker, now, until)? else { return Ok(None) };
        let task = Arc::new(Task::default());
        let run = Run { lease: lease.clone(), task: Arc::clone(&task) };
        running.tasks.insert((lease.record.id.clone(), lease.step), run);
        self.changes.send_replace(());
        let Record { id, request_id, attempts, .. } = &lease.record;
        match lease.step {
            Step::Whole => tracing::info!(job = id, request = request_id, attempt = attempts, "job started"),
            step => tracing::info!(job = id, request = request_id, ?step, "step of a job started"),
        }
        Ok(Some((lease, task)))
    }

    /// How long a lease is, in milliseconds. It is extended when half of it is over, so a worker that ended is missed after
    /// this time at most, and one that is slow for half of it loses nothing.
    fn lease(&self) -> Time {
        self.settings.lease.as_millis().try_into().unwrap_or(Time::MAX)
    }

    /// How often leases, and what waits, are looked at, whoever tells of changes.
    fn look(&self) -> Duration {
        LOOK.min(self.settings.lease / 4)
    }

    /// Extends the leases of which half is over. Work at a job whose lease is another's is stopped.
    fn renew(&self, running: &mut Running, now: Time) -> Result<(), StoreError> {
        let half_over = now.saturating_add(self.lease() / 2);
        self.renew_those(running, now, |lease| lease.until <= half_over)
    }

    /// Extends some leases.
    fn renew_those(
        &self,
        running: &mut Running,
        now: Time,
        which: impl Fn(&Lease) -> bool,
    ) -> Result<(), StoreError> {
        let until = now.saturating_add(self.lease());
        let mut taken = Vec::new();
        for (key @ (id, _), Run { lease, task }) in &mut running.tasks {
            if !which(lease) {
                continue;
            }
            if self.store.beat(lease, until)? {
                lease.until = until;
            } else {
                tracing::warn!(job = id, "the lease of a job is another's");
                task.cancel();
                taken.push(key.clone());
            }
        }
        taken.iter().for_each(|key| drop(running.tasks.remove(key)));
        Ok(())
    }

    /// Extends leases, and forgets jobs when their time has come, on a thread of its own, since all others may be at
    /// work for long.
    fn keep_up(&self) {
        let mut collected = Instant::now();
        let mut running = self.lock();
        while !running.stopping {
            if let Err(error) = self.renew(&mut running, self.now()) {
                self.beats_failed.fetch_add(1, Ordering::Relaxed);
                tracing::error!(%error, "leases of jobs cannot be extended");
            }
            drop(running);
            let more = self.expire();
            if let Keeping::Shared { process, .. } = &self.settings.keeping {
                // Whoever only takes jobs keeps no other from doing them.
                if self.settings.running > 0 {
                    self.attend(process);
                }
                if collected.elapsed() > COLLECT {
                    collected = Instant::now();
                    self.collect();
                }
            }
            running = self.lock();
            if !more && !running.stopping {
                let wait = self.look().min(self.settings.expiry.max(PAUSE));
                running = self.stopped.wait_timeout(running, wait).unwrap_or_else(PoisonError::into_inner).0;
            }
        }
    }

    /// Says that this process is there.
    fn attend(&self, process: &str) {
        match self.store.attend(process, self.now()) {
            Ok(taken) => taken.iter().for_each(|id| {
                tracing::warn!(job = id, "a job of a version or model that nobody runs any more begins anew");
            }),
            Err(error) => tracing::error!(%error, "nobody can be told that this process is there"),
        }
    }

    fn collect(&self) {
        let collected =
            SystemTime::now().checked_sub(COLLECT).map_or(Ok(()), |time| self.store.collect(time));
        if let Err(error) = collected {
            tracing::error!(%error, "leftovers of jobs cannot be removed");
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

    /// Does a step and keeps what came of it; says how it ended, and whether the thread should wait before it tries the next.
    fn run(&self, lease: &Lease, task: &Task, work: &dyn Work) -> (How, bool) {
        let id = &lease.record.id;
        // A panic is a bug in one job; it must not take the thread, and all other jobs, with it.
        let ended = std::panic::catch_unwind(AssertUnwindSafe(|| self.attempt(lease, task, work)));
        let ended = ended.unwrap_or(Err(Stopped::Crashed));
        if ended.is_err() {
            // What is left goes with the job.
            let _ = self.store.discard(lease);
        }
        // Against `stop` and `delete`, which may just now be at it.
        let mut running = self.lock();
        // Under the same lock as the state: once it is put back, another thread may start it anew.
        let key = (id.clone(), lease.step);
        if running.tasks.get(&key).is_some_and(|run| run.lease.attempt == lease.attempt) {
            running.tasks.remove(&key);
        }
        let kept = match ended {
            Err(_) if task.cancelled() => Ok(How::Lost),
            Err(stopped) => match self.stop_at(lease, stopped) {
                Ok(Some(failure)) => {
                    // The job is over: what others do of it is of no use.
                    running.of(id).for_each(|run| run.task.cancel());
                    self.fail(lease, &failure)
                }
                Ok(None) => Ok(How::Later),
                Err(error) => Err(error),
            },
            Ok(ended) => self.keep(lease, &ended),
        };
        match kept {
            Ok(how) => (how, how == How::Later),
            Err(error) => {
                lose(running, lease, &error);
                (How::Lost, true)
            }
        }
    }

    /// Does a step.
    fn attempt(&self, lease: &Lease, task: &Task, work: &dyn Work) -> Result<Ended, Stopped> {
        let (job, place) = (&lease.record, self.store.place(lease));
        if let Step::Tile(tile) = lease.step {
            return work.tile(job, tile, &place, task).map(Ended::Tile);
        }
        let input = self.store.input(&job.id)?;
        let mut sink = self.store.result_writer(lease)?;
        let mut checked = Checked { sink: &mut sink, task };
        let about = match lease.step {
            Step::Join => {
                let names = self.store.parts(&job.id).map_err(io::Error::other)?;
                let parts = Parts { input, names: names.into_iter().map(|(_, name)| name).collect() };
                work.join(job, parts, &place, task, &mut checked)?
            }
            _ => match work.begin(job, input, &place, task, &mut checked)? {
                Begun::Done(about) => about,
                Begun::Split { sizes, bytes } => return Ok(Ended::Split { sizes, bytes }),
            },
        };
        Ok(Ended::Result(sink.finish(about)?))
    }

    /// Keeps what came of a step.
    fn keep(&self, lease: &Lease, ended: &Ended) -> Result<How, StoreError> {
        let Record { id, request_id, .. } = &lease.record;
        let kept = match ended {
            Ended::Result(result) => self.store.done(lease, result, self.now())?,
            Ended::Split { sizes, bytes } => self.store.split(lease, sizes, *bytes)?,
            Ended::Tile(points) => self.store.tile_done(lease, *points)?,
        };
        if !kept {
            return Ok(How::Lost);
        }
        match ended {
            Ended::Result(result) => {
                tracing::info!(job = id, request = request_id, bytes = result.bytes, "job done");
            }
            Ended::Split { sizes, .. } => {
                tracing::info!(job = id, request = request_id, tiles = sizes.len(), "job planned");
                self.queued.notify_all();
            }
            Ended::Tile(points) => {
                tracing::info!(job = id, request = request_id, step = ?lease.step, points, "tile done");
                self.queued.notify_one();
            }
        }
        Ok(How::Done)
    }

    /// Whether this process may not use what others may: that says nothing of the job.
    fn is_barred(&self, error: &io::Error) -> bool {
        self.settings.folder().is_none() && error.kind() == io::ErrorKind::PermissionDenied
    }

    /// A step has no result: what its job fails of, or none where it waits again.
    fn stop_at(&self, lease: &Lease, stopped: Stopped) -> Result<Option<Failure>, StoreError> {
        let id = &lease.record.id;
        Ok(Some(match stopped {
            Stopped::Later | Stopped::Cancelled => return self.store.defer(lease).map(|_| None),
            Stopped::Storage(error) if passes(&error) || self.is_barred(&error) => {
                tracing::warn!(job = id, %error, "a job is tried again later");
                return self.store.defer(lease).map(|_| None);
            }
            Stopped::Differs => {
                tracing::warn!(job = id, "the tiles of a job are planned anew: they are another version's");
                return self.store.unsplit(lease).map(|_| None);
            }
            Stopped::Refused(why) => Failure::Refused(why),
            Stopped::Crashed => Failure::Crashed,
            Stopped::Storage(error) => {
                tracing::error!(job = id, %error, "a job's file cannot be read or written");
                let full = StoreError::from(io::Error::from(error.kind())).is_full();
                Failure::Storage { why: error.to_string(), full }
            }
        }))
    }

    fn fail(&self, lease: &Lease, failure: &Failure) -> Result<How, StoreError> {
        if !self.store.failed(lease, failure, self.now())? {
            return Ok(How::Lost);
        }
        let Record { id, request_id, .. } = &lease.record;
        tracing::info!(job = id, request = request_id, ?failure, "job failed");
        Ok(How::Failed)
    }
}

/// The database could not be written: the job is put back as soon as that works, or at the next start.
fn lose(mut running: MutexGuard<'_, Running>, lease: &Lease, error: &StoreError) {
    tracing::error!(job = lease.record.id, %error, "a job's state cannot be kept");
    running.lost.push(lease.clone());
}
