//! Which web pages from elsewhere may use the server: none, unless they are named (`--cors-origin`).

use std::str::FromStr;
use std::time::Duration;

use axum::http::{HeaderValue, Method, Uri};
use tower_http::cors::{AllowHeaders, AllowOrigin, Any, CorsLayer};

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
/// It has to lie outside whatever refuses requests: a browser asks first, without the request's own
/// headers, and a refusal that a page may not read helps nobody.
pub(super) fn layer(origins: &[CorsOrigin]) -> Option<CorsLayer> {
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

#[cfg(test)]
mod tests {
    use super::*;

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
