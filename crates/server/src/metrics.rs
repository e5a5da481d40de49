//! What `/metrics` tells, in Prometheus' text format.
//!
//! Each server has its own recorder, held here, instead of the process-wide one of the `metrics`
//! macros: several servers in one process (tests, for one) do not mix their figures.

mod jobs;

use std::time::Duration;

use metrics::{Counter, Gauge, Histogram, Key, Label, Level, Metadata, Recorder, Unit};
use metrics_exporter_prometheus::{BuildError, PrometheusBuilder, PrometheusHandle, PrometheusRecorder};
use metrics_process::Collector;

use crate::config::{Config, ModelInfo};
use densecloud_engine::Engine;

/// The figures of one server. All names, in one place.
pub(super) struct Metrics {
    recorder: PrometheusRecorder,
    handle: PrometheusHandle,
    duration: [Histogram; Interface::ALL.len()],
    points_in: Counter,
    points_out: Counter,
    in_flight: Gauge,
    event_streams: Gauge,
    queue_points: Gauge,
    backlog: Gauge,
    memory: Gauge,
    held_bytes: Gauge,
    admitted: Counter,
    estimated: Histogram,
    worked: Histogram,
    lines_lost: Counter,
    /// Of the file of keys, read and not.
    reloads: [Counter; 2],
    /// What every process tells, under the names that every one tells it.
    process: Collector,
}

const REQUESTS: &str = "densecloud_requests_total";
const DURATION: &str = "densecloud_request_duration_seconds";
const STAGE: &str = "densecloud_stage_duration_seconds";
const POINTS_IN: &str = "densecloud_points_in_total";
const POINTS_OUT: &str = "densecloud_points_out_total";
const IN_FLIGHT: &str = "densecloud_requests_in_flight";
const EVENT_STREAMS: &str = "densecloud_event_streams";
const QUEUE: &str = "densecloud_queue_points";
const BACKLOG: &str = "densecloud_backlog_seconds";
const MEMORY: &str = "densecloud_work_memory_bytes";
const ADMITTED: &str = "densecloud_admitted_total";
const REFUSED: &str = "densecloud_refused_total";
const ESTIMATED: &str = "densecloud_work_estimated_seconds";
const WORKED: &str = "densecloud_work_seconds";
const HELD: &str = "densecloud_held_bytes";
const MODEL: &str = "densecloud_model_info";
const BUILD: &str = "densecloud_build_info";
const LINES_LOST: &str = "densecloud_log_lines_lost_total";
const RELOADS: &str = "densecloud_keys_reloads_total";
/// As the crate for figures of the process has it: with fractions it is a gauge there, which it never is.
const CPU_TYPE: [&str; 2] =
    ["# TYPE process_cpu_seconds_total gauge\n", "# TYPE process_cpu_seconds_total counter\n"];

/// Why requests are mostly refused.
const REASONS: [&str; 8] = [
    "client-share",
    "client-time",
    "queue-full",
    "queue-long",
    "too-late",
    "too-big-for-memory",
    "client-jobs",
    "jobs-full",
];

/// Outcomes whose first must be seen as a change, from none: what alerts ask for.
const FROM_THE_START: [&str; 9] = [
    "ok",
    "internal",
    "failed",
    "deadline",
    "disk-full",
    "job-disk-full",
    "queue-full",
    "queue-long",
    "memory-full",
];

/// From a small cloud's milliseconds to a large one's ten minutes.
const BUCKETS: [f64; 14] =
    [0.001, 0.005, 0.01, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 15.0, 60.0, 180.0, 600.0];

static METADATA: Metadata<'static> = Metadata::new(module_path!(), Level::INFO, Some(module_path!()));

/// The door by which a request came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Interface {
    Http,
    Grpc,
}

impl Interface {
    const ALL: [Self; 2] = [Self::Http, Self::Grpc];

    fn label(self) -> Label {
        let name = match self {
            Self::Http => "http",
            Self::Grpc => "grpc",
        };
        Label::from_static_parts("interface", name)
    }
}

impl Metrics {
    /// Registers everything, so that each series is there from the start.
    ///
    /// # Errors
    /// When the exporter refuses the buckets.
    pub(super) fn new(model: &ModelInfo) -> Result<Self, BuildError> {
        let recorder = PrometheusBuilder::new().set_buckets(&BUCKETS)?.build_recorder();
        for (name, unit, text) in [
            (REQUESTS, None, "Requests answered, by interface and outcome; cancelled: the client left"),
            (POINTS_IN, None, "Points read from the clouds of answered requests"),
            (POINTS_OUT, None, "Points in the results of answered requests"),
            (ADMITTED, None, "Requests for which points of the queue were taken"),
            (REFUSED, None, "Requests for which none were, by the end of the problem's type"),
            (LINES_LOST, None, "Lines of the log that could not be written, or found no room"),
            (RELOADS, None, "Times that the file of keys was read again (ok), or could not be (failed)"),
        ] {
            recorder.describe_counter(name.into(), unit, text.into());
        }
        for (name, unit, text) in [
            (
                DURATION,
                Unit::Seconds,
                "From a request's head to the last byte of its response; not of events",
            ),
            (ESTIMATED, Unit::Seconds, "What finished work was expected to take, alone on the machine"),
            (WORKED, Unit::Seconds, "What it took, without the time that other work had"),
            (STAGE, Unit::Seconds, "Work on one request, by stage; upload includes waiting for the client"),
        ] {
            recorder.describe_histogram(name.into(), Some(unit), text.into());
        }
        for (name, unit, text) in [
            (IN_FLIGHT, None, "Requests whose response is not over"),
            (EVENT_STREAMS, None, "Streams of a job's events that are open"),
            (QUEUE, None, "Points reserved, queued or being worked on"),
            (BACKLOG, Some(Unit::Seconds), "How long all that is admitted will take"),
            (MEMORY, Some(Unit::Bytes), "Memory that the work at hand takes, as estimated"),
            (HELD, Some(Unit::Bytes), "Uploads not yet parsed and results not yet sent"),
            (MODEL, None, "The model that answers; always 1"),
            (BUILD, None, "The program; always 1"),
        ] {
            recorder.describe_gauge(name.into(), unit, text.into());
        }
        jobs::describe(&recorder);
        let metrics = Self {
            handle: recorder.handle(),
            duration: Interface::ALL.map(|interface| {
                recorder.register_histogram(&Key::from_parts(DURATION, vec![interface.label()]), &METADATA)
            }),
            points_in: recorder.register_counter(&Key::from_static_name(POINTS_IN), &METADATA),
            points_out: recorder.register_counter(&Key::from_static_name(POINTS_OUT), &METADATA),
            in_flight: recorder.register_gauge(&Key::from_static_name(IN_FLIGHT), &METADATA),
            event_streams: recorder.register_gauge(&Key::from_static_name(EVENT_STREAMS), &METADATA),
            queue_points: recorder.register_gauge(&Key::from_static_name(QUEUE), &METADATA),
            backlog: recorder.register_gauge(&Key::from_static_name(BACKLOG), &METADATA),
            memory: recorder.register_gauge(&Key::from_static_name(MEMORY), &METADATA),
            admitted: recorder.register_counter(&Key::from_static_name(ADMITTED), &METADATA),
            estimated: recorder.register_histogram(&Key::from_static_name(ESTIMATED), &METADATA),
            worked: recorder.register_histogram(&Key::from_static_name(WORKED), &METADATA),
            held_bytes: recorder.register_gauge(&Key::from_static_name(HELD), &METADATA),
            lines_lost: recorder.register_counter(&Key::from_static_name(LINES_LOST), &METADATA),
            reloads: ["ok", "failed"].map(|outcome| {
                let outcome = Label::from_static_parts("outcome", outcome);
                recorder.register_counter(&Key::from_parts(RELOADS, vec![outcome]), &METADATA)
            }),
            process: Collector::default(),
            recorder,
        };
        for reason in REASONS {
            metrics.refusals(reason).increment(0);
        }
        for interface in Interface::ALL {
            for outcome in FROM_THE_START {
                metrics.requests(interface, outcome).increment(0);
            }
        }
        metrics.steps_from_the_start();
        metrics::with_local_recorder(&metrics.recorder, || metrics.process.describe());
        let labels = vec![
            Label::new("model", model.name.name.clone()),
            Label::new("sha256", model.name.sha256.clone()),
            Label::new("provider", model.provider.clone()),
        ];
        metrics.recorder.register_gauge(&Key::from_parts(MODEL, labels), &METADATA).set(1.0);
        let labels = vec![
            Label::from_static_parts("version", env!("CARGO_PKG_VERSION")),
            Label::new("model", model.name.name.clone()),
        ];
        metrics.recorder.register_gauge(&Key::from_parts(BUILD, labels), &METADATA).set(1.0);
        Ok(metrics)
    }

    /// A request has arrived.
    pub(super) fn begun(&self) {
        self.in_flight.increment(1.0);
    }

    /// Its response is over. `outcome` comes from a fixed set: `ok`, `cancelled`, `failed`, or the
    /// name of a problem.
    pub(super) fn ended(&self, interface: Interface, outcome: &'static str, took: Duration) {
        self.in_flight.decrement(1.0);
        self.requests(interface, outcome).increment(1);
        self.duration[interface as usize].record(took);
    }

    /// A response is a stream of events, and so goes on for as long as what it tells of.
    pub(super) fn events_begun(&self) {
        self.event_streams.increment(1.0);
    }

    /// It is over. Counted as any request; how long it took says nothing of how fast requests are answered.
    pub(super) fn events_ended(&self, interface: Interface, outcome: &'static str) {
        self.event_streams.decrement(1.0);
        self.in_flight.decrement(1.0);
        self.requests(interface, outcome).increment(1);
    }

    /// One stage of one request.
    pub(super) fn stage(&self, stage: &'static str, took: Duration) {
        let key = Key::from_parts(STAGE, vec![Label::from_static_parts("stage", stage)]);
        self.recorder.register_histogram(&key, &METADATA).record(took);
    }

    /// A result is complete.
    pub(super) fn points(&self, points_in: u64, points_out: u64) {
        self.points_in.increment(points_in);
        self.points_out.increment(points_out);
    }

    /// Points of the queue were taken for a request.
    pub(super) fn admitted(&self) {
        self.admitted.increment(1);
    }

    /// None were, because of a problem of this name.
    pub(super) fn refused(&self, reason: &'static str) {
        self.refusals(reason).increment(1);
    }

    fn refusals(&self, reason: &'static str) -> Counter {
        let key = Key::from_parts(REFUSED, vec![Label::from_static_parts("reason", reason)]);
        self.recorder.register_counter(&key, &METADATA)
    }

    /// Work is done that was estimated to take so long, and took so long.
    pub(super) fn worked(&self, estimate: Duration, took: Duration) {
        self.estimated.record(estimate);
        self.worked.record(took);
    }

    /// The page, with what the engine and the requests hold at the moment.
    pub(super) fn render(&self, engine: &Engine, config: &Config, held_bytes: u64) -> String {
        self.queue_points.set(engine.queued_points() as f64);
        self.backlog.set(engine.backlog().as_secs_f64());
        self.memory.set(engine.memory() as f64);
        self.held_bytes.set(held_bytes as f64);
        self.lines_lost.absolute(config.lines_lost.count());
        let reloads = config.access.keys.as_ref().map_or([0, 0], |keys| keys.reloads());
        for (counter, count) in self.reloads.iter().zip(reloads) {
            counter.absolute(count);
        }
        metrics::with_local_recorder(&self.recorder, || self.process.collect());
        let [gauge, counter] = CPU_TYPE;
        self.handle.render().replacen(gauge, counter, 1)
    }

    /// Folds recorded durations into their buckets; without it they pile up until the next
    /// [`Metrics::render`], which may never come.
    pub(super) fn fold(&self) {
        self.handle.run_upkeep();
    }

    fn requests(&self, interface: Interface, outcome: &'static str) -> Counter {
        let labels = vec![interface.label(), Label::from_static_parts("outcome", outcome)];
        self.recorder.register_counter(&Key::from_parts(REQUESTS, labels), &METADATA)
    }
}

impl std::fmt::Debug for Metrics {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Metrics").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_backends::ModelName;
    use densecloud_cascade::Fake;
    use densecloud_engine::EngineConfig;
    use densecloud_jobs::{How, State, Step, Waiting};

    fn idle() -> Engine {
        Engine::with_backend(std::sync::Arc::new(Fake::new()), EngineConfig::default()).expect("an engine")
    }

    #[test]
    fn what_alerts_ask_for_is_there_before_it_happens() {
        let alerts = include_str!("../../../deploy/alerts.yml");
        let asked: Vec<_> = alerts
            .split("outcome=")
            .skip(1)
            .flat_map(|rest| rest.split('"').nth(1).unwrap_or_default().split('|'))
            .collect();
        assert!(asked.len() > 5, "{asked:?}");
        for outcome in asked {
            let of_steps = How::ALL.iter().any(|how| how.name() == outcome);
            assert!(FROM_THE_START.contains(&outcome) || of_steps, "{outcome}");
        }
    }

    #[test]
    fn the_page_has_every_series_from_the_start_and_counts_what_happens() {
        let model = ModelInfo {
            name: ModelName { name: "default".into(), sha256: "ab12".into() },
            provider: "cpu".into(),
        };
        let metrics = Metrics::new(&model).expect("metrics");
        let page = metrics.render(&idle(), &Config::default(), 0);
        for line in [
            "densecloud_requests_total{interface=\"http\",outcome=\"ok\"} 0",
            "densecloud_requests_total{interface=\"grpc\",outcome=\"ok\"} 0",
            "densecloud_points_in_total 0",
            "densecloud_queue_points 0",
            "# TYPE process_resident_memory_bytes gauge",
            "# TYPE process_cpu_seconds_total counter",
            "densecloud_model_info{model=\"default\",sha256=\"ab12\",provider=\"cpu\"} 1",
            concat!("densecloud_build_info{version=\"", env!("CARGO_PKG_VERSION"), "\",model=\"default\"} 1"),
            "densecloud_log_lines_lost_total 0",
            "densecloud_keys_reloads_total{outcome=\"failed\"} 0",
            "densecloud_event_streams 0",
            "densecloud_steps_total{step=\"tile\",outcome=\"lost\"} 0",
        ] {
            assert!(page.lines().any(|l| l == line), "{line} is missing in\n{page}");
        }
        metrics.begun();
        metrics.begun();
        metrics.ended(Interface::Http, "ok", Duration::from_millis(20));
        metrics.begun();
        metrics.ended(Interface::Grpc, "ok", Duration::from_millis(20));
        metrics.stage("units", Duration::from_secs(2));
        metrics.points(10, 40);
        metrics.admitted();
        metrics.refused("queue-full");
        metrics.worked(Duration::from_millis(1), Duration::from_millis(2));
        for _ in 0..2 {
            metrics.begun();
            metrics.events_begun();
        }
        metrics.events_ended(Interface::Http, "cancelled");
        let config = Config::default();
        config.lines_lost.add();
        let page = metrics.render(&idle(), &config, 99);
        for line in [
            "densecloud_requests_total{interface=\"http\",outcome=\"ok\"} 1",
            "densecloud_requests_total{interface=\"grpc\",outcome=\"ok\"} 1",
            "densecloud_request_duration_seconds_bucket{interface=\"http\",le=\"0.01\"} 0",
            "densecloud_request_duration_seconds_bucket{interface=\"http\",le=\"0.05\"} 1",
            "densecloud_stage_duration_seconds_count{stage=\"units\"} 1",
            "densecloud_request_duration_seconds_count{interface=\"http\"} 1",
            "densecloud_requests_total{interface=\"http\",outcome=\"cancelled\"} 1",
            "densecloud_event_streams 1",
            "densecloud_log_lines_lost_total 1",
            "densecloud_requests_in_flight 2",
            "densecloud_points_in_total 10",
            "densecloud_points_out_total 40",
            "densecloud_refused_total{reason=\"queue-full\"} 1",
            "densecloud_admitted_total 1",
            "densecloud_work_seconds_sum 0.002",
            "densecloud_held_bytes 99",
        ] {
            assert!(page.lines().any(|l| l == line), "{line} is missing in\n{page}");
        }
    }

    #[test]
    fn the_manual_names_every_series() {
        let manual = include_str!("../../../docs/http.md");
        let metrics = Metrics::new(&ModelInfo::default()).expect("metrics");
        metrics.ended(Interface::Http, "ok", Duration::ZERO);
        metrics.stage("units", Duration::ZERO);
        metrics.jobs(&[(State::Queued, 1)], &Waiting::default(), 0);
        metrics.step(Step::Join, How::Done, Duration::ZERO);
        metrics.fleet(0, [0, 0]);
        metrics.refused("queue-full");
        metrics.worked(Duration::ZERO, Duration::ZERO);
        let page = metrics.render(&idle(), &Config::default(), 0);
        let names: Vec<_> = page
            .lines()
            .filter(|line| line.contains(" densecloud_"))
            .filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next())
            .collect();
        assert_eq!(names.len(), 27, "{names:?}");
        for name in names {
            assert!(manual.contains(&format!("`{name}`")), "{name} is not in the manual");
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn processor_time_has_fractions() {
        let metrics = Metrics::new(&ModelInfo::default()).expect("metrics");
        let engine = idle();
        // Of some hundred hundredths, one is no whole second.
        let fraction = (0..1_000_000).any(|_| {
            let page = metrics.render(&engine, &Config::default(), 0);
            let value = page.lines().find_map(|line| line.strip_prefix("process_cpu_seconds_total "));
            value.expect("a value").parse::<f64>().expect("a number").fract() > 0.0
        });
        assert!(fraction);
    }

    #[test]
    fn two_servers_do_not_mix_their_figures() {
        let one = Metrics::new(&ModelInfo::default()).expect("metrics");
        let other = Metrics::new(&ModelInfo::default()).expect("metrics");
        one.points(1, 2);
        assert!(one.render(&idle(), &Config::default(), 0).contains("densecloud_points_in_total 1"));
        assert!(other.render(&idle(), &Config::default(), 0).contains("densecloud_points_in_total 0"));
    }
}
