//! Reading a cloud in whatever format it comes.

use std::fs::File;
use std::io::Read;
use std::path::Path;

pub use super::block::Block;
use super::block::Within;
use super::columns::{TextColumn, rounded};
use super::first_bytes::ENOUGH;
use super::kind::Opened;
use super::known;
use super::registry::{self, Found};
use super::source::{Around, Input, Source};
use super::text::shown;
use super::{Format, FormatError, Header, Limits, Reading};
use densecloud_cloud::{Attribute, Cloud, Kind, Named, Origin, Values};

/// Points that are read at a time where nobody says how many.
const BLOCK: usize = 1 << 16;

/// Sentences that are told of one file: over HTTP each is a header field, of which clients take a hundred.
const MOST_NOTES: usize = 20;

/// Reads one cloud: [`open`](Self::open) takes the header, then [`read`](Self::read) all points, or
/// [`next_block`](Self::next_block) some at a time and [`finish`](Self::finish) what follows them.
///
/// It buffers by itself, so that the reader needs no `BufReader` around it.
///
/// ```
/// use densecloud_formats::{Block, CloudReader, Limits};
///
/// let text = "x y z red\n0 0 0 7\n1 0 0 8\n0 1 0 9\n";
/// let mut reader = CloudReader::open(text.as_bytes(), Limits::default())?;
/// let (mut block, mut points) = (Block::default(), 0);
/// while reader.next_block(2, &mut block)? {
///     points += block.positions.len();
/// }
/// let ending = reader.finish()?;
/// assert_eq!((points, ending.columns[0].as_ref().map(|c| c.name.as_str())), (3, Some("red")));
/// # Ok::<(), densecloud_formats::FormatError>(())
/// ```
pub struct CloudReader<'r> {
    source: Source<'r>,
    header: Header,
    points: Box<dyn Points>,
    /// Options of reading that say nothing to this format.
    unheeded: Vec<&'static str>,
    /// Points given so far.
    given: u64,
    within: Option<Within>,
}

/// Facts about a cloud that are known only after its last point.
#[derive(Debug, Clone, PartialEq)]
pub struct Ending {
    /// The attribute that each column of the blocks is; none for a column that is not kept.
    pub columns: Vec<Option<ColumnName>>,
    /// As [`Cloud::dropped_properties`].
    pub dropped_properties: Vec<String>,
    /// As [`Cloud::notes`].
    pub notes: Vec<String>,
    /// What the file tells of the whole, its hash among it.
    pub origin: Origin,
}

/// The attribute that a column is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColumnName {
    /// The attribute's name.
    pub name: String,
    /// The smallest usual type that holds its numbers.
    pub kind: Kind,
}

impl Ending {
    /// The cloud of the blocks that came before.
    #[must_use]
    pub fn joined(self, blocks: Vec<Block>) -> Cloud {
        let Self { columns, dropped_properties, notes, origin } = self;
        let named = columns.iter().flatten();
        let mut attributes: Vec<Attribute> =
            named.map(|c| Attribute { name: c.name.clone(), values: Values::new(c.kind) }).collect();
        let mut positions = Vec::with_capacity(blocks.iter().map(|block| block.positions.len()).sum());
        for mut block in blocks {
            positions.append(&mut block.positions);
            // The types of text change on the way.
            let last =
                |(values, column): (Values, &Option<ColumnName>)| Some(values.cast(column.as_ref()?.kind));
            let values = block.columns.into_iter().zip(&columns).filter_map(last);
            attributes.iter_mut().zip(values).for_each(|(a, mut more)| a.values.append(&mut more));
        }
        Cloud { positions, attributes, dropped_properties, notes, origin }
    }

    /// Of columns of text by these names, which tell nothing of the whole.
    pub(crate) fn of_text<'a>(columns: impl Iterator<Item = (String, &'a TextColumn)>) -> Self {
        let (mut dropped_properties, mut notes) = (Vec::new(), Vec::new());
        let columns = columns.map(|(name, column)| {
            if *column == (TextColumn::Real { rounded: true }) {
                notes.push(rounded(&name));
            }
            match column.kind() {
                Some(kind) => Some(ColumnName { name, kind }),
                None => {
                    dropped_properties.push(format!("{name} (text)"));
                    None
                }
            }
        });
        let columns = columns.collect();
        Self { columns, dropped_properties, notes, origin: Origin::default() }
    }
}

/// The points of a file that is open.
pub(crate) trait Points {
    /// Appends the next points, at most `rows` of them, and nothing when all are read. The block is empty, or holds the
    /// points of all calls before. A file whose points do not lie one after another gives all of them in one call.
    ///
    /// # Errors
    /// The data are malformed, end early, or pass a limit.
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError>;

    /// Reads what follows the points. The hash is not told here.
    ///
    /// # Errors
    /// The data are malformed, end early, or go on after what the header counts.
    fn finish(self: Box<Self>, source: &mut Source<'_>) -> Result<Ending, FormatError>;
}

impl<'r> CloudReader<'r> {
    /// Recognises the format by its content and reads its header (for text: the first thousand lines, which decide how
    /// the others are read).
    ///
    /// # Errors
    /// The format is none of ours, the header is malformed, or what it claims is over a limit.
    pub fn open(reader: impl Read + 'r, limits: Limits) -> Result<Self, FormatError> {
        Self::open_as(reader, limits, &Reading::default())
    }

    /// As [`open`](Self::open), in the way that a person asks for.
    ///
    /// # Errors
    /// As [`open`](Self::open), or the file is not what `reading` says.
    pub fn open_as(reader: impl Read + 'r, limits: Limits, reading: &Reading) -> Result<Self, FormatError> {
        Self::open_input(Input::Stream(Box::new(reader)), limits, reading, None)
    }

    /// As [`open`](Self::open) of a file. What must be sought in is read from where it lies, and not copied first.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_file(file: File, limits: Limits) -> Result<Self, FormatError> {
        Self::open_file_as(file, limits, &Reading::default())
    }

    /// As [`open_file`](Self::open_file), in the way that a person asks for.
    ///
    /// # Errors
    /// As [`open_as`](Self::open_as).
    pub fn open_file_as(file: File, limits: Limits, reading: &Reading) -> Result<Self, FormatError> {
        Self::open_input(Input::of_file(file)?, limits, reading, None)
    }

    /// As [`open_file_as`](Self::open_file_as), without limits; the file's name may tell what its content does not, as
    /// [`read_cloud_file`] has it.
    ///
    /// # Errors
    /// As [`open_as`](Self::open_as), or the file cannot be opened.
    pub fn open_path(path: &Path, reading: &Reading) -> Result<CloudReader<'static>, FormatError> {
        let input = Input::of_file(File::open(path)?)?;
        CloudReader::open_input(input, Limits::default(), reading, Some(path))
    }

    /// As [`open_path`](Self::open_path), of a file of this name that lies elsewhere.
    ///
    /// # Errors
    /// As [`open_as`](Self::open_as).
    pub fn open_named(reader: impl Read + 'r, name: &Path, reading: &Reading) -> Result<Self, FormatError> {
        Self::open_input(Input::Stream(Box::new(reader)), Limits::default(), reading, Some(name))
    }

    /// As [`open_as`](Self::open_as), of a file of this name.
    fn open_input(
        input: Input<'r>,
        limits: Limits,
        reading: &Reading,
        name: Option<&Path>,
    ) -> Result<Self, FormatError> {
        let asked = reading.format.and_then(|format| registry::by_name(format.name()));
        let around = asked.as_ref().map_or(Around::Utf16, |found| found.around);
        let mut source = Source::new(input, limits, around)?;
        let found = match asked {
            Some(found) => found,
            None => recognise(source.peek(ENOUGH)?, name)?,
        };
        let within = reading.bounds.map(|bounds| Within::new(bounds, limits));
        let is_all = within.is_none();
        // Which points count is known only as they come.
        let max_points = limits.max_points.filter(|_| is_all);
        let opened = (found.open)(&mut source, Limits { max_points, ..limits }, reading)?;
        let Opened { mut header, points } = opened;
        header.points = header.points.filter(|_| is_all);
        Ok(Self { source, header, points, unheeded: reading.unheeded(found.heeds), given: 0, within })
    }

    /// What is known before the points are read.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Replaces the block's points by the next ones, at most `rows` of them; false when all are read.
    ///
    /// Memory is that of the block and a buffer, whatever the file's length. Files whose points do not lie one after
    /// another come in one block: compressed PCD, E57, OBJ, and NumPy arrays in Fortran order. Of COLMAP's points the
    /// keys are held to the end, 32 bytes a point. LAS, LAZ and E57 need to seek: a file given to
    /// [`open_file`](Self::open_file) is read where it lies; a stream is copied first, to memory up to 64 MiB and to a
    /// temporary file beyond.
    ///
    /// # Errors
    /// The data are malformed, end early, or pass a limit.
    pub fn next_block(&mut self, rows: usize, block: &mut Block) -> Result<bool, FormatError> {
        loop {
            block.positions.clear();
            block.columns.clear();
            self.points.append(&mut self.source, rows.max(1), block)?;
            if block.positions.is_empty() {
                return Ok(false);
            }
            if let Some(within) = &mut self.within {
                within.keep(block, self.given)?;
            }
            self.given += block.positions.len() as u64;
            if !block.positions.is_empty() {
                return Ok(true);
            }
        }
    }

    /// Reads what follows the points; to be called once [`next_block`](Self::next_block) has given all.
    ///
    /// # Errors
    /// The data are malformed, end early, go on after what the header counts, or hold no point.
    pub fn finish(mut self) -> Result<Ending, FormatError> {
        let mut ending = self.points.finish(&mut self.source)?;
        if self.given == 0 {
            let what = if self.within.is_some() { "points within the bounds" } else { "points" };
            return Err(FormatError::Empty(what));
        }
        if self.within.is_some_and(|within| within.has_others) {
            let lost = ending.origin.drop_references();
            ending
                .dropped_properties
                .extend(lost.into_iter().map(|name| format!("{name} (about all points)")));
        }
        let mut dropped = self.header.dropped_properties;
        dropped.append(&mut ending.dropped_properties);
        ending.dropped_properties = dropped;
        if !self.unheeded.is_empty() {
            let options = self.unheeded.join(", ");
            let note = format!("{options}: for text; this is {}, and tells its own", self.header.format);
            // Before what may be told often.
            ending.notes.insert(0, note);
        }
        shorten(&mut ending.notes);
        let names = ending.columns.iter().flatten().map(|column| column.name.clone()).collect();
        ending.origin.named_in = Some(Named { kind: self.header.format.kind(), names });
        ending.origin.sha256 = Some(self.source.sha256()?);
        Ok(ending)
    }

    /// Reads the points and everything after them. O(n); memory grows with the data, not with the
    /// header's claim. NaN and infinite coordinates are read as they are.
    ///
    /// # Errors
    /// The data are malformed, end early, go on after what the header counts, pass a limit, or hold no
    /// point.
    pub fn read(mut self) -> Result<Cloud, FormatError> {
        if self.within.is_some() {
            return self.read_blocks();
        }
        let mut all = Block::default();
        loop {
            let before = all.positions.len();
            self.points.append(&mut self.source, BLOCK, &mut all)?;
            if all.positions.len() == before {
                break;
            }
        }
        self.given = all.positions.len() as u64;
        let Ending { columns, dropped_properties, notes, origin } = self.finish()?;
        let attribute = |(values, column): (Values, Option<ColumnName>)| {
            let ColumnName { name, kind } = column?;
            Some(Attribute { name, values: narrowed(values, kind) })
        };
        let attributes = all.columns.into_iter().zip(columns).filter_map(attribute).collect();
        Ok(Cloud { positions: all.positions, attributes, dropped_properties, notes, origin })
    }
}

impl CloudReader<'_> {
    /// As [`read`](Self::read), by way of blocks.
    fn read_blocks(mut self) -> Result<Cloud, FormatError> {
        let mut blocks = Vec::new();
        let mut block = Block::default();
        while self.next_block(BLOCK, &mut block)? {
            blocks.push(std::mem::take(&mut block));
        }
        Ok(self.finish()?.joined(blocks))
    }
}

/// Leaves the first sentences, and how many there were beside them.
fn shorten(notes: &mut Vec<String>) {
    if notes.len() > MOST_NOTES {
        let more = notes.len() - MOST_NOTES + 1;
        notes.truncate(MOST_NOTES - 1);
        notes.push(format!("and {more} more of this kind"));
    }
}

/// The numbers in another type, which holds them all, where they are not in that already.
fn narrowed(values: Values, kind: Kind) -> Values {
    match (values, kind) {
        (Values::I64(numbers), Kind::U8) => Values::U8(numbers.iter().map(|&n| n as u8).collect()),
        (Values::I64(numbers), Kind::I32) => Values::I32(numbers.iter().map(|&n| n as i32).collect()),
        (values, _) => values,
    }
}

/// Reads a cloud from a file, without limits. The content tells the format; where that is text or numbers alone, the
/// name may: a `points3D.txt` is COLMAP's, and text that is named `.ply` is refused rather than taken for points.
///
/// # Errors
/// As [`CloudReader::open`] and [`CloudReader::read`], or the file cannot be opened.
pub fn read_cloud_file(path: &Path) -> Result<(Cloud, Header), FormatError> {
    read_cloud_file_as(path, &Reading::default())
}

/// As [`read_cloud_file`], in the way that a person asks for.
///
/// # Errors
/// As [`read_cloud_file`], or the file is not what `reading` says.
pub fn read_cloud_file_as(path: &Path, reading: &Reading) -> Result<(Cloud, Header), FormatError> {
    let reader = CloudReader::open_path(path, reading)?;
    let header = reader.header.clone();
    Ok((reader.read()?, header))
}

/// The format of a file that begins with `head` and has this name, if it has one. Content wins, but text under the name of
/// another format is refused rather than taken for points.
fn recognise(head: &[u8], name: Option<&Path>) -> Result<Found, FormatError> {
    match (by_content(head), name) {
        (Ok(found), Some(_)) if !found.is_bare => Ok(found),
        (found, None) => found,
        (found, Some(name)) => {
            if let (Some(named), false) = (registry::by_file(name), head.is_empty()) {
                return Ok(named);
            }
            let found = found?;
            match Format::from_extension(name).and_then(Format::beginning) {
                Some(begins) => {
                    let found = format!("text that does not begin with {begins}");
                    Err(FormatError::Unrecognised { found })
                }
                None => Ok(found),
            }
        }
    }
}

/// The format of a file that begins with `head`.
fn by_content(head: &[u8]) -> Result<Found, FormatError> {
    if head.is_empty() {
        return Err(FormatError::Empty("points"));
    }
    if let Some(found) = registry::by_bytes(head) {
        return Ok(found);
    }
    let unknown = |found: String| FormatError::Unrecognised { found };
    if let Some(name) = known::name(head) {
        return Err(unknown(name));
    }
    if head.len() >= 8 && (is_every_other(head, 0) || is_every_other(head, 1)) {
        return Err(unknown("text in UTF-16 without a byte order mark; save it as UTF-8".to_owned()));
    }
    if known::is_binary(head) {
        let (begin, names) = (shown(&head[..head.len().min(8)]), registry::unmarked().join(", "));
        return Err(unknown(format!(
            "binary data that begin with {begin} (--format reads what nothing tells: {names})"
        )));
    }
    registry::by_lines(head).ok_or_else(|| unknown("text".to_owned()))
}

/// Whether every other byte, from this one on, is zero, and none between them: as letters and digits are in UTF-16.
fn is_every_other(head: &[u8], from: usize) -> bool {
    let (pairs, _) = head.as_chunks::<2>();
    pairs.iter().take(64).all(|pair| pair[from] == 0 && pair[1 - from] != 0)
}
