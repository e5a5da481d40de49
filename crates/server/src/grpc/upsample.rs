//! The method `Upsample`: one task a call, from its first message to its last.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::http::HeaderMap;
use futures::stream::{self, BoxStream, StreamExt};
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval, timeout};
use tonic::{Request, Response, Status, Streaming};

use super::outgoing::{self, Messages};
use super::start::Start;
use super::{MESSAGE, incoming, tiles};
use crate::admission::deadline::Deadline;
use crate::admission::guess;
use crate::admission::ticket::Ticket;
use crate::app::App;
use crate::connection::record::{Early, Ongoing};
use crate::connection::request_id::RequestId;
use crate::http::asked::{self, Asked, Begun, Following, cost, unread};
use crate::http::upload::Upload;
use crate::problem::Problem;
use crate::proto::upsampler_server::Upsampler;
use crate::proto::{UpsampleRequest, UpsampleResponse};
use densecloud_engine::Client;
use densecloud_formats::Header;

/// How often progress is told.
const TICK: Duration = Duration::from_millis(250);
/// Messages that wait for a slow reader; each is a chunk at most.
const WAITING: usize = 2;

/// The service: calls, each on its own.
pub(super) struct Calls {
    app: Arc<App>,
}

impl Calls {
    pub(super) fn new(app: Arc<App>) -> Self {
        Self { app }
    }
}

/// What a call's task has for its client.
enum Item {
    Message(UpsampleResponse),
    End,
}

#[tonic::async_trait]
impl Upsampler for Calls {
    type UpsampleStream = BoxStream<'static, Result<UpsampleResponse, Status>>;

    /// Starts the call's task. It is a task, and not the response's stream itself, because deadlines must also
    /// fire while the client reads nothing, which is when nobody asks the stream. It ends with the
    /// stream, which is dropped when the client leaves.
    async fn upsample(
        &self,
        request: Request<Streaming<UpsampleRequest>>,
    ) -> Result<Response<Self::UpsampleStream>, Status> {
        let (metadata, mut extensions, messages) = request.into_parts();
        let call = Call {
            app: Arc::clone(&self.app),
            headers: metadata.into_headers(),
            ongoing: extensions.remove().unwrap_or_default(),
            client: extensions.remove().unwrap_or_default(),
        };
        let id = extensions.remove().unwrap_or_else(|| RequestId::of(&HeaderMap::new()));
        let (items, received) = mpsc::channel(WAITING);
        let mut task = JoinSet::new();
        task.spawn(call.run(messages, items, id.clone()));
        let stream = stream::unfold(Some((received, task)), move |state| {
            let id = id.clone();
            async move {
                let (mut received, task) = state?;
                match received.recv().await {
                    Some(Ok(Item::Message(message))) => Some((Ok(message), Some((received, task)))),
                    Some(Err(status)) => Some((Err(status), None)),
                    Some(Ok(Item::End)) => None,
                    // Without a word: a result that broke off must not look whole.
                    None => {
                        Some((Err(Problem::Internal("the task ended early".into()).grpc(id.as_str())), None))
                    }
                }
            }
        });
        let mut response = Response::new(stream.boxed());
        response.extensions_mut().insert(Early);
        Ok(response)
    }
}

/// One call.
struct Call {
    app: Arc<App>,
    headers: HeaderMap,
    ongoing: Ongoing,
    client: Client,
}

type Items = mpsc::Sender<Result<Item, Status>>;

impl Call {
    async fn run(self, messages: Streaming<UpsampleRequest>, items: Items, id: RequestId) {
        // The client's deadline, where it is sooner than the server's.
        let deadline = Deadline::new(deadline(&self.headers), self.app.config.timeouts.request);
        let ticket = Ticket::until(&self.app, self.client.clone(), deadline.clone());
        let answer = deadline.run(self.answer(ticket, messages, &items)).await;
        self.ongoing.sending();
        let ended = match answer {
            Ok(mut result) => loop {
                match result.next().await {
                    None => break Ok(()),
                    Some(Err(problem)) => break Err(problem),
                    Some(Ok(message)) => {
                        if !self.send(&items, Ok(Item::Message(message))).await {
                            return;
                        }
                    }
                }
            },
            Err(problem) => Err(problem),
        };
        let last = ended.map(|()| Item::End).map_err(|problem| {
            self.ongoing.problem(&problem);
            problem.grpc(id.as_str())
        });
        self.send(&items, last).await;
    }

    /// Waits until there is room for an item; false where the client has left or reads nothing, and then its
    /// connection is cut (see [`crate::connection::activity`]).
    async fn send(&self, items: &Items, item: Result<Item, Status>) -> bool {
        matches!(timeout(self.app.config.timeouts.stall, items.send(item)).await, Ok(Ok(())))
    }

    /// From the first message to the result.
    async fn answer(
        &self,
        mut ticket: Ticket,
        mut messages: Streaming<UpsampleRequest>,
        items: &Items,
    ) -> Result<Messages, Problem> {
        let app = &self.app;
        ticket.check()?;
        ticket.deadline.enter("of upload");
        let stall = app.config.timeouts.stall;
        // For a message that is only half there; never so much that the largest cloud has no room beside it.
        let limits = &app.config.limits;
        let half = limits.held_bytes.saturating_sub(limits.body_bytes).min(MESSAGE as u64);
        let half = app.budget.hold(half).ok_or_else(|| app.held_full())?;
        let start = timeout(stall, incoming::start(&mut messages)).await;
        let start = start.unwrap_or(Err(Problem::UploadStalled { limit: stall }))?;
        let Start { options, as_points, columns } = Start::read(start, app)?;
        let mut known = |header: &Header| ticket.reserve(cost(&options, header));
        if let Some(columns) = &columns {
            known(&unread(columns.points))?;
        }
        // Of the HTTP body's own headers, none mean anything here.
        let none = HeaderMap::new();
        let mut upload = Upload::new(&none, incoming::body(messages, columns));
        let received = upload.receive(&none, app, &options.reading, known).await?;
        drop(half);
        ticket.guess(cost(&options, &unread(guess::of_file(received.head(), received.length()))))?;
        let arrived = (received.length(), received.took);
        let read = move |app: &App| Asked::read(app, received, options);
        let (sender, begun) = oneshot::channel();
        let result = async {
            let begun = asked::begin(app, ticket, arrived, read, |following| {
                // Nobody listens where the work is over.
                let _ = sender.send(following);
            });
            match begun.await? {
                Begun::Whole(done) => Ok((done.points(), outgoing::messages(*done, as_points))),
                Begun::Tiled(tiled) => tiles::messages(app, tiled, as_points).await,
            }
        };
        let (points, messages) = tokio::select! {
            result = result => result?,
            never = tell(begun, items) => match never {},
        };
        self.ongoing.points(points);
        Ok(messages)
    }
}

/// Tells how far the job is, as long as there is room for that.
async fn tell(begun: oneshot::Receiver<Following>, items: &Items) -> Infallible {
    let Ok(job) = begun.await else { return std::future::pending().await };
    let mut ticks = interval(TICK);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut told = None;
    loop {
        ticks.tick().await;
        let now = job.progress();
        if told != Some(now) && items.try_send(Ok(Item::Message(outgoing::progress(now)))).is_ok() {
            told = Some(now);
        }
    }
}

/// The header of a call's deadline: how long from when the call was made; eight digits at most and a
/// unit.
const TIMEOUT: &str = "grpc-timeout";

/// The client's deadline. One that cannot be read is none, as other servers have it.
fn deadline(headers: &HeaderMap) -> Option<Duration> {
    let value = headers.get(TIMEOUT)?.to_str().ok()?;
    let (number, unit) = value.split_at_checked(value.len().checked_sub(1)?)?;
    if number.len() > 8 || !number.bytes().all(|digit| digit.is_ascii_digit()) {
        return None;
    }
    let number: u64 = number.parse().ok()?;
    Some(match unit {
        "H" => Duration::from_secs(3600 * number),
        "M" => Duration::from_secs(60 * number),
        "S" => Duration::from_secs(number),
        "m" => Duration::from_millis(number),
        "u" => Duration::from_micros(number),
        "n" => Duration::from_nanos(number),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deadlines_are_read_in_every_unit() {
        for (text, expected) in [
            ("2H", Some(Duration::from_secs(7200))),
            ("3M", Some(Duration::from_secs(180))),
            ("99999999S", Some(Duration::from_secs(99_999_999))),
            ("100m", Some(Duration::from_millis(100))),
            ("5u", Some(Duration::from_micros(5))),
            ("0n", Some(Duration::ZERO)),
            ("", None),
            ("S", None),
            ("5", None),
            ("+5S", None),
            ("999999999S", None),
            ("5s", None),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(TIMEOUT, text.parse().expect("a value"));
            assert_eq!(deadline(&headers), expected, "{text:?}");
        }
        assert_eq!(deadline(&HeaderMap::new()), None);
    }
}
