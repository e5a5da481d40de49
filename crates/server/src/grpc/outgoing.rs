//! A result as messages: its header, then its chunks, each made when the one before is on its way.

use std::ops::Range;

use axum::body::Bytes;
use futures::stream::{self, BoxStream, StreamExt, TryStreamExt};
use tokio::task::spawn_blocking;

use super::start::Columns;
use super::{CHUNK, LARGEST_CHUNK};
use crate::http::download::{self, Dense};
use crate::http::upsample::{About, Done};
use crate::problem::Problem;
use crate::proto::upsample_response::Message;
use crate::proto::{PointChunk, Progress, ResultHeader, UpsampleResponse};
use densecloud_cloud::{Position, Values, each_kind};
use densecloud_formats::{Format, Scalar};

/// A result's messages; the memory that it holds is given back with the stream.
pub(super) type Messages = BoxStream<'static, Result<UpsampleResponse, Problem>>;

pub(super) fn message(message: Message) -> UpsampleResponse {
    UpsampleResponse { message: Some(message) }
}

pub(super) fn progress(progress: densecloud_engine::Progress) -> UpsampleResponse {
    message(Message::Progress(Progress {
        stage: progress.stage.map_or_else(String::new, |stage| stage.name().to_owned()),
        level: progress.level as u32,
        levels: progress.levels as u32,
        fraction: progress.fraction,
    }))
}

/// The messages of this result, as columns of numbers or as a file.
pub(super) fn messages(done: Done, as_points: bool) -> Messages {
    let Done { dense, held, format, about, .. } = done;
    let columns = as_points.then(|| Columns::of(about.points_out, scalar(format), &dense.attributes));
    let header = header(about, columns.as_ref());
    let chunks = match columns {
        None => file(download::body(dense, format, held)),
        Some(columns) => {
            let points = Points { dense, columns, next: 0 };
            let chunks = stream::try_unfold((points, held), |(mut points, held)| async move {
                let step = spawn_blocking(move || points.chunk().map(|chunk| (chunk, points)));
                let (chunk, points) = step.await.map_err(|e| Problem::Internal(e.to_string()))??;
                Ok(chunk.map(|chunk| (message(Message::Points(chunk)), (points, held))))
            });
            chunks.boxed()
        }
    };
    stream::once(async { Ok(header) }).chain(chunks).boxed()
}

/// What is told before the points, which come in columns or else in a file.
pub(super) fn header(about: About, columns: Option<&Columns>) -> UpsampleResponse {
    message(Message::Header(ResultHeader {
        points_in: about.points_in,
        points_out: about.points_out,
        media_type: if columns.is_some() { String::new() } else { about.media_type },
        layout: columns.map(Columns::layout),
        provenance: about.provenance,
        warnings: about.warnings,
    }))
}

/// A file's blocks, of which those of points with many attributes may be larger than a chunk.
fn file(body: axum::body::Body) -> Messages {
    let blocks = body.into_data_stream().map_err(|error| Problem::Internal(error.to_string()));
    blocks.map_ok(|block: Bytes| stream::iter(pieces(block).map(Ok))).try_flatten().boxed()
}

/// The chunks of a block of a file.
pub(super) fn pieces(mut block: Bytes) -> impl Iterator<Item = UpsampleResponse> {
    std::iter::from_fn(move || {
        let piece = block.split_to(block.len().min(LARGEST_CHUNK));
        (!piece.is_empty()).then(|| message(Message::FileChunk(piece)))
    })
}

/// The type of the coordinates of a result that comes as points.
pub(super) fn scalar(format: Format) -> Scalar {
    match format {
        Format::Npy { scalar, .. } => scalar,
        _ => Scalar::F64,
    }
}

/// Points on their way.
pub(super) struct Points {
    pub(super) dense: Dense,
    pub(super) columns: Columns,
    /// The first that is not yet sent.
    pub(super) next: usize,
}

impl Points {
    /// The next ones, or nothing after the last.
    pub(super) fn chunk(&mut self) -> Result<Option<PointChunk>, Problem> {
        let Dense { positions, attributes, .. } = &self.dense;
        let rows = (CHUNK / self.columns.stride()).max(1);
        let range = self.next..positions.len().min(self.next + rows);
        if range.is_empty() {
            return Ok(None);
        }
        self.next = range.end;
        let fields = attributes.iter().map(|a| field(&a.values, range.clone())).collect();
        Ok(Some(PointChunk { positions: coordinates(&positions[range], self.columns.scalar)?, fields }))
    }
}

fn coordinates(positions: &[Position], scalar: Scalar) -> Result<Bytes, Problem> {
    let numbers = positions.as_flattened();
    let mut bytes = Vec::with_capacity(size_of_val(numbers));
    for number in numbers {
        match scalar {
            Scalar::F64 => bytes.extend(number.to_le_bytes()),
            Scalar::F32 => {
                let single = *number as f32;
                if !single.is_finite() {
                    let why = format!("the coordinate {number} does not fit into a 32-bit float");
                    return Err(Problem::Impossible(why));
                }
                bytes.extend(single.to_le_bytes());
            }
        }
    }
    Ok(bytes.into())
}

fn field(values: &Values, range: Range<usize>) -> Bytes {
    each_kind!(values, column => column[range].iter().flat_map(|number| number.to_le_bytes()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_cloud::{Attribute, Origin};

    #[test]
    fn chunks_hold_all_points_once_in_their_order() {
        for scalar in [Scalar::F32, Scalar::F64] {
            let count = 3 * CHUNK / 12 + 1;
            let positions: Vec<Position> = (0..count).map(|i| [i as f64, 0.5, -1.0]).collect();
            let values = Values::I16((0..count).map(|i| i as i16).collect());
            let attributes = vec![Attribute { name: "a".into(), values }];
            let columns = Columns::of(count as u64, scalar, &attributes);
            let (size, stride) = (columns.position() / 3, columns.stride());
            let dense = Dense { positions, attributes, origin: Origin::default() };
            let mut points = Points { dense, columns, next: 0 };
            let mut seen = 0;
            while let Some(chunk) = points.chunk().expect("a chunk") {
                let rows = chunk.positions.len() / (3 * size);
                assert!(rows > 0 && rows * stride <= CHUNK);
                let first = &chunk.positions[..size];
                let first = match scalar {
                    Scalar::F32 => f64::from(f32::from_le_bytes(first.try_into().expect("4 bytes"))),
                    Scalar::F64 => f64::from_le_bytes(first.try_into().expect("8 bytes")),
                };
                assert_eq!(first, seen as f64);
                assert_eq!(chunk.fields[0][..2], (seen as i16).to_le_bytes());
                assert_eq!(chunk.fields[0].len(), 2 * rows);
                seen += rows;
            }
            assert_eq!(seen, count);
        }
        assert!(coordinates(&[[1e300, 0.0, 0.0]], Scalar::F32).is_err());
    }
}
