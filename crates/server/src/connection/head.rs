//! What HTTP asks of every head, where the HTTP library does not: one `Host`, a known transfer coding, a length.

use axum::body::Bytes;
use axum::extract::Request;
use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderValue, Method, Version, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use crate::connection::request_id::{self, RequestId};
use crate::problem::Problem;

/// The layer.
pub(crate) async fn check(request: Request, next: Next) -> Response {
    match judge(request.version(), request.method(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(problem) => {
            let mut response = problem.into_response();
            // Where its body ends is not known.
            response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
            response
        }
    }
}

fn judge(version: Version, method: &Method, headers: &HeaderMap) -> Result<(), Problem> {
    if version > Version::HTTP_11 {
        return Ok(());
    }
    check_host(version, headers)?;
    let codings = headers.get_all(header::TRANSFER_ENCODING);
    let codings: Vec<_> = codings.iter().map(|value| String::from_utf8_lossy(value.as_bytes())).collect();
    if !codings.is_empty() {
        return check_codings(&codings.join(","));
    }
    if version == Version::HTTP_10 && *method == Method::POST && !headers.contains_key(header::CONTENT_LENGTH)
    {
        return Err(Problem::LengthRequired);
    }
    Ok(())
}

/// RFC 9112, section 3.2.
fn check_host(version: Version, headers: &HeaderMap) -> Result<(), Problem> {
    let wrong = |why: &str| Err(Problem::MalformedRequest(why.to_owned()));
    let mut hosts = headers.get_all(header::HOST).iter();
    let Some(host) = hosts.next() else {
        return match version {
            Version::HTTP_11 => wrong("the head has no Host line; HTTP/1.1 needs one"),
            _ => Ok(()),
        };
    };
    if hosts.next().is_some() {
        return wrong("the head has several Host lines; there must be one");
    }
    let authority = Authority::try_from(host.as_bytes());
    if !host.is_empty() && authority.map_or(true, |authority| authority.as_str().contains('@')) {
        return wrong("the head's Host line is no name or address with or without a port");
    }
    Ok(())
}

/// RFC 9112, section 6.1: there is `chunked`, once.
fn check_codings(all: &str) -> Result<(), Problem> {
    let mut names = all.split(',').map(str::trim).filter(|name| !name.is_empty());
    let unknown = names.clone().find(|name| !name.eq_ignore_ascii_case("chunked"));
    match unknown {
        Some(unknown) => Err(Problem::TransferCoding(unknown.escape_debug().to_string())),
        None if names.nth(1).is_some() => {
            Err(Problem::MalformedRequest("Transfer-Encoding: chunked more than once".to_owned()))
        }
        None => Ok(()),
    }
}

/// The library's own words where it cannot tell where a body ends.
const REFUSED: &[u8] = b"HTTP/1.1 400 ";

/// The whole answer to a head that the library refuses as malformed, where all that is wrong with it is a transfer
/// coding that nobody here knows: RFC 9112 wants 501 for that. `answer` is how the library's own begins.
pub(crate) fn answer_instead(head: &[u8], answer: &[u8]) -> Option<Bytes> {
    let answer = answer.starts_with(REFUSED).then(|| String::from_utf8_lossy(answer))?;
    let end = head.windows(4).position(|bytes| bytes == b"\r\n\r\n")?;
    let head = String::from_utf8_lossy(&head[..end]);
    let (request, lines) = head.split_once("\r\n")?;
    if !request.ends_with(" HTTP/1.1") {
        return None;
    }
    let fields = lines.split("\r\n").filter_map(|line| line.split_once(':'));
    let codings = fields.filter(|(name, _)| name.eq_ignore_ascii_case("transfer-encoding"));
    let codings: Vec<&str> = codings.map(|(_, value)| value).collect();
    let Err(problem @ Problem::TransferCoding(_)) = check_codings(&codings.join(",")) else { return None };
    let id = RequestId::of(&HeaderMap::new());
    let date = answer.lines().find(|line| line.starts_with("date:")).unwrap_or("date:");
    let body = problem.value(id.as_str());
    let (status, length) = (problem.status(), body.to_string().len() + 1);
    tracing::info!(id = id.as_str(), outcome = problem.outcome(), "head refused");
    let text = format!(
        "HTTP/1.1 {status}\r\ncontent-type: application/problem+json\r\nconnection: close\r\n\
         content-length: {length}\r\n{}: {}\r\n{date}\r\n\r\n{body}\n",
        request_id::HEADER,
        id.as_str()
    );
    Some(text.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(version: Version, method: Method, lines: &[(&'static str, &'static str)]) -> String {
        let mut headers = HeaderMap::new();
        for (name, value) in lines {
            headers.append(*name, HeaderValue::from_static(value));
        }
        judge(version, &method, &headers)
            .map_or_else(|problem| problem.outcome().to_owned(), |()| "fine".into())
    }

    #[test]
    fn a_head_has_one_host_a_known_coding_and_a_length() {
        const HOST: (&str, &str) = ("host", "x:80");
        let (new, old) = (Version::HTTP_11, Version::HTTP_10);
        for (version, method, lines, expected) in [
            (new, Method::GET, &[HOST][..], "fine"),
            (new, Method::GET, &[("host", "[::1]:80")], "fine"),
            (new, Method::GET, &[("host", "")], "fine"),
            (new, Method::GET, &[], "malformed-request"),
            (new, Method::GET, &[HOST, HOST], "malformed-request"),
            (old, Method::GET, &[HOST, HOST], "malformed-request"),
            (new, Method::GET, &[("host", "me@x")], "malformed-request"),
            (new, Method::GET, &[("host", "a b")], "malformed-request"),
            (old, Method::GET, &[], "fine"),
            (Version::HTTP_2, Method::POST, &[], "fine"),
            (new, Method::POST, &[HOST, ("transfer-encoding", "Chunked")], "fine"),
            (new, Method::POST, &[HOST, ("transfer-encoding", "gzip, chunked")], "unknown-transfer-coding"),
            (
                new,
                Method::POST,
                &[HOST, ("transfer-encoding", "gzip"), ("transfer-encoding", "chunked")],
                "unknown-transfer-coding",
            ),
            (new, Method::POST, &[HOST, ("transfer-encoding", "chunked, chunked")], "malformed-request"),
            (new, Method::POST, &[HOST], "fine"),
            (old, Method::POST, &[HOST], "length-required"),
            (old, Method::POST, &[("content-length", "0")], "fine"),
        ] {
            assert_eq!(judged(version, method, lines), expected, "{lines:?}");
        }
    }

    #[test]
    fn only_an_unknown_coding_is_answered_in_the_librarys_place() {
        let refused = b"HTTP/1.1 400 Bad Request\r\ncontent-length: 0\r\ndate: today\r\n\r\n";
        let head = |lines: &str| format!("POST / HTTP/1.1\r\nhost: x\r\n{lines}\r\n").into_bytes();
        let answer = answer_instead(&head("Transfer-Encoding: gzip\r\n"), refused).expect("501");
        let text = String::from_utf8(answer.to_vec()).expect("text");
        assert!(text.starts_with("HTTP/1.1 501 Not Implemented\r\n") && text.contains("\r\ndate: today\r\n"));
        let (top, body) = text.split_once("\r\n\r\n").expect("a body");
        assert!(top.contains(&format!("content-length: {}", body.len())), "{text}");
        for (head, answer) in [
            (head("Transfer-Encoding: gzip\r\n"), &b"HTTP/1.1 200 OK\r\n\r\n"[..]),
            (head("Transfer-Encoding: chunked\r\n"), refused),
            (head("Content-Length: x\r\n"), refused),
            (b"POST / HTTP/1.1\r\nTransfer-Encoding: gzip\r\n".to_vec(), refused),
            (b"POST / HTTP/1.0\r\nTransfer-Encoding: gzip\r\n\r\n".to_vec(), refused),
        ] {
            assert_eq!(answer_instead(&head, answer), None, "{}", String::from_utf8_lossy(&head));
        }
    }
}
