//! What a format tells of itself. One implementation of [`FormatKind`] in a folder, and one entry in the
//! [registry](super::registry), are all that makes a format.

use std::fmt::{self, Debug};
use std::io::{Seek, Write};

use super::reader::Points;
use super::source::Source;
use super::spool::Spool;
use super::{Format, FormatError, Header, Limits, Reading, Scalar, registry, writer};
use densecloud_cloud::{Attribute, Origin, Position, Role};

/// A format, whatever the choices within it: how its files are named, recognised and opened. The type that
/// implements it is the choices.
pub(crate) trait FormatKind: Choices + Copy + 'static {
    /// How its files are told from those of others.
    const MARK: Mark;

    /// The names by which a person asks for it as a file's format ([`Reading::format`]).
    const NAMES: &'static [&'static str];

    /// The options of [`Reading`] that say how its files are read, by their names on the command line; a warning tells of
    /// others.
    const HEEDS: &'static [&'static str] = &[];

    /// What its files begin with, for people; none for text, which begins with points.
    const BEGINNING: Option<&'static str>;

    /// The word at the end of a header of lines, which must be there whole before the header can be judged; none where
    /// its beginning says enough.
    const HEADER_END: Option<&'static [u8]> = None;

    /// The media types that it is written as, without parameters.
    const MEDIA_TYPES: &'static [&'static str];

    /// The extensions, in lower case, of what is written in it.
    const EXTENSIONS: &'static [&'static str];

    /// The whole names, of what is written in it, that tell more than their extension does.
    const FILES: &'static [&'static str] = &[];

    /// The choices that a file's whole name, in lower case, asks for, whatever its extension.
    fn from_name(_name: &str) -> Option<Self> {
        None
    }

    /// The choices that a file's extension, in lower case, asks for.
    fn from_extension(extension: &str) -> Option<Self>;

    /// The choices that a media type, in lower case and without parameters, asks for.
    fn from_media_type(media_type: &str) -> Option<Self>;

    /// Reads what stands before the points, and checks it against the limits.
    ///
    /// # Errors
    /// The header is malformed, or what it claims is over a limit.
    fn open(source: &mut Source<'_>, limits: Limits, reading: &Reading) -> Result<Opened, FormatError>;
}

/// How files of a format are recognised by their first bytes, up to 4096 of them.
pub(crate) enum Mark {
    /// By bytes that nothing else begins with.
    Bytes(fn(&[u8]) -> bool),
    /// By nothing but what a person says, or its name.
    None,
    /// By its first lines. Asked of text that no format's bytes match, in the registry's order.
    Lines(fn(&[u8]) -> bool),
}

/// A file whose header is read.
pub(crate) struct Opened {
    pub(crate) header: Header,
    pub(crate) points: Box<dyn Points>,
}

/// A format with its choices made: what a file of it holds, and how it is written. Its [`Display`](fmt::Display)
/// is for people: `PLY (binary_little_endian, 32-bit)`.
pub(crate) trait Choices: fmt::Display {
    /// The media type for HTTP, with parameters.
    fn media_type(&self) -> &'static str;

    /// The format of a result that is wanted in this one, by an extension, say; see [`Format::of_result`].
    fn of_result(&self, input: Format, names: bool) -> Format;

    /// The format that a cloud of this one is written in by default, if it is another.
    fn written(&self) -> Option<Format> {
        None
    }

    /// The type that holds all that coordinates of this format can tell.
    fn scalar(&self) -> Scalar {
        Scalar::F64
    }

    /// This format with 64-bit coordinates, where it has 32-bit ones now.
    fn finer(&self) -> Option<Format> {
        None
    }

    /// Whether it has a place for comments.
    fn holds_comments(&self) -> bool {
        true
    }

    /// Whether it has a place for the coordinate system.
    fn holds_crs(&self) -> bool {
        true
    }

    /// Whether it has a place for where the sensor stood.
    fn holds_sensor(&self) -> bool {
        false
    }

    /// Whether it has a place for how the sensor was turned.
    fn holds_orientation(&self) -> bool {
        false
    }

    /// Whether it has a place for tables beside the points.
    fn holds_tables(&self) -> bool {
        false
    }

    /// Attributes and facts about the whole cloud that it has no place for, a phrase each; the coordinate system, the
    /// sensor's place and tables are asked for apart.
    fn not_held(&self, _attributes: &[Attribute], origin: &Origin) -> Vec<String> {
        origin.extra.as_ref().map(|extra| extra.lost_elsewhere()).unwrap_or_default()
    }

    /// What has become of attributes' names in a file: the name in the cloud, and that in the file, where they differ.
    /// What stands under one of the format's own names, for what it means, is not among them.
    fn renamed(&self, _attributes: &[Attribute], _origin: &Origin) -> Vec<(String, String)> {
        Vec::new()
    }

    /// What it has whole numbers for.
    fn whole_numbers(&self) -> &'static [Role] {
        &[]
    }

    /// Whether files are compressed in themselves.
    fn is_packed(&self) -> bool {
        false
    }

    /// Whether each block's bytes are made as it is written, and none are held back to the end.
    fn is_streamed(&self) -> bool;

    /// Whether a file can be made of points that are given in parts ([`begin`](Self::begin),
    /// [`first_pass`](Self::first_pass)), and not only of a whole cloud.
    fn is_made_in_parts(&self) -> bool {
        true
    }

    /// The exact length of a file, where it depends on the number of points and on nothing else of them.
    fn encoded_len(&self, _points: u64, _attributes: &[Attribute], _origin: &Origin) -> Option<u64> {
        None
    }

    /// An estimate of a point's bytes in a file, mostly from above. `position`, `attributes`: bytes of its position and
    /// of its attributes in memory.
    fn bytes_a_point(&self, position: u64, attributes: u64) -> u64 {
        position + attributes
    }

    /// An estimate, from above, of the bytes of memory that making a file of `file` bytes takes beside the cloud and a
    /// block of points.
    fn bytes_at_work(&self, file: u64) -> u64 {
        if self.is_streamed() { 0 } else { Spool::most_held(file) }
    }

    /// An estimate of the bytes of temporary files that making a file of `file` bytes takes, where they are more than memory holds.
    fn temporary_bytes(&self, file: u64) -> u64 {
        if self.is_streamed() { 0 } else { file }
    }

    /// Begins a file of exactly `points` points with attributes of these names and types.
    ///
    /// # Errors
    /// The header needs to know more ([`first_pass`](Self::first_pass)), or the format is not written in parts.
    fn begin(&self, _points: u64, _attributes: &[Attribute], _origin: &Origin) -> Result<Begun, FormatError> {
        Err(FormatError::not_streamed(self))
    }

    /// Gathers what the header needs to know of the points, for attributes of these names and types; none where their
    /// number suffices.
    fn first_pass(&self, _attributes: &[Attribute], _origin: &Origin) -> Option<Box<dyn FirstPass>> {
        None
    }

    /// Writes a whole cloud.
    ///
    /// # Errors
    /// The sink fails, or the cloud holds what the format does not.
    fn encode(
        &self,
        sink: &mut dyn Write,
        positions: &[Position],
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<(), FormatError> {
        let begun = match self.first_pass(attributes, origin) {
            None => self.begin(positions.len() as u64, attributes, origin)?,
            Some(mut pass) => {
                pass.see(positions, attributes, 0)?;
                pass.begin()?
            }
        };
        writer::write_streamed(sink, begun, positions, attributes)
    }

    /// As [`encode`](Self::encode), from the beginning of a spool.
    ///
    /// # Errors
    /// As [`encode`](Self::encode).
    fn spooled(
        &self,
        positions: &[Position],
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<Spool, FormatError> {
        encoded(self, positions, attributes, origin)
    }
}

/// A file that is written from its beginning to its end, as a spool.
pub(crate) fn encoded<C: Choices + ?Sized>(
    format: &C,
    positions: &[Position],
    attributes: &[Attribute],
    origin: &Origin,
) -> Result<Spool, FormatError> {
    let mut file = Spool::new();
    format.encode(&mut file, positions, attributes, origin)?;
    file.rewind()?;
    Ok(file)
}

/// A format that is read and not written, with its choices made: its clouds are written in another.
pub(crate) trait ReadOnly: fmt::Display {
    /// As [`Choices::media_type`].
    fn media_type(&self) -> &'static str;

    /// As [`Choices::scalar`].
    fn scalar(&self) -> Scalar {
        Scalar::F64
    }
}

impl<T: ReadOnly> Choices for T {
    fn media_type(&self) -> &'static str {
        ReadOnly::media_type(self)
    }

    fn of_result(&self, input: Format, _names: bool) -> Format {
        input.written()
    }

    fn written(&self) -> Option<Format> {
        Some(registry::usual(ReadOnly::scalar(self)))
    }

    fn scalar(&self) -> Scalar {
        ReadOnly::scalar(self)
    }

    fn holds_comments(&self) -> bool {
        false
    }

    fn is_streamed(&self) -> bool {
        false
    }

    fn is_made_in_parts(&self) -> bool {
        false
    }

    fn begin(&self, _points: u64, _attributes: &[Attribute], _origin: &Origin) -> Result<Begun, FormatError> {
        Err(FormatError::read_only(self))
    }
}

/// A file's header, and the encoder of its points.
pub(crate) type Begun = (Vec<u8>, Box<dyn Rows>);

/// What a header needs to know of all points before the first one is written.
pub(crate) trait FirstPass: Send {
    /// Takes note of further points. The first point's attributes are at row `from`.
    ///
    /// # Errors
    /// The format has no place for one of them.
    fn see(
        &mut self,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError>;

    /// Begins a file of all points that were seen.
    ///
    /// # Errors
    /// The cloud holds what the format does not.
    fn begin(self: Box<Self>) -> Result<Begun, FormatError>;

    /// As [`Choices::renamed`], of all points that were seen; none where that does not depend on them.
    fn renamed(&self) -> Option<Vec<(String, String)>> {
        None
    }
}

/// Makes the bytes of points, a block at a time.
pub(crate) trait Rows: Debug + Send {
    /// Appends the bytes of points. The first point's attributes are at row `from`.
    ///
    /// # Errors
    /// A coordinate does not fit into the type that it is written in.
    fn put(
        &mut self,
        bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError>;

    /// Writes what follows the points.
    ///
    /// # Errors
    /// The sink fails.
    fn end(&mut self, _sink: &mut dyn Write) -> Result<(), FormatError> {
        Ok(())
    }
}
