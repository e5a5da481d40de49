//! The header of a PLY file.

use std::collections::HashSet;

use super::super::names::Apart;
use super::super::source::Source;
use super::super::{FormatError, PlyEncoding};
use densecloud_cloud::Kind;

/// More lines and bytes than any real header has; they bound what a hostile one costs.
const MAX_LINES: usize = 10_000;
const MAX_BYTES: usize = 1 << 20;

/// Everything before the data.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct PlyHeader {
    pub(super) encoding: PlyEncoding,
    /// In the order of the data.
    pub(super) elements: Vec<Element>,
    /// What the lines `comment` and `obj_info` say.
    pub(super) comments: Vec<String>,
    /// What was done about properties of one name, a sentence each.
    pub(super) notes: Vec<String>,
}

/// A table: `count` rows of `properties`.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Element {
    pub(super) name: String,
    /// A claim.
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

/// A column.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Property {
    /// No other property of the element has it.
    pub(super) name: String,
    /// The name in the file.
    pub(super) declared: String,
    pub(super) shape: Shape,
}

/// What one row holds in a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    Scalar(Kind),
    /// A length, then that many items.
    List {
        length: Kind,
        item: Kind,
    },
}

/// Parses a header and leaves `source` at the first byte of data.
pub(super) fn parse(source: &mut Source<'_>) -> Result<PlyHeader, FormatError> {
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut comments = Vec::new();
    let mut element_names = HashSet::new();
    let mut bytes = 0;
    for number in 0..MAX_LINES {
        let Some(range) = source.next_line()? else {
            return Err(FormatError::truncated(source.line(), "the PLY header has no `end_header`"));
        };
        bytes += range.len();
        if bytes > MAX_BYTES {
            let why = format!("the PLY header is longer than {MAX_BYTES} bytes");
            return Err(FormatError::malformed(source.line(), why));
        }
        let line = String::from_utf8_lossy(source.bytes(range)).into_owned();
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let bad = |why: String| FormatError::malformed(source.line(), why);
        match (number, words.as_slice()) {
            (0, ["ply"]) | (_, []) => {}
            (_, [key @ ("comment" | "obj_info"), ..]) => {
                comments.push(line.trim_start()[key.len()..].to_owned());
            }
            (0, _) => return Err(bad("a PLY file begins with the line `ply`".into())),
            (_, ["end_header"]) => {
                let encoding = encoding.ok_or_else(|| bad("the PLY header has no `format` line".into()))?;
                let notes = elements.iter_mut().flat_map(Element::tell_apart).collect();
                return Ok(PlyHeader { encoding, elements, comments, notes });
            }
            (_, ["format", name, version]) => {
                if encoding.is_some() {
                    return Err(bad("a second `format` line".into()));
                }
                encoding = Some(parse_encoding(name, version).map_err(bad)?);
            }
            (_, ["element", name, count]) => {
                if !element_names.insert((*name).to_owned()) {
                    return Err(bad(format!("the element `{name}` is declared twice")));
                }
                let count = count
                    .parse()
                    .map_err(|_| bad(format!("`{count}` is not a number of `{name}` elements")))?;
                elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            (_, ["property", rest @ ..]) => {
                let Some(element) = elements.last_mut() else {
                    return Err(bad("a `property` before any `element`".into()));
                };
                element.properties.push(parse_property(rest).map_err(bad)?);
            }
            _ => return Err(bad(format!("`{}` means nothing in a PLY header", line.trim()))),
        }
    }
    Err(FormatError::malformed(source.line(), format!("the PLY header is longer than {MAX_LINES} lines")))
}

fn parse_encoding(name: &str, version: &str) -> Result<PlyEncoding, String> {
    if version != "1.0" {
        return Err(format!("PLY version `{version}`; only 1.0 is known"));
    }
    match name {
        "ascii" => Ok(PlyEncoding::Ascii),
        "binary_little_endian" => Ok(PlyEncoding::BinaryLittleEndian),
        "binary_big_endian" => Ok(PlyEncoding::BinaryBigEndian),
        _ => Err(format!("unknown PLY format `{name}`")),
    }
}

fn parse_property(words: &[&str]) -> Result<Property, String> {
    let kind = |word: &str| parse_kind(word).ok_or_else(|| format!("unknown PLY type `{word}`"));
    match words {
        ["list", length, item, name] => {
            let (length, item) = (kind(length)?, kind(item)?);
            if matches!(length, Kind::F32 | Kind::F64) {
                return Err(format!("the length of the list `{name}` cannot be a float"));
            }
            Ok(Property::of(name, Shape::List { length, item }))
        }
        [scalar, name] => Ok(Property::of(name, Shape::Scalar(kind(scalar)?))),
        _ => Err(format!("cannot read `property {}`", words.join(" "))),
    }
}

impl Property {
    fn of(name: &str, shape: Shape) -> Self {
        Self { name: name.to_owned(), declared: name.to_owned(), shape }
    }

    /// What is told of a name that is not the file's.
    fn renamed(&self, element: &str) -> Option<String> {
        let Self { name, declared, .. } = self;
        (name != declared).then(|| {
            format!("`{declared}` is the name of several properties of `{element}`; a later one is called `{name}`")
        })
    }
}

impl PlyHeader {
    /// The element of that name and its position.
    pub(super) fn element(&self, name: &str) -> Option<(usize, &Element)> {
        self.elements.iter().enumerate().find(|(_, e)| e.name == name)
    }

    /// The fewest bytes that the data can have if the counts are true.
    pub(super) fn min_len(&self) -> u64 {
        self.elements.iter().fold(0, |sum: u64, element| {
            // In text, a number takes a digit and something after it; the last may lack that.
            let smallest = |kind: Kind| if self.encoding == PlyEncoding::Ascii { 2 } else { kind.size() };
            let row = element.properties.iter().map(|p| match p.shape {
                Shape::Scalar(kind) | Shape::List { length: kind, .. } => smallest(kind) as u64,
            });
            sum.saturating_add(element.count.saturating_mul(row.sum()))
        })
    }
}

impl Element {
    /// Gives properties of one name others, and tells of each.
    fn tell_apart(&mut self) -> Vec<String> {
        let declared: Vec<&str> = self.properties.iter().map(|property| property.declared.as_str()).collect();
        let names = Apart::all(&declared);
        self.properties.iter_mut().zip(names).for_each(|(property, name)| property.name = name);
        self.properties.iter().filter_map(|property| property.renamed(&self.name)).collect()
    }

    /// Bytes a row in a binary file, if all rows are the same.
    pub(super) fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0, |sum, p| match p.shape {
            Shape::Scalar(kind) => Some(sum + kind.size()),
            Shape::List { .. } => None,
        })
    }
}

/// The type of that name in a header.
fn parse_kind(word: &str) -> Option<Kind> {
    Some(match word {
        "char" | "int8" => Kind::I8,
        "uchar" | "uint8" => Kind::U8,
        "short" | "int16" => Kind::I16,
        "ushort" | "uint16" => Kind::U16,
        "int" | "int32" => Kind::I32,
        "uint" | "uint32" => Kind::U32,
        // Not in the specification, but written by some programs.
        "int64" | "long" => Kind::I64,
        "uint64" | "ulong" => Kind::U64,
        "float" | "float32" => Kind::F32,
        "double" | "float64" => Kind::F64,
        _ => return None,
    })
}

/// The name that a written header gives it: the specification's own, and for 64-bit integers, which it
/// does not have, what most programs read.
pub(super) fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::I8 => "char",
        Kind::U8 => "uchar",
        Kind::I16 => "short",
        Kind::U16 => "ushort",
        Kind::I32 => "int",
        Kind::U32 => "uint",
        Kind::I64 => "int64",
        Kind::U64 => "uint64",
        Kind::F32 => "float",
        Kind::F64 => "double",
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::Limits;
    use super::super::super::source::{Around, Input};
    use super::*;

    fn parse_text(text: &[u8]) -> Result<PlyHeader, FormatError> {
        parse(&mut Source::new(Input::Stream(Box::new(text)), Limits::default(), Around::Utf8)?)
    }

    #[test]
    fn a_header_is_parsed_whatever_ends_its_lines() {
        let lines = [
            "ply",
            "format binary_big_endian 1.0 ",
            "comment made by \u{e9}",
            "obj_info whatever",
            "",
            "element vertex 3",
            "property float x",
            "property float64  y",
            "element face 4000000000",
            "property list uchar int vertex_indices",
            "end_header",
        ];
        for end in ["\n", "\r\n", "\r"] {
            let header = parse_text((lines.join(end) + end).as_bytes()).expect("a header");
            assert_eq!(header.encoding, PlyEncoding::BinaryBigEndian);
            let [vertex, face] = header.elements.as_slice() else { panic!("two elements") };
            assert_eq!((vertex.name.as_str(), vertex.count, vertex.stride()), ("vertex", 3, Some(12)));
            assert_eq!((face.count, face.stride()), (4_000_000_000, None));
            assert_eq!(face.properties[0].shape, Shape::List { length: Kind::U8, item: Kind::I32 });
            assert_eq!(header.min_len(), 36 + 4_000_000_000);
        }
    }

    #[test]
    fn comments_may_hold_any_bytes() {
        let text = b"ply\ncomment \xFF\xFE\nformat ascii 1.0\nend_header\n";
        assert_eq!(parse_text(text).expect("a header").encoding, PlyEncoding::Ascii);
    }

    #[test]
    fn broken_headers_name_their_line() {
        for (body, line, what) in [
            ("format ascii 2.0\n", 2, "version `2.0`"),
            ("format text 1.0\n", 2, "format `text`"),
            ("format ascii 1.0\nformat ascii 1.0\n", 3, "second `format`"),
            ("element vertex -5\n", 2, "`-5`"),
            ("element vertex 99999999999999999999999\n", 2, "not a number"),
            ("element vertex many\n", 2, "`many`"),
            ("element vertex 1\nelement vertex 1\n", 3, "twice"),
            ("property float x\n", 2, "before any"),
            ("element vertex 1\nproperty half x\n", 3, "`half`"),
            ("element vertex 1\nproperty float x y\n", 3, "property float x y"),
            ("element face 1\nproperty list float int i\n", 3, "cannot be a float"),
            ("hello\n", 2, "`hello`"),
            ("end_header\n", 2, "no `format`"),
        ] {
            let error = parse_text(format!("ply\n{body}").as_bytes()).expect_err("an error");
            let text = error.to_string();
            assert!(text.starts_with(&format!("line {line}: ")) && text.contains(what), "{text}");
        }
        let error = parse_text(b"ply\nformat ascii 1.0\n").expect_err("an error");
        assert!(matches!(error, FormatError::Truncated { .. }), "{error}");
        let endless = "ply\n".to_owned() + &"comment\n".repeat(MAX_LINES);
        assert!(parse_text(endless.as_bytes()).is_err());
        let long = format!("ply\n{}", format!("comment {}\n", "x".repeat(MAX_BYTES / 4)).repeat(5));
        let error = parse_text(long.as_bytes()).expect_err("too long");
        assert!(error.to_string().contains("bytes"), "{error}");
    }
}
