//! How often values fall between edges.

/// Bars of a histogram.
const BARS: usize = 40;

/// Shares of two clouds' values, or of one's, that fall between edges. What lies beyond the edges is in the first and the
/// last bar.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub(crate) struct Histogram {
    /// Ascending, one more than there are bars.
    pub(super) edges: Vec<f64>,
    /// For each bar the share of the input's values, from 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) input: Option<Vec<f64>>,
    /// The same of the result's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) output: Option<Vec<f64>>,
}

impl Histogram {
    /// Between edges that are as far apart, from `low` to `high`.
    pub(super) fn even(low: f64, high: f64, input: Option<&[f64]>, output: Option<&[f64]>) -> Self {
        let edges: Vec<f64> = (0..=BARS).map(|i| low + (high - low) * i as f64 / BARS as f64).collect();
        Self::between(edges, input, output)
    }

    /// Between edges of one ratio, which hold all but one in a thousand of the values at either end; none where no value is
    /// above 0.
    pub(super) fn logarithmic(input: &[f64], output: &[f64]) -> Option<Self> {
        let mut all: Vec<f64> = input.iter().chain(output).copied().filter(|v| *v > 0.0).collect();
        all.sort_unstable_by(f64::total_cmp);
        let last = all.len().checked_sub(1)?;
        let at = |share: f64| all[(share * last as f64).round() as usize].ln();
        // Of one value alone, edges lie about it.
        let (low, high) = (at(0.001) - 0.05, at(0.999) + 0.05);
        let even = Self::even(low, high, None, None);
        Some(Self::between(even.edges.into_iter().map(f64::exp).collect(), Some(input), Some(output)))
    }

    fn between(edges: Vec<f64>, input: Option<&[f64]>, output: Option<&[f64]>) -> Self {
        let shares = |values: &[f64]| {
            let mut counts = vec![0_usize; BARS];
            for value in values {
                let bar = edges.partition_point(|edge| edge <= value).saturating_sub(1);
                counts[bar.min(BARS - 1)] += 1;
            }
            counts.iter().map(|n| *n as f64 / values.len().max(1) as f64).collect()
        };
        let (input, output) = (input.map(shares), output.map(shares));
        Self { edges, input, output }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_is_in_the_bar_between_its_edges_and_those_beyond_in_the_outer_ones() {
        let histogram = Histogram::even(0.0, 4.0, None, Some(&[-1.0, 0.0, 0.1, 0.15, 3.95, 4.0, 9.0, 2.0]));
        let shares = histogram.output.expect("shares");
        assert_eq!((shares[0], shares[1], shares[20], shares[39]), (0.25, 0.25, 0.125, 0.375));
        assert_eq!((shares.iter().sum::<f64>(), histogram.input), (1.0, None));
    }

    #[test]
    fn logarithmic_edges_hold_the_values() {
        let (input, output): (Vec<f64>, Vec<f64>) = (vec![8.0; 50], vec![2.0; 50]);
        let histogram = Histogram::logarithmic(&input, &output).expect("a histogram");
        assert!(histogram.edges[0] < 2.0 && histogram.edges[BARS] > 8.0);
        let ratio = histogram.edges[1] / histogram.edges[0];
        assert!(histogram.edges.windows(2).all(|e| (e[1] / e[0] - ratio).abs() < 1e-9));
        for shares in [histogram.input, histogram.output] {
            assert_eq!(shares.expect("shares").iter().filter(|s| **s == 1.0).count(), 1);
        }
        assert_eq!(Histogram::logarithmic(&[0.0], &[]), None, "duplicates have no logarithm");
    }
}
