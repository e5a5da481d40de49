//! `GET /files/{number}`: the files that `densecloud view` was given.

use std::fs::File;
use std::io::{self, Read};
use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use tokio::task::spawn_blocking;

use crate::app::App;
use crate::connection::compress::AsIs;
use crate::http::download::blocks;
use crate::problem::Problem;

/// Bytes that are read at a time.
const CHUNK: u64 = 256 << 10;

/// The handler. Paths are the program's own: a client names a number.
pub(crate) async fn file(
    State(app): State<Arc<App>>,
    Path(number): Path<String>,
) -> Result<Response, Problem> {
    let path = number.parse::<usize>().ok().and_then(|number| app.config.files.get(number).cloned());
    let path = path.ok_or(Problem::NotFound)?;
    let internal = |error: io::Error| Problem::Internal(error.to_string());
    let opened = spawn_blocking(move || {
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        Ok((file, length))
    });
    let opened = opened.await.map_err(|error| Problem::Internal(error.to_string()))?;
    let (file, length) = opened.map_err(internal)?;
    let held = app.budget.hold(CHUNK).ok_or_else(|| app.held_full())?;
    // No more than was told, should somebody write to it.
    let mut left = file.take(length);
    let body = blocks(held, move || {
        let mut chunk = Vec::with_capacity(CHUNK as usize);
        left.by_ref().take(CHUNK).read_to_end(&mut chunk)?;
        Ok((!chunk.is_empty()).then(|| chunk.into()))
    });
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
        (header::CONTENT_LENGTH, length.to_string()),
    ];
    let mut response = (headers, body).into_response();
    response.extensions_mut().insert(AsIs);
    Ok(response)
}
