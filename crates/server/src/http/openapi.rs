//! What the interface is, for programs (`GET /openapi.json`) and for people (`GET /docs`).
//!
//! The description is a file, `docs/openapi.json`, so that it can be read and compared without a server. It is written
//! by hand: handlers take heads and bodies as they come, so that limits hold before anything is read, and the types that
//! a generator could read know a tenth of it. What parameters, headers, answers and statuses mean would stand in
//! attributes instead, no less by hand. So tests hold it against the program: each path and method against the table that
//! the router is made of, each parameter with its bounds and default against what reads it, each problem and status
//! against the table of problems, and each schema against what the handlers answer.

#[cfg(test)]
mod schema;
#[cfg(test)]
mod tests;

use std::borrow::Cow;

use axum::Extension;
use axum::http::header;
use axum::response::IntoResponse;

use crate::connection::prefix::Prefix;

const DESCRIPTION: &str = include_str!("../../../../docs/openapi.json");
const PAGE: &str = include_str!("docs.html");

/// What the page may load and run: itself, and what this server answers.
const POLICY: &str =
    "default-src 'none'; connect-src 'self'; script-src 'unsafe-inline'; style-src 'unsafe-inline'";

/// Where the description says that the server is at the root.
const ROOT: &str = "\"url\": \"/\"";

/// `GET /openapi.json`.
pub(crate) async fn openapi(Extension(prefix): Extension<Prefix>) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json")], description_under(&prefix))
}

/// The description of a server that others see under a prefix, which has nothing that JSON would escape.
fn description_under(prefix: &Prefix) -> Cow<'static, str> {
    match prefix.as_str() {
        "" => DESCRIPTION.into(),
        prefix => DESCRIPTION.replacen(ROOT, &format!("\"url\": \"{prefix}\""), 1).into(),
    }
}

/// `GET /docs`.
pub(crate) async fn docs() -> impl IntoResponse {
    let headers =
        [(header::CONTENT_TYPE, "text/html; charset=utf-8"), (header::CONTENT_SECURITY_POLICY, POLICY)];
    (headers, PAGE)
}
