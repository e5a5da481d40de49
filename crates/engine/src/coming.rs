//! Work that was let in and has not come yet: its points are taken, its cloud is being sent, or waits to be parsed.

use std::collections::HashMap;
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

    /// How long the work of one client will take that will wait in a lane. The first `idle` of all do not wait: threads have
    /// nothing else to do than them. O(what is on its way).
    pub(super) fn time(&self, client: &Client, lane: Lane, idle: usize, now: Instant) -> Duration {
        let waiting = self.waiting(lane, idle, now);
        waiting.filter(|expected| expected.client == *client).map(|expected| expected.time).sum()
    }

    /// The same of all clients', of each up to `most`: what has not come may never come, and then whoever asked for the
    /// most would keep all others out. O(what is on its way).
    pub(super) fn time_of_all(&self, most: Duration, lane: Lane, idle: usize, now: Instant) -> Duration {
        let mut each: HashMap<&Client, Duration> = HashMap::new();
        for expected in self.waiting(lane, idle, now) {
            *each.entry(&expected.client).or_default() += expected.time;
        }
        each.into_values().map(|time| time.min(most)).sum()
    }

    fn waiting(&self, lane: Lane, idle: usize, now: Instant) -> impl Iterator<Item = &Expected> {
        let slow = move |since: Instant| now.saturating_duration_since(since) > self.patience;
        let coming = move |expected: &&Expected| expected.lane == lane && !expected.since.is_some_and(slow);
        self.all.iter().filter(coming).skip(idle)
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
        let all = |coming: &Coming, idle, after| {
            coming.time_of_all(Duration::MAX, Lane::Express, idle, start + after)
        };
        assert_eq!(all(&coming, 0, second), 3 * second);
        assert_eq!(all(&coming, 1, Duration::ZERO), 2 * second, "the first does not wait");
        assert_eq!(coming.time(&b, Lane::Express, 1, start), 2 * second);
        assert_eq!(coming.time(&a, Lane::Express, 1, start), Duration::ZERO);
        assert_eq!(coming.time(&b, Lane::Express, 0, start + second), 2 * second);
        assert_eq!(all(&coming, 0, 2 * second), Duration::ZERO);
        coming.arrived(1);
        coming.arrived(99);
        assert_eq!(all(&coming, 0, 2 * second), second);
        let first = coming.remove(1).expect("it is there");
        assert!(coming.remove(1).is_none());
        assert_eq!(all(&coming, 0, second), 2 * second);
        coming.add(first);
        assert_eq!(all(&coming, 1, Duration::ZERO), 2 * second, "still the first");
    }

    #[test]
    fn of_all_each_client_counts_up_to_the_most() {
        let (start, second) = (Instant::now(), Duration::from_secs(1));
        let mut coming = Coming::new(second);
        for (number, name) in [(1, "a"), (2, "a"), (3, "b")] {
            let (client, time) = (Client::new(name), 4 * second);
            coming.add(Expected { number, client, lane: Lane::Bulk, time, since: Some(start) });
        }
        for (most, all) in [(9, 12), (5, 9), (4, 8), (1, 2)] {
            assert_eq!(coming.time_of_all(most * second, Lane::Bulk, 0, start), all * second, "{most}");
        }
        assert_eq!(coming.time(&Client::new("a"), Lane::Bulk, 0, start), 8 * second, "its own is whole");
    }
}
