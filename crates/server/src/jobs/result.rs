//! `GET /jobs/{id}/result`: the file, or a part of it.

use std::io::{self, SeekFrom};
use std::ops::Range;
use std::sync::Arc;

use axum::body::{Body, Bytes};
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures::stream;
use tokio::task::spawn_blocking;

use crate::admission::budget::Held;
use crate::app::App;
use crate::connection::compress::{AsIs, Compression};
use crate::connection::fields::{has_tag, joined, part};
use crate::jobs::document::about;
use crate::jobs::{JobId, finished};
use crate::problem::Problem;
use densecloud_engine::Client;
use densecloud_jobs::BlobReader;

/// Bytes read at a time.
const CHUNK: u64 = 64 << 10;
/// Pieces of a result in memory: one is read, or waits to be sent, while the one before it is.
const PIECES: u64 = 2;

/// The handler. Also answers `HEAD`, since axum leaves the body out there.
pub(crate) async fn result(
    State(app): State<Arc<App>>,
    Extension(client): Extension<Client>,
    JobId(id): JobId,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (result, mut file) = finished(&app, &client, id).await?;
    let about = about(&result)?;
    // Parts are parts of the file as it is. What is compressed is sent whole, under a tag of its own.
    let range = headers.get(header::RANGE).filter(|_| method == Method::GET);
    let compression = match range {
        None if !about.packed => Compression::of_file(&headers, &about.media_type, result.bytes),
        _ => None,
    };
    let plain = format!("\"{}\"", result.sha256);
    let tag = compression.map_or_else(|| plain.clone(), |one| one.tag(&plain));
    let mut response = if has_tag(&joined(&headers, header::IF_NONE_MATCH), &tag) {
        let mut response = StatusCode::NOT_MODIFIED.into_response();
        response.headers_mut().insert(header::ETAG, value(&tag)?);
        response
    } else {
        // A part of another version of the file would be of no use (RFC 9110, section 13.1.5).
        let valid = headers.get(header::IF_RANGE).is_none_or(|one| one.as_bytes() == plain.as_bytes());
        let range = range.filter(|_| valid).and_then(|range| range.to_str().ok());
        let part = range.map_or(Ok(None), |range| part(range, result.bytes))?;
        let Range { start, end } = part.clone().unwrap_or(0..result.bytes);
        if start > 0 {
            // A seek only sets a number: it waits for nothing.
            file.seek(SeekFrom::Start(start)).map_err(|error| Problem::Internal(error.to_string()))?;
        }
        let held = app.budget.hold((end - start).min(PIECES * CHUNK)).ok_or_else(|| app.held_full())?;
        let mut response = body(file, end - start, held).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_LENGTH, (end - start).into());
        // Whoever compresses it changes the tag and takes the ranges away.
        headers.insert(header::ETAG, value(&plain)?);
        headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
        if part.is_some() {
            headers.insert(
                header::CONTENT_RANGE,
                value(&format!("bytes {start}-{}/{}", end - 1, result.bytes))?,
            );
            *response.status_mut() = StatusCode::PARTIAL_CONTENT;
        }
        response
    };
    about.tell(response.headers_mut());
    response.headers_mut().insert(header::CONTENT_DISPOSITION, about.disposition());
    if range.is_some() && !about.packed {
        response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    }
    if about.packed || range.is_some() {
        response.extensions_mut().insert(AsIs);
    }
    Ok(response)
}

fn value(text: &str) -> Result<HeaderValue, Problem> {
    HeaderValue::from_str(text).map_err(|error| Problem::Internal(error.to_string()))
}

/// So many bytes of a result from where its reader stands, read as fast as the client reads.
fn body(file: Box<dyn BlobReader>, left: u64, held: Held) -> Body {
    Body::from_stream(stream::try_unfold((file, left, held), |(mut file, left, held)| async move {
        if left == 0 {
            return Ok(None);
        }
        let read = spawn_blocking(move || {
            let mut bytes = vec![0; left.min(CHUNK) as usize];
            file.read_exact(&mut bytes).map(|()| (bytes, file))
        });
        let (bytes, file) = read.await.map_err(io::Error::other)??;
        let left = left - bytes.len() as u64;
        Ok::<_, io::Error>(Some((Bytes::from(bytes), (file, left, held))))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::admission::budget::Budget;
    use http_body_util::BodyExt;
    use std::io::Seek;

    #[tokio::test]
    async fn a_result_that_is_not_read_holds_its_pieces_until_it_is_over() {
        let mut file = tempfile::tempfile().expect("a file");
        file.set_len(3 * CHUNK).expect("room");
        file.rewind().expect("a file");
        let budget = Budget::new(PIECES * CHUNK);
        let mut body = body(Box::new(file), 3 * CHUNK, budget.hold(PIECES * CHUNK).expect("room"));
        for _ in 0..3 {
            assert_eq!(budget.used(), PIECES * CHUNK);
            let piece = body.frame().await.expect("a piece").expect("no fault").into_data().expect("bytes");
            assert_eq!(piece.len() as u64, CHUNK);
        }
        assert!(body.frame().await.is_none());
        assert_eq!(budget.used(), 0);
    }
}
