//! What fields of a request's head say: lists with weights, tags of what a client has, a part of a file.
//!
//! Ranges are read by `http-range-header`. Lists and tags are read here, in a few lines each, since the crates for them
//! do worse: `headers-accept` 0.3 refuses all of an `Accept` for one element that it cannot read, such as the `*` that
//! Java sends, or an empty one, which is to be ignored, and puts what is more specific before what is liked better.
//! `headers` 0.4 reads neither `Accept` nor `Accept-Encoding`, takes no suffix that is longer than the file, and brings a
//! second family of hashing crates for what is left, which is to compare two tags.

use std::ops::Range;

use axum::http::{HeaderMap, HeaderName};
use http_range_header::{SyntacticallyCorrectRange as Part, parse_range_header};

use crate::problem::Problem;

/// All fields of a name as one, which is what several of them mean (RFC 9110, section 5.3); those that are no text are
/// left out.
pub(crate) fn joined(headers: &HeaderMap, name: HeaderName) -> String {
    let values: Vec<&str> = headers.get_all(name).iter().filter_map(|value| value.to_str().ok()).collect();
    values.join(",")
}

/// The elements of a list such as `Accept` is, in lower case and without their parameters, each with its weight (RFC
/// 9110, section 12.4.2): 1 where it has none, 0 where that is no number.
pub(crate) fn weighted(list: &str) -> impl Iterator<Item = (String, f32)> {
    list.split(',').map(|element| {
        let mut parts = element.split(';').map(str::trim);
        let name = parts.next().unwrap_or_default().to_ascii_lowercase();
        let weight = parts.find_map(|part| part.strip_prefix("q=").or_else(|| part.strip_prefix("Q=")));
        (name, weight.map_or(1.0, |weight| weight.parse().unwrap_or(0.0)))
    })
}

/// Whether one of the tags in a list is this one, weak or not (RFC 9110, section 13.1.2); `*` is any.
pub(crate) fn has_tag(list: &str, tag: &str) -> bool {
    list.split(',').map(str::trim).any(|one| one == "*" || one.trim_start_matches("W/") == tag)
}

/// The part of so many bytes that a `Range` field asks for; none where the whole is to be sent: for what
/// is not understood, and for several parts at once (RFC 9110, section 14.2, lets a server do so).
///
/// # Errors
/// [`Problem::Range`] where the part has no bytes.
pub(crate) fn part(field: &str, length: u64) -> Result<Option<Range<u64>>, Problem> {
    let parts = parse_range_header(field).map(|parts| parts.into_ranges());
    let Ok([part]) = parts.as_deref() else { return Ok(None) };
    let part = match *part {
        Part::FromStart(first) => first..length,
        Part::FromLast(count) => length.saturating_sub(count)..length,
        Part::Indexed(first, last) => first..length.min(last.saturating_add(1)),
    };
    if part.is_empty() { Err(Problem::Range { length }) } else { Ok(Some(part)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_come_with_their_weights() {
        let found = |list| weighted(list).collect::<Vec<_>>();
        let one = |name: &str, weight| (name.to_owned(), weight);
        assert_eq!(found("Text/CSV; charset=utf-8;q=0.5"), [one("text/csv", 0.5)]);
        // What Java's own client sends where nobody says.
        assert_eq!(
            found("text/html, *; q=.2, */*; Q=.2,"),
            [one("text/html", 1.0), one("*", 0.2), one("*/*", 0.2), one("", 1.0)]
        );
        assert_eq!(found("gzip;q=none"), [one("gzip", 0.0)]);
    }

    #[test]
    fn fields_of_one_name_are_one_list() {
        let mut headers = HeaderMap::new();
        for value in [&b"a, b"[..], b"\xff", b"c"] {
            headers.append("accept", axum::http::HeaderValue::from_bytes(value).expect("a value"));
        }
        assert_eq!(joined(&headers, axum::http::header::ACCEPT), "a, b,c");
    }

    #[test]
    fn a_tag_is_found_whether_weak_or_not() {
        for (list, found) in [
            ("\"one\"", true),
            ("W/\"one\"", true),
            ("\"other\", \"one\"", true),
            ("*", true),
            ("\"one-gzip\"", false),
            ("one", false),
            ("", false),
        ] {
            assert_eq!(has_tag(list, "\"one\""), found, "{list}");
        }
    }

    #[test]
    fn one_range_is_read_as_the_standard_says() {
        for (header, expected) in [
            ("bytes=0-0", Ok(Some(0..1))),
            ("bytes=2-", Ok(Some(2..10))),
            ("bytes=2-99", Ok(Some(2..10))),
            ("bytes=9-18446744073709551615", Ok(Some(9..10))),
            ("bytes=-3", Ok(Some(7..10))),
            ("bytes=-99", Ok(Some(0..10))),
            ("bytes=10-", Err(Problem::Range { length: 10 })),
            ("bytes=-0", Err(Problem::Range { length: 10 })),
            ("bytes=5-2", Ok(None)),
            ("bytes=1-2,4-5", Ok(None)),
            ("lines=1-2", Ok(None)),
            ("bytes=x-", Ok(None)),
        ] {
            assert_eq!(part(header, 10), expected, "{header}");
        }
    }
}
