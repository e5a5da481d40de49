//! Which web pages from elsewhere may use the server: none, unless they are named (`--cors-origin`).

use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tower_http::cors::{AllowHeaders, AllowOrigin, Any, CorsLayer};

use crate::app::App;
use crate::problem::Problem;

/// Pages of one site, or of all.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CorsOrigin {
    /// `*`: every page anywhere.
    Any,
    /// As a browser's `Origin` header has it: `https://example.org`, `http://localhost:3000`.
    Site(HeaderValue),
}

impl FromStr for CorsOrigin {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if text == "*" {
            return Ok(Self::Any);
        }
        let whole =
            "an origin is a scheme, a host and perhaps a port, such as https://example.org, or it is *";
        // Browsers compare letter by letter, and send lower case without a path.
        let lower = !text.bytes().any(|byte| byte.is_ascii_uppercase());
        let uri: Uri = text.parse().map_err(|_| whole)?;
        let scheme = uri.scheme_str().ok_or(whole)?;
        let authority = uri.authority().ok_or(whole)?;
        if !lower || text != format!("{scheme}://{authority}") || authority.as_str().contains('@') {
            return Err(whole);
        }
        HeaderValue::from_str(text).map(Self::Site).map_err(|_| whole)
    }
}

/// For how long a browser need not ask again what is allowed.
const MAX_AGE: Duration = Duration::from_secs(3600);

/// What answers browsers on behalf of every path; nothing where no origin is allowed.
///
/// The layer lies outside all that refuse requests: a browser asks first, without the request's own headers, and a
/// page cannot read a refusal that lacks the headers of CORS.
pub(crate) fn layer(origins: &[CorsOrigin]) -> Option<CorsLayer> {
    let sites: Vec<_> = origins
        .iter()
        .filter_map(|origin| match origin {
            CorsOrigin::Any => None,
            CorsOrigin::Site(site) => Some(site.clone()),
        })
        .collect();
    let allowed = match origins {
        [] => return None,
        origins if origins.contains(&CorsOrigin::Any) => AllowOrigin::any(),
        _ => AllowOrigin::list(sites),
    };
    Some(
        CorsLayer::new()
            .allow_origin(allowed)
            .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::DELETE])
            // Those that it asks for: a star would leave out Authorization.
            .allow_headers(AllowHeaders::mirror_request())
            .expose_headers(Any)
            .max_age(MAX_AGE),
    )
}

/// Refuses work and deletions that a page of another site asks for. A browser keeps their answers from that page, but
/// sends a form, or plain text, for it without asking first: the visitor's machine would do the work.
pub(crate) async fn keep_out(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let reads = matches!(*request.method(), Method::GET | Method::HEAD | Method::OPTIONS);
    // Of HTTP/2, in the URI.
    let host = request.uri().authority().map(|host| host.as_str().to_owned());
    if !reads && is_foreign(request.headers(), host.as_deref(), &app.config.cors) {
        return Problem::CrossSite.into_response();
    }
    next.run(request).await
}

/// Whether the browser's headers tell that a page sent this which is neither the server's own nor allowed. Other
/// programs send neither header.
fn is_foreign(headers: &HeaderMap, host: Option<&str>, allowed: &[CorsOrigin]) -> bool {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    let origin = headers.get(header::ORIGIN);
    if allowed.contains(&CorsOrigin::Any)
        || origin.is_some_and(|origin| allowed.contains(&CorsOrigin::Site(origin.clone())))
    {
        return false;
    }
    // Where it is there it knows best: behind a proxy, the host may be another one.
    if headers.contains_key("sec-fetch-site") {
        return !matches!(text("sec-fetch-site"), Some("same-origin" | "none"));
    }
    let Some(origin) = origin else { return false };
    let site = origin.to_str().ok().and_then(|origin| origin.split_once("://")).map(|(_, site)| site);
    let host = host.or_else(|| text("host"));
    !matches!((site, host), (Some(site), Some(host)) if site.eq_ignore_ascii_case(host))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_the_servers_own_a_named_one_or_foreign() {
        let site = "https://example.org";
        for (origin, fetch, foreign) in [
            (None, None, false),
            (Some("http://cloud:8080"), None, false),
            (Some("HTTP://Cloud:8080"), None, false),
            (Some("https://public.example.org"), Some("same-origin"), false),
            (None, Some("none"), false),
            (Some(site), Some("cross-site"), false),
            (Some(site), None, false),
            (Some("http://cloud:3000"), None, true),
            (Some("http://cloud"), None, true),
            (Some("http://cloud:8080"), Some("cross-site"), true),
            (Some("http://cloud:3000"), Some("same-site"), true),
            (Some("null"), None, true),
            (Some(""), None, true),
            (None, Some("cross-site"), true),
            (None, Some("?"), true),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, HeaderValue::from_static("cloud:8080"));
            for (name, value) in [("origin", origin), ("sec-fetch-site", fetch)] {
                if let Some(value) = value {
                    headers.insert(name, HeaderValue::from_static(value));
                }
            }
            let named = [CorsOrigin::Site(HeaderValue::from_static(site))];
            assert_eq!(is_foreign(&headers, None, &named), foreign, "{origin:?} {fetch:?}");
            assert!(!is_foreign(&headers, None, &[CorsOrigin::Any]));
            headers.remove(header::HOST);
            assert_eq!(is_foreign(&headers, Some("cloud:8080"), &named), foreign, "{origin:?} {fetch:?}");
        }
    }

    #[test]
    fn an_origin_is_what_a_browser_sends() {
        for good in ["https://example.org", "http://localhost:3000", "http://127.0.0.1", "http://[::1]:80"] {
            assert_eq!(good.parse(), Ok(CorsOrigin::Site(HeaderValue::from_static(good))));
        }
        assert_eq!("*".parse(), Ok(CorsOrigin::Any));
        for bad in [
            "",
            "example.org",
            "https://example.org/",
            "https://example.org/page",
            "https://Example.org",
            "https://me@example.org",
            "https://*.example.org/",
            "https://a.org,https://b.org",
            "null",
        ] {
            assert!(bad.parse::<CorsOrigin>().is_err(), "{bad:?}");
        }
    }
}
