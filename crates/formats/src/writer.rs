//! Writing a cloud.

use std::io::{self, Read, Write};

use super::kind::{Begun, FirstPass, Rows};
use super::spool::Spool;
use super::{Format, FormatError};
use densecloud_cloud::{Attribute, Kind, Origin, Position};

/// Points encoded between two writes to the sink.
const BLOCK: usize = 4096;

/// Writes one cloud in parts: the header at once, then any number of [`write`](Self::write)s, then
/// [`finish`](Self::finish), which writes the tables of a PLY file. Where the header depends on more of the points than
/// their number, [`CloudPlan`] begins it.
///
/// Text holds the shortest decimals that read back as the same number. The output depends on what is
/// given alone: no date, no name of a machine.
#[derive(Debug)]
pub struct CloudWriter<W: Write> {
    sink: W,
    rows: Box<dyn Rows>,
    /// Of each attribute.
    kinds: Vec<Kind>,
    promised: u64,
    written: u64,
    scratch: Vec<u8>,
}

/// Writes a whole cloud, in any format. `origin` is what its source told of the whole.
///
/// Points are encoded and written some thousand at a time. The header of LAS depends on all points, so it costs a pass
/// over the columns first. LAZ and E57 files are made as a whole before they are written: in memory up to 64 MiB, in a
/// temporary file beyond. Compressed PCD is made in memory.
///
/// # Errors
/// The sink fails, a coordinate is beyond what the format holds, or a point's attributes are.
pub fn encode<W: Write>(
    mut sink: W,
    format: Format,
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<W, FormatError> {
    format.ask(|format| format.encode(&mut sink, positions, attributes, origin))?;
    sink.flush()?;
    Ok(sink)
}

/// The file of a cloud as bytes to read, for formats that are made as a whole: see [`encode_spooled`].
#[derive(Debug)]
pub struct Encoded(Spool);

impl Read for Encoded {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.0.read(bytes)
    }
}

/// As [`encode`], into memory up to 64 MiB and a temporary file without a name beyond.
///
/// # Errors
/// As [`encode`].
pub fn encode_spooled(
    format: Format,
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<Encoded, FormatError> {
    format.ask(|format| format.spooled(positions, attributes, origin)).map(Encoded)
}

/// What is to be known of a cloud before its first point is written: [`see`](Self::see) all points once, in blocks of
/// any size, then [`begin`](Self::begin) the file and write the same points. Memory is that of a block. For all formats
/// but E57 and compressed PCD.
///
/// ```
/// use densecloud_cloud::Origin;
/// use densecloud_formats::{CloudPlan, Format};
///
/// let blocks = [[[0.0, 0.0, 0.0]], [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.5]]];
/// let mut plan = CloudPlan::new(Format::Las { compressed: false }, &[], &Origin::default());
/// for block in &blocks {
///     plan.see(block, &[], 0)?;
/// }
/// let mut writer = plan.begin(Vec::new())?;
/// for block in &blocks {
///     writer.write(block)?;
/// }
/// assert!(writer.finish()?.starts_with(b"LASF"));
/// # Ok::<(), densecloud_formats::FormatError>(())
/// ```
pub struct CloudPlan {
    format: Format,
    /// Without numbers.
    attributes: Vec<Attribute>,
    origin: Origin,
    points: u64,
    /// Where the header needs more than the number of points.
    pass: Option<Box<dyn FirstPass>>,
}

impl CloudPlan {
    /// Nothing seen, of a cloud with attributes of these names and types.
    #[must_use]
    pub fn new(format: Format, attributes: &[Attribute], origin: &Origin) -> Self {
        let pass = format.ask(|format| format.first_pass(attributes, origin));
        let attributes = attributes.iter().map(Attribute::without_values).collect();
        Self { format, attributes, origin: origin.clone(), points: 0, pass }
    }

    /// Takes note of further points: the first of `positions` has the attributes' values at row `from`. O(n).
    ///
    /// # Errors
    /// The format has no place for one of the points.
    ///
    /// # Panics
    /// When the attributes are not of the types named first, or have too few rows.
    pub fn see(
        &mut self,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        assert_kinds(attributes, &kinds(&self.attributes));
        self.points += positions.len() as u64;
        self.pass.as_mut().map_or(Ok(()), |pass| pass.see(positions, attributes, from))
    }

    /// Whether the header depends on more of the points than their number; if not, [`CloudWriter::with`] begins the same
    /// file of points that nobody has seen.
    #[must_use]
    pub fn needs_points(&self) -> bool {
        self.pass.is_some()
    }

    /// As [`Format::renamed`], of the points that were seen.
    #[must_use]
    pub fn renamed(&self) -> Vec<(String, String)> {
        let told = self.pass.as_ref().and_then(|pass| pass.renamed());
        told.unwrap_or_else(|| self.format.renamed(&self.attributes, &self.origin))
    }

    /// Writes the header of a cloud of all points that were seen.
    ///
    /// # Errors
    /// The sink fails, the format has no place for the cloud, or is only made as a whole.
    pub fn begin<W: Write>(self, sink: W) -> Result<CloudWriter<W>, FormatError> {
        let Self { format, attributes, origin, points, pass } = self;
        let begun = match pass {
            Some(pass) => pass.begin()?,
            None => format.ask(|format| format.begin(points, &attributes, &origin))?,
        };
        CloudWriter::begun(sink, begun, points, &attributes)
    }
}

fn kinds(attributes: &[Attribute]) -> Vec<Kind> {
    attributes.iter().map(|attribute| attribute.values.kind()).collect()
}

fn assert_kinds(attributes: &[Attribute], promised: &[Kind]) {
    assert!(kinds(attributes) == promised, "other attributes than promised");
}

/// Writes what [`Choices::begin`](super::kind::Choices::begin) has begun.
pub(super) fn write_streamed(
    sink: &mut dyn Write,
    (header, mut rows): Begun,
    positions: &[Position],
    attributes: &[Attribute],
) -> Result<(), FormatError> {
    sink.write_all(&header)?;
    write_blocks(sink, rows.as_mut(), &mut Vec::new(), positions, attributes, 0)?;
    rows.end(sink)
}

/// Writes points block by block. The first point's attributes are at row `from`.
fn write_blocks(
    sink: &mut dyn Write,
    rows: &mut dyn Rows,
    scratch: &mut Vec<u8>,
    positions: &[Position],
    attributes: &[Attribute],
    from: usize,
) -> Result<(), FormatError> {
    for (i, block) in positions.chunks(BLOCK).enumerate() {
        scratch.clear();
        rows.put(scratch, block, attributes, from + i * BLOCK)?;
        sink.write_all(scratch)?;
    }
    Ok(())
}

impl<W: Write> CloudWriter<W> {
    /// Writes the header of a cloud of exactly `points` points without attributes.
    ///
    /// # Errors
    /// As [`with`](Self::with).
    pub fn new(sink: W, format: Format, points: u64) -> Result<Self, FormatError> {
        Self::with(sink, format, points, &[], &Origin::default())
    }

    /// Writes the header of a cloud of exactly `points` points with attributes of these names and types.
    ///
    /// # Errors
    /// The sink fails, the header depends on more (LAS: see [`CloudPlan`]), or the format is only made as a whole.
    pub fn with(
        sink: W,
        format: Format,
        points: u64,
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<Self, FormatError> {
        let begun = format.ask(|format| format.begin(points, attributes, origin))?;
        Self::begun(sink, begun, points, attributes)
    }

    fn begun(
        mut sink: W,
        (header, rows): Begun,
        promised: u64,
        attributes: &[Attribute],
    ) -> Result<Self, FormatError> {
        sink.write_all(&header)?;
        Ok(Self { sink, rows, kinds: kinds(attributes), promised, written: 0, scratch: Vec::new() })
    }

    /// Appends points of a cloud without attributes.
    ///
    /// # Errors
    /// As [`write_rows`](Self::write_rows).
    pub fn write(&mut self, positions: &[Position]) -> Result<(), FormatError> {
        self.write_rows(positions, &[], 0)
    }

    /// Appends points: the first of `positions` has the attributes' values at row `from`.
    ///
    /// # Errors
    /// The sink fails, there are more points than promised (then none of these is written), or a
    /// finite coordinate is beyond the range of [`Scalar::F32`](super::Scalar::F32).
    ///
    /// # Panics
    /// When the attributes are not of the promised types, or have too few rows.
    pub fn write_rows(
        &mut self,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        let written = self.written.saturating_add(positions.len() as u64);
        if written > self.promised {
            return Err(FormatError::WrongCount { promised: self.promised, written });
        }
        assert_kinds(attributes, &self.kinds);
        write_blocks(&mut self.sink, self.rows.as_mut(), &mut self.scratch, positions, attributes, from)?;
        self.written = written;
        Ok(())
    }

    /// Writes what follows the points, flushes, and gives the sink back.
    ///
    /// # Errors
    /// The sink fails, or fewer points were written than promised.
    pub fn finish(mut self) -> Result<W, FormatError> {
        if self.written != self.promised {
            return Err(FormatError::WrongCount { promised: self.promised, written: self.written });
        }
        self.rows.end(&mut self.sink)?;
        self.sink.flush()?;
        Ok(self.sink)
    }
}
