//! Names of formats, what a header says, and limits.

use std::fmt;
use std::path::Path;

use super::reader::CloudReader;
use super::registry::{self, Format};
use super::{FormatError, Reading};
use densecloud_cloud::{Attribute, Origin, Position};
use serde::{Deserialize, Serialize};

/// The type of written coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Scalar {
    /// 32-bit floats.
    F32,
    /// 64-bit floats.
    F64,
}

/// What is known of a cloud before its points are read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// The format, as a writer needs it. A PLY file whose coordinates are 32-bit integers or wider
    /// counts as [`Scalar::F64`], narrower ones as [`Scalar::F32`]: no dense cloud is integer.
    pub format: Format,
    /// The number of points that the header claims. A claim: the data may end earlier.
    pub points: Option<u64>,
    /// What the file tells of each point beside its position, by name, in the file's order.
    pub attributes: Vec<String>,
    /// What the file holds and will be dropped: lists of vertices, fields of several numbers, elements
    /// without properties, in the file's order.
    pub dropped_properties: Vec<String>,
}

/// How much a reader takes. The default sets no limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Limits {
    /// Most bytes of input, the header included.
    pub max_bytes: Option<u64>,
    /// Most points.
    pub max_points: Option<u64>,
}

impl Limits {
    /// # Errors
    /// [`FormatError::TooManyPoints`] for more points than these.
    pub(super) fn check_points(self, points: u64) -> Result<(), FormatError> {
        match self.max_points {
            Some(limit) if points > limit => Err(FormatError::TooManyPoints { points, limit }),
            _ => Ok(()),
        }
    }

    /// # Errors
    /// [`FormatError::TooLarge`] for more bytes than these.
    pub(super) fn check_bytes(self, bytes: u64) -> Result<(), FormatError> {
        match self.max_bytes {
            Some(limit) if bytes > limit => Err(FormatError::TooLarge { bytes, limit }),
            _ => Ok(()),
        }
    }
}

impl Format {
    /// The format that a file's extension asks for: `ply` is binary, little-endian, with 32-bit floats; `xyz`, `txt`,
    /// `asc`, `pts` and `pwn` are text without names, with spaces, and `csv` with commas; `las`, `laz`, `e57`, `pcd`
    /// (binary) and `npy` (64-bit floats, attributes as fields) are what they say. The whole names `points3D.txt` and
    /// `points3D.bin` come first. Case is ignored.
    #[must_use]
    pub fn from_extension(path: &Path) -> Option<Self> {
        let lower = |name: &std::ffi::OsStr| Some(name.to_str()?.to_ascii_lowercase());
        let by_name = path.file_name().and_then(lower).and_then(|name| registry::from_name(&name));
        by_name.or_else(|| registry::from_extension(&path.extension().and_then(lower)?))
    }

    /// The format that the name of an output asks for: as [`from_extension`](Self::from_extension), and none for a name
    /// without an extension, or `-`.
    ///
    /// # Errors
    /// [`FormatError::NotWritten`] for an extension of nothing that is written, with those that are: what has that name
    /// would not be what it says.
    pub fn of_output(path: &Path) -> Result<Option<Self>, FormatError> {
        let Some(extension) = path.extension() else { return Ok(None) };
        if let Some(format) = Self::from_extension(path).filter(|format| format.is_written()) {
            return Ok(Some(format));
        }
        let (extension, endings) = (extension.to_string_lossy(), registry::endings());
        let (last, others) = endings.split_last().map_or(("", &[][..]), |(last, others)| (last, others));
        Err(FormatError::NotWritten(format!(
            "nothing is written as `.{extension}`; names of outputs end in {} or {last}",
            others.join(", ")
        )))
    }

    /// As [`of_output`](Self::of_output), of what is made of the file `input`, which is read as `reading` says: where both
    /// names end alike and no format does (`.dat`), text stays what it is. Looks at the input's first lines only then.
    ///
    /// # Errors
    /// As [`of_output`](Self::of_output).
    pub fn of_output_from(
        output: &Path,
        input: &Path,
        reading: &Reading,
    ) -> Result<Option<Self>, FormatError> {
        Self::of_output(output).or_else(|refused| {
            let is_own =
                ends_alike(output, input) && Self::of_file(input, reading).is_some_and(Self::has_any_name);
            if is_own { Ok(None) } else { Err(refused) }
        })
    }

    /// The format of a file, where it can be opened as one.
    fn of_file(path: &Path, reading: &Reading) -> Option<Self> {
        Some(CloudReader::open_path(path, reading).ok()?.header().format)
    }

    /// Whether its files are called anything: they begin with their points, and so say nothing of their own.
    fn has_any_name(self) -> bool {
        self.is_written() && self.beginning().is_none()
    }

    /// Whether both are of one kind, whatever the choices within it.
    #[must_use]
    pub fn is_like(self, other: Self) -> bool {
        std::mem::discriminant(&self) == std::mem::discriminant(&other)
    }

    /// Whether files of both go by the same names: LAS and LAZ do not.
    #[must_use]
    pub fn is_named_like(self, other: Self) -> bool {
        let is_text = |format: Self| format.media_type().starts_with("text/");
        self.is_like(other) && is_text(self) == is_text(other) && self.is_packed() == other.is_packed()
    }

    /// Whether clouds are written in it, and not only read.
    #[must_use]
    pub fn is_written(self) -> bool {
        self.written() == self
    }

    /// The format that a cloud of this one is written in where nobody says which: itself, or, for what
    /// is read only, binary PLY in 64-bit floats, which holds all that was read.
    #[must_use]
    pub fn written(self) -> Self {
        self.ask(|format| format.written()).unwrap_or(self)
    }

    /// The type that holds all that coordinates of this format can tell: 64 bits for text, LAS and whole numbers.
    #[must_use]
    pub fn scalar(self) -> Scalar {
        self.ask(|format| format.scalar())
    }

    /// The format of a result: the kind that is `wanted` (by an extension, say), with the encoding of the
    /// input where both are of one kind; the [written](Self::written) one of the input where none is.
    ///
    /// `names` is whether text of another kind of input should begin with a line of names, without which
    /// those of its attributes would be lost.
    #[must_use]
    pub fn of_result(wanted: Option<Self>, input: Self, names: bool) -> Self {
        wanted.map_or_else(|| input.written(), |wanted| wanted.ask(|format| format.of_result(input, names)))
    }

    /// This format with 64-bit coordinates where 32-bit ones would move points of `bounds` by more than a
    /// hundredth of `spacing`: a cloud in UTM coordinates, say.
    #[must_use]
    pub fn fine_enough(self, bounds: [Position; 2], spacing: f64) -> Self {
        let largest = bounds.as_flattened().iter().fold(0.0_f64, |most, c| most.max(c.abs()));
        // Rounding moves a coordinate by half of the step between two floats at most.
        let is_coarse = 0.5 * largest * f64::from(f32::EPSILON) > 0.01 * spacing;
        let finer = if is_coarse { self.ask(|format| format.finer()) } else { None };
        finer.unwrap_or(self)
    }

    /// Whether it has a place for comments, and so for provenance.
    #[must_use]
    pub fn holds_comments(self) -> bool {
        self.ask(|format| format.holds_comments())
    }

    /// Whether files are compressed in themselves, so that compressing them once more is in vain.
    #[must_use]
    pub fn is_packed(self) -> bool {
        self.ask(|format| format.is_packed())
    }

    /// Whether [`CloudWriter`](super::CloudWriter) gives the bytes of each point as it is written; if not, they come at
    /// the end (LAZ), or only [`encode`](super::encode) writes it, from all columns (E57, compressed PCD).
    #[must_use]
    pub fn is_streamed(self) -> bool {
        self.ask(|format| format.is_streamed())
    }

    /// Whether [`CloudPlan`](super::CloudPlan) writes it, and no memory needs to hold a whole cloud: all that is written but
    /// E57 and compressed PCD.
    #[must_use]
    pub fn is_made_in_parts(self) -> bool {
        self.ask(|format| format.is_made_in_parts())
    }

    /// Extensions of what is [made in parts](Self::is_made_in_parts).
    #[must_use]
    pub fn endings_of_parts() -> Vec<String> {
        let is_one = |ending: &String| {
            Self::from_extension(format!("cloud{ending}").as_ref()).is_some_and(Self::is_made_in_parts)
        };
        registry::endings().into_iter().filter(is_one).collect()
    }

    /// What a file of this format has no place for, a phrase each: of the attributes and of what else is
    /// known of the cloud.
    #[must_use]
    pub fn cannot_hold(self, attributes: &[Attribute], origin: &Origin) -> Vec<String> {
        self.ask(|format| {
            let mut lost = format.not_held(attributes, origin);
            if let (false, Some(crs)) = (format.holds_crs(), &origin.crs) {
                lost.push(format!("the coordinate system ({})", crs.name()));
            }
            if !format.holds_sensor() && (origin.sensor.is_some() || origin.sensors.is_some()) {
                lost.push("the sensor's place".to_owned());
            }
            if !format.holds_orientation() && origin.orientation.is_some() {
                lost.push("how the sensor was turned".to_owned());
            }
            if !format.holds_tables() {
                lost.extend(origin.tables.iter().map(|table| table.name.clone()));
            }
            lost
        })
    }

    /// What becomes of attributes' names in a file of this format: the name in the cloud, and that in the file, where they
    /// differ, because the format has no place for some characters, has the name for something else, or would have it twice. Attributes
    /// that go to a place of the format's own (`Red` to LAS's `red`) are not among them. For LAS, whose places hold some
    /// numbers and not others, it costs a pass over the columns.
    ///
    /// ```
    /// use densecloud_cloud::{Attribute, Origin, Values};
    /// use densecloud_formats::Format;
    ///
    /// let attribute = |name: &str| Attribute { name: name.into(), values: Values::U8(vec![7]) };
    /// let attributes = ["scan angle", "red", "red"].map(attribute);
    /// let ply = Format::from_extension("dense.ply".as_ref()).expect("PLY");
    /// let renamed = ply.renamed(&attributes, &Origin::default());
    /// let pairs: Vec<(&str, &str)> = renamed.iter().map(|(from, to)| (from.as_str(), to.as_str())).collect();
    /// assert_eq!(pairs, [("scan angle", "scan_angle"), ("red", "red_")]);
    /// ```
    #[must_use]
    pub fn renamed(self, attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
        self.ask(|format| format.renamed(attributes, origin))
    }

    /// The media types of all that is written; see [`Format::media_type`].
    pub const MEDIA_TYPES: [&str; registry::MEDIA_TYPES.len()] = registry::MEDIA_TYPES;

    /// The format that a media type asks for, without parameters, in lower case; as
    /// [`Format::from_extension`] has it.
    #[must_use]
    pub fn from_media_type(media_type: &str) -> Option<Self> {
        registry::from_media_type(media_type)
    }

    /// The media type for HTTP. PLY and PCD have no registered one.
    #[must_use]
    pub fn media_type(self) -> &'static str {
        self.ask(|format| format.media_type())
    }

    /// The name that a file of it is saved under: `stem` with its extension, or a whole name where that alone tells what
    /// the file is.
    ///
    /// ```
    /// use densecloud_formats::Format;
    ///
    /// for media_type in Format::MEDIA_TYPES {
    ///     let name = Format::from_media_type(media_type).expect("it is written").file_name("dense");
    ///     let named = Format::from_extension(name.as_ref()).expect("a format");
    ///     assert_eq!(named.media_type().split(';').next(), Some(media_type));
    /// }
    /// assert_eq!(Format::TEXT.file_name("dense"), "dense.xyz");
    /// assert_eq!(Format::Colmap { binary: false }.file_name("dense"), "points3D.txt");
    /// ```
    #[must_use]
    pub fn file_name(self, stem: &str) -> String {
        let media_type = self.written().media_type();
        let own = |name: &String| {
            Self::from_extension(name.as_ref()).is_some_and(|format| format.media_type() == media_type)
        };
        let whole = |ending: String| if ending.starts_with('.') { format!("{stem}{ending}") } else { ending };
        // Of all that is written there is one.
        registry::endings().into_iter().map(whole).find(own).unwrap_or_else(|| stem.to_owned())
    }

    /// The exact length in bytes of a file of `points` points with these attributes as
    /// [`CloudWriter`](super::CloudWriter) writes it, where it depends on nothing else: binary PLY,
    /// PCD and COLMAP, and NumPy.
    #[must_use]
    pub fn encoded_len(self, points: u64, attributes: &[Attribute], origin: &Origin) -> Option<u64> {
        self.ask(|format| format.encoded_len(points, attributes, origin))
    }

    /// An estimate of a file's length in bytes, mostly from above. `attribute_bytes`: bytes of a point's attributes in
    /// memory.
    #[must_use]
    pub fn file_bytes(self, points: u64, attribute_bytes: u64) -> u64 {
        let position = size_of::<Position>() as u64;
        points.saturating_mul(self.ask(|format| format.bytes_a_point(position, attribute_bytes)))
    }

    /// An estimate of the disk that making a file takes beside the file itself, in the folder for temporary files: none for what is
    /// [streamed](Self::is_streamed). `attribute_bytes` as for [`file_bytes`](Self::file_bytes).
    #[must_use]
    pub fn temporary_bytes(self, points: u64, attribute_bytes: u64) -> u64 {
        let file = self.file_bytes(points, attribute_bytes);
        self.ask(|format| format.temporary_bytes(file))
    }

    /// An estimate, from above, of the memory that [`encode`](super::encode) takes beside the cloud: little for what is
    /// [streamed](Self::is_streamed), 128 MiB at most for E57, 192 for LAZ and 448 for COPC (more where no temporary file can be written), and the file three times for
    /// compressed PCD. `attribute_bytes` as for [`file_bytes`](Self::file_bytes).
    #[must_use]
    pub fn bytes_at_work(self, points: u64, attribute_bytes: u64) -> u64 {
        let file = self.file_bytes(points, attribute_bytes);
        self.ask(|format| format.bytes_at_work(file))
    }
}

/// Whether two names have one extension, in any case; none of what is packed, since no result is.
fn ends_alike(a: &Path, b: &Path) -> bool {
    let extension = |path: &Path| path.extension().map(|extension| extension.to_ascii_lowercase());
    extension(a).is_some_and(|own| own != "gz" && extension(b) == Some(own))
}

/// For people: `PLY (binary_little_endian, 32-bit)`.
impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.ask(|format| format.fmt(f))
    }
}

impl Scalar {
    /// Bytes a number.
    pub(super) fn size(self) -> u64 {
        match self {
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}
