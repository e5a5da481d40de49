//! From parts to one file.

use std::io::Write;
use std::sync::mpsc::{self, SyncSender};
use std::thread;

use densecloud::{Made, Report};
use densecloud_cascade::CascadeError;
use densecloud_cloud::Attribute;
use densecloud_formats::{CloudPlan, CloudWriter, FormatError};

use crate::TilesError;
use crate::part::Points;
use crate::run::Done;
use crate::tiling::Tiling;

/// Blocks of points that are read before they are taken: reading goes on beside the writing.
const AHEAD: usize = 2;

/// The parts of a cloud, ready to be written one after another.
pub struct Join<'a> {
    tiling: &'a Tiling,
    /// The result's attributes, without values.
    attributes: Vec<Attribute>,
    /// Where the header needs to know the points: it has seen them.
    seen: Option<CloudPlan>,
    report: Report,
}

impl Tiling {
    /// Looks at all parts. Where the header of the result's format depends on the points, they are read for that.
    ///
    /// # Errors
    /// [`TilesError::NotDone`], [`TilesError::Broken`]; [`CascadeError::NoneSure`] where no point of any is sure enough.
    pub fn join(&self) -> Result<Join<'_>, TilesError> {
        let (mut done, mut missing): (Vec<Done>, Vec<u32>) = Default::default();
        for tile in 0..self.len() {
            match self.done(tile)? {
                Some(part) => done.push(part),
                None => missing.push(tile),
            }
        }
        if !missing.is_empty() {
            return Err(TilesError::NotDone(missing));
        }
        let points: u64 = done.iter().map(|done| done.points).sum();
        if points == 0 {
            return Err(CascadeError::NoneSure(self.manifest.causes.options.finish.min_confidence).into());
        }
        for (tile, part) in done.iter().enumerate() {
            self.check_attributes(tile as u32, &done[0], part)?;
        }
        let attributes = done[0].bare_attributes();
        let mut seen = CloudPlan::new(self.report.format, &attributes, &self.report.origin);
        if seen.needs_points() {
            self.each_block(&attributes, points, |attributes, block| seen.see(&block, attributes, 0))?;
        }
        let report = self.completed(&done, &attributes, &seen.renamed());
        let seen = seen.needs_points().then_some(seen);
        Ok(Join { tiling: self, attributes, seen, report })
    }

    /// What is told of the result once these tiles are done, whose parts have these attributes.
    pub(crate) fn completed(
        &self,
        done: &[Done],
        attributes: &[Attribute],
        renamed: &[(String, String)],
    ) -> Report {
        let mut report = self.report.clone();
        if done.len() as u32 == self.len() {
            report.points_out = done.iter().map(|done| done.points).sum();
        }
        report.warnings.extend(self.made(done).warnings());
        if self.lost {
            let lost = "not carried over: what only the input's format knows (of COLMAP's points the keys): join where it was \
                        planned, with `upsample`, to keep it";
            report.warnings.push(lost.to_owned());
        }
        report.tell_losses(&report.format.cannot_hold(attributes, &report.origin), renamed);
        report
    }

    /// What became of the points of these tiles.
    fn made(&self, done: &[Done]) -> Made {
        let sum = |of: fn(&Done) -> u64| done.iter().map(of).sum::<u64>() as usize;
        Made {
            positions: Vec::new(),
            attributes: Vec::new(),
            dropped_non_finite: (self.manifest.points - self.manifest.finite) as usize,
            duplicates: sum(|done| done.duplicates),
            apart: sum(|done| done.apart),
            unsure: sum(|done| done.unsure),
        }
    }

    /// Gives the points of all parts, with their attributes, some at a time; there must be as many as `points`.
    fn each_block(
        &self,
        attributes: &[Attribute],
        points: u64,
        mut take: impl FnMut(&[Attribute], Vec<densecloud_cloud::Position>) -> Result<(), FormatError>,
    ) -> Result<(), TilesError> {
        let mut given = 0;
        thread::scope(|scope| {
            let (give, blocks) = mpsc::sync_channel(AHEAD);
            let reading = scope.spawn(move || self.read_parts(attributes, &give));
            for (block, positions) in blocks {
                given += positions.len() as u64;
                take(&block, positions)?;
            }
            reading.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        })?;
        if given == points {
            return Ok(());
        }
        let why = format!("the parts have {given} points, and should have {points}");
        Err(TilesError::broken(self.folder.path(), why))
    }
}

impl Tiling {
    /// Reads all parts until nobody wants more of them.
    fn read_parts(&self, attributes: &[Attribute], give: &SyncSender<Points>) -> Result<(), TilesError> {
        for tile in 0..self.len() {
            let mut part = self.part(tile)?;
            while let Some(block) = part.next(attributes)? {
                if give.send(block).is_err() {
                    return Ok(());
                }
            }
        }
        Ok(())
    }
}

impl Join<'_> {
    /// All that is told of the result.
    #[must_use]
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Writes the result, and gives all that is told of it. Memory: that of some thousand points; LAZ is made in a temporary
    /// file first.
    ///
    /// # Errors
    /// The sink fails, a number is beyond what the format holds, or the parts are not as they were written.
    pub fn write(self, sink: impl Write) -> Result<Report, TilesError> {
        let Self { tiling, attributes, seen, report } = self;
        let Report { format, origin, points_out, .. } = &report;
        let mut writer = match seen {
            Some(seen) => seen.begin(sink)?,
            None => CloudWriter::with(sink, *format, *points_out, &attributes, origin)?,
        };
        tiling.each_block(&attributes, *points_out, |attributes, block| {
            writer.write_rows(&block, attributes, 0)
        })?;
        writer.finish()?;
        Ok(report)
    }
}
