//! What a request for points asks for: how they are read, how many are sent, in which order and in which form.

use axum::http::{HeaderMap, Uri, header};

use crate::connection::fields::{joined, weighted};
use crate::http::accepted::accepted;
use crate::http::query;
use crate::problem::Problem;
use densecloud::{Options, PARAMETERS, Parameter, Topic};
use densecloud_formats::{Format, Reading};

/// Points that are sent packed, where nobody says.
pub(crate) const LIMIT: u64 = 5_000_000;
/// And at most.
pub(crate) const MOST: u64 = 50_000_000;

/// The media type of the packed form.
pub(crate) const PACKED: &str = "application/vnd.densecloud.points";

/// What a request asks for.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Asked {
    pub(crate) reading: Reading,
    /// The most points of the packed form.
    pub(crate) limit: usize,
    pub(crate) order: Order,
    pub(crate) shape: As,
}

/// In which order points are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Order {
    /// Any first part of them is an even sample of all.
    Shuffled,
    /// As in the file.
    File,
}

/// In which form.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum As {
    Packed,
    File(Format),
}

impl Asked {
    /// # Errors
    /// [`Problem::Parameter`], or [`Problem::NotAcceptable`] where `Accept` names neither the packed form nor a format.
    pub(crate) fn of(uri: &Uri, headers: &HeaderMap) -> Result<Self, Problem> {
        let pairs = query::pairs(uri)?;
        if let Some((name, _)) = pairs
            .iter()
            .enumerate()
            .find_map(|(i, pair)| pairs[..i].iter().any(|(earlier, _)| *earlier == pair.0).then_some(pair))
        {
            return Err(Problem::parameter(name, "given twice".into()));
        }
        let (own, of_reading): (Vec<_>, Vec<_>) =
            pairs.into_iter().partition(|(name, _)| name == "limit" || name == "order");
        let (mut limit, mut order) = (LIMIT, Order::Shuffled);
        for (name, value) in own {
            match name.as_str() {
                "limit" => limit = limit_of(&value)?,
                _ => order = order_of(&value)?,
            }
        }
        let reading = reading(&of_reading)?;
        let limit = usize::try_from(limit).unwrap_or(usize::MAX);
        Ok(Self { reading, limit, order, shape: shape(headers)? })
    }
}

fn limit_of(value: &str) -> Result<u64, Problem> {
    let limit = value.parse().ok().filter(|limit| (1..=MOST).contains(limit));
    limit.ok_or_else(|| Problem::parameter("limit", format!("{value:?} is not a number from 1 to {MOST}")))
}

fn order_of(value: &str) -> Result<Order, Problem> {
    match value {
        "shuffled" => Ok(Order::Shuffled),
        "file" => Ok(Order::File),
        _ => Err(Problem::parameter("order", format!("{value:?} is neither shuffled nor file"))),
    }
}

/// The parameters that say how a file is read, and no others.
fn reading(pairs: &[(String, String)]) -> Result<Reading, Problem> {
    let is_known = |name: &str| Parameter::named(name).is_some_and(|one| one.topic == Topic::Reading);
    if let Some((name, _)) = pairs.iter().find(|(name, _)| !is_known(name)) {
        let known = PARAMETERS.iter().filter(|one| one.topic == Topic::Reading).map(|one| one.name);
        let known: Vec<&str> = ["limit", "order"].into_iter().chain(known).collect();
        return Err(Problem::parameter(name, format!("unknown; there are {}", known.join(", "))));
    }
    Ok(Options::parse(pairs)?.reading)
}

/// The packed form, unless a format is liked better.
fn shape(headers: &HeaderMap) -> Result<As, Problem> {
    let all = joined(headers, header::ACCEPT);
    if weighted(&all).any(|(kind, quality)| kind == PACKED && quality > 0.0) {
        return Ok(As::Packed);
    }
    Ok(accepted(headers)?.map_or(As::Packed, As::File))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(query: &str, accept: &str) -> Result<Asked, Problem> {
        let uri = format!("/points{query}").parse().expect("a path");
        Asked::of(&uri, &HeaderMap::from_iter([(header::ACCEPT, accept.parse().expect("a header"))]))
    }

    #[test]
    fn a_query_says_how_many_and_in_which_order_and_how_the_file_is_read() {
        let unsaid = asked("", "*/*").expect("a request");
        assert_eq!((unsaid.limit, unsaid.order, unsaid.shape), (LIMIT as usize, Order::Shuffled, As::Packed));
        let said = asked("?limit=7&order=file&axes=2,3,4&bounds=0,0,1,1", PACKED).expect("a request");
        assert_eq!((said.limit, said.order), (7, Order::File));
        assert!(said.reading.axes.is_some() && said.reading.bounds.is_some());
        for (query, wrong) in [
            ("?limit=0", "limit"),
            ("?limit=50000001", "limit"),
            ("?order=odd", "order"),
            ("?ratio=4", "ratio"),
            ("?limit=1&limit=1", "limit"),
            ("?axes=1,2", "axes"),
        ] {
            match asked(query, "*/*") {
                Err(Problem::Parameter { name, .. }) => assert_eq!(name, wrong, "{query}"),
                other => panic!("{query}: {other:?}"),
            }
        }
    }

    #[test]
    fn a_format_is_given_to_whoever_names_one() {
        let csv = Format::from_media_type("text/csv").expect("a format");
        for (accept, shape) in [
            ("*/*", Some(As::Packed)),
            (PACKED, Some(As::Packed)),
            ("text/csv", Some(As::File(csv))),
            ("text/csv;q=0.5, application/vnd.densecloud.points", Some(As::Packed)),
            ("application/vnd.densecloud.points;q=0, text/csv", Some(As::File(csv))),
            ("image/png", None),
        ] {
            assert_eq!(asked("", accept).ok().map(|asked| asked.shape), shape, "{accept}");
        }
    }
}
