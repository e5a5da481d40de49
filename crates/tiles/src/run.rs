//! One tile: from its points to its part of the result.

use std::fs::File;
use std::io::BufWriter;

use densecloud::attributes::{self, finish_part};
use densecloud_cascade::{
    CascadeError, LevelRunner, Observer, Part, Stage, Target, Upsampled, UpsampledPart, upsample,
    upsample_part,
};
use densecloud_cloud::{Attribute, FrameError, Position};
use densecloud_formats::Block;
use serde::{Deserialize, Serialize};

use crate::TilesError;
use crate::chunk::{self, KindName, ROWS};
use crate::disk::write_whole;
use crate::tile::TileCloud;
use crate::tiling::Tiling;

/// A tile's part of the result, before it is written.
pub(crate) struct TilePart {
    positions: Vec<Position>,
    attributes: Vec<Attribute>,
    pub(crate) done: Done,
}

/// What is known of a tile that is done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Done {
    /// Points of its part.
    pub(crate) points: u64,
    /// The names and types of their attributes.
    pub(crate) attributes: Vec<(String, KindName)>,
    /// As [`Made::duplicates`](densecloud::Made::duplicates), and so on.
    pub(crate) duplicates: u64,
    pub(crate) apart: u64,
    pub(crate) unsure: u64,
}

impl Tiling {
    /// Works on one tile, and writes its part to the folder; gives the points of that. Done again, it writes the same.
    ///
    /// Cost and memory: as of a cloud of the tile's points and those around it.
    ///
    /// # Errors
    /// [`TilesError::NoTile`], [`TilesError::Tile`]; [`CascadeError::Cancelled`] where the observer stops it.
    pub fn run(
        &self,
        tile: u32,
        runner: &dyn LevelRunner,
        observer: &dyn Observer,
    ) -> Result<u64, TilesError> {
        let part = self.made_of(tile, runner, observer)?;
        let points = part.done.points;
        self.write(tile, part)?;
        Ok(points)
    }

    /// Works on one tile.
    pub(crate) fn made_of(
        &self,
        tile: u32,
        runner: &dyn LevelRunner,
        observer: &dyn Observer,
    ) -> Result<TilePart, TilesError> {
        let last = self.len().saturating_sub(1);
        let planned = self.manifest.tiles.get(tile as usize).ok_or(TilesError::NoTile { tile, last })?;
        let (attributes, adaptation) = (self.manifest.attributes(), self.manifest.adaptation());
        let points = TileCloud::read(&self.folder, tile, &attributes, &adaptation, &self.report.origin)?;
        if points.own.len() as u64 != planned.own {
            return Err(TilesError::broken(&self.folder.own(tile), "it has not the points that are planned"));
        }
        let failed = |why| match why {
            CascadeError::Cancelled => TilesError::Cascade(why),
            why => TilesError::Tile { tile, bounds: points.bounds(), why },
        };
        let made = self.upsampled(tile, &points.cloud.positions, runner, observer).map_err(failed)?;
        let UpsampledPart { positions, rim, duplicates, apart, levels } = made;
        observer.begin(levels.saturating_sub(1), Stage::Attributes);
        let (positions, attributes) = self.finished(&points, positions, &rim, observer).map_err(failed)?;
        let done = Done {
            points: positions.len() as u64,
            attributes: attributes.iter().map(|a| (a.name.clone(), KindName(a.values.kind()))).collect(),
            duplicates: duplicates as u64,
            apart: apart as u64,
            unsure: planned.size - positions.len() as u64,
        };
        Ok(TilePart { positions, attributes, done })
    }

    /// Upsamples a tile's points and those around it.
    fn upsampled(
        &self,
        tile: u32,
        positions: &[Position],
        runner: &dyn LevelRunner,
        observer: &dyn Observer,
    ) -> Result<UpsampledPart, CascadeError> {
        let (options, size) =
            (&self.manifest.causes.options.cascade, self.manifest.tiles[tile as usize].size);
        if self.len() == 1 {
            // Nothing is around it, so it is worked on as anywhere else.
            let made = upsample(positions, Target::Points(size), options, runner, observer)?;
            let Upsampled { positions, duplicates, apart, levels, .. } = made;
            return Ok(UpsampledPart { positions, rim: Vec::new(), duplicates, apart, levels });
        }
        let (partition, whole) = (&self.partition, &self.whole);
        let part = Part { positions, partition, cell: tile, whole, size };
        upsample_part(&part, options, runner, observer)
    }

    /// Gives points their attributes.
    fn finished(
        &self,
        points: &TileCloud,
        positions: Vec<Position>,
        rim: &[Position],
        observer: &dyn Observer,
    ) -> Result<(Vec<Position>, Vec<Attribute>), CascadeError> {
        let (own, rows) = (Some(&points.own[..]), Some(&points.rows[..]));
        let ratio = Some(self.report.points_out as f64 / self.manifest.finite as f64);
        let part = attributes::Part { own, rows, rim, ratio };
        let finish = &self.manifest.causes.options.finish;
        let cancelled = || observer.cancelled();
        let finished = finish_part(&points.cloud, positions, finish, &self.plan, &part, &cancelled);
        let degenerate = || CascadeError::from(FrameError::Degenerate);
        finished.ok_or_else(|| if observer.cancelled() { CascadeError::Cancelled } else { degenerate() })
    }

    /// Writes a part, and then that it is done.
    pub(crate) fn write(&self, tile: u32, part: TilePart) -> Result<(), TilesError> {
        let TilePart { positions, attributes, done } = part;
        let path = self.folder.part(tile);
        let before = path.with_extension("part.new");
        let all = Block { positions, columns: attributes.into_iter().map(|a| a.values).collect() };
        let rows: Vec<u32> = densecloud_geometry::indices(all.positions.len()).collect();
        let write = || {
            let mut sink = BufWriter::new(File::create(&before)?);
            for rows in rows.chunks(ROWS) {
                chunk::write(&mut sink, &all.gather(rows))?;
            }
            sink.into_inner().map_err(std::io::IntoInnerError::into_error)?.sync_all()?;
            std::fs::rename(&before, &path)
        };
        write().map_err(TilesError::file(&path))?;
        let json = serde_json::to_vec(&done).map_err(|why| TilesError::broken(&path, why.to_string()))?;
        write_whole(&self.folder.done(tile), &json)
    }
}
