//! A name for each request, in its response, its problem and the log.

use std::hash::{BuildHasher, RandomState};
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};

use axum::http::{HeaderMap, HeaderName, HeaderValue};

/// `x-request-id`.
pub(crate) const HEADER: HeaderName = HeaderName::from_static("x-request-id");

/// The client's own id where it gives a sane one, else one of ours.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct RequestId(String);

/// The longest id taken from a client.
const LONGEST: usize = 128;

/// Tells two processes' ids apart; nothing secret depends on it.
static PROCESS: LazyLock<u64> = LazyLock::new(|| RandomState::new().hash_one("densecloud"));
static NEXT: AtomicU64 = AtomicU64::new(0);

impl RequestId {
    /// The id of the request with these headers.
    pub(crate) fn of(headers: &HeaderMap) -> Self {
        match headers.get(HEADER).map(HeaderValue::as_bytes) {
            // Visible ASCII only: the id goes into the log and into JSON.
            Some(id) if (1..=LONGEST).contains(&id.len()) && id.iter().all(u8::is_ascii_graphic) => {
                Self(id.iter().map(|&byte| char::from(byte)).collect())
            }
            _ => Self(format!("{:016x}-{:x}", *PROCESS, NEXT.fetch_add(1, Ordering::Relaxed))),
        }
    }

    pub(crate) fn as_str(&self) -> &str {
        &self.0
    }

    /// For the response.
    pub(crate) fn header_value(&self) -> HeaderValue {
        // Visible ASCII by construction, so the fallback is never used.
        HeaderValue::from_str(&self.0).unwrap_or(HeaderValue::from_static("invalid"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(value: &[u8]) -> RequestId {
        let mut headers = HeaderMap::new();
        headers.insert(HEADER, HeaderValue::from_bytes(value).expect("a header value"));
        RequestId::of(&headers)
    }

    #[test]
    fn a_sane_id_is_kept() {
        assert_eq!(of(b"abc-123").as_str(), "abc-123");
        assert_eq!(of(b"abc-123").header_value(), "abc-123");
    }

    #[test]
    fn any_other_is_replaced_by_a_new_one() {
        let mut seen = std::collections::BTreeSet::new();
        for value in [&b""[..], b"two words", b"\xff", &[b'x'; LONGEST + 1], b"tab\there"] {
            let id = of(value);
            assert_eq!(id.header_value(), id.as_str());
            assert!(seen.insert(id.as_str().to_owned()), "{id:?} came twice");
        }
        assert!(seen.insert(RequestId::of(&HeaderMap::new()).0));
    }
}
