//! A cloud's messages as the body of a file, which all that follows reads as any other.

use std::sync::Arc;

use axum::body::{Body, Bytes};
use futures::stream;
use tokio::task::spawn_blocking;
use tonic::{Code, Status, Streaming};

use super::MESSAGE;
use super::start::Columns;
use crate::problem::Problem;
use crate::proto::upsample_request::Message;
use crate::proto::{PointChunk, Start, UpsampleRequest};

/// Reads the first message.
///
/// # Errors
/// [`Problem::MalformedRequest`] where it is none of its kind; [`Problem::Interrupted`].
pub(super) async fn start(messages: &mut Streaming<UpsampleRequest>) -> Result<Start, Problem> {
    match messages.message().await.map_err(broken)?.and_then(|message| message.message) {
        Some(Message::Start(start)) => Ok(start),
        _ => Err(malformed("the first message must be a `start`")),
    }
}

/// The messages after the first, as a body: a file's bytes as they come, columns as a NumPy file's rows.
/// What is wrong with them is the body's error.
pub(super) fn body(messages: Streaming<UpsampleRequest>, columns: Option<Columns>) -> Body {
    let header = columns.as_ref().map(|columns| columns.npy_header().into());
    let incoming = Incoming { messages, columns: columns.map(Rows::new), header };
    Body::from_stream(stream::try_unfold(incoming, |mut incoming| async move {
        let bytes = incoming.next().await?;
        Ok::<_, Problem>(bytes.map(|bytes| (bytes, incoming)))
    }))
}

struct Incoming {
    messages: Streaming<UpsampleRequest>,
    columns: Option<Rows>,
    /// To be given before anything else.
    header: Option<Bytes>,
}

/// Columns that become rows.
struct Rows {
    columns: Arc<Columns>,
    /// Points so far.
    seen: u64,
}

fn malformed(why: impl Into<String>) -> Problem {
    Problem::MalformedRequest(why.into())
}

/// What the stream's own errors are to a client that is still there.
fn broken(status: Status) -> Problem {
    match status.code() {
        // What tonic has for a message that is longer than it may be, before or after decompression.
        Code::OutOfRange | Code::ResourceExhausted => malformed(format!(
            "a message has more than {MESSAGE} bytes; send the cloud in smaller chunks ({})",
            status.message()
        )),
        Code::Internal | Code::Unimplemented | Code::InvalidArgument => {
            malformed(format!("a message cannot be read: {}", status.message()))
        }
        _ => Problem::Interrupted(status.message().to_owned()),
    }
}

impl Incoming {
    /// The next bytes, or nothing at the end.
    async fn next(&mut self) -> Result<Option<Bytes>, Problem> {
        if let Some(header) = self.header.take() {
            return Ok(Some(header));
        }
        let Some(message) = self.messages.message().await.map_err(broken)? else {
            return match &self.columns {
                Some(rows) => rows.finish().map(|()| None),
                None => Ok(None),
            };
        };
        match (message.message, &mut self.columns) {
            (Some(Message::FileChunk(bytes)), None) => Ok(Some(bytes)),
            (Some(Message::Points(chunk)), Some(rows)) => rows.add(chunk).await.map(Some),
            (Some(Message::FileChunk(_)), Some(_)) => {
                Err(malformed("a `file_chunk`, but the start has a layout; it is for `points`"))
            }
            (Some(Message::Points(_)), None) => {
                Err(malformed("`points`, but the start has no layout that says what they are"))
            }
            (Some(Message::Start(_)), _) => Err(malformed("a second `start`; a call is for one cloud")),
            (None, _) => Err(malformed("a message that is neither `start`, `file_chunk` nor `points`")),
        }
    }
}

impl Rows {
    fn new(columns: Columns) -> Self {
        Self { columns: Arc::new(columns), seen: 0 }
    }

    /// The chunk's points, row by row.
    async fn add(&mut self, chunk: PointChunk) -> Result<Bytes, Problem> {
        self.check(&chunk)?;
        if self.columns.fields.is_empty() {
            // Nothing is between two positions.
            return Ok(chunk.positions);
        }
        let columns = Arc::clone(&self.columns);
        // A large chunk of many columns takes milliseconds.
        let rows = spawn_blocking(move || rows(&columns, &chunk)).await;
        rows.map_err(|error| Problem::Internal(error.to_string()))
    }

    /// Checks the chunk against the layout, and counts its points.
    fn check(&mut self, chunk: &PointChunk) -> Result<(), Problem> {
        let position = self.columns.position();
        if !chunk.positions.len().is_multiple_of(position) {
            return Err(malformed(format!(
                "a chunk has {} bytes of positions; a point has {position}",
                chunk.positions.len()
            )));
        }
        let points = chunk.positions.len() / position;
        self.seen += points as u64;
        if self.seen > self.columns.points {
            return Err(malformed(format!(
                "the chunks have {} points or more, the layout {}",
                self.seen, self.columns.points
            )));
        }
        let fields = &self.columns.fields;
        if chunk.fields.len() != fields.len() {
            return Err(malformed(format!(
                "a chunk has {} fields, the layout {}",
                chunk.fields.len(),
                fields.len()
            )));
        }
        for ((name, kind), bytes) in fields.iter().zip(&chunk.fields) {
            let expected = points * kind.size();
            if bytes.len() != expected {
                return Err(malformed(format!(
                    "a chunk of {points} points has {} bytes of {}, not {expected}",
                    bytes.len(),
                    name.escape_debug()
                )));
            }
        }
        Ok(())
    }

    fn finish(&self) -> Result<(), Problem> {
        if self.seen == self.columns.points {
            return Ok(());
        }
        Err(malformed(format!(
            "the chunks have {} points together, the layout {}",
            self.seen, self.columns.points
        )))
    }
}

/// Blocking work: a chunk that fits the layout, row by row.
fn rows(columns: &Columns, chunk: &PointChunk) -> Bytes {
    let fields = columns.fields.iter().zip(&chunk.fields).map(|((_, kind), bytes)| (bytes, kind.size()));
    let all: Vec<_> = std::iter::once((&chunk.positions, columns.position())).chain(fields).collect();
    let points = chunk.positions.len() / columns.position();
    let mut rows = Vec::with_capacity(points * columns.stride());
    for i in 0..points {
        for (bytes, size) in &all {
            rows.extend_from_slice(&bytes[i * size..(i + 1) * size]);
        }
    }
    rows.into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::{Kind, Values};
    use densecloud_formats::{CloudReader, Limits, Scalar};

    #[tokio::test]
    async fn columns_become_the_rows_of_a_numpy_file() {
        let fields = vec![("label".to_owned(), Kind::U16), ("rot's".to_owned(), Kind::F64)];
        let columns = Columns { points: 3, scalar: Scalar::F32, fields };
        let mut file = columns.npy_header();
        let mut rows = Rows::new(columns);
        for some in [&[0_u8, 1][..], &[], &[2]] {
            let chunk = PointChunk {
                positions: some
                    .iter()
                    .flat_map(|i| [*i, 7, 9].map(f32::from))
                    .flat_map(f32::to_le_bytes)
                    .collect(),
                fields: vec![
                    some.iter().flat_map(|i| (1000 + u16::from(*i)).to_le_bytes()).collect(),
                    some.iter().flat_map(|i| (0.1 * f64::from(*i)).to_le_bytes()).collect(),
                ],
            };
            file.extend(rows.add(chunk).await.expect("a chunk"));
        }
        assert_eq!(rows.finish(), Ok(()));
        let cloud =
            CloudReader::open(&file[..], Limits::default()).and_then(CloudReader::read).expect("a cloud");
        assert_eq!(cloud.positions, [[0.0, 7.0, 9.0], [1.0, 7.0, 9.0], [2.0, 7.0, 9.0]]);
        assert_eq!(cloud.attributes[0].values, Values::U16(vec![1000, 1001, 1002]));
        assert_eq!(cloud.attributes[1].name, "rot's");
        assert_eq!(cloud.attributes[1].values, Values::F64(vec![0.0, 0.1, 0.2]));
    }

    #[test]
    fn what_does_not_fit_the_layout_is_refused() {
        let columns = Columns { points: 2, scalar: Scalar::F32, fields: vec![("a".into(), Kind::U8)] };
        for (positions, fields, part) in [
            (13, vec![1], "a point has 12"),
            (36, vec![3], "the layout 2"),
            (24, vec![], "0 fields, the layout 1"),
            (24, vec![3], "3 bytes of a, not 2"),
        ] {
            let chunk = PointChunk {
                positions: vec![0; positions].into(),
                fields: fields.into_iter().map(|bytes| vec![0; bytes].into()).collect(),
            };
            let why = Rows::new(columns.clone()).check(&chunk).expect_err(part).to_string();
            assert!(why.contains(part), "{why}");
        }
        assert!(Rows::new(columns).finish().is_err(), "points are missing");
    }
}
