//! A tile's part of the result, as it lies on the disk.

use std::fmt;
use std::io::{self, Read};
use std::path::PathBuf;

use densecloud_cloud::{Attribute, Position, Values};
use densecloud_formats::Block;

use crate::TilesError;
use crate::chunk::{Chunks, KindName};
use crate::run::Done;
use crate::tiling::Tiling;

/// Attributes of some points, and their positions.
pub type Points = (Vec<Attribute>, Vec<Position>);

/// A part that is read.
pub struct PartReader {
    path: PathBuf,
    chunks: Chunks,
}

/// Opens parts that do not lie in the folder.
pub(crate) struct Elsewhere(Box<Opener>);

type Opener = dyn Fn(u32) -> io::Result<Box<dyn Read + Send>> + Send + Sync;

impl fmt::Debug for Elsewhere {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("elsewhere")
    }
}

impl Done {
    /// The part's attributes, without values.
    pub(crate) fn bare_attributes(&self) -> Vec<Attribute> {
        let bare =
            |(name, kind): &(String, KindName)| Attribute { name: name.clone(), values: Values::new(kind.0) };
        self.attributes.iter().map(bare).collect()
    }
}

impl Tiling {
    /// The attributes that the points of the result have, without values. The first tile must be done.
    ///
    /// # Errors
    /// [`TilesError::NotDone`], [`TilesError::File`], [`TilesError::Broken`].
    pub fn attributes(&self) -> Result<Vec<Attribute>, TilesError> {
        Ok(self.done(0)?.ok_or_else(|| TilesError::NotDone(vec![0]))?.bare_attributes())
    }

    /// Opens the part of a tile that is done.
    ///
    /// # Errors
    /// [`TilesError::File`].
    pub fn part(&self, tile: u32) -> Result<PartReader, TilesError> {
        let path = self.folder.part(tile);
        let chunks = match &self.elsewhere {
            None => Chunks::open(&path)?,
            Some(Elsewhere(open)) => Chunks::of(&path, open(tile).map_err(TilesError::file(&path))?),
        };
        Ok(PartReader { chunks, path })
    }

    /// The same, with parts that are read from elsewhere, each when its turn comes. What is known of those tiles lies in the
    /// folder.
    #[must_use]
    pub fn with_parts(
        self,
        open: impl Fn(u32) -> io::Result<Box<dyn Read + Send>> + Send + Sync + 'static,
    ) -> Self {
        Self { elsewhere: Some(Elsewhere(Box::new(open))), ..self }
    }

    /// Refuses a tile whose part has other attributes than the first.
    pub(crate) fn check_attributes(&self, tile: u32, first: &Done, done: &Done) -> Result<(), TilesError> {
        if done.attributes == first.attributes {
            return Ok(());
        }
        Err(TilesError::broken(&self.folder.done(tile), "it has other attributes than the first"))
    }
}

impl PartReader {
    /// The next points, 65,536 at most, with values for these attributes, which it must have; none at its end.
    ///
    /// # Errors
    /// [`TilesError::Broken`] where it is not as it was written.
    pub fn next(&mut self, attributes: &[Attribute]) -> Result<Option<Points>, TilesError> {
        let Some(Block { positions, columns }) = self.chunks.next()? else { return Ok(None) };
        let is_whole = |(a, column): (&Attribute, &Values)| {
            a.values.kind() == column.kind() && column.len() == positions.len()
        };
        if columns.len() != attributes.len() || !attributes.iter().zip(&columns).all(is_whole) {
            return Err(TilesError::broken(&self.path, "it has other attributes than it should"));
        }
        let named = |(a, values): (&Attribute, Values)| Attribute { name: a.name.clone(), values };
        Ok(Some((attributes.iter().zip(columns).map(named).collect(), positions)))
    }
}
