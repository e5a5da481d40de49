//! The answer to an inference request: JSON that describes the tensor, and holds its numbers or is followed
//! by them.

use std::io;

use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::{Datatype, HEADER_LENGTH, MODEL, TENSOR, VERSION};
use crate::http::download::{BLOCK, blocks};
use crate::http::upsample::Done;
use crate::problem::Problem;
use densecloud_cloud::Position;

/// What an answer must know of its request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Reply {
    /// The request's own name for itself, which comes back.
    pub(super) id: Option<String>,
    /// The type of its numbers, and so of the answer's.
    pub(super) datatype: Datatype,
    /// Whether the numbers follow the JSON.
    pub(super) binary: bool,
}

#[derive(Serialize)]
struct Document<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<&'a str>,
    model_name: &'static str,
    model_version: &'static str,
    parameters: Told<'a>,
    outputs: [Output; 1],
}

/// What `/upsample` says in headers, which clients of this protocol do not show.
#[derive(Serialize)]
struct Told<'a> {
    provenance: &'a str,
    #[serde(skip_serializing_if = "str::is_empty")]
    warnings: String,
}

#[derive(Serialize)]
struct Output {
    name: &'static str,
    datatype: &'static str,
    shape: [u64; 2],
    #[serde(skip_serializing_if = "Option::is_none")]
    parameters: Option<Size>,
}

#[derive(Serialize)]
struct Size {
    binary_data_size: u64,
}

/// What [`Document`] ends with: numbers in JSON go before it.
const END: &str = "}]}";

impl Reply {
    /// The answer with this result.
    pub(super) fn response(&self, done: Done) -> Result<Response, Problem> {
        let Done { dense, held, about, .. } = done;
        let bytes = about.points_out * 3 * self.datatype.width() as u64;
        let document = Document {
            id: self.id.as_deref(),
            model_name: MODEL,
            model_version: VERSION,
            parameters: Told { provenance: &about.provenance, warnings: about.warnings.join("; ") },
            outputs: [Output {
                name: TENSOR,
                datatype: self.datatype.name(),
                shape: [about.points_out, 3],
                parameters: self.binary.then_some(Size { binary_data_size: bytes }),
            }],
        };
        let mut json = serde_json::to_string(&document).map_err(|e| Problem::Internal(e.to_string()))?;
        let mut headers = HeaderMap::new();
        if self.binary {
            headers.insert(HEADER_LENGTH, json.len().into());
            headers.insert(header::CONTENT_LENGTH, (json.len() as u64 + bytes).into());
            headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
        } else {
            headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
            json.truncate(json.len() - END.len());
            json += ",\"data\":[";
        }
        let body = blocks(held, tensor(json, dense.positions, self.datatype, self.binary));
        Ok((headers, body).into_response())
    }
}

/// Makes the pieces of an answer's body: the JSON, then some points at a time.
fn tensor(
    json: String,
    positions: Vec<Position>,
    datatype: Datatype,
    binary: bool,
) -> impl FnMut() -> io::Result<Option<Bytes>> + Send + 'static {
    let mut start = Some(json);
    let mut next = 0;
    move || {
        if let Some(json) = start.take() {
            let end = if positions.is_empty() && !binary { "]}]}" } else { "" };
            return Ok(Some((json + end).into()));
        }
        let rows = &positions[next..positions.len().min(next + BLOCK)];
        if rows.is_empty() {
            return Ok(None);
        }
        let mut block = Vec::with_capacity(rows.len() * 3 * datatype.width());
        for (i, number) in rows.as_flattened().iter().enumerate() {
            if !binary && next + i > 0 {
                block.push(b',');
            }
            put(&mut block, *number, datatype, binary)?;
        }
        next += rows.len();
        if next == positions.len() && !binary {
            block.push(b']');
            block.extend(END.as_bytes());
        }
        Ok(Some(block.into()))
    }
}

fn put(block: &mut Vec<u8>, number: f64, datatype: Datatype, binary: bool) -> io::Result<()> {
    match (datatype, binary) {
        (Datatype::F32, _) if !(number as f32).is_finite() => {
            return Err(io::Error::other(format!("{number} does not fit into FP32")));
        }
        (Datatype::F32, true) => block.extend((number as f32).to_le_bytes()),
        (Datatype::F64, true) => block.extend(number.to_le_bytes()),
        (Datatype::F32, false) => serde_json::to_writer(block, &(number as f32))?,
        (Datatype::F64, false) => serde_json::to_writer(block, &number)?,
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body(count: usize, datatype: Datatype, binary: bool) -> Vec<u8> {
        let positions = (0..count).map(|i| [i as f64 * 0.1, 1.0, -1e-9]).collect();
        let mut next = tensor("{[{\"data\":[".into(), positions, datatype, binary);
        std::iter::from_fn(|| next().expect("a block")).flatten().collect()
    }

    #[test]
    fn json_is_whole_however_many_blocks_there_are() {
        for count in [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK] {
            let text = String::from_utf8(body(count, Datatype::F64, false)).expect("text");
            let numbers = text.strip_prefix("{[{\"data\":").and_then(|t| t.strip_suffix(END)).expect("ends");
            let numbers: Vec<f64> = serde_json::from_str(numbers).expect("numbers");
            assert_eq!(numbers.len(), 3 * count);
            assert!(numbers.chunks(3).enumerate().all(|(i, n)| n == [i as f64 * 0.1, 1.0, -1e-9]), "exactly");
        }
    }

    #[test]
    fn binary_numbers_follow_the_json() {
        let start = "{[{\"data\":[".len();
        let bytes = body(BLOCK + 1, Datatype::F32, true);
        assert_eq!(bytes.len(), start + (BLOCK + 1) * 12);
        assert_eq!(bytes[start + 12..start + 16], 0.1_f32.to_le_bytes());
    }

    #[test]
    fn what_does_not_fit_breaks_off() {
        let mut next = tensor(String::new(), vec![[1e300, 0.0, 0.0]], Datatype::F32, true);
        assert!(next().is_ok());
        assert!(next().is_err());
    }
}
