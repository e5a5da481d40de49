//! The path under which others see the server: links begin with it.

use std::str::FromStr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::uri::PathAndQuery;
use axum::http::{HeaderMap, Uri};
use axum::middleware::Next;
use axum::response::Response;

use crate::app::{self, App};

/// A path before all others (`--base-path`): `/clouds`; none by default.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct BasePath(String);

impl FromStr for BasePath {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let path = text.strip_suffix('/').unwrap_or(text);
        if path.is_empty() {
            return Ok(Self::default());
        }
        let why = "not a path such as /clouds, of letters, digits, -, _, . and ~ between single slashes";
        let path = sane(path).ok_or(why)?;
        match first(path) {
            // It could not be told from a path before it.
            Some(part) if app::routes().iter().any(|route| first(route.path) == Some(part)) => {
                Err(format!("/{part} is a path of the server's own"))
            }
            _ => Ok(Self(path.to_owned())),
        }
    }
}

/// A path's first part.
fn first(path: &str) -> Option<&str> {
    path.split('/').nth(1)
}

/// A path that may stand before others, if this is one.
fn sane(path: &str) -> Option<&str> {
    let part = |part: &str| {
        let known = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte);
        !matches!(part, "" | "." | "..") && part.bytes().all(known)
    };
    path.strip_prefix('/')?.split('/').all(part).then_some(path)
}

impl BasePath {
    /// Takes the path away from a request's where a proxy has not done so.
    pub(crate) fn strip(&self, uri: &mut Uri) {
        if self.0.is_empty() {
            return;
        }
        let Some(rest) = uri.path_and_query().and_then(|path| path.as_str().strip_prefix(&self.0)) else {
            return;
        };
        // What only begins like it is another path.
        if !rest.starts_with('/') {
            return;
        }
        let mut parts = uri.clone().into_parts();
        // Cannot fail: it is the end of one.
        let Ok(path) = PathAndQuery::try_from(rest) else { return };
        parts.path_and_query = Some(path);
        if let Ok(stripped) = Uri::from_parts(parts) {
            *uri = stripped;
        }
    }
}

/// What the links of one answer begin with.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Prefix(Arc<str>);

impl Prefix {
    /// Of an answer to a request with these headers: a trusted proxy that takes a part of the path away says so in
    /// `X-Forwarded-Prefix`, which counts before the setting.
    fn of(headers: &HeaderMap, trusted: bool, base: &BasePath) -> Self {
        let told = headers.get_all("x-forwarded-prefix").iter().next_back().filter(|_| trusted);
        let told = told.and_then(|value| value.to_str().ok()?.rsplit(',').next());
        let told = told.map(|path| path.trim().trim_end_matches('/'));
        // A host could stand there, too: the links would lead to it.
        let told = told.filter(|path| path.is_empty() || sane(path).is_some());
        Self(told.unwrap_or(&base.0).into())
    }

    #[cfg(test)]
    pub(crate) fn of_path(path: &str) -> Self {
        Self(path.into())
    }

    /// A path of ours as others see it.
    pub(crate) fn link(&self, path: &str) -> String {
        format!("{}{path}", self.0)
    }

    /// Itself.
    pub(crate) fn as_str(&self) -> &str {
        &self.0
    }
}

/// Leaves the prefix for the handlers.
pub(crate) async fn find(State(app): State<Arc<App>>, mut request: Request, next: Next) -> Response {
    let config = &app.config;
    let prefix = Prefix::of(request.headers(), config.access.trust_forwarded, &config.base_path);
    request.extensions_mut().insert(prefix);
    next.run(request).await
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    #[test]
    fn a_base_path_is_a_plain_path_and_none_of_ours() {
        for (text, path) in
            [("", ""), ("/", ""), ("/x", "/x"), ("/x/", "/x"), ("/clouds/v1.2_a-b~", "/clouds/v1.2_a-b~")]
        {
            assert_eq!(text.parse(), Ok(BasePath(path.to_owned())), "{text}");
        }
        for bad in ["x", "//x", "/x//y", "/x/..", "/./x", "/x y", "/é", "/x?y", "http://x/y"] {
            assert!(bad.parse::<BasePath>().is_err_and(|why| why.contains("such as /clouds")), "{bad}");
        }
        for own in ["/upsample", "/jobs", "/jobs/mine", "/healthz", "/openapi.json", "/v2/x", "/v2"] {
            assert!(own.parse::<BasePath>().is_err_and(|why| why.contains("server's own")), "{own}");
        }
    }

    #[test]
    fn a_path_is_found_with_the_base_and_without() {
        let base: BasePath = "/x/y".parse().expect("a path");
        for (asked, found) in [
            ("/x/y/jobs?limit=2", "/jobs?limit=2"),
            ("/jobs?limit=2", "/jobs?limit=2"),
            ("/x/y/", "/"),
            ("/x/y", "/x/y"),
            ("/x/yjobs", "/x/yjobs"),
            ("http://host/x/y/jobs", "http://host/jobs"),
        ] {
            let mut uri = asked.parse().expect("a URI");
            base.strip(&mut uri);
            assert_eq!(uri, found, "{asked}");
            let mut uri: Uri = asked.parse().expect("a URI");
            BasePath::default().strip(&mut uri);
            assert_eq!(uri, asked);
        }
    }

    #[test]
    fn a_trusted_proxy_says_where_it_is() {
        let base: BasePath = "/base".parse().expect("a path");
        let link = |values: &[&'static str], trusted: bool| {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append("x-forwarded-prefix", HeaderValue::from_static(value));
            }
            Prefix::of(&headers, trusted, &base).link("/jobs")
        };
        for (values, trusted, expected) in [
            (&[][..], true, "/base/jobs"),
            (&["/x"], true, "/x/jobs"),
            (&["/x"], false, "/base/jobs"),
            (&["/x/"], true, "/x/jobs"),
            (&["/"], true, "/jobs"),
            (&["/forged, /x"], true, "/x/jobs"),
            (&["/forged", "/x"], true, "/x/jobs"),
            (&["//example.org"], true, "/base/jobs"),
            (&["https://example.org/"], true, "/base/jobs"),
            (&["/x\"y"], true, "/base/jobs"),
        ] {
            assert_eq!(link(values, trusted), expected, "{values:?}");
        }
    }
}
