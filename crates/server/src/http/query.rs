//! The parameters of `POST /upsample`.

use axum::extract::Query;
use axum::http::Uri;

use crate::problem::Problem;
use densecloud::attributes::{Finish, Rules, RulesError};
use densecloud::survey::Goal;
use densecloud_cascade::{MAX_RATIO, Target};
use densecloud_cloud::Position;

/// All there are.
pub(crate) const NAMES: [&str; 10] = [
    "ratio",
    "points",
    "spacing",
    "density",
    "seed",
    "attributes",
    "keep_input",
    "source_fields",
    "normals",
    "sensor",
];

/// Those of which a request has one.
pub(crate) const GOALS: [&str; 4] = ["ratio", "points", "spacing", "density"];

/// The query's names and values.
///
/// # Errors
/// [`Problem::Parameter`] where it is none.
pub(crate) fn pairs(uri: &Uri) -> Result<Vec<(String, String)>, Problem> {
    let pairs = Query::try_from_uri(uri).map_err(|error| Problem::parameter("query", error.to_string()));
    pairs.map(|Query(pairs)| pairs)
}

/// What a request asks for, in the query of its URI.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Parameters {
    /// `ratio`, `points`, `spacing` or `density`.
    pub(crate) goal: Goal,
    /// `seed`; the same default as the command line's when absent.
    pub(crate) seed: Option<u64>,
    /// `attributes`, `keep_input`, `source_fields`, `normals` and `sensor`.
    pub(crate) finish: Finish,
}

impl Parameters {
    /// Reads the query strictly: a parameter that is unknown or comes twice is an error, so that a
    /// misspelt one is not silently ignored.
    ///
    /// # Errors
    /// [`Problem::Parameter`] naming the parameter and what it may be.
    pub(crate) fn parse(uri: &Uri) -> Result<Self, Problem> {
        Self::from_pairs(&pairs(uri)?)
    }

    /// As [`Parameters::parse`], from names and values that came in another way.
    ///
    /// # Errors
    /// The same.
    pub(crate) fn from_pairs(pairs: &[(String, String)]) -> Result<Self, Problem> {
        let (mut goals, mut seed, mut finish) = (Vec::new(), None, Finish::default());
        for (i, (name, value)) in pairs.iter().enumerate() {
            if pairs[..i].iter().any(|(earlier, _)| earlier == name) {
                return Err(Problem::parameter(name, "given twice".into()));
            }
            match name.as_str() {
                "ratio" => goals.push((name, Goal::Target(Target::Ratio(parse_ratio(value)?)))),
                "points" => goals.push((name, Goal::Target(Target::Points(parse_points(value)?)))),
                "spacing" => goals.push((name, Goal::Spacing(parse_positive(name, value)?))),
                "density" => goals.push((name, Goal::Density(parse_positive(name, value)?))),
                "seed" => seed = Some(parse_seed(value)?),
                "attributes" => finish.rules = parse_rules(value)?,
                "keep_input" => finish.keep_input = parse_switch(name, value)?,
                "source_fields" => finish.source_fields = parse_switch(name, value)?,
                "normals" => finish.estimate_normals = parse_normals(value)?,
                "sensor" => finish.sensor = Some(parse_sensor(value)?),
                _ => {
                    let why = format!("unknown; there are {}", NAMES.join(", "));
                    return Err(Problem::parameter(name, why));
                }
            }
        }
        let goal = match goals[..] {
            [(_, goal)] => goal,
            [_, (second, _), ..] => {
                let why = "give one of ratio, points, spacing and density";
                return Err(Problem::parameter(second, why.into()));
            }
            [] => {
                let why = "missing; give ratio=R (1 to 64), points=N, spacing=D or density=N";
                return Err(Problem::parameter("ratio", why.into()));
            }
        };
        Ok(Self { goal, seed, finish })
    }

    /// Points in the result for so many points in; unlike [`Target::points_out`], also for a claim that
    /// no cloud could meet. For a spacing or a density, which only the points themselves decide, the
    /// least that it can be.
    pub(crate) fn points_out(&self, points_in: u64) -> u64 {
        match self.goal {
            Goal::Target(target) => points_out(target, points_in),
            Goal::Spacing(_) | Goal::Density(_) => points_in,
        }
    }
}

/// As [`Parameters::points_out`].
pub(crate) fn points_out(target: Target, points_in: u64) -> u64 {
    match target {
        // Saturates, so a claim of 2^64 points is just a number that is too large.
        Target::Ratio(ratio) => (points_in as f64 * ratio).round() as u64,
        Target::Points(points) => points,
    }
}

fn parse_positive(name: &str, value: &str) -> Result<f64, Problem> {
    match value.parse() {
        Ok(number) if f64::is_finite(number) && number > 0.0 => Ok(number),
        _ => Err(Problem::parameter(name, format!("{value:?} is not a positive number"))),
    }
}

fn parse_switch(name: &str, value: &str) -> Result<bool, Problem> {
    match value {
        "true" | "1" | "" => Ok(true),
        "false" | "0" => Ok(false),
        _ => Err(Problem::parameter(name, format!("{value:?} is neither true nor false"))),
    }
}

fn parse_normals(value: &str) -> Result<bool, Problem> {
    match value {
        "estimate" => Ok(true),
        _ => Err(Problem::parameter("normals", format!("{value:?}; there is `estimate`"))),
    }
}

fn parse_sensor(value: &str) -> Result<Position, Problem> {
    let numbers: Option<Vec<f64>> =
        value.split(',').map(|n| n.parse().ok().filter(|n: &f64| n.is_finite())).collect();
    numbers
        .and_then(|n| n.try_into().ok())
        .ok_or_else(|| Problem::parameter("sensor", format!("{value:?} is not three numbers X,Y,Z")))
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
            let parameters = Parameters { goal: Goal::Target(target), seed, finish: Finish::default() };
            assert_eq!(parse(query), Ok(parameters), "{query}");
        }
    }

    #[test]
    fn other_goals_and_what_is_done_with_points_are_read() {
        let all = parse("?spacing=0.5&keep_input=true&source_fields&normals=estimate&sensor=1,-2,3e1")
            .expect("parameters");
        let finish = Finish {
            keep_input: true,
            source_fields: true,
            estimate_normals: true,
            sensor: Some([1.0, -2.0, 30.0]),
            ..Finish::default()
        };
        assert_eq!(all, Parameters { goal: Goal::Spacing(0.5), seed: None, finish });
        assert_eq!(parse("?density=7").expect("parameters").goal, Goal::Density(7.0));
        assert_eq!(parse("?density=7").expect("parameters").points_out(9), 9);
    }

    #[test]
    fn every_name_is_known() {
        for name in NAMES {
            let Err(Problem::Parameter { why, .. }) = parse(&format!("?{name}=?")) else { panic!("{name}") };
            assert!(!why.contains("unknown"), "{name}: {why}");
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
            ("?ratio=4&spacing=8", "spacing"),
            ("?spacing=0", "spacing"),
            ("?density=inf", "density"),
            ("?ratio=4&keep_input=maybe", "keep_input"),
            ("?ratio=4&normals=yes", "normals"),
            ("?ratio=4&sensor=1,2", "sensor"),
            ("?ratio=4&sensor=1,2,nan", "sensor"),
            ("?ratio=4&attributes=red:drop,red:mean", "attributes"),
            ("?ratio=4&attributes=red:drop&attributes=red:drop", "attributes"),
        ] {
            match parse(query) {
                Err(Problem::Parameter { name: found, .. }) => assert_eq!(found, name, "{query}"),
                other => panic!("{query}: {other:?}"),
            }
        }
    }

    #[test]
    fn points_out_are_the_cascades_own_and_saturate() {
        for points_in in 1..200 {
            let expected = Target::Ratio(1.37).points_out(points_in).expect("a size");
            assert_eq!(points_out(Target::Ratio(1.37), points_in), expected);
        }
        assert_eq!(points_out(Target::Ratio(64.0), u64::MAX), u64::MAX);
        assert_eq!(points_out(Target::Points(9), 3), 9);
    }
}
