//! The options of a request, in the query of its URI.

use axum::extract::Query;
use axum::http::Uri;
use densecloud::{OptionError, Options};

use crate::problem::Problem;

/// The query's names and values.
///
/// # Errors
/// [`Problem::Parameter`] where it is none.
pub(crate) fn pairs(uri: &Uri) -> Result<Vec<(String, String)>, Problem> {
    let pairs = Query::try_from_uri(uri).map_err(|error| Problem::parameter("query", error.to_string()));
    pairs.map(|Query(pairs)| pairs)
}

/// What a query asks for.
///
/// # Errors
/// As [`options_of`].
pub(crate) fn options(uri: &Uri) -> Result<Options, Problem> {
    options_of(&pairs(uri)?)
}

/// As [`options`], from names and values that came in another way. A request must say how dense its result shall be.
///
/// # Errors
/// [`Problem::Parameter`] naming the parameter and what it may be.
pub(crate) fn options_of(pairs: &[(String, String)]) -> Result<Options, Problem> {
    let options = Options::parse(pairs)?;
    if !Options::names_goal(pairs.iter().map(|(name, _)| name.as_str())) {
        let why = "missing; give ratio=R (1 to 64), points=N, spacing=D or density=N";
        return Err(Problem::parameter("ratio", why.into()));
    }
    Ok(options)
}

impl From<OptionError> for Problem {
    fn from(error: OptionError) -> Self {
        Self::parameter(&error.name, error.why)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(query: &str) -> Result<Options, Problem> {
        options(&format!("/upsample{query}").parse().expect("a URI"))
    }

    #[test]
    fn a_query_is_decoded_and_says_how_dense() {
        let options = parse("?ratio=2.5&attributes=a+b%26c:drop&keep_input").expect("options");
        assert_eq!(
            options,
            Options::parse(&[("ratio", "2.5"), ("attributes", "a b&c:drop"), ("keep_input", "true"),])
                .expect("options")
        );
        for (query, name) in
            [("", "ratio"), ("?", "ratio"), ("?seed=1", "ratio"), ("?ratio=4&ration=4", "ration")]
        {
            match parse(query) {
                Err(Problem::Parameter { name: found, .. }) => assert_eq!(found, name, "{query}"),
                other => panic!("{query}: {other:?}"),
            }
        }
    }
}
