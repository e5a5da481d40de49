//! Parts that leave as soon as they are final, while later tiles are worked on.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::thread;

use densecloud::Report;
use densecloud_cascade::{Observer, Stage};
use densecloud_cloud::Attribute;
use densecloud_formats::{CloudPlan, CloudWriter};

use crate::part::PartReader;
use crate::run::Done;
use crate::tiling::Tiling;
use crate::{Step, TilesError, Watch, Work};

/// A result that is written while it is made: its parts leave in the order of the tiles.
pub struct Flow<W: Write> {
    tiling: Arc<Tiling>,
    /// The result's attributes, without values.
    attributes: Vec<Attribute>,
    writer: CloudWriter<W>,
    /// Of each tile whose part is begun.
    done: Vec<Done>,
    /// The part that is being written, and the points that it should still have.
    part: Option<(PartReader, u64)>,
}

impl Tiling {
    /// Whether the file of the result can begin before all of its points are there: its header needs no more of them than
    /// their number, and that is planned.
    #[must_use]
    pub fn flows(&self) -> bool {
        let Report { format, origin, .. } = &self.report;
        let is_counted = self.manifest.causes.options.finish.min_confidence <= 0.0;
        is_counted && !CloudPlan::new(*format, &[], origin).needs_points()
    }

    /// Begins the file of a result that [flows](Self::flows): writes its header. The first tile must be done.
    ///
    /// # Errors
    /// [`TilesError::NotDone`], or the sink fails.
    pub fn flow<W: Write>(self: &Arc<Self>, sink: W) -> Result<Flow<W>, TilesError> {
        let attributes = self.attributes()?;
        let Report { format, points_out, origin, .. } = &self.report;
        let writer = CloudWriter::with(sink, *format, *points_out, &attributes, origin)?;
        Ok(Flow { tiling: Arc::clone(self), attributes, writer, done: Vec::new(), part: None })
    }

    /// Runs all tiles that are not done, and writes the result: each part on a thread beside the work as soon as it is
    /// final, where the format's files [flow](Self::flows), else all of them at the end. The bytes are those of
    /// [`Tiling::join`]. What is written waits for nothing but the disk: a sink that is slow does not hold up the work, and one
    /// that fails, since its reader has left, ends it within a batch.
    ///
    /// # Errors
    /// As [`Tiling::run`] and [`Flow::advance`]; the sink has the beginning of a file then. The parts stay.
    pub fn run_into(
        self: &Arc<Self>,
        work: &Work<'_>,
        sink: impl Write + Send,
    ) -> Result<Report, TilesError> {
        if !self.flows() {
            self.run_all(work)?;
            return self.join()?.write(sink);
        }
        let wanted = Wanted { watch: work.watch, no_more: AtomicBool::new(false) };
        thread::scope(|scope| {
            let (done, finals) = mpsc::channel();
            let no_more = &wanted.no_more;
            let writing = scope.spawn(move || {
                written(self, sink, &finals).inspect_err(|_| no_more.store(true, Ordering::Relaxed))
            });
            let ran = self.run_each(&Work { watch: &wanted, ..*work }, || done.send(()).is_ok());
            drop(done);
            let written = writing.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))?;
            ran?;
            written.ok_or(TilesError::NotDone(self.not_done()?))
        })
    }
}

/// Stops a work whose result can be written no further.
struct Wanted<'a> {
    watch: &'a dyn Watch,
    no_more: AtomicBool,
}

impl Observer for Wanted<'_> {
    fn plan(&self, sizes: &[usize]) {
        self.watch.plan(sizes);
    }

    fn begin(&self, level: usize, stage: Stage) {
        self.watch.begin(level, stage);
    }

    fn advance(&self, done: usize, total: usize) {
        self.watch.advance(done, total);
    }

    fn cancelled(&self) -> bool {
        self.no_more.load(Ordering::Relaxed) || self.watch.cancelled()
    }
}

impl Watch for Wanted<'_> {
    fn step(&self, step: Step) {
        self.watch.step(step);
    }

    fn read(&self, points: u64) {
        self.watch.read(points);
    }
}

/// Writes a result as far as it is told of tiles that are done; none where it hears the last before it is whole.
fn written(
    tiling: &Arc<Tiling>,
    sink: impl Write,
    finals: &Receiver<()>,
) -> Result<Option<Report>, TilesError> {
    if finals.recv().is_err() {
        return Ok(None);
    }
    let mut flow = tiling.flow(sink)?;
    loop {
        while flow.advance()? {}
        if flow.is_whole() {
            return flow.finish().map(Some);
        }
        if finals.recv().is_err() {
            return Ok(None);
        }
    }
}

impl<W: Write> Flow<W> {
    /// What is told of the result as far as it is known when its file begins.
    #[must_use]
    pub fn report(&self) -> Report {
        self.tiling.completed(&self.done, &self.attributes, &self.renamed())
    }

    fn renamed(&self) -> Vec<(String, String)> {
        let Report { format, origin, .. } = &self.tiling.report;
        format.renamed(&self.attributes, origin)
    }

    /// Writes some of the points that come next; false where there are none, since their tile is not done, or all
    /// [are written](Self::is_whole). Of a temporary folder, parts are removed behind it.
    ///
    /// Cost and memory: those of 65,536 points.
    ///
    /// # Errors
    /// The sink fails, a number is beyond what the format holds, or the part is not as it was written.
    pub fn advance(&mut self) -> Result<bool, TilesError> {
        if self.part.is_none() && !self.begin()? {
            return Ok(false);
        }
        let Some((part, left)) = &mut self.part else { return Ok(false) };
        match part.next(&self.attributes)? {
            Some((block, positions)) if positions.len() as u64 <= *left => {
                *left -= positions.len() as u64;
                self.writer.write_rows(&positions, &block, 0)?;
                Ok(true)
            }
            None if *left == 0 => self.end(),
            _ => Err(TilesError::broken(&self.path(), "it has not the points that are planned")),
        }
    }

    /// Opens the next part; false where it is not there.
    fn begin(&mut self) -> Result<bool, TilesError> {
        let tile = self.done.len() as u32;
        if tile >= self.tiling.len() {
            return Ok(false);
        }
        let Some(done) = self.tiling.done(tile)? else { return Ok(false) };
        self.tiling.check_attributes(tile, self.done.first().unwrap_or(&done), &done)?;
        self.part = Some((self.tiling.part(tile)?, done.points));
        self.done.push(done);
        Ok(true)
    }

    /// Closes a part that is written, and goes on with the next.
    fn end(&mut self) -> Result<bool, TilesError> {
        self.part = None;
        if self.tiling.folder.is_temporary() {
            let path = self.path();
            std::fs::remove_file(&path).map_err(TilesError::file(&path))?;
        }
        self.advance()
    }

    /// The part that was opened last.
    fn path(&self) -> std::path::PathBuf {
        self.tiling.folder.part((self.done.len() as u32).saturating_sub(1))
    }

    /// Whether all points are written.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        self.part.is_none() && self.done.len() as u32 == self.tiling.len()
    }

    /// Writes what follows the points, and gives all that is told of the result.
    ///
    /// # Errors
    /// The sink fails, or points are missing.
    pub fn finish(self) -> Result<Report, TilesError> {
        let report = self.report();
        self.writer.finish()?;
        Ok(report)
    }
}
