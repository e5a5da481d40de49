//! The parameters of `POST /upsample`.

use axum::extract::Query;
use axum::http::Uri;

use super::problem::Problem;
use crate::attributes::{Rules, RulesError};
use crate::cascade::{MAX_RATIO, Target};

/// What a request asks for, in the query of its URI.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Parameters {
    /// `ratio` or `points`.
    pub(super) target: Target,
    /// `seed`; the same default as the command line's when absent.
    pub(super) seed: Option<u64>,
    /// `attributes`: how new points come by them.
    pub(super) rules: Rules,
}

impl Parameters {
    /// Reads the query strictly: a parameter that is unknown or comes twice is an error, so that a
    /// misspelt one is not silently ignored.
    ///
    /// # Errors
    /// [`Problem::Parameter`] naming the parameter and what it may be.
    pub(super) fn parse(uri: &Uri) -> Result<Self, Problem> {
        let Query(pairs) = Query::<Vec<(String, String)>>::try_from_uri(uri)
            .map_err(|error| Problem::parameter("query", error.to_string()))?;
        let (mut ratio, mut points, mut seed, mut rules) = (None, None, None, None);
        for (name, value) in pairs {
            let twice = match name.as_str() {
                "ratio" => ratio.replace(parse_ratio(&value)?).is_some(),
                "points" => points.replace(parse_points(&value)?).is_some(),
                "seed" => seed.replace(parse_seed(&value)?).is_some(),
                "attributes" => rules.replace(parse_rules(&value)?).is_some(),
                _ => {
                    return Err(Problem::parameter(
                        &name,
                        "unknown; there are ratio, points, seed and attributes".into(),
                    ));
                }
            };
            if twice {
                return Err(Problem::parameter(&name, "given twice".into()));
            }
        }
        let target = match (ratio, points) {
            (Some(ratio), None) => Target::Ratio(ratio),
            (None, Some(points)) => Target::Points(points),
            (Some(_), Some(_)) => {
                return Err(Problem::parameter("points", "give either ratio or points, not both".into()));
            }
            (None, None) => {
                return Err(Problem::parameter(
                    "ratio",
                    "missing; give ratio=R (1 to 64) or points=N".into(),
                ));
            }
        };
        Ok(Self { target, seed, rules: rules.unwrap_or_default() })
    }

    /// Points in the result for so many points in; unlike [`Target::points_out`], also for a claim that
    /// no cloud could meet.
    pub(super) fn points_out(&self, points_in: u64) -> u64 {
        match self.target {
            // Saturates, so a claim of 2^64 points is just a number that is too large.
            Target::Ratio(ratio) => (points_in as f64 * ratio).round() as u64,
            Target::Points(points) => points,
        }
    }
}

fn parse_ratio(value: &str) -> Result<f64, Problem> {
    match value.parse() {
        Ok(ratio) if (1.0..=f64::from(MAX_RATIO)).contains(&ratio) => Ok(ratio),
        _ => Err(Problem::parameter("ratio", format!("{value:?} is not a number from 1 to {MAX_RATIO}"))),
    }
}

fn parse_points(value: &str) -> Result<u64, Problem> {
    match value.parse() {
        Ok(points) if points > 0 => Ok(points),
        _ => Err(Problem::parameter("points", format!("{value:?} is not a positive whole number"))),
    }
}

fn parse_seed(value: &str) -> Result<u64, Problem> {
    value.parse().map_err(|_| {
        Problem::parameter("seed", format!("{value:?} is not a whole number from 0 to {}", u64::MAX))
    })
}

fn parse_rules(value: &str) -> Result<Rules, Problem> {
    value.parse().map_err(|why: RulesError| Problem::parameter("attributes", why.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(query: &str) -> Result<Parameters, Problem> {
        Parameters::parse(&format!("/upsample{query}").parse().expect("a URI"))
    }

    #[test]
    fn each_parameter_is_read() {
        let cases = [
            ("?ratio=4", Target::Ratio(4.0), None),
            ("?ratio=2.5&seed=7", Target::Ratio(2.5), Some(7)),
            ("?seed=18446744073709551615&points=1000", Target::Points(1000), Some(u64::MAX)),
            ("?ratio=%31%36", Target::Ratio(16.0), None),
        ];
        for (query, target, seed) in cases {
            assert_eq!(parse(query), Ok(Parameters { target, seed, rules: Rules::default() }), "{query}");
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (query, name) in [
            ("", "ratio"),
            ("?", "ratio"),
            ("?seed=1", "ratio"),
            ("?ratio=", "ratio"),
            ("?ratio=0.5", "ratio"),
            ("?ratio=64.1", "ratio"),
            ("?ratio=nan", "ratio"),
            ("?ratio=inf", "ratio"),
            ("?ratio=4&ratio=4", "ratio"),
            ("?points=0", "points"),
            ("?points=-1", "points"),
            ("?points=1e3", "points"),
            ("?ratio=4&points=8", "points"),
            ("?ratio=4&seed=-1", "seed"),
            ("?ratio=4&ration=4", "ration"),
            ("?Ratio=4", "Ratio"),
            ("?ratio=4&attributes=red", "attributes"),
            ("?ratio=4&attributes=red:drop,red:mean", "attributes"),
        ] {
            match parse(query) {
                Err(Problem::Parameter { name: found, .. }) => assert_eq!(found, name, "{query}"),
                other => panic!("{query}: {other:?}"),
            }
        }
    }

    #[test]
    fn points_out_are_the_cascades_own_and_saturate() {
        let ratio = |ratio| Parameters { target: Target::Ratio(ratio), seed: None, rules: Rules::default() };
        assert_eq!(ratio(4.0).points_out(10), 40);
        for points_in in 1..200 {
            let expected = Target::Ratio(1.37).points_out(points_in).expect("a size");
            assert_eq!(ratio(1.37).points_out(points_in), expected);
        }
        assert_eq!(ratio(64.0).points_out(u64::MAX), u64::MAX);
        let points = Parameters { target: Target::Points(9), seed: None, rules: Rules::default() };
        assert_eq!(points.points_out(3), 9);
    }
}
