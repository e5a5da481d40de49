//! Work on a thread of its own, and a caller who waits for it: hears how far it is, and stops it at a signal.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use densecloud_cascade::{Observer, Stage};
use densecloud_tiles::{Step, Watch};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

/// Between two looks at signals and progress.
const INTERVAL: Duration = Duration::from_millis(50);

/// Of the work on a level, the network's share, about; the stages before it take little, and sampling what is left.
const UNITS: f64 = 0.6;

/// How far a work is, and whether it is to end.
#[derive(Debug, Default)]
pub(crate) struct Progress {
    stopped: AtomicBool,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    /// The sizes after each level.
    sizes: Vec<usize>,
    level: usize,
    /// Of this level, what is done.
    share: f64,
    stage: &'static str,
    /// Whether tiles are still being planned, which runs the cascade on samples.
    is_planning: bool,
    /// Tiles before the one at hand, and all; none where the cloud is worked on as a whole.
    tiles: Option<(u32, u32)>,
}

impl Progress {
    fn stop(&self) {
        self.stopped.store(true, Ordering::Relaxed);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// What is done of all, from 0 to 1, by the points of levels and by tiles.
    fn fraction(&self) -> f64 {
        if self.is_planning {
            return 0.0;
        }
        let all = self.sizes.iter().sum::<usize>().max(1) as f64;
        let before = self.sizes.iter().take(self.level).sum::<usize>() as f64;
        let own = self.sizes.get(self.level).map_or(0.0, |size| *size as f64);
        let (done, of) = self.tiles.unwrap_or((0, 1));
        ((f64::from(done) + (before + self.share * own) / all) / f64::from(of)).clamp(0.0, 1.0)
    }
}

impl Observer for Progress {
    fn plan(&self, sizes: &[usize]) {
        let mut state = self.lock();
        (state.sizes, state.level, state.share) = (sizes.to_vec(), 0, 0.0);
    }

    fn begin(&self, level: usize, stage: Stage) {
        let mut state = self.lock();
        let share = match stage {
            Stage::Seeds | Stage::Patches | Stage::Units => 0.0,
            Stage::Resample => UNITS,
            Stage::Attributes => 1.0,
        };
        (state.level, state.stage, state.share) = (level, stage.name(), share);
    }

    fn advance(&self, done: usize, total: usize) {
        let mut state = self.lock();
        if state.stage == Stage::Units.name() {
            state.share = UNITS * done as f64 / total.max(1) as f64;
        }
    }

    fn cancelled(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }
}

impl Watch for Progress {
    fn step(&self, step: Step) {
        let mut state = self.lock();
        match step {
            Step::Read => (state.is_planning, state.stage) = (true, "read"),
            Step::Cut => (state.is_planning, state.stage) = (true, "cut"),
            Step::Tile { done, of, .. } => {
                *state = State { stage: "tile", tiles: Some((done, of)), ..State::default() };
            }
        }
    }
}

/// Runs `work` while this thread waits without the interpreter, looks at signals, and calls `hear` with what is done, from 0 to 1, and
/// the name of the stage.
///
/// # Errors
/// That of the work; where a signal's handler or `hear` raises something, that, once the work has ended.
pub(crate) fn waited<T: Send>(
    py: Python<'_>,
    hear: Option<&Py<PyAny>>,
    work: impl FnOnce(&Progress) -> PyResult<T> + Send,
) -> PyResult<T> {
    check_process()?;
    let progress = Progress::default();
    py.detach(|| {
        thread::scope(|scope| {
            let (end, ended) = mpsc::channel::<()>();
            let worker = scope.spawn(|| {
                // Dropped as the work ends, also by a panic.
                let _end = end;
                work(&progress)
            });
            let mut raised = None;
            while let Err(RecvTimeoutError::Timeout) = ended.recv_timeout(INTERVAL) {
                raised = raised.or_else(|| Python::attach(|py| look(py, hear, &progress)).err());
                if raised.is_some() {
                    progress.stop();
                }
            }
            let made = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            raised.map_or(made, Err)
        })
    })
}

fn look(py: Python<'_>, hear: Option<&Py<PyAny>>, progress: &Progress) -> PyResult<()> {
    py.check_signals()?;
    let Some(hear) = hear else { return Ok(()) };
    let (fraction, stage) = {
        let state = progress.lock();
        (state.fraction(), state.stage)
    };
    hear.call1(py, (fraction, stage)).map(drop)
}

/// Refuses to work in a process that was forked from one that has: the threads stayed there, and it would wait for ever.
fn check_process() -> PyResult<()> {
    static OWN: AtomicU32 = AtomicU32::new(0);
    let here = std::process::id();
    match OWN.compare_exchange(0, here, Ordering::Relaxed, Ordering::Relaxed) {
        Err(first) if first != here => Err(PyRuntimeError::new_err(
            "densecloud was used before this process was forked, and its threads are not here: start processes by \
             `multiprocessing.get_context(\"spawn\")` or \"forkserver\"",
        )),
        _ => Ok(()),
    }
}
