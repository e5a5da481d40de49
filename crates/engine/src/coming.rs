//! Work that was let in and has not come yet: its points are taken, its cloud is being sent, or waits to be parsed.

use std::time::{Duration, Instant};

use super::client::Client;
use super::workers::Lane;

/// What is on its way, by the numbers of its permits. It will wait in the queue as surely as what waits there already, so it
/// counts as waiting: else all of a burst would be let in before the first of it has come.
///
/// An upload that takes longer than what waits may take counts no more until it is there: in the meantime others' work is
/// done, and clients who send slowly, or never, do not keep them out.
#[derive(Debug)]
pub(super) struct Coming {
    /// In the order in which they were let in.
    all: Vec<Expected>,
    /// How long an upload counts.
    patience: Duration,
}

#[derive(Debug)]
pub(super) struct Expected {
    pub(super) number: u64,
    pub(super) client: Client,
    pub(super) lane: Lane,
    /// How long the work will take.
    pub(super) time: Duration,
    /// When it was let in; none once all of it has arrived.
    pub(super) since: Option<Instant>,
}

impl Coming {
    /// Nothing; uploads count for so long.
    pub(super) fn new(patience: Duration) -> Self {
        Self { all: Vec::new(), patience }
    }

    /// Adds one, at its place in the order. O(what is on its way).
    pub(super) fn add(&mut self, expected: Expected) {
        let place = self.all.partition_point(|earlier| earlier.number < expected.number);
        self.all.insert(place, expected);
    }

    /// Takes it out, if it is still on its way. O(what is on its way).
    pub(super) fn remove(&mut self, number: u64) -> Option<Expected> {
        let place = self.place(number)?;
        Some(self.all.remove(place))
    }

    /// All of it is there, but for its turn to be parsed.
    pub(super) fn arrived(&mut self, number: u64) {
        if let Some(place) = self.place(number) {
            self.all[place].since = None;
        }
    }

    fn place(&self, number: u64) -> Option<usize> {
        self.all.binary_search_by_key(&number, |expected| expected.number).ok()
    }

    #[cfg(test)]
    pub(super) fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// How long the work in a lane will take that will wait there, one client's or all for `None`. The first `idle` of all
    /// do not: threads have nothing else to do than them.
    pub(super) fn time(&self, client: Option<&Client>, lane: Lane, idle: usize, now: Instant) -> Duration {
        let coming = |expected: &&Expected| {
            let slow =
                expected.since.is_some_and(|since| now.saturating_duration_since(since) > self.patience);
            expected.lane == lane && !slow
        };
        let waiting = self.all.iter().filter(coming).skip(idle);
        let mine = waiting.filter(|expected| client.is_none_or(|client| *client == expected.client));
        mine.map(|expected| expected.time).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_slow_counts_again_when_it_has_arrived() {
        let (start, second) = (Instant::now(), Duration::from_secs(1));
        let (a, b) = (Client::new("a"), Client::new("b"));
        let mut coming = Coming::new(second);
        for (number, client, lane) in [(1, &a, Lane::Express), (2, &b, Lane::Express), (3, &a, Lane::Bulk)] {
            let client = client.clone();
            coming.add(Expected { number, client, lane, time: number as u32 * second, since: Some(start) });
        }
        let time = |coming: &Coming, client, after| coming.time(client, Lane::Express, 0, start + after);
        assert_eq!(time(&coming, None, second), 3 * second);
        assert_eq!(coming.time(None, Lane::Express, 1, start), 2 * second, "the first does not wait");
        assert_eq!(coming.time(Some(&b), Lane::Express, 1, start), 2 * second);
        assert_eq!(coming.time(Some(&a), Lane::Express, 1, start), Duration::ZERO);
        assert_eq!(time(&coming, Some(&b), second), 2 * second);
        assert_eq!(time(&coming, None, 2 * second), Duration::ZERO);
        coming.arrived(1);
        coming.arrived(99);
        assert_eq!(time(&coming, None, 2 * second), second);
        let first = coming.remove(1).expect("it is there");
        assert!(coming.remove(1).is_none());
        assert_eq!(time(&coming, None, second), 2 * second);
        coming.add(first);
        assert_eq!(coming.time(None, Lane::Express, 1, start), 2 * second, "still the first");
    }
}
