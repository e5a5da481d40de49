//! The steps that threads of this process are at.

use std::collections::HashMap;
use std::sync::Arc;
use std::thread::JoinHandle;

use densecloud_engine::Progress;

use crate::records::{Lease, Step};
use crate::work::Task;

#[derive(Default)]
pub(super) struct Running {
    pub(super) tasks: HashMap<(String, Step), Run>,
    /// Steps whose end could not be written: they run in the records alone.
    pub(super) lost: Vec<Lease>,
    pub(super) threads: Vec<JoinHandle<()>>,
    pub(super) stopping: bool,
}

/// A step that one of the threads works at.
pub(super) struct Run {
    pub(super) lease: Lease,
    pub(super) task: Arc<Task>,
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
    /// The steps of a job.
    pub(super) fn of<'a>(&'a self, id: &'a str) -> impl Iterator<Item = &'a Run> {
        self.tasks.iter().filter(move |((job, _), _)| job == id).map(|(_, run)| run)
    }
}
