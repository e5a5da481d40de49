//! The steps that threads of this process are at.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use densecloud_engine::Progress;

use crate::record::Time;
use crate::records::{Lease, Step};
use crate::work::Task;

/// Ends of jobs that are remembered: more than come while a step is claimed.
const ENDS: usize = 1000;

#[derive(Default)]
pub(super) struct Running {
    tasks: HashMap<(String, Step), Run>,
    /// Steps whose end could not be written: they run in the records alone.
    pub(super) lost: Vec<Lease>,
    pub(super) threads: Vec<JoinHandle<()>>,
    /// The threads are to end.
    pub(super) stopping: bool,
    /// Until then steps are left to others, since there is no room here.
    pub(super) rest: Option<Instant>,
    /// How often something came to wait. Who found nothing before the last time has not looked at all of it.
    pub(super) came: u64,
    /// How often leases came that are to be looked at.
    pub(super) doubts: u64,
    /// Names of jobs of whose ends somebody told, the last ones of all that were told.
    ends: VecDeque<String>,
    pub(super) told: u64,
}

/// A step that one of the threads works at.
pub(super) struct Run {
    pub(super) lease: Lease,
    pub(super) task: Arc<Task>,
    /// The work is done, and its thread alone says what becomes of the step.
    over: bool,
}

/// The steps of a job that threads here are at.
#[derive(Clone, Default)]
pub struct AtWork(pub(super) Vec<Arc<Task>>);

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

impl Running {
    /// How often something came to wait so far; none where the threads are to end.
    pub(super) fn waiting(&self) -> Option<u64> {
        (!self.stopping).then_some(self.came)
    }

    /// How long steps are left to others.
    pub(super) fn rest(&self) -> Duration {
        self.rest.map_or(Duration::ZERO, |end| end.saturating_duration_since(Instant::now()))
    }

    pub(super) fn all(&self) -> impl Iterator<Item = &Run> {
        self.tasks.values()
    }

    /// The steps of a job.
    pub(super) fn of<'a>(&'a self, id: &'a str) -> impl Iterator<Item = &'a Run> {
        self.all().filter(move |run| run.lease.record.id == id)
    }

    /// Those whose work goes on.
    pub(super) fn at_work(&self) -> impl Iterator<Item = &Run> {
        self.all().filter(|run| !run.over)
    }

    /// Adds a step that was claimed after so many ends were told. Its job's may be one of the later ones: then its lease is
    /// to be looked at.
    pub(super) fn begin(&mut self, lease: &Lease, told: u64) -> Arc<Task> {
        let (id, task) = (lease.record.id.clone(), Arc::<Task>::default());
        let mut run = Run { lease: lease.clone(), task: Arc::clone(&task), over: false };
        if self.has_ended_since(told, &id) {
            run.doubt();
            self.doubts += 1;
        }
        self.tasks.insert((id, lease.step), run);
        task
    }

    /// The step that this very lease is on.
    fn find(&mut self, lease: &Lease) -> Option<&mut Run> {
        let run = self.tasks.get_mut(&(lease.record.id.clone(), lease.step))?;
        (run.lease.attempt == lease.attempt).then_some(run)
    }

    /// Its work is over: nobody else cancels it from now on, or says anything of its lease.
    pub(super) fn is_over(&mut self, lease: &Lease) {
        self.find(lease).into_iter().for_each(|run| run.over = true);
    }

    pub(super) fn remove(&mut self, lease: &Lease) {
        if self.find(lease).is_some() {
            self.tasks.remove(&(lease.record.id.clone(), lease.step));
        }
    }

    /// A lease was extended.
    pub(super) fn extend(&mut self, lease: &Lease, until: Time) {
        // Unless there was a reason to doubt it since.
        let same = self.find(lease).filter(|run| run.lease.until == lease.until);
        same.into_iter().for_each(|run| run.lease.until = until);
    }

    /// A lease is another's: whether that is news.
    pub(super) fn give_up(&mut self, lease: &Lease) -> bool {
        let news = self.find(lease).is_some_and(|run| !run.over);
        if news {
            self.tasks
                .remove(&(lease.record.id.clone(), lease.step))
                .into_iter()
                .for_each(|run| run.task.cancel());
        }
        news
    }

    /// Somebody told that a job is over, or waits anew: leases on its steps are to be looked at.
    pub(super) fn doubt(&mut self, id: &str) {
        self.told += 1;
        self.ends.push_back(id.to_owned());
        if self.ends.len() > ENDS {
            self.ends.pop_front();
        }
        for run in self.tasks.values_mut().filter(|run| run.lease.record.id == id) {
            run.doubt();
            self.doubts += 1;
        }
    }

    fn has_ended_since(&self, told: u64, id: &str) -> bool {
        let later = usize::try_from(self.told - told).unwrap_or(usize::MAX);
        later > self.ends.len() || self.ends.iter().rev().take(later).any(|end| end == id)
    }
}

impl Run {
    fn doubt(&mut self) {
        self.lease.until = Time::MIN;
    }
}
