//! What became of the requests of a load.

use std::collections::BTreeMap;
use std::time::Duration;

#[derive(Default)]
pub(crate) struct Tally {
    /// From when a request was due to the end of its whole and right answer.
    pub(crate) accepted: Vec<Duration>,
    /// Points and requests that were answered whole and right while the load lasted.
    pub(crate) points: u64,
    pub(crate) answers: u64,
    /// Of these, by client.
    pub(crate) by_client: BTreeMap<usize, u64>,
    /// From when a refused request was due to the head of its refusal.
    pub(crate) refused: Vec<Duration>,
    pub(crate) statuses: BTreeMap<u16, u64>,
    /// Clients that left because it took too long.
    pub(crate) left: u64,
    /// What must not happen, and how often it did.
    pub(crate) faults: BTreeMap<String, u64>,
}

impl Tally {
    pub(crate) fn fault(&mut self, what: String) {
        *self.faults.entry(what).or_default() += 1;
    }

    /// All statuses and how often each came, and clients that left.
    pub(crate) fn summary(&self) -> String {
        let mut parts: Vec<_> =
            self.statuses.iter().map(|(status, count)| format!("{status}: {count}")).collect();
        if self.left > 0 {
            parts.push(format!("left: {}", self.left));
        }
        parts.join(", ")
    }

    pub(crate) fn print_faults(&self) {
        for (what, count) in &self.faults {
            println!("FAULT, {count} times: {what}");
        }
    }
}

/// The value below which this share of them is, in milliseconds; a dash where there are none.
pub(crate) fn quantile(values: &[Duration], share: f64) -> String {
    let mut sorted = values.to_vec();
    sorted.sort();
    let place = (share * sorted.len() as f64).ceil() as usize;
    match sorted.get(place.saturating_sub(1)) {
        Some(value) => format!("{:.0}", value.as_secs_f64() * 1000.0),
        None => "-".into(),
    }
}

pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}
