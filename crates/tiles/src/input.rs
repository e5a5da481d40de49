//! A cloud that is read until it is known whether one tile holds it.

use densecloud::{Options, check_rules};
use densecloud_cascade::CascadeError;
use densecloud_cloud::{Attribute, Cloud, FrameError, Position, Values};
use densecloud_formats::{Block, CloudReader, ColumnName, Format, FormatError, Header};

use crate::TilesError;
use crate::chunk::ROWS;

/// What a reader turns out to hold.
pub enum Input<'r> {
    /// No more points than a tile: the cloud, as [`CloudReader::read`] gives it.
    Small(Box<Cloud>, Header),
    /// More than that.
    Large(Box<Large<'r>>),
}

/// A cloud of more points than a tile, its first ones read.
pub struct Large<'r> {
    pub(crate) reader: CloudReader<'r>,
    pub(crate) header: Header,
    pub(crate) first: Vec<Block>,
}

impl<'r> Input<'r> {
    /// Reads until there are more than `tile_points` points, or none are left. Memory: that of these points.
    ///
    /// # Errors
    /// As [`CloudReader::next_block`] and [`CloudReader::finish`].
    pub fn read(mut reader: CloudReader<'r>, tile_points: u64) -> Result<Self, FormatError> {
        let header = reader.header().clone();
        let (mut first, mut points) = (Vec::new(), 0);
        let mut block = Block::default();
        while reader.next_block(ROWS, &mut block)? {
            points += block.positions.len() as u64;
            first.push(std::mem::take(&mut block));
            if points > tile_points {
                return Ok(Self::Large(Box::new(Large { reader, header, first })));
            }
        }
        Ok(Self::Small(Box::new(reader.finish()?.joined(first)), header))
    }
}

/// What is found of a cloud that is read to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Found {
    /// Its points.
    pub points: u64,
    /// Those that are finite.
    pub finite: u64,
    /// Bytes of each point's attributes in the result.
    pub attribute_bytes: u64,
}

impl Large<'_> {
    /// Reads it to its end, only to know that it can be worked on as is asked. Memory: that of a block.
    ///
    /// # Errors
    /// As [`plan`](crate::plan), as far as it can be known without one.
    pub fn check(self, options: &Options, tile_points: u64) -> Result<Found, TilesError> {
        check_format(&self.header, options, tile_points)?;
        let Self { mut reader, first, .. } = self;
        let (mut points, mut finite) = (0, 0);
        let mut see = |block: &Block| {
            points += block.positions.len() as u64;
            let is_finite = |p: &&Position| p.iter().all(|c| c.is_finite());
            finite += block.positions.iter().filter(is_finite).count() as u64;
        };
        first.iter().for_each(&mut see);
        drop(first);
        let mut block = Block::default();
        while reader.next_block(ROWS, &mut block)? {
            see(&block);
        }
        let attributes = empty(&reader.finish()?.columns);
        check_rules(options, &attributes)?;
        if finite == 0 {
            return Err(CascadeError::from(FrameError::NotFinite).into());
        }
        Ok(Found { points, finite, attribute_bytes: options.finish.bytes_a_point(&attributes) })
    }
}

/// Refuses a format that needs the whole cloud, before any work.
pub(crate) fn check_format(header: &Header, options: &Options, tile_points: u64) -> Result<(), TilesError> {
    let format = Format::of_result(options.format, header.format, true);
    if format.is_made_in_parts() {
        return Ok(());
    }
    Err(TilesError::NotInParts { format: Box::new(format), tile_points, endings: Format::endings_of_parts() })
}

/// The attributes that the columns of a file are, without values.
pub(crate) fn empty(columns: &[Option<ColumnName>]) -> Vec<Attribute> {
    let attribute =
        |column: &ColumnName| Attribute { name: column.name.clone(), values: Values::new(column.kind) };
    columns.iter().flatten().map(attribute).collect()
}

/// The columns of a block that are attributes, in their last types: those of text change on the way.
pub(crate) fn kept(block: Vec<Values>, columns: &[Option<ColumnName>]) -> Vec<Values> {
    let last = |(values, column): (Values, &Option<ColumnName>)| Some(values.cast(column.as_ref()?.kind));
    block.into_iter().zip(columns).filter_map(last).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use densecloud_formats::Limits;

    /// More than one block of rows, whose types change on the way: whole numbers that become fractions, that become too large
    /// for 63 bits, and that become text.
    fn text() -> String {
        let row = |i: usize| {
            let half = if i == 70_000 { ".5" } else { "" };
            let large = if i == 69_000 { u64::MAX } else { i as u64 };
            let word = if i == 68_000 { "tree" } else { "7" };
            format!("{i} {} 0 {i}{half} {large} {word} {} {}\n", i % 100, i % 200, i as i64 - 9)
        };
        let rows: String = (0..80_000).map(row).collect();
        format!("x y z height id word red shift\n{rows}")
    }

    #[test]
    fn a_small_cloud_is_what_a_reader_reads() {
        let text = text();
        let open = || CloudReader::open(text.as_bytes(), Limits::default()).expect("a header");
        let Input::Small(cloud, header) = Input::read(open(), 80_000).expect("a cloud") else {
            panic!("it is small");
        };
        assert_eq!(header, *open().header());
        let whole = open().read().expect("a cloud");
        let kinds = |cloud: &Cloud| cloud.attributes.iter().map(|a| a.values.kind()).collect::<Vec<_>>();
        assert_eq!(kinds(&cloud), kinds(&whole));
        assert!(*cloud == whole && cloud.attributes.len() == 4);
        let Input::Large(large) = Input::read(open(), 79_999).expect("a cloud") else {
            panic!("it is large");
        };
        assert_eq!(large.first.iter().map(|block| block.positions.len()).sum::<usize>(), 80_000);
    }
}
