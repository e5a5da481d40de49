//! Which format a client wants its result in: the header `Accept`.

use axum::http::{HeaderMap, header};

use crate::connection::fields::{joined, weighted};
use crate::problem::Problem;
use densecloud_formats::Format;

/// The format that the header asks for; `None` is any, and so the one of the input.
///
/// Reads all `Accept` headers (RFC 9110, section 12.5.1). Media types that are unknown here are skipped, as
/// the client names alternatives; no header means any.
///
/// # Errors
/// [`Problem::NotAcceptable`] when there is none that is written here.
pub(crate) fn accepted(headers: &HeaderMap) -> Result<Option<Format>, Problem> {
    let all = joined(headers, header::ACCEPT);
    if all.trim().is_empty() {
        return Ok(None);
    }
    let mut best: Option<(f32, Option<Format>)> = None;
    for (kind, quality) in weighted(&all) {
        let what = match kind.as_str() {
            "*/*" | "application/*" | "application/octet-stream" => None,
            "text/*" => Format::from_media_type("text/plain"),
            known => match Format::from_media_type(known) {
                Some(format) => Some(format),
                None => continue,
            },
        };
        // Of equal ones, the first named.
        if quality > best.map_or(0.0, |(quality, _)| quality) {
            best = Some((quality, what));
        }
    }
    best.map(|(_, what)| what).ok_or(Problem::NotAcceptable { wanted: all })
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_formats::Separator;

    fn format(accept: &str) -> Result<Option<Format>, Problem> {
        let mut headers = HeaderMap::new();
        headers.insert(header::ACCEPT, accept.parse().expect("a header"));
        accepted(&headers)
    }

    #[test]
    fn the_best_that_is_known_is_taken() {
        let csv = Format::text(Separator::Comma);
        for (accept, wanted) in [
            ("*/*", None),
            ("", None),
            ("text/html, */*;q=0.1", None),
            ("text/csv", Some(csv)),
            ("text/csv; charset=utf-8", Some(csv)),
            ("image/png, application/vnd.laszip", Some(Format::Las { compressed: true })),
            ("text/csv;q=0.5, Application/VND.las;q=0.9, */*;q=0.1", Some(Format::Las { compressed: false })),
            ("application/octet-stream", None),
            ("text/*", Format::from_media_type("text/plain")),
        ] {
            assert_eq!(format(accept).expect("a format"), wanted, "{accept}");
        }
        assert_eq!(accepted(&HeaderMap::new()), Ok(None));
        for refused in ["text/html", "model/stl", "image/*", "text/csv;q=0", "text/csv;Q=0"] {
            assert!(matches!(format(refused), Err(Problem::NotAcceptable { .. })), "{refused}");
        }
    }
}
