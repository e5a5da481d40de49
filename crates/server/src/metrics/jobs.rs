//! Figures of jobs, and of the programs that share them.

use std::time::Duration;

use metrics::{Counter, Gauge, Key, Label, Recorder, Unit};
use metrics_exporter_prometheus::PrometheusRecorder;

use super::{METADATA, Metrics};
use densecloud_jobs::{How, State, Step, Time, Waiting};

const JOBS: &str = "densecloud_jobs";
const STEPS_WAITING: &str = "densecloud_steps_waiting";
const OLDEST: &str = "densecloud_oldest_wait_seconds";
const WORKERS: &str = "densecloud_workers";
const STEP: &str = "densecloud_step_seconds";
const STEPS: &str = "densecloud_steps_total";
const BEATS: &str = "densecloud_beats_failed_total";
const STORE_BYTES: &str = "densecloud_store_bytes_total";

/// Says what each is.
pub(super) fn describe(recorder: &PrometheusRecorder) {
    for (name, unit, text) in [
        (JOBS, None, "Jobs that are kept, by state"),
        (STEPS_WAITING, None, "Steps of jobs that wait for a worker"),
        (OLDEST, Some(Unit::Seconds), "How long ago the oldest job came that waits to be begun"),
        (WORKERS, None, "Processes that work on the jobs and were seen of late"),
    ] {
        recorder.describe_gauge(name.into(), unit, text.into());
    }
    for (name, unit, text) in [
        (STEPS, None, "Steps of jobs that ended here; lost: another has them, or the job was over"),
        (BEATS, None, "Times that leases on steps could not be extended"),
        (STORE_BYTES, Some(Unit::Bytes), "Clouds, tiles and results read from and written to the store"),
    ] {
        recorder.describe_counter(name.into(), unit, text.into());
    }
    let text = "From the beginning of a step of a job to its end";
    recorder.describe_histogram(STEP.into(), Some(Unit::Seconds), text.into());
}

impl Metrics {
    /// How many jobs are kept in each state, and what waits of them at this time.
    pub(crate) fn jobs(&self, counts: &[(State, u64)], waiting: &Waiting, now: Time) {
        for (state, count) in counts {
            self.gauge(JOBS, ("state", state.name())).set(*count as f64);
        }
        let Waiting { whole, tiles, joins, oldest, processes } = *waiting;
        for (step, count) in [(Step::Whole, whole), (Step::Tile(0), tiles), (Step::Join, joins)] {
            self.gauge(STEPS_WAITING, ("step", step.name())).set(count as f64);
        }
        let waits = oldest.map_or(0, |oldest| now.saturating_sub(oldest).max(0));
        self.recorder.register_gauge(&Key::from_static_name(OLDEST), &METADATA).set(waits as f64 / 1000.0);
        self.recorder.register_gauge(&Key::from_static_name(WORKERS), &METADATA).set(processes as f64);
    }

    fn gauge(&self, name: &'static str, (label, value): (&'static str, &'static str)) -> Gauge {
        let key = Key::from_parts(name, vec![Label::from_static_parts(label, value)]);
        self.recorder.register_gauge(&key, &METADATA)
    }

    /// A step of a job ended here.
    pub(crate) fn step(&self, step: Step, how: How, took: Duration) {
        let label = Label::from_static_parts("step", step.name());
        let key = Key::from_parts(STEP, vec![label]);
        self.recorder.register_histogram(&key, &METADATA).record(took);
        self.steps(step, how).increment(1);
    }

    /// The first of each is seen as a change, from none.
    pub(super) fn steps_from_the_start(&self) {
        for step in [Step::Whole, Step::Tile(0), Step::Join] {
            How::ALL.iter().for_each(|how| self.steps(step, *how).increment(0));
        }
    }

    fn steps(&self, step: Step, how: How) -> Counter {
        let labels = vec![
            Label::from_static_parts("step", step.name()),
            Label::from_static_parts("outcome", how.name()),
        ];
        self.recorder.register_counter(&Key::from_parts(STEPS, labels), &METADATA)
    }

    /// What the threads of jobs have come to so far: times that leases could not be extended, and bytes read from and
    /// written to the store.
    pub(crate) fn fleet(&self, beats_failed: u64, [read, written]: [u64; 2]) {
        self.recorder.register_counter(&Key::from_static_name(BEATS), &METADATA).absolute(beats_failed);
        for (direction, bytes) in [("read", read), ("written", written)] {
            let labels = vec![Label::from_static_parts("direction", direction)];
            self.recorder.register_counter(&Key::from_parts(STORE_BYTES, labels), &METADATA).absolute(bytes);
        }
    }
}
