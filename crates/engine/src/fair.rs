//! Whose turn it is: a fair queue among clients.

use std::collections::{BTreeMap, VecDeque};

use super::client::Client;

/// What waits in one lane, first come first served for each client, and the clients by turns, weighed by
/// points: fair queueing by start times (Goyal, Vin and Cheng, 1996).
///
/// Each client's next item has a start on a common clock, counted in points: where the client's last item
/// ended, or now for a client that comes anew. The earliest goes first. The clock goes on by each item's
/// points over the number of clients that wait, so every start is reached in the end: nobody starves,
/// whoever else comes. Nothing depends on time or chance.
#[derive(Debug)]
pub struct Fair<T> {
    flows: BTreeMap<Client, Flow<T>>,
    clock: u64,
    turns: u64,
}

/// One client's.
#[derive(Debug)]
struct Flow<T> {
    waiting: VecDeque<(T, u64)>,
    /// Of the first that waits; where nothing does, the earliest of one that comes.
    start: u64,
    /// Its last turn; of equal starts the one whose turn is longest ago goes first.
    turn: u64,
}

impl<T> Default for Fair<T> {
    fn default() -> Self {
        Self { flows: BTreeMap::new(), clock: 0, turns: 0 }
    }
}

impl<T> Fair<T> {
    /// Adds an item that counts as `points`. O(log clients).
    pub fn push(&mut self, client: &Client, item: T, points: u64) {
        let clock = self.clock;
        let new = || Flow { waiting: VecDeque::new(), start: clock, turn: 0 };
        let flow = self.flows.entry(client.clone()).or_insert_with(new);
        if flow.waiting.is_empty() {
            flow.start = flow.start.max(clock);
        }
        flow.waiting.push_back((item, points));
    }

    fn first(&self) -> Option<Client> {
        let waiting = self.flows.iter().filter(|(_, flow)| !flow.waiting.is_empty());
        waiting.min_by_key(|(_, flow)| (flow.start, flow.turn)).map(|(client, _)| client.clone())
    }

    /// The item whose turn it is. O(clients).
    pub(super) fn peek(&self) -> Option<&T> {
        let flow = &self.flows[&self.first()?];
        flow.waiting.front().map(|(item, _)| item)
    }

    /// Takes it out. O(clients).
    pub fn pop(&mut self) -> Option<T> {
        let client = self.first()?;
        let clients = self.flows.values().filter(|flow| !flow.waiting.is_empty()).count() as u64;
        let flow = self.flows.get_mut(&client)?;
        let (item, points) = flow.waiting.pop_front()?;
        let points = points.max(1);
        self.turns += 1;
        self.clock = self.clock.max(flow.start).saturating_add((points / clients).max(1));
        (flow.start, flow.turn) = (flow.start.saturating_add(points), self.turns);
        // Whoever is owed nothing and owes nothing is as one that comes anew.
        let clock = self.clock;
        self.flows.retain(|_, flow| !flow.waiting.is_empty() || flow.start > clock);
        Some(item)
    }

    /// Takes out the client's item that `is` picks, and charges nothing for it. O(its items).
    pub(super) fn remove(&mut self, client: &Client, is: impl Fn(&T) -> bool) -> Option<T> {
        let waiting = &mut self.flows.get_mut(client)?.waiting;
        let place = waiting.iter().position(|(item, _)| is(item))?;
        waiting.remove(place).map(|(item, _)| item)
    }

    /// The items that wait: one client's, or all for `None`.
    pub(super) fn iter(&self, client: Option<&Client>) -> impl Iterator<Item = &T> {
        let flows = self.flows.iter().filter(move |(of, _)| client.is_none_or(|client| client == *of));
        flows.flat_map(|(_, flow)| flow.waiting.iter().map(|(item, _)| item))
    }

    /// Takes out everything.
    pub(super) fn drain(&mut self) -> Vec<T> {
        let flows = std::mem::take(&mut self.flows);
        flows.into_values().flat_map(|flow| flow.waiting).map(|(item, _)| item).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn order(fair: &mut Fair<&'static str>, count: usize) -> String {
        (0..count).filter_map(|_| fair.pop()).collect()
    }

    #[test]
    fn one_request_waits_for_one_of_a_client_with_a_hundred() {
        let (a, b) = (Client::new("a"), Client::new("b"));
        let mut fair = Fair::default();
        for _ in 0..100 {
            fair.push(&a, "a", 1000);
        }
        assert_eq!(order(&mut fair, 5), "aaaaa");
        fair.push(&b, "b", 1000);
        assert_eq!(order(&mut fair, 2), "ba", "before all that waited");
        // One after the other, each when the last is done.
        for _ in 0..10 {
            fair.push(&b, "b", 1000);
            let two = order(&mut fair, 2);
            assert!(two.contains('b') && two.contains('a'), "by turns: {two}");
        }
    }

    #[test]
    fn turns_are_weighed_by_points() {
        let (a, b) = (Client::new("a"), Client::new("b"));
        let mut fair = Fair::default();
        for _ in 0..10 {
            fair.push(&a, "a", 4000);
            fair.push(&b, "b", 1000);
            fair.push(&b, "b", 1000);
        }
        let first = order(&mut fair, 20);
        assert_eq!(first.matches('b').count(), 16, "{first}");
    }

    #[test]
    fn nobody_starves_however_many_come_anew() {
        let mut fair = Fair::default();
        let patient = Client::new("patient");
        fair.push(&patient, usize::MAX, 1000);
        fair.push(&patient, usize::MAX, 1000);
        let mut served = 0;
        for i in 0..100 {
            fair.push(&Client::new(&i.to_string()), i, 1000);
            fair.push(&Client::new(&format!("{i}, too")), i, 1000);
            for _ in 0..2 {
                served += usize::from(fair.pop() == Some(usize::MAX));
            }
        }
        assert_eq!(served, 2);
        assert!(fair.flows.len() < 10, "clients that have gone are forgotten: {}", fair.flows.len());
    }

    #[test]
    fn what_was_taken_back_is_not_charged() {
        let (a, b) = (Client::new("a"), Client::new("b"));
        let mut fair = Fair::default();
        fair.push(&b, "b", 10);
        fair.push(&a, "x", 1_000_000);
        fair.push(&a, "a", 10);
        assert_eq!(fair.remove(&a, |item| *item == "x"), Some("x"));
        assert_eq!(fair.remove(&a, |item| *item == "x"), None);
        fair.push(&b, "b", 10);
        assert_eq!(order(&mut fair, 3), "abb");
    }

    proptest! {
        #[test]
        fn everything_comes_out_once_and_in_order_for_each_client(
            steps in prop::collection::vec((any::<bool>(), 0_u8..4, 0_u64..5000), 1..200)
        ) {
            let mut fair = Fair::default();
            let mut waiting: BTreeMap<u8, VecDeque<usize>> = BTreeMap::new();
            for (i, (push, client, points)) in steps.into_iter().enumerate() {
                if push {
                    fair.push(&Client::new(&client.to_string()), (client, i), points);
                    waiting.entry(client).or_default().push_back(i);
                } else {
                    let expected = fair.peek().copied();
                    let popped = fair.pop();
                    prop_assert_eq!(popped, expected);
                    prop_assert_eq!(popped.is_none(), waiting.values().all(VecDeque::is_empty));
                    if let Some((client, i)) = popped {
                        prop_assert_eq!(waiting.get_mut(&client).and_then(VecDeque::pop_front), Some(i));
                    }
                }
            }
            let left: usize = waiting.values().map(VecDeque::len).sum();
            prop_assert_eq!(fair.drain().len(), left);
        }
    }
}
