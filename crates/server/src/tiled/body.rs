//! A result in tiles as a response's body: block by block as its parts become final, and no faster than the client reads.

use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, Write};
use std::sync::{Arc, Weak};
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, Version, header};
use futures::stream;
use http_body_util::StreamBody;
use hyper::body::Frame;
use tokio::task::spawn_blocking;
use tokio::time::sleep;

use crate::admission::budget::Held;
use crate::app::App;
use crate::connection::fields::joined;
use crate::http::download::{Sink, blocks, result_bytes};
use crate::http::upsample::{timing, visible};
use crate::problem::Problem;
use crate::tiled::{Plan, Tiled, discard};
use densecloud::Report;
use densecloud_tiles::Flow;

/// Points of a part that are encoded at a time, as they lie in its file.
const BLOCK: u64 = 1 << 16;
/// Bytes of a file that are read at a time.
const CHUNK: usize = 256 << 10;

/// The header fields that come after the last point.
pub(crate) const TRAILERS: &str = "densecloud-warning, server-timing";

/// A result that is about to be sent.
pub(crate) struct Sent {
    /// What is told of it before its points.
    pub(crate) report: Report,
    pub(crate) body: Body,
    /// Its length, where that is known.
    pub(crate) length: Option<u64>,
    /// Whether fields come after it.
    pub(crate) has_trailers: bool,
}

/// How the end of a body is told from its breaking off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Framing {
    /// By its length alone: HTTP/1.0.
    Length,
    /// By its last chunk, too.
    Chunks,
    /// The same, and trailers may follow.
    Trailers,
}

impl Framing {
    /// That of an answer to such a request.
    pub(crate) fn of(version: Version, headers: &HeaderMap) -> Self {
        let asks =
            joined(headers, header::TE).split(',').any(|one| one.trim().eq_ignore_ascii_case("trailers"));
        match version {
            Version::HTTP_09 | Version::HTTP_10 => Self::Length,
            Version::HTTP_11 if !asks => Self::Chunks,
            _ => Self::Trailers,
        }
    }
}

/// Waits until the file can begin, and gives it: at the first final part, or, of a format that has to know all points,
/// as a whole.
///
/// # Errors
/// What ended the work before that.
pub(crate) async fn sent(app: &Arc<App>, mut tiled: Tiled, framing: Framing) -> Result<Sent, Problem> {
    let plan = tiled.begun().await?;
    let held = app.budget.hold(block_bytes(&plan)).ok_or_else(|| app.held_full())?;
    let length = length(&plan).await?;
    if plan.tiling().flows() && (length.is_some() || framing != Framing::Length) {
        // With a length, HTTP/1.1 has no trailers.
        let (length, has_trailers) =
            (length.filter(|_| framing != Framing::Trailers), framing == Framing::Trailers);
        return Ok(Sent { length, has_trailers, ..flowing(tiled, plan, held).await? });
    }
    let plan = tiled.whole().await?;
    whole(app, plan, held).await
}

/// The length of the file, where it is known from the plan.
async fn length(plan: &Plan) -> Result<Option<u64>, Problem> {
    let plan = plan.clone();
    blocking(move || {
        let Report { format, points_out, origin, .. } = plan.tiling().report();
        Ok(format.encoded_len(*points_out, &plan.tiling().attributes()?, origin))
    })
    .await
}

/// Memory of a block on its way: its points, and what they are encoded to.
pub(crate) fn block_bytes(plan: &Plan) -> u64 {
    let report = plan.tiling().report();
    2 * result_bytes(BLOCK.min(report.points_out), plan.tiling().attribute_bytes(), report.format)
}

/// Blocking work that may fail as the system or the tiles do.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    spawn_blocking(work).await.map_err(|error| Problem::Internal(error.to_string()))?
}

/// Bytes of each block that are held back. While the next tile is worked on they are sent one by one: only what is sent to a
/// client shows whether it is still there, and proxies cut connections that are silent for long.
const HELD_BACK: usize = 16;
/// From a block to the first of these bytes; each next gap is twice as long.
const GAP: Duration = Duration::from_secs(1);

/// A file that is sent while later parts of it are made.
struct Flowing {
    tiled: Tiled,
    flow: Option<Flow<Sink>>,
    sink: Sink,
    held_back: Bytes,
    gap: Duration,
    /// Tiles that were done when they were last looked for.
    seen: u32,
    /// Warnings that were told beforehand.
    told: Vec<String>,
    /// All that is told, once the file is whole.
    report: Option<Report>,
    _held: Held,
}

impl Drop for Flowing {
    fn drop(&mut self) {
        discard(self.flow.take());
    }
}

async fn flowing(tiled: Tiled, plan: Plan, held: Held) -> Result<Sent, Problem> {
    let tiling = Arc::clone(plan.tiling());
    let (flow, sink) = blocking(move || {
        let sink = Sink::default();
        Ok((tiling.flow(sink.clone())?, sink))
    })
    .await?;
    let report = flow.report();
    let told = report.warnings.clone();
    let (flow, held_back, gap) = (Some(flow), Bytes::new(), GAP);
    let flowing = Flowing { tiled, flow, sink, held_back, gap, seen: 1, told, report: None, _held: held };
    let frames = stream::try_unfold(Some(flowing), |state| async {
        let Some(flowing) = state else { return Ok(None) };
        flowing.frame().await.map(Some).map_err(io::Error::other)
    });
    let body = Body::new(StreamBody::new(Box::pin(frames)));
    Ok(Sent { report, body, length: None, has_trailers: false })
}

/// What comes next of a file.
enum Step {
    Block(Bytes),
    /// Nothing before another tile is done.
    Wait,
}

impl Flowing {
    /// The next frame; the trailers are the last.
    async fn frame(mut self) -> Result<(Frame<Bytes>, Option<Self>), Problem> {
        loop {
            let Some(flow) = self.flow.take() else {
                if !self.held_back.is_empty() {
                    return Ok((Frame::data(std::mem::take(&mut self.held_back)), Some(self)));
                }
                // All tiles are done, so this waits for the figures alone.
                self.tiled.whole().await?;
                return Ok((Frame::trailers(self.trailers()), None));
            };
            let sink = self.sink.clone();
            let Advanced { step, flow, report } = blocking(move || advance(flow, &sink)).await?;
            (self.flow, self.report) = (flow, report);
            match step {
                Step::Block(block) if block.is_empty() => {}
                Step::Block(block) => return Ok((Frame::data(self.hold_back(block)), Some(self))),
                Step::Wait => {
                    if let Some(byte) = self.wait().await? {
                        return Ok((Frame::data(byte), Some(self)));
                    }
                }
            }
        }
    }

    /// What may be sent now that this block has come.
    fn hold_back(&mut self, block: Bytes) -> Bytes {
        let mut all = [&self.held_back[..], &block[..]].concat();
        self.held_back = all.split_off(all.len().saturating_sub(HELD_BACK)).into();
        all.into()
    }

    /// Waits for the next tile; a byte where it is time to ask whether the client still waits, too.
    async fn wait(&mut self) -> Result<Option<Bytes>, Problem> {
        tokio::select! {
            done = self.tiled.tiles(self.seen + 1) => {
                done?;
                (self.seen, self.gap) = (self.seen + 1, GAP);
                Ok(None)
            }
            () = sleep(self.gap), if !self.held_back.is_empty() => {
                self.gap *= 2;
                Ok(Some(self.held_back.split_to(1)))
            }
        }
    }

    fn trailers(&self) -> HeaderMap {
        let mut trailers = HeaderMap::new();
        let all = self.report.iter().flat_map(|report| &report.warnings);
        for warning in all.filter(|warning| !self.told.contains(warning)) {
            trailers.append("densecloud-warning", visible(warning));
        }
        trailers.insert("server-timing", visible(&timing(&self.tiled.stages())));
        trailers
    }
}

/// A file after a step, and what came of that.
struct Advanced {
    step: Step,
    flow: Option<Flow<Sink>>,
    /// Once the file has ended.
    report: Option<Report>,
}

/// Encodes the next points, or ends the file.
fn advance(mut flow: Flow<Sink>, sink: &Sink) -> Result<Advanced, Problem> {
    // The header is there before any point.
    if flow.advance()? {
        return Ok(Advanced { step: Step::Block(sink.take()), flow: Some(flow), report: None });
    }
    if !flow.is_whole() {
        return Ok(Advanced { step: Step::Wait, flow: Some(flow), report: None });
    }
    let report = Some(flow.finish()?);
    Ok(Advanced { step: Step::Block(sink.take()), flow: None, report })
}

/// Makes the whole file, and sends it from the disk.
async fn whole(app: &App, plan: Plan, held: Held) -> Result<Sent, Problem> {
    let (tiling, temp) = (Arc::clone(plan.tiling()), app.config.temp_dir());
    let waited = Arc::new(());
    let waits = Arc::downgrade(&waited);
    let (file, report) = blocking(move || {
        let file = tempfile::tempfile_in(temp);
        let mut file = file.map_err(|error| Problem::of_temp(error.kind(), error.to_string()))?;
        let report = tiling.join()?.write(BufWriter::new(Wanted { file: &file, waits }))?;
        file.rewind().map_err(|error| Problem::Internal(error.to_string()))?;
        Ok((file, report))
    })
    .await?;
    drop(waited);
    let length = file.metadata().map_err(|error| Problem::Internal(error.to_string()))?.len();
    let mut file = file.take(length);
    let body = blocks(held, move || {
        let mut chunk = Vec::with_capacity(CHUNK);
        file.by_ref().take(CHUNK as u64).read_to_end(&mut chunk)?;
        Ok((!chunk.is_empty()).then(|| chunk.into()))
    });
    Ok(Sent { report, body, length: Some(length), has_trailers: false })
}

/// A file that takes no more once nobody waits for it.
struct Wanted<'a> {
    file: &'a File,
    waits: Weak<()>,
}

impl Write for Wanted<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.waits.strong_count() == 0 {
            return Err(io::Error::other("nobody waits for it"));
        }
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
