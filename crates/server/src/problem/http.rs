//! A problem as an HTTP answer: RFC 9457, and the Open Inference Protocol's own form.

use axum::body::Body;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::{Problem, Row};
use crate::connection::decode::Coding;

impl Problem {
    /// The body, as JSON. A separate step from [`IntoResponse`], because only the outermost layer
    /// knows the request's id.
    pub(crate) fn body(&self, request_id: &str) -> Body {
        // Strings and numbers only: there is nothing that JSON could not hold.
        let mut text = serde_json::to_vec(&self.document(request_id)).unwrap_or_default();
        // For people at a terminal.
        text.push(b'\n');
        Body::from(text)
    }

    /// The same, to be part of another document.
    pub(crate) fn value(&self, request_id: &str) -> serde_json::Value {
        serde_json::to_value(self.document(request_id)).unwrap_or_default()
    }

    fn document<'a>(&'a self, request_id: &'a str) -> Document<'a> {
        let Row { status, name, title, setting } = self.row();
        Document {
            kind: format!("urn:densecloud:problem:{name}"),
            title,
            status: status.as_u16(),
            detail: self.to_string(),
            parameter: match self {
                Self::Parameter { name, .. } => Some(name),
                _ => None,
            },
            limit: self.limit(),
            setting,
            request_id,
        }
    }
}

/// The body of an error under `/v2`, as the Open Inference Protocol has it.
pub(crate) fn inference_error(problem: &Problem) -> Body {
    Body::from(serde_json::json!({ "error": problem.to_string() }).to_string())
}

/// The members of RFC 9457, then our own.
#[derive(Serialize)]
struct Document<'a> {
    #[serde(rename = "type")]
    kind: String,
    title: &'static str,
    status: u16,
    detail: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    parameter: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    limit: Option<serde_json::Number>,
    #[serde(skip_serializing_if = "Option::is_none")]
    setting: Option<&'static str>,
    request_id: &'a str,
}

impl IntoResponse for Problem {
    /// Status and headers; the problem itself goes along as an extension, for
    /// [`crate::connection::record`] to write its body.
    fn into_response(self) -> Response {
        let mut response = self.row().status.into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        if let Some(wait) = self.retry_after() {
            // Rounded up: one who comes back a moment early is refused again.
            let seconds = wait.as_secs() + u64::from(wait.subsec_nanos() > 0);
            headers.insert(header::RETRY_AFTER, seconds.max(1).into());
        }
        if let Self::Unauthorized(_) = self {
            // RFC 9110, section 15.5.2: says how to do it.
            let how = HeaderValue::from_static("Bearer realm=\"densecloud\"");
            headers.insert(header::WWW_AUTHENTICATE, how);
        }
        if let Self::UnsupportedEncoding(_) = self {
            // RFC 9110, section 15.5.16: says what would have been accepted.
            headers.insert(header::ACCEPT_ENCODING, HeaderValue::from_static(Coding::ACCEPTED));
        }
        if let Self::Range { length } = self {
            // RFC 9110, section 15.5.17: says what there is.
            let there = HeaderValue::from_str(&format!("bytes */{length}"));
            headers.insert(header::CONTENT_RANGE, there.unwrap_or(HeaderValue::from_static("bytes */*")));
        }
        response.extensions_mut().insert(self);
        response
    }
}
