//! How many inference requests there were and how long they took, as Triton's statistics extension tells it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use serde_json::{Value, json};

use super::{MODEL, Named, VERSION, check_model};
use crate::app::App;
use crate::http::upsample::Done;
use crate::problem::Problem;
use densecloud_cascade::Stage;

/// The figures since the start. A mutex, so that they are of one moment; it is held for some additions.
#[derive(Default)]
pub(crate) struct Statistics(Mutex<Counts>);

#[derive(Default)]
struct Counts {
    /// When the last result was complete, in milliseconds since 1970.
    last: u64,
    success: Total,
    fail: Total,
    queue: Total,
    parse: Total,
    work: Total,
}

/// How often something was, and how long it took in all.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
struct Total {
    count: u64,
    ns: u64,
}

impl Total {
    fn add(&mut self, took: Duration) {
        self.count += 1;
        self.ns = self.ns.saturating_add(took.as_nanos().try_into().unwrap_or(u64::MAX));
    }
}

/// How long the parts of a request took.
pub(super) struct Times {
    queue: Duration,
    parse: Duration,
    work: Duration,
}

impl Times {
    pub(super) fn of(done: &Done) -> Self {
        let work = Stage::ALL.into_iter().map(|stage| done.took(stage.name())).sum();
        Self { queue: done.took("queue"), parse: done.took("parse"), work }
    }
}

/// One request, which failed unless somebody says otherwise before it is dropped: its client may leave.
pub(super) struct Attempt<'a> {
    statistics: &'a Statistics,
    start: Instant,
    over: bool,
}

impl Statistics {
    /// A request for the model has arrived.
    pub(super) fn begin(&self) -> Attempt<'_> {
        Attempt { statistics: self, start: Instant::now(), over: false }
    }

    fn counts(&self) -> MutexGuard<'_, Counts> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// As the extension has it. Nothing is cached, and there are no batches of several requests.
    fn document(&self) -> Value {
        let counts = self.counts();
        let Counts { last, success, fail, queue, parse, work } = &*counts;
        // A result is encoded while it is sent, at its reader's pace, and so as often as there is one, in no time.
        let output = Total { count: success.count, ns: 0 };
        let batches = (success.count > 0).then(|| {
            json!({ "batch_size": 1, "compute_input": parse, "compute_infer": work, "compute_output": output })
        });
        json!({ "model_stats": [{
            "name": MODEL,
            "version": VERSION,
            "last_inference": last,
            "inference_count": success.count,
            "execution_count": success.count,
            "inference_stats": {
                "success": success,
                "fail": fail,
                "queue": queue,
                "compute_input": parse,
                "compute_infer": work,
                "compute_output": output,
                "cache_hit": Total::default(),
                "cache_miss": Total::default(),
            },
            "batch_stats": batches.as_slice(),
        }] })
    }
}

impl Attempt<'_> {
    /// Its answer is there.
    pub(super) fn succeeded(mut self, times: &Times) {
        self.over = true;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let mut counts = self.statistics.counts();
        counts.last = now.as_millis().try_into().unwrap_or(u64::MAX);
        counts.success.add(self.start.elapsed());
        counts.queue.add(times.queue);
        counts.parse.add(times.parse);
        counts.work.add(times.work);
    }
}

impl Drop for Attempt<'_> {
    fn drop(&mut self) {
        if !self.over {
            self.statistics.counts().fail.add(self.start.elapsed());
        }
    }
}

/// `GET /v2/models/stats`.
pub(super) async fn all(State(app): State<Arc<App>>) -> Json<Value> {
    Json(app.statistics.document())
}

/// `GET /v2/models/densecloud/stats`.
pub(super) async fn of_model(State(app): State<Arc<App>>, named: Named) -> Result<Json<Value>, Problem> {
    check_model(&named)?;
    Ok(Json(app.statistics.document()))
}
