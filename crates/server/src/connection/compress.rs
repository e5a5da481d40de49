//! Compressing answers for clients that ask for it, while they are sent.
//!
//! A ready-made layer (tower-http's) would compress on the threads that serve all connections; here each
//! piece is compressed on a blocking thread, as everything that takes time is, and what the compressor
//! holds is counted like the rest.

use std::io::{self, Write};
use std::sync::Arc;

use axum::body::{Body, Bytes, HttpBody};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::Response;
use flate2::write::GzEncoder;
use futures::stream;
use http_body_util::{BodyExt, StreamBody};
use hyper::body::Frame;
use tokio::task::spawn_blocking;
use zstd::stream::write::Encoder as ZstdEncoder;
use zstd::zstd_safe::CParameter;

use crate::admission::budget::Held;
use crate::app::App;
use crate::connection::fields::{joined, weighted};
use densecloud_formats::Format;

/// How an answer is compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Compression {
    Gzip,
    Zstd,
}

/// Left on a response that is to be sent as it is.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AsIs;

/// At this level both compress about as fast as a fast network sends; the processors are for the cascade.
const LEVEL: u32 = 3;
/// zstd's window, as a power of two: clouds repeat themselves within a few points or not at all.
const ZSTD_WINDOW: u32 = 20;
/// Memory of either compressor, at most.
const MEMORY: u64 = 4 << 20;
/// Answers shorter than this are not worth it.
const SHORTEST: u64 = 1024;

impl Compression {
    /// The coding of the highest weight: zstd before gzip where they are equal, none where identity has a higher one.
    /// `*` names no coding and counts as none.
    pub(crate) fn preferred(headers: &HeaderMap) -> Option<Self> {
        let (mut best, mut identity) = (None, 0.0);
        for (name, quality) in weighted(&joined(headers, header::ACCEPT_ENCODING)) {
            let named = match name.as_str() {
                "gzip" | "x-gzip" => Self::Gzip,
                "zstd" => Self::Zstd,
                "identity" => {
                    identity = quality;
                    continue;
                }
                _ => continue,
            };
            if quality > best.map_or(0.0, |(quality, _)| quality) || best == Some((quality, Self::Gzip)) {
                best = Some((quality, named));
            }
        }
        best.filter(|(quality, _)| *quality >= identity).map(|(_, named)| named)
    }

    /// As [`Compression::preferred`], for a file of this kind and length.
    pub(crate) fn of_file(headers: &HeaderMap, media_type: &str, length: u64) -> Option<Self> {
        Self::preferred(headers).filter(|_| length >= SHORTEST && shrinks(media_type))
    }

    /// The tag of what has this one as it is: another representation needs another tag.
    pub(crate) fn tag(self, tag: &str) -> String {
        format!("{}-{}\"", tag.trim_end_matches('"'), self.name())
    }

    fn name(self) -> &'static str {
        match self {
            Self::Gzip => "gzip",
            Self::Zstd => "zstd",
        }
    }
}

/// Whether a kind of answer becomes smaller; LAZ, E57 and images do not, and events must not wait.
fn shrinks(media_type: &str) -> bool {
    let kind = media_type.split(';').next().unwrap_or_default().trim();
    matches!(
        kind,
        "application/octet-stream" | "application/json" | "text/html" | "text/css" | "text/javascript"
    ) || Format::from_media_type(kind).is_some_and(|format| !format.is_packed())
}

/// The layer.
pub(crate) async fn compress(State(app): State<Arc<App>>, request: Request, next: Next) -> Response {
    let preferred = Compression::preferred(request.headers());
    let bodyless = request.method() == Method::HEAD;
    let mut response = next.run(request).await;
    let headers = response.headers();
    let kind = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
    if response.extensions().get::<AsIs>().is_none() && shrinks(kind) {
        response.headers_mut().append(header::VARY, HeaderValue::from_static("accept-encoding"));
    } else {
        return response;
    }
    let headers = response.headers();
    let told = headers.get(header::CONTENT_LENGTH).and_then(|length| length.to_str().ok()?.parse().ok());
    let length: Option<u64> = told.or_else(|| response.body().size_hint().exact());
    if response.status() != StatusCode::OK || length.is_some_and(|length| length < SHORTEST) {
        return response;
    }
    let Some(compression) = preferred else { return response };
    // Without memory for a compressor, the answer is sent as it is.
    let Some(held) = app.budget.hold(MEMORY) else { return response };
    let Ok(encoder) = Encoder::new(compression) else { return response };
    let headers = response.headers_mut();
    headers.remove(header::CONTENT_LENGTH);
    headers.remove(header::ACCEPT_RANGES);
    let tag = headers
        .get(header::ETAG)
        .and_then(|tag| HeaderValue::from_str(&compression.tag(tag.to_str().ok()?)).ok());
    if let Some(tag) = tag {
        headers.insert(header::ETAG, tag);
    }
    headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static(compression.name()));
    if bodyless { response } else { response.map(|body| encoded(body, encoder, held)) }
}

/// What is left of a body that is compressed.
enum Left {
    Body(Body, Encoder, Held),
    Trailers(HeaderMap),
    Nothing,
}

/// The body, compressed as fast as the client reads; trailers as they are.
fn encoded(body: Body, encoder: Encoder, held: Held) -> Body {
    let frames = stream::try_unfold(Left::Body(body, encoder, held), |left| async move {
        let (mut body, mut encoder, held) = match left {
            Left::Body(body, encoder, held) => (body, encoder, held),
            Left::Trailers(fields) => return Ok(Some((Frame::trailers(fields), Left::Nothing))),
            Left::Nothing => return Ok(None),
        };
        loop {
            let frame = body.frame().await.transpose().map_err(io::Error::other)?;
            let piece = match frame.map(Frame::into_data) {
                Some(Ok(piece)) => piece,
                end => {
                    let trailers = end.and_then(|frame| frame.err()?.into_trailers().ok());
                    let last = spawn_blocking(move || encoder.finish()).await.map_err(io::Error::other)??;
                    return Ok(Some((Frame::data(last), trailers.map_or(Left::Nothing, Left::Trailers))));
                }
            };
            let step = spawn_blocking(move || encoder.add(&piece).map(|ready| (ready, encoder)));
            let ready;
            (ready, encoder) = step.await.map_err(io::Error::other)??;
            if !ready.is_empty() {
                return Ok::<_, io::Error>(Some((Frame::data(ready), Left::Body(body, encoder, held))));
            }
        }
    });
    Body::new(StreamBody::new(Box::pin(frames)))
}

enum Encoder {
    Gzip(GzEncoder<Vec<u8>>),
    Zstd(Box<ZstdEncoder<'static, Vec<u8>>>),
}

impl Encoder {
    fn new(compression: Compression) -> io::Result<Self> {
        Ok(match compression {
            Compression::Gzip => Self::Gzip(GzEncoder::new(Vec::new(), flate2::Compression::new(LEVEL))),
            Compression::Zstd => {
                let mut encoder = ZstdEncoder::new(Vec::new(), LEVEL as i32)?;
                encoder.set_parameter(CParameter::WindowLog(ZSTD_WINDOW))?;
                Self::Zstd(Box::new(encoder))
            }
        })
    }

    /// Takes a piece, and gives what is ready, which may be nothing yet.
    fn add(&mut self, piece: &[u8]) -> io::Result<Bytes> {
        let ready = match self {
            Self::Gzip(encoder) => {
                encoder.write_all(piece)?;
                encoder.get_mut()
            }
            Self::Zstd(encoder) => {
                encoder.write_all(piece)?;
                encoder.get_mut()
            }
        };
        Ok(std::mem::take(ready).into())
    }

    fn finish(self) -> io::Result<Bytes> {
        Ok(match self {
            Self::Gzip(encoder) => encoder.finish()?.into(),
            Self::Zstd(encoder) => encoder.finish()?.into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::admission::budget::Budget;
    use std::io::Read;

    #[test]
    fn the_best_liked_is_chosen() {
        use Compression::{Gzip, Zstd};
        for (values, expected) in [
            (&[][..], None),
            (&["gzip"], Some(Gzip)),
            (&["X-GZIP"], Some(Gzip)),
            (&["deflate, gzip, br, zstd"], Some(Zstd)),
            (&["zstd, gzip"], Some(Zstd)),
            (&["zstd;q=0.5, gzip"], Some(Gzip)),
            (&["zstd;q=0.5", "gzip;q=0.4"], Some(Zstd)),
            (&["gzip;q=0"], None),
            (&["gzip;q=none"], None),
            (&["gzip;q=0.2, identity;q=0.5"], None),
            (&["gzip;q=0.5, identity;q=0.5"], Some(Gzip)),
            (&["br, *"], None),
        ] {
            let mut headers = HeaderMap::new();
            for value in values {
                headers.append(header::ACCEPT_ENCODING, HeaderValue::from_static(value));
            }
            assert_eq!(Compression::preferred(&headers), expected, "{values:?}");
        }
    }

    #[tokio::test]
    async fn bodies_come_out_as_they_went_in_and_the_memory_comes_back() {
        let text: Vec<u8> = (0..50_000_u32).flat_map(|i| format!("{i} 2 3\n").into_bytes()).collect();
        for compression in [Compression::Gzip, Compression::Zstd] {
            let budget = Budget::new(MEMORY);
            let pieces = text.chunks(7000).map(|piece| Ok::<_, io::Error>(Bytes::copy_from_slice(piece)));
            let body = Body::from_stream(stream::iter(pieces.collect::<Vec<_>>()));
            let encoder = Encoder::new(compression).expect("memory");
            let encoded = encoded(body, encoder, budget.hold(MEMORY).expect("room"));
            let bytes = axum::body::to_bytes(encoded, usize::MAX).await.expect("a body");
            assert!(bytes.len() < text.len() / 3, "{compression:?}");
            let mut decoded = Vec::new();
            match compression {
                Compression::Gzip => {
                    flate2::read::GzDecoder::new(&bytes[..]).read_to_end(&mut decoded).expect("gzip");
                }
                Compression::Zstd => decoded = zstd::decode_all(&bytes[..]).expect("zstd"),
            }
            assert!(decoded == text, "{compression:?}");
            assert_eq!(budget.used(), 0);
        }
    }

    #[tokio::test]
    async fn a_body_that_breaks_off_is_not_made_whole() {
        let pieces = [Ok(Bytes::from_static(b"1 2 3\n")), Err(io::Error::other("gone"))];
        let encoder = Encoder::new(Compression::Gzip).expect("memory");
        let held = Budget::new(MEMORY).hold(MEMORY).expect("room");
        let encoded = encoded(Body::from_stream(stream::iter(pieces)), encoder, held);
        assert!(axum::body::to_bytes(encoded, usize::MAX).await.is_err());
    }
}
