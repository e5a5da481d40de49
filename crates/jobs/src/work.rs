//! What jobs are about, and one job while it runs.

use std::io::{self, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use densecloud_blobs::BlobReader;
use densecloud_engine::{EngineError, Outcome, Progress, ProgressHandle};

use crate::record::Record;
use crate::records::Step;
use crate::store::Place;

/// What jobs are about.
pub trait Work: Send + Sync + 'static {
    /// Computes a job's result from the cloud in `input`, writes it into `sink`, and gives what is to be told of
    /// it; or plans tiles of it, and puts the plan into its [own place](Place::own). Blocks.
    ///
    /// # Errors
    /// Why there is neither.
    fn begin(
        &self,
        job: &Record,
        input: Box<dyn BlobReader>,
        place: &Place,
        task: &Task,
        sink: &mut dyn Write,
    ) -> Result<Begun, Stopped>;

    /// Works on one tile of a job by its [plan](Place::plan), puts its part into its [own place](Place::own), and gives the
    /// part's points. The task's progress is that of the job. Blocks.
    ///
    /// # Errors
    /// Why there is no part.
    fn tile(&self, job: &Record, tile: u32, place: &Place, task: &Task) -> Result<u64, Stopped>;

    /// Computes a job's result from the parts of all its tiles, as [`Work::begin`] does.
    ///
    /// # Errors
    /// Why there is none.
    fn join(
        &self,
        job: &Record,
        parts: Parts,
        place: &Place,
        task: &Task,
        sink: &mut dyn Write,
    ) -> Result<String, Stopped>;

    /// Hears of a step that ended here: how, and after how long.
    fn ended(&self, _step: Step, _how: How, _took: Duration) {}
}

/// How a step ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum How {
    /// It is done.
    Done,
    /// Its job has failed of it.
    Failed,
    /// It waits again.
    Later,
    /// It is another's, or its job is over.
    Lost,
}

impl How {
    /// All.
    pub const ALL: [Self; 4] = [Self::Done, Self::Failed, Self::Later, Self::Lost];

    /// Its name in metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Later => "later",
            Self::Lost => "lost",
        }
    }
}

/// What the parts of all tiles are joined from.
pub struct Parts {
    /// The job's cloud.
    pub input: Box<dyn BlobReader>,
    /// What the names of each part's blobs begin with, in the order of the tiles.
    pub names: Vec<String>,
}

/// What became of a job that was begun.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Begun {
    /// Its result is written, and this is to be told of it.
    Done(String),
    /// It is to be done in tiles.
    Split {
        /// Points of the result that each tile gives.
        sizes: Vec<u64>,
        /// Bytes that the plan takes, with the parts that will be made by it.
        bytes: u64,
    },
}

/// Why a job that was started has no result.
#[derive(Debug)]
#[non_exhaustive]
pub enum Stopped {
    /// It never will.
    Refused(String),
    /// There is no room for it at the moment.
    Later,
    /// It was cancelled.
    Cancelled,
    /// Its tiles are planned as this program does not work on them; it has to be begun anew.
    Differs,
    /// A bug.
    Crashed,
    /// Its cloud cannot be read, or its result not written.
    Storage(io::Error),
}

/// Whether a failure says nothing of the file: no descriptor was left, or no memory, or a signal came; or the store does
/// not answer. What runs beside will be over some time, and the store be back.
pub(crate) fn passes(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, OutOfMemory};
    // ENFILE and EMFILE, on every Unix, have no kind of their own.
    let descriptors = cfg!(unix) && matches!(error.raw_os_error(), Some(23 | 24));
    descriptors || matches!(error.kind(), OutOfMemory | Interrupted) || is_away(error)
}

/// Whether what keeps files does not answer.
pub(crate) fn is_away(error: &io::Error) -> bool {
    use io::ErrorKind as Kind;
    matches!(
        error.kind(),
        Kind::TimedOut
            | Kind::NotConnected
            | Kind::ConnectionRefused
            | Kind::ConnectionReset
            | Kind::ConnectionAborted
            | Kind::HostUnreachable
            | Kind::NetworkUnreachable
            | Kind::NetworkDown
            | Kind::ResourceBusy
    )
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
    /// What the progress of a part is for the whole.
    whole: Option<Box<Whole>>,
}

/// What the progress of a part is for the whole.
type Whole = dyn Fn(Progress) -> Progress + Send;

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
    pub fn wait<T: Send + 'static>(
        &self,
        job: densecloud_engine::Pending<T>,
    ) -> Result<Outcome<T>, EngineError> {
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

    /// From now on, what it waits for is a part of its work, whose progress is this for the whole.
    pub fn part(&self, whole: impl Fn(Progress) -> Progress + Send + 'static) {
        let mut state = self.lock();
        // The last part's is over.
        state.handle = None;
        state.whole = Some(Box::new(whole));
    }

    pub(crate) fn cancel(&self) {
        let mut state = self.lock();
        state.cancelled = true;
        if let Some(handle) = &state.handle {
            handle.cancel();
        }
    }

    /// How far it is; none while it is read or waits for the engine. Waits for nothing but a moment.
    pub fn progress(&self) -> Option<Progress> {
        let state = self.lock();
        let whole = |progress| state.whole.as_ref().map_or(progress, |whole| whole(progress));
        state.handle.as_ref().map(ProgressHandle::progress).map(whole)
    }
}

/// A result that takes no more once its job is cancelled.
pub(crate) struct Checked<'a> {
    pub(crate) sink: &'a mut dyn Write,
    pub(crate) task: &'a Task,
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
