//! Around every request: its id, its line in the log, its place in the metrics.

use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::task::{Context, Poll};
use std::time::Instant;

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;
use hyper::body::{Frame, SizeHint};
use tracing::{Instrument, Span};

use crate::app::App;
use crate::connection::accept::Connection;
use crate::connection::activity::Busy;
use crate::connection::request_id::{self, RequestId};
use crate::metrics::Interface;
use crate::problem::{Problem, inference_error};
use crate::{grpc, inference};

/// Points in and out of an answered request; a handler leaves them on its response for the log.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Points {
    pub(crate) read: u64,
    pub(crate) made: u64,
}

/// Marks a response that begins before its work is done. Only the handler knows when the client is waited for, and
/// tells it through [`Ongoing`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Early;

/// What a handler tells of its request after its response has begun: in gRPC the outcome comes last.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ongoing(Arc<Mutex<HandlerReport>>);

#[derive(Debug, Default)]
struct HandlerReport {
    busy: Option<Busy>,
    points: Option<Points>,
    /// Its outcome and its words.
    problem: Option<(&'static str, String)>,
}

impl Ongoing {
    fn told(&self) -> MutexGuard<'_, HandlerReport> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// From now on it is the client who is waited for.
    pub(crate) fn sending(&self) {
        if let Some(busy) = &self.told().busy {
            busy.sending();
        }
    }

    /// There is a result.
    pub(crate) fn points(&self, points: Points) {
        self.told().points = Some(points);
    }

    /// There is none.
    pub(crate) fn problem(&self, problem: &Problem) {
        if let Problem::Internal(why) = problem {
            tracing::error!(why, "internal failure");
        }
        self.told().problem = Some((problem.outcome(), problem.to_string()));
    }
}

/// The outermost layer. The record it keeps ends with the response's last byte, not its first, and
/// also where the client leaves in between: it is dropped with the handler or with the body.
pub(crate) async fn record(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let id = RequestId::of(request.headers());
    request.extensions_mut().insert(id.clone());
    let connection = request.extensions().get::<Connection>().cloned();
    let peer = connection.as_ref().map(|c| c.peer);
    let span = tracing::info_span!(
        "request", id = id.as_str(), peer = peer.map(tracing::field::display),
        client = tracing::field::Empty, method = %request.method(), path = request.uri().path(),
    );
    let busy = connection.map(|connection| connection.activity.begin());
    let ongoing = Ongoing::default();
    ongoing.told().busy = busy;
    request.extensions_mut().insert(ongoing.clone());
    let is_grpc = grpc::is_call(&request);
    let interface = if is_grpc { Interface::Grpc } else { Interface::Http };
    let mut record = Record::begin(app, request.uri().path(), span.clone(), interface, ongoing);
    let inference = inference::is_path(request.uri().path());
    let bodyless = request.method() == Method::HEAD;
    let mut response = next.run(request).instrument(span).await;
    record.status = Some(response.status());
    record.tells_events(&response);
    record.points = response.extensions_mut().remove();
    let verdict = match response.extensions_mut().remove::<Problem>() {
        None => "ok",
        Some(problem) => {
            if let Problem::Internal(why) = &problem {
                tracing::error!(parent: &record.span, why, "internal failure");
            }
            if is_grpc {
                response = grpc::refusal(&problem, id.as_str());
            } else if inference {
                *response.body_mut() = inference_error(&problem);
                let json = HeaderValue::from_static("application/json");
                response.headers_mut().insert(header::CONTENT_TYPE, json);
            } else {
                *response.body_mut() = problem.body(id.as_str());
            }
            record.why = Some(problem.to_string());
            problem.outcome()
        }
    };
    response.headers_mut().insert(request_id::HEADER, id.header_value());
    if response.extensions_mut().remove::<Early>().is_none() {
        record.ongoing.sending();
    }
    let length = match response.headers().get(header::CONTENT_LENGTH) {
        _ if bodyless => Some(0),
        Some(length) => length.to_str().ok().and_then(|length| length.parse().ok()),
        None => response.body().size_hint().exact(),
    };
    response.map(|body| Body::new(Recorded::new(body, record, verdict, length)))
}

/// One request, until its response is over.
struct Record {
    app: Arc<App>,
    /// Health checks and scrapes: too many, and too dull, to be logged and counted.
    probe: bool,
    /// Whether the answer is a stream of events.
    events: bool,
    start: Instant,
    span: Span,
    interface: Interface,
    ongoing: Ongoing,
    status: Option<StatusCode>,
    points: Option<Points>,
    why: Option<String>,
    outcome: &'static str,
}

impl Record {
    fn begin(app: Arc<App>, path: &str, span: Span, interface: Interface, ongoing: Ongoing) -> Self {
        let probe = matches!(path, "/healthz" | "/readyz" | "/metrics")
            || inference::is_probe(path)
            || grpc::is_probe(path);
        if !probe {
            app.in_flight.send_modify(|count| *count += 1);
            app.metrics.begun();
        }
        Self {
            app,
            probe,
            events: false,
            start: Instant::now(),
            span,
            interface,
            ongoing,
            status: None,
            points: None,
            why: None,
            // Until something else is known.
            outcome: "cancelled",
        }
    }
}

/// The media type of server-sent events.
const EVENTS: &[u8] = b"text/event-stream";

impl Record {
    /// Notes whether the answer is a stream of events.
    fn tells_events(&mut self, response: &Response) {
        let kind = response.headers().get(header::CONTENT_TYPE).map(HeaderValue::as_bytes);
        if !self.probe && kind.is_some_and(|kind| kind.starts_with(EVENTS)) {
            self.events = true;
            self.app.metrics.events_begun();
        }
    }
}

impl Drop for Record {
    fn drop(&mut self) {
        let HandlerReport { busy, points, problem } = std::mem::take(&mut *self.ongoing.told());
        drop(busy);
        if self.probe {
            return;
        }
        self.points = self.points.or(points);
        if let ("ok", Some((outcome, why))) = (self.outcome, problem) {
            (self.outcome, self.why) = (outcome, Some(why));
        }
        let took = self.start.elapsed();
        match self.events {
            true => self.app.metrics.events_ended(self.interface, self.outcome),
            false => self.app.metrics.ended(self.interface, self.outcome, took),
        }
        tracing::info!(
            parent: &self.span, outcome = self.outcome, status = self.status.map(|s| s.as_u16()),
            points_in = self.points.map(|p| p.read), points_out = self.points.map(|p| p.made),
            seconds = took.as_secs_f64(), why = self.why, "request over",
        );
        self.app.in_flight.send_modify(|count| *count -= 1);
    }
}

/// A response's body with its request's record. The content can be taken away from outside: while a reader takes
/// nothing, hyper does not poll the body and would never drop it.
struct Recorded(Arc<Mutex<Option<Sending>>>);

struct Sending {
    body: Body,
    record: Record,
    /// The outcome once everything is sent.
    verdict: &'static str,
    /// Bytes still to come, where known: hyper drops a body of known length without asking it for
    /// its end.
    left: Option<u64>,
}

impl Recorded {
    fn new(body: Body, record: Record, verdict: &'static str, left: Option<u64>) -> Self {
        let mut sending = Sending { body, record, verdict, left };
        sending.sent(0);
        let ongoing = sending.record.ongoing.clone();
        let recorded = Self(Arc::new(Mutex::new(Some(sending))));
        if let Some(busy) = &ongoing.told().busy {
            let slot = Arc::downgrade(&recorded.0);
            busy.ended_by(move || end(&slot));
        }
        recorded
    }

    fn sending(&self) -> MutexGuard<'_, Option<Sending>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Takes the content of a stalled response, and so gives back its memory. The reader gets an error at the next poll.
fn end(slot: &Weak<Mutex<Option<Sending>>>) {
    let Some(slot) = slot.upgrade() else { return };
    let taken = slot.lock().unwrap_or_else(PoisonError::into_inner).take();
    if let Some(mut sending) = taken {
        sending.record.why = Some("the client took nothing of its answer for too long".into());
    }
}

impl Sending {
    fn sent(&mut self, bytes: u64) {
        self.left = self.left.map(|left| left.saturating_sub(bytes));
        if self.left == Some(0) {
            self.record.outcome = self.verdict;
        }
    }
}

impl HttpBody for Recorded {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let mut sending = self.sending();
        match &mut *sending {
            Some(sending) => sending.poll_frame(context),
            None => Poll::Ready(Some(Err(axum::Error::new("the answer was given up")))),
        }
    }

    fn is_end_stream(&self) -> bool {
        self.sending().as_ref().is_some_and(|sending| sending.body.is_end_stream())
    }

    fn size_hint(&self) -> SizeHint {
        self.sending().as_ref().map(|sending| sending.body.size_hint()).unwrap_or_default()
    }
}

impl Sending {
    fn poll_frame(&mut self, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        match &polled {
            Poll::Pending => {
                if let Some(busy) = &self.record.ongoing.told().busy {
                    busy.making();
                }
            }
            Poll::Ready(None) => self.record.outcome = self.verdict,
            Poll::Ready(Some(Err(error))) => {
                self.record.outcome = "failed";
                self.record.why = Some(error.to_string());
            }
            Poll::Ready(Some(Ok(frame))) => {
                let bytes = frame.data_ref().map_or(0, Bytes::len) as u64;
                self.sent(bytes);
                if frame.is_trailers() {
                    // Nothing comes after them, and so nobody asks for it.
                    self.record.outcome = self.verdict;
                }
                if let Some(busy) = &self.record.ongoing.told().busy {
                    busy.piece();
                }
            }
        }
        polled
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::time::Duration;

    use axum::Router;
    use axum::middleware::from_fn_with_state;
    use axum::routing::get;
    use futures::stream;
    use http_body_util::BodyExt;
    use tokio::time::sleep;
    use tower::ServiceExt;

    use super::*;
    use crate::config::Timeouts;
    use crate::connection::activity::Activity;
    use crate::testing;

    /// Longer than a client may stall.
    const LONG: Duration = Duration::from_secs(600);

    /// Two pieces, each of which takes long to be made.
    async fn slow() -> Body {
        Body::from_stream(stream::unfold(0, |made| async move {
            sleep(LONG).await;
            (made < 2).then_some((Ok::<_, Infallible>("piece"), made + 1))
        }))
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_is_not_cut_off_for_what_the_server_is_still_making() {
        let (app, _folder) = testing::app();
        let activity = Activity::default();
        let connection = Connection { peer: ([127, 0, 0, 1], 1).into(), activity: activity.clone() };
        let router = Router::new().route("/", get(slow)).layer(from_fn_with_state(app, record));
        let request = Request::get("/").extension(connection).body(Body::empty()).expect("a request");
        let mut body = router.oneshot(request).await.expect("an answer").into_body();
        let timeouts = Timeouts::default();
        for _ in 0..2 {
            tokio::select! {
                () = activity.silence(&timeouts) => panic!("it has taken all that there was"),
                piece = body.frame() => assert!(piece.is_some_and(|piece| piece.is_ok())),
            }
        }
        let waited = tokio::time::Instant::now();
        activity.silence(&timeouts).await;
        assert_eq!(waited.elapsed().as_secs(), timeouts.stall.as_secs(), "the last is not taken");
    }
}
