//! How long a request may take, time in the queue included, and what it took that time for.

use std::fmt::Write;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::http::HeaderMap;
use tokio::time::{Instant, timeout_at};

use crate::problem::Problem;
use densecloud_engine::ProgressHandle;

/// `X-Request-Timeout: SECONDS`, decimals allowed.
pub(crate) const HEADER: &str = "x-request-timeout";

/// The end of one request's time. Clones share what is known of it.
#[derive(Clone)]
pub(crate) struct Deadline {
    start: Instant,
    limit: Duration,
    // A mutex: the handler writes it between its waits, and reads it when the time is over.
    spent: Arc<Mutex<Spent>>,
}

#[derive(Default)]
struct Spent {
    /// What was over, and how long it took.
    done: Vec<(&'static str, Duration)>,
    /// What is going on, and since when.
    now: Option<(&'static str, Instant)>,
    /// The engine's part, once it has begun.
    job: Option<ProgressHandle>,
}

impl Deadline {
    /// From now on: what the client wishes, but not longer than `most`. For any interface that has deadlines
    /// of its own.
    pub(crate) fn new(wish: Option<Duration>, most: Duration) -> Self {
        let limit = wish.map_or(most, |wish| wish.min(most));
        Self { start: Instant::now(), limit, spent: Arc::default() }
    }

    /// As the header has it.
    ///
    /// # Errors
    /// [`Problem::Parameter`] where that is not a positive number.
    pub(crate) fn of(headers: &HeaderMap, most: Duration) -> Result<Self, Problem> {
        let mut values = headers.get_all(HEADER).iter();
        let wish = match (values.next(), values.next()) {
            (None, _) => None,
            (Some(value), None) => {
                let seconds = value.to_str().ok().and_then(|text| text.trim().parse::<f64>().ok());
                match seconds.map(Duration::try_from_secs_f64) {
                    Some(Ok(wish)) if !wish.is_zero() => Some(wish),
                    // More than there is room for: as long as it may be.
                    Some(Err(_)) if seconds.is_some_and(|s| s > 0.0 && s.is_finite()) => None,
                    _ => {
                        let why = format!("{value:?} is not a positive number of seconds");
                        return Err(Problem::parameter("X-Request-Timeout", why));
                    }
                }
            }
            (Some(_), Some(_)) => {
                return Err(Problem::parameter("X-Request-Timeout", "given twice".into()));
            }
        };
        Ok(Self::new(wish, most))
    }

    /// When it is; none where that is further away than there are times.
    pub(crate) fn at(&self) -> Option<std::time::Instant> {
        self.end().map(Instant::into_std)
    }

    fn end(&self) -> Option<Instant> {
        self.start.checked_add(self.limit)
    }

    /// Does `work` until the deadline; what is not done by then is dropped.
    ///
    /// # Errors
    /// [`Problem::Deadline`], or the work's own.
    pub(crate) async fn run<T>(&self, work: impl Future<Output = Result<T, Problem>>) -> Result<T, Problem> {
        match self.end() {
            Some(end) => timeout_at(end, work).await.unwrap_or_else(|_| Err(self.over())),
            None => work.await,
        }
    }

    /// From now on, time is spent for this.
    pub(crate) fn enter(&self, what: &'static str) {
        let mut spent = self.spent();
        spent.end();
        spent.now = Some((what, Instant::now()));
    }

    /// From now on, time is spent in the engine's queue and, then, at work.
    pub(crate) fn queued(&self, job: ProgressHandle) {
        self.enter("in the queue");
        self.spent().job = Some(job);
    }

    /// The deadline has passed.
    pub(crate) fn over(&self) -> Problem {
        let mut spent = self.spent();
        spent.end();
        let mut text = String::new();
        for (what, took) in &spent.done {
            let comma = if text.is_empty() { "" } else { ", " };
            // Writing into a string cannot fail.
            let _ = write!(text, "{comma}{:.1} s {what}", took.as_secs_f64());
        }
        Problem::Deadline { limit: self.limit, spent: text }
    }

    fn spent(&self) -> MutexGuard<'_, Spent> {
        self.spent.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Spent {
    fn end(&mut self) {
        let Some((what, since)) = self.now.take() else { return };
        let took = since.elapsed();
        match self.job.take() {
            Some(job) => {
                let waited = job.waited().min(took);
                self.done.push((what, waited));
                self.done.push(("at work", took - waited));
            }
            None => self.done.push((what, took)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::advance;

    const MOST: Duration = Duration::from_secs(60);

    fn of(values: &[&'static str]) -> Result<Duration, Problem> {
        let mut headers = HeaderMap::new();
        for value in values {
            headers.append(HEADER, axum::http::HeaderValue::from_static(value));
        }
        Deadline::of(&headers, MOST).map(|deadline| deadline.limit)
    }

    #[test]
    fn a_client_may_have_less_time_but_no_more() {
        for (value, seconds) in [("5", 5.0), ("0.25", 0.25), (" 7 ", 7.0), ("600", 60.0), ("1e300", 60.0)] {
            assert_eq!(of(&[value]), Ok(Duration::from_secs_f64(seconds)), "{value}");
        }
        assert_eq!(of(&[]), Ok(MOST));
        for values in [&["0"][..], &["-1"], &["soon"], &[""], &["nan"], &["inf"], &["1 s"], &["1", "2"]] {
            let Err(Problem::Parameter { name, .. }) = of(values) else { panic!("{values:?}") };
            assert_eq!(name, "X-Request-Timeout");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn what_the_time_was_spent_for_is_told() {
        let deadline = Deadline::new(Some(Duration::from_secs(2)), MOST);
        deadline.enter("of upload");
        advance(Duration::from_millis(1500)).await;
        deadline.enter("of parsing");
        let work = std::future::pending::<Result<(), Problem>>();
        let text = deadline.run(work).await.expect_err("no end").to_string();
        assert!(text.contains("1.5 s of upload, 0.5 s of parsing"), "{text}");
        assert!(text.contains("2 s"), "{text}");
    }
}
