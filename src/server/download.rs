//! Sending a result: encoded block by block as fast as the client reads, and no faster.

use std::io::{self, Write};
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::{Body, Bytes};
use futures::stream;
use tokio::task::spawn_blocking;

use super::budget::Held;
use crate::cloud::{Attribute, Position, bytes_a_point};
use crate::formats::{CloudWriter, Format, FormatError};

/// Points encoded at a time: 48 KiB in the commonest format, well under a millisecond of work.
const BLOCK: usize = 4096;

/// Memory that a result of so many points with these attributes takes until it is sent.
pub(super) fn result_bytes(points: u64, attributes: &[Attribute]) -> u64 {
    points.saturating_mul(size_of::<Position>() as u64 + bytes_a_point(attributes))
}

/// A result as a response's body.
///
/// Each block is encoded on a blocking thread when the connection asks for it. So a slow reader
/// occupies no thread, neither the engine's nor one that encodes; it holds the result's memory,
/// which `held` accounts for, until it is done or [`super::activity`] ends the connection.
pub(super) fn body(positions: Vec<Position>, attributes: Vec<Attribute>, format: Format, held: Held) -> Body {
    let state =
        Encoder { positions, attributes, format, next: 0, writer: None, sink: Sink::default(), _held: held };
    Body::from_stream(stream::try_unfold(state, |mut state| async move {
        let step = spawn_blocking(move || state.block().map(|block| (block, state)));
        let (block, state) = step.await.map_err(io::Error::other)?.map_err(io::Error::other)?;
        Ok::<_, io::Error>(block.map(|block| (block, state)))
    }))
}

struct Encoder {
    positions: Vec<Position>,
    attributes: Vec<Attribute>,
    format: Format,
    /// First position not yet written.
    next: usize,
    /// The same writer as the command line's, so that both give the same bytes.
    writer: Option<CloudWriter<Sink>>,
    sink: Sink,
    _held: Held,
}

impl Encoder {
    /// The next bytes, or nothing at the end.
    fn block(&mut self) -> Result<Option<Bytes>, FormatError> {
        let writer = match &mut self.writer {
            Some(writer) => writer,
            None if self.next == self.positions.len() => return Ok(None),
            None => {
                let points = self.positions.len() as u64;
                self.writer.insert(CloudWriter::with_attributes(
                    self.sink.clone(),
                    self.format,
                    points,
                    &self.attributes,
                )?)
            }
        };
        let Range { start, end } = self.next..self.positions.len().min(self.next + BLOCK);
        writer.write_rows(&self.positions[start..end], &self.attributes, start)?;
        self.next = end;
        if end == self.positions.len()
            && let Some(writer) = self.writer.take()
        {
            writer.finish()?;
        }
        Ok(Some(self.sink.take()))
    }
}

/// Memory that the writer writes into and the encoder takes from. A mutex that is never contended:
/// it only lets both own the buffer.
#[derive(Clone, Default)]
struct Sink(Arc<Mutex<Vec<u8>>>);

impl Sink {
    fn take(&self) -> Bytes {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner)).into()
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::budget::Budget;
    use super::*;
    use crate::cloud::Values;
    use crate::formats::{PlyEncoding, Scalar};

    #[tokio::test]
    async fn the_body_is_what_one_writer_would_have_written_at_once() {
        let budget = Budget::new(1 << 30);
        let ply = |encoding, scalar| Format::Ply { encoding, scalar };
        for format in [
            Format::Xyz { names: false },
            ply(PlyEncoding::Ascii, Scalar::F32),
            ply(PlyEncoding::BinaryLittleEndian, Scalar::F32),
            ply(PlyEncoding::BinaryBigEndian, Scalar::F64),
        ] {
            for count in [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK] {
                let positions: Vec<Position> =
                    (0..count).map(|i| [i as f64 * 0.1, 1.0, -(i as f64)]).collect();
                let red = Values::U16((0..count).map(|i| i as u16).collect());
                let attributes = vec![Attribute { name: "red".into(), values: red }];
                let mut whole =
                    CloudWriter::with_attributes(Vec::new(), format, count as u64, &attributes).unwrap();
                whole.write_rows(&positions, &attributes, 0).unwrap();
                let whole = whole.finish().unwrap();
                let held = budget.hold(result_bytes(count as u64, &attributes)).unwrap();
                let sent = axum::body::to_bytes(body(positions, attributes, format, held), usize::MAX)
                    .await
                    .unwrap();
                if count > 0 {
                    assert!(sent == whole, "{format:?}, {count} points");
                }
                assert_eq!(budget.used(), 0, "the memory is given back");
            }
        }
    }

    #[tokio::test]
    async fn what_cannot_be_written_breaks_the_body_off() {
        let format = Format::Ply { encoding: PlyEncoding::Ascii, scalar: Scalar::F32 };
        let held = Budget::new(100).hold(1).unwrap();
        let body = body(vec![[1e300, 0.0, 0.0]], Vec::new(), format, held);
        assert!(axum::body::to_bytes(body, usize::MAX).await.is_err());
    }
}
