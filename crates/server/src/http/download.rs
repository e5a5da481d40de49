//! Sending a result: encoded block by block as fast as the client reads, and no faster.

use std::io::{self, Read, Write};
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::{Body, Bytes};
use futures::stream;
use tokio::task::spawn_blocking;

use crate::admission::budget::Held;
use densecloud_cloud::{Attribute, Origin, Position};
use densecloud_formats::{CloudPlan, CloudWriter, Encoded, Format, FormatError, encode_spooled};

/// Points encoded at a time: 48 KiB in the commonest format, well under a millisecond of work.
pub(crate) const BLOCK: usize = 4096;

/// Bytes of a chunk of a result that is encoded as a whole.
const CHUNK: usize = 256 * 1024;

/// A dense cloud on its way to the client.
pub(crate) struct Dense {
    pub(crate) positions: Vec<Position>,
    pub(crate) attributes: Vec<Attribute>,
    pub(crate) origin: Origin,
}

/// Memory of a result until it is sent: the points, and what making the file takes. `attribute_bytes`: those of one point.
pub(crate) fn result_bytes(points: u64, attribute_bytes: u64, format: Format) -> u64 {
    let a_point = size_of::<Position>() as u64 + attribute_bytes;
    points.saturating_mul(a_point).saturating_add(format.bytes_at_work(points, attribute_bytes))
}

/// About the bytes of a result's file, mostly more than it will have. The arguments are those of [`result_bytes`].
pub(crate) fn file_bytes(points: u64, attribute_bytes: u64, format: Format) -> u64 {
    format.file_bytes(points, attribute_bytes)
}

/// A result as a response's body, which holds its share of the memory until it is over.
pub(crate) fn body(dense: Dense, format: Format, held: Held) -> Body {
    let mut encoder = Encoder { dense, format, next: 0, stage: Stage::Start, sink: Sink::default() };
    blocks(held, move || encoder.block().map_err(io::Error::other))
}

/// A body of blocks, up to the first `None`.
///
/// Each block is made on a blocking thread when the connection asks for it. So a slow reader
/// occupies no thread, neither the engine's nor one that encodes; it holds the result's memory,
/// which `held` accounts for, until it is done or [`crate::connection::activity`] ends the connection.
pub(crate) fn blocks(held: Held, next: impl FnMut() -> io::Result<Option<Bytes>> + Send + 'static) -> Body {
    Body::from_stream(stream::try_unfold((next, held), |(mut next, held)| async move {
        let step = spawn_blocking(move || next().map(|block| (block, next)));
        let (block, next) = step.await.map_err(io::Error::other)??;
        Ok::<_, io::Error>(block.map(|block| (block, (next, held))))
    }))
}

struct Encoder {
    dense: Dense,
    format: Format,
    /// First position not yet written.
    next: usize,
    stage: Stage,
    sink: Sink,
}

enum Stage {
    Start,
    /// The same writer as the command line's, so that both give the same bytes.
    Rows(CloudWriter<Sink>),
    /// What is left of a file that could only be made as a whole.
    Whole(Encoded),
    End,
}

impl Encoder {
    /// The next bytes, or nothing at the end.
    fn block(&mut self) -> Result<Option<Bytes>, FormatError> {
        let Dense { positions, attributes, origin } = &self.dense;
        if let Stage::Start = self.stage {
            self.stage = if self.format.is_streamed() {
                let mut plan = CloudPlan::new(self.format, attributes, origin);
                plan.see(positions, attributes, 0)?;
                Stage::Rows(plan.begin(self.sink.clone())?)
            } else {
                Stage::Whole(encode_spooled(self.format, positions, attributes, origin)?)
            };
        }
        match &mut self.stage {
            Stage::Rows(writer) if self.next < positions.len() => {
                let Range { start, end } = self.next..positions.len().min(self.next + BLOCK);
                writer.write_rows(&positions[start..end], attributes, start)?;
                self.next = end;
                if end == positions.len()
                    && let Stage::Rows(writer) = std::mem::replace(&mut self.stage, Stage::End)
                {
                    writer.finish()?;
                }
                Ok(Some(self.sink.take()))
            }
            Stage::Whole(file) => {
                let mut chunk = Vec::with_capacity(CHUNK);
                file.take(CHUNK as u64).read_to_end(&mut chunk)?;
                Ok((!chunk.is_empty()).then(|| chunk.into()))
            }
            _ => Ok(None),
        }
    }
}

/// Memory that the writer writes into and the encoder takes from. A mutex that is never contended:
/// it only lets both own the buffer.
#[derive(Clone, Default)]
pub(crate) struct Sink(Arc<Mutex<Vec<u8>>>);

impl Sink {
    pub(crate) fn take(&self) -> Bytes {
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
    use super::*;
    use crate::admission::budget::Budget;
    use densecloud_cloud::Values;
    use densecloud_formats::{Decimal, PcdEncoding, PlyEncoding, Scalar, Separator, encode};

    #[tokio::test]
    async fn the_body_is_what_one_writer_would_have_written_at_once() {
        let budget = Budget::new(1 << 30);
        let ply = |encoding, scalar| Format::Ply { encoding, scalar };
        for format in [
            Format::TEXT,
            ply(PlyEncoding::Ascii, Scalar::F32),
            ply(PlyEncoding::BinaryLittleEndian, Scalar::F32),
            ply(PlyEncoding::BinaryBigEndian, Scalar::F64),
            Format::Npy { scalar: Scalar::F64, fields: true },
            Format::Las { compressed: false },
            Format::Las { compressed: true },
            Format::E57,
        ] {
            for count in [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK] {
                let positions: Vec<Position> =
                    (0..count).map(|i| [i as f64 * 0.1, 1.0, -(i as f64)]).collect();
                let red = Values::U16((0..count).map(|i| i as u16).collect());
                let attributes = vec![Attribute { name: "red".into(), values: red }];
                let origin = Origin::default();
                let whole = encode(Vec::new(), format, &positions, &attributes, &origin).unwrap();
                let held = budget.hold(result_bytes(count as u64, 2, format)).unwrap();
                let dense = Dense { positions, attributes, origin };
                let sent = axum::body::to_bytes(body(dense, format, held), usize::MAX).await.unwrap();
                if count > 0 {
                    assert!(sent == whole, "{format:?}, {count} points");
                }
                assert_eq!(budget.used(), 0, "the memory is given back");
            }
        }
    }

    #[test]
    fn a_file_is_not_much_longer_than_it_was_taken_for() {
        let count = 1000;
        // All digits that there are, and the longest numbers.
        let positions: Vec<Position> =
            (0..count).map(|i| [-1e6 / 3.0 - f64::from(i), -0.1 / f64::from(i + 3), 1.0 / 3.0]).collect();
        let values = |values: Values| Attribute { name: "one".into(), values };
        let attributes = [
            values(Values::I8(vec![i8::MIN; count as usize])),
            values(Values::U8(vec![u8::MAX; count as usize])),
            values(Values::I16(vec![i16::MIN; count as usize])),
            values(Values::F32(vec![-1.0 / 3.0; count as usize])),
            values(Values::F64(vec![-1.0 / 3.0; count as usize])),
        ];
        for format in [
            Format::TEXT,
            Format::Xyz { names: true, separator: Separator::Comma, decimal: Decimal::Point },
            Format::Ply { encoding: PlyEncoding::Ascii, scalar: Scalar::F64 },
            Format::Ply { encoding: PlyEncoding::BinaryBigEndian, scalar: Scalar::F64 },
            Format::Pcd { encoding: PcdEncoding::Ascii, scalar: Scalar::F64 },
            Format::Pcd { encoding: PcdEncoding::Compressed, scalar: Scalar::F64 },
            Format::Npy { scalar: Scalar::F64, fields: true },
            Format::Las { compressed: false },
            Format::Las { compressed: true },
            Format::E57,
        ] {
            for attributes in [&attributes[..0], &attributes[..1], &attributes[1..2], &attributes[2..]] {
                let origin = Origin::default();
                let file = encode(Vec::new(), format, &positions, attributes, &origin).unwrap();
                let guess = file_bytes(count as u64, densecloud_cloud::bytes_a_point(attributes), format);
                assert!(file.len() as u64 <= guess + 4096, "{format:?}: {} of {guess}", file.len());
            }
        }
    }

    #[tokio::test]
    async fn what_cannot_be_written_breaks_the_body_off() {
        let format = Format::Ply { encoding: PlyEncoding::Ascii, scalar: Scalar::F32 };
        let held = Budget::new(100).hold(1).unwrap();
        let positions = vec![[1e300, 0.0, 0.0]];
        let dense = Dense { positions, attributes: Vec::new(), origin: Origin::default() };
        let body = body(dense, format, held);
        assert!(axum::body::to_bytes(body, usize::MAX).await.is_err());
    }
}
