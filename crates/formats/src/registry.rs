//! The list of formats: one entry each, with the choices that a file of it can be written with.
//!
//! Formats of text are asked in this order. Plain columns of numbers come last, since any text could be that.

use std::path::Path;

use super::kind::{Choices, FormatKind, Mark, Opened};
use super::source::{Around, Source};
use super::{
    Decimal, FormatError, Limits, PcdEncoding, PlyEncoding, Reading, Scalar, Separator, colmap, e57, kitti,
    las, npy, obj, off, pcd, ply, ptx, xyz,
};

/// Declares [`Format`] and the ways from it to the formats' modules.
macro_rules! formats {
    ($(
        $(#[$doc:meta])*
        $module:ident::$name:ident $({ $( $(#[$field_doc:meta])* $field:ident: $type:ty ),+ $(,)? })?
    )+) => {
        /// A file format and the choices within it. A reader reports it and a writer takes it, so that a
        /// cloud goes back in the form it came in.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        pub enum Format {
            $( $(#[$doc])* $name $({ $( $(#[$field_doc])* $field: $type ),+ })?, )+
        }

        $(impl From<$module::$name> for Format {
            fn from(choices: $module::$name) -> Self {
                let $module::$name $({ $($field),+ })? = choices;
                Self::$name $({ $($field),+ })?
            }
        })+

        /// All formats, whatever the choices within them.
        const KINDS: &[Registered] = &[$(Registered::of::<$module::$name>(),)+];

        impl Format {
            /// Asks the format's own module.
            pub(crate) fn ask<T>(self, question: impl FnOnce(&dyn Choices) -> T) -> T {
                match self {
                    $( Self::$name $({ $($field),+ })? => question(&$module::$name $({ $($field),+ })?), )+
                }
            }

            /// A word for the kind of format, whatever the choices within it.
            #[must_use]
            pub fn kind(self) -> &'static str {
                match self {
                    $( Self::$name { .. } => stringify!($module), )+
                }
            }

            /// What files of this format begin with, if not with points.
            pub(crate) fn beginning(self) -> Option<&'static str> {
                match self {
                    $( Self::$name { .. } => $module::$name::BEGINNING, )+
                }
            }
        }
    };
}

formats! {
    /// Stanford PLY.
    ply::Ply {
        /// How numbers are stored.
        encoding: PlyEncoding,
        /// The type of the coordinates.
        scalar: Scalar,
    }
    /// COPC: LAZ whose points lie in an octree.
    las::Copc
    /// LAS, and LAZ, which is LAS compressed.
    las::Las {
        /// LAZ.
        compressed: bool,
    }
    /// The Point Cloud Library's PCD.
    pcd::Pcd {
        /// How numbers are stored.
        encoding: PcdEncoding,
        /// The type of the coordinates; PCL's own points have 32-bit floats.
        scalar: Scalar,
    }
    /// NumPy's `.npy`, written little-endian, a point a row.
    npy::Npy {
        /// The type of the coordinates.
        scalar: Scalar,
        /// Whether attributes are fields with names and types of their own; without, they are further
        /// columns of the table that the coordinates are in, of the same type.
        fields: bool,
    }
    /// ASTM E57, written with 64-bit floats for coordinates.
    e57::E57
    /// OFF, read only: the vertices of a mesh.
    off::Off
    /// Wavefront OBJ, read only: the vertices of a mesh.
    obj::Obj
    /// Leica's PTX, read only: scans, each where its pose puts it.
    ptx::Ptx
    /// COLMAP's sparse points, without their tracks.
    colmap::Colmap {
        /// `points3D.bin`, and not `points3D.txt`.
        binary: bool,
    }
    /// A sweep of bare 32-bit floats, as KITTI and nuScenes have it, read only.
    kitti::Sweep {
        /// Whether a point has a fifth number, its ring, as in nuScenes.
        ring: bool,
    }
    /// Text, a point a line: `.xyz`, `.txt`, `.asc`, `.pts`, `.pwn`, `.csv`. Written with the
    /// position first.
    xyz::Xyz {
        /// Whether a first line names the columns.
        names: bool,
        /// What stands between two numbers.
        separator: Separator,
        /// What stands before the fraction of a number.
        decimal: Decimal,
    }
}

/// The format of a result where nobody names one and the input's is not written: it holds all that was read.
pub(crate) fn usual(scalar: Scalar) -> Format {
    Format::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar }
}

/// How a file is opened once its format is known.
pub(crate) type Open = fn(&mut Source<'_>, Limits, &Reading) -> Result<Opened, FormatError>;

/// A [`FormatKind`] as a value.
struct Registered {
    mark: Mark,
    names: &'static [&'static str],
    heeds: &'static [&'static str],
    media_types: &'static [&'static str],
    extensions: &'static [&'static str],
    files: &'static [&'static str],
    from_name: fn(&str) -> Option<Format>,
    from_extension: fn(&str) -> Option<Format>,
    from_media_type: fn(&str) -> Option<Format>,
    open: Open,
    /// Whether its files begin with points.
    is_bare: bool,
    header_end: Option<&'static [u8]>,
}

impl Registered {
    const fn of<K: FormatKind>() -> Self
    where
        Format: From<K>,
    {
        Self {
            mark: K::MARK,
            names: K::NAMES,
            heeds: K::HEEDS,
            media_types: K::MEDIA_TYPES,
            extensions: K::EXTENSIONS,
            files: K::FILES,
            from_name: |name| K::from_name(name).map(Format::from),
            from_extension: |extension| K::from_extension(extension).map(Format::from),
            from_media_type: |media_type| K::from_media_type(media_type).map(Format::from),
            open: K::open,
            is_bare: K::BEGINNING.is_none(),
            header_end: K::HEADER_END,
        }
    }
}

/// The format that a whole name, in lower case, asks for, whatever its extension.
pub(crate) fn from_name(name: &str) -> Option<Format> {
    KINDS.iter().find_map(|kind| (kind.from_name)(name))
}

/// The format of a file of this name, where the whole of it tells.
pub(crate) fn by_file(path: &Path) -> Option<Found> {
    let name = path.file_name()?.to_str()?;
    find(|kind| kind.files.iter().any(|file| file.eq_ignore_ascii_case(name)))
}

/// The names of the formats that nothing in a file tells.
pub(crate) fn unmarked() -> Vec<&'static str> {
    let unmarked = KINDS.iter().filter(|kind| matches!(kind.mark, Mark::None));
    unmarked.flat_map(|kind| kind.names).copied().collect()
}

/// How names end that outputs have: extensions with their dot, and whole names.
pub(crate) fn endings() -> Vec<String> {
    let extensions = KINDS.iter().flat_map(|kind| kind.extensions).map(|extension| format!(".{extension}"));
    let names = KINDS.iter().flat_map(|kind| kind.files).map(|name| (*name).to_owned());
    extensions.chain(names).collect()
}

/// The format that an extension, in lower case, asks for.
pub(crate) fn from_extension(extension: &str) -> Option<Format> {
    KINDS.iter().find_map(|kind| (kind.from_extension)(extension))
}

/// The format that a media type, in lower case and without parameters, asks for.
pub(crate) fn from_media_type(media_type: &str) -> Option<Format> {
    KINDS.iter().find_map(|kind| (kind.from_media_type)(media_type))
}

/// A file's format, recognised by its first bytes.
pub(crate) struct Found {
    pub(crate) open: Open,
    /// Whether it begins with points, and so with nothing that tells it from other text.
    pub(crate) is_bare: bool,
    /// The word that ends its header, if the header must be whole to be judged.
    pub(crate) header_end: Option<&'static [u8]>,
    /// What may lie about it.
    pub(crate) around: Around,
    /// The options of [`Reading`] that say how it is read.
    pub(crate) heeds: &'static [&'static str],
}

/// The format whose bytes a file begins with.
pub(crate) fn by_bytes(head: &[u8]) -> Option<Found> {
    find(|kind| matches!(kind.mark, Mark::Bytes(fits) if fits(head)))
}

/// The format whose lines a text begins with.
pub(crate) fn by_lines(head: &[u8]) -> Option<Found> {
    find(|kind| matches!(kind.mark, Mark::Lines(fits) if fits(head)))
}

/// The format that has this name.
pub(crate) fn by_name(name: &str) -> Option<Found> {
    find(|kind| kind.names.contains(&name))
}

fn find(fits: impl Fn(&Registered) -> bool) -> Option<Found> {
    let kind = KINDS.iter().find(|kind| fits(kind))?;
    Some(Found {
        open: kind.open,
        is_bare: kind.is_bare,
        header_end: kind.header_end,
        around: match kind.mark {
            Mark::Lines(_) => Around::Utf16,
            Mark::Bytes(_) => Around::Utf8,
            Mark::None => Around::Nothing,
        },
        heeds: kind.heeds,
    })
}

/// Declares a list of what all formats have in one field, in the registry's order.
macro_rules! gathered {
    ($(#[$doc:meta])* $all:ident, $count:ident, $field:ident) => {
        const $count: usize = {
            let (mut count, mut i) = (0, 0);
            while i < KINDS.len() {
                count += KINDS[i].$field.len();
                i += 1;
            }
            count
        };

        $(#[$doc])*
        pub(crate) const $all: [&str; $count] = {
            let mut all = [""; $count];
            let (mut next, mut i) = (0, 0);
            while i < KINDS.len() {
                let mut j = 0;
                while j < KINDS[i].$field.len() {
                    all[next] = KINDS[i].$field[j];
                    next += 1;
                    j += 1;
                }
                i += 1;
            }
            all
        };
    };
}

gathered! {
    /// The media types of all formats that are written.
    MEDIA_TYPES, MEDIA_TYPE_COUNT, media_types
}

gathered! {
    /// The names of all formats.
    NAMES, NAME_COUNT, names
}
