//! OFF (Object File Format): a keyword, three counts, vertices, faces.

use std::fmt;
use std::ops::Range;

use super::columns::TextColumn;
use super::kind::{FormatKind, Mark, Opened, ReadOnly};
use super::mesh::Polygons;
use super::reader::{Block, Ending, Points};
use super::source::Source;
use super::text::{next_token, parse_f64, shown, strip_comment};
use super::{Format, FormatError, Header, Limits, Place, Reading};
use densecloud_cloud::Position;
use densecloud_geometry::Mesh;

/// OFF, which has no choices.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Off;

impl FormatKind for Off {
    const MARK: Mark = Mark::Lines(|head| {
        let mut lines = head.split(|b| matches!(b, b'\n' | b'\r'));
        lines.find_map(|line| next_token(&mut strip_comment(line))).is_some_and(is_keyword)
    });
    const NAMES: &'static [&'static str] = &["off"];
    const BEGINNING: Option<&'static str> = Some("`OFF`");
    const MEDIA_TYPES: &'static [&'static str] = &[];
    const EXTENSIONS: &'static [&'static str] = &[];

    fn from_extension(extension: &str) -> Option<Self> {
        (extension == "off").then_some(Self)
    }

    fn from_media_type(_media_type: &str) -> Option<Self> {
        None
    }

    fn open(source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        let (points, header) = OffHeader::open(source, limits)?;
        Ok(Opened { header, points: Box::new(points) })
    }
}

impl ReadOnly for Off {
    fn media_type(&self) -> &'static str {
        "model/vnd.off"
    }
}

impl fmt::Display for Off {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("OFF")
    }
}

/// Whether a file that begins with this token is an OFF file. `COFF`, `NOFF` and `STOFF` add colours,
/// normals and texture coordinates to vertices; some writers put the first count right behind.
pub(super) fn is_keyword(token: &[u8]) -> bool {
    keyword_len(token).is_some()
}

/// What stands before the vertices.
#[derive(Debug)]
struct OffHeader {
    keyword: String,
    vertices: u32,
    faces: u32,
    /// What each vertex has behind its coordinates.
    normals: bool,
    colours: bool,
    textures: bool,
    /// Vertices given as points.
    given: u32,
    /// What they have behind their coordinates, by [`names`](Self::names).
    columns: Vec<TextColumn>,
    /// How many of them have more numbers than the keyword says.
    surplus: u32,
}

impl OffHeader {
    /// Reads the keyword and the counts, on its line or the next; `#` comments may be anywhere.
    fn parse(source: &mut Source<'_>) -> Result<Self, FormatError> {
        let mut line = need_line(source, "the keyword `OFF`")?;
        let keyword = {
            let mut rest = source.bytes(line.clone());
            let token = next_token(&mut rest).unwrap_or_default();
            let length = keyword_len(token).ok_or_else(|| bad(source, token, "the keyword `OFF`"))?;
            line.start = line.end - rest.len() - token.len() + length;
            token[..length].to_vec()
        };
        let mut counts = source.bytes(line.clone());
        if next_token(&mut counts) == Some(b"BINARY") {
            return Err(FormatError::Unrecognised { found: "binary OFF".into() });
        }
        if source.bytes(line.clone()).iter().all(u8::is_ascii_whitespace) {
            line = need_line(source, "the counts")?;
        }
        let mut rest = source.bytes(line);
        let vertices = whole(source, &mut rest, "the number of vertices")?;
        let faces = whole(source, &mut rest, "the number of faces")?;
        let keyword = String::from_utf8_lossy(&keyword).into_owned();
        let before = keyword.strip_suffix("OFF").unwrap_or_default();
        let textures = before.starts_with("ST");
        let before = before.strip_prefix("ST").unwrap_or(before);
        let (normals, colours) = (before.contains('N'), before.contains('C'));
        let columns = vec![TextColumn::new(); 3 * (usize::from(normals) + usize::from(colours))];
        Ok(Self { keyword, vertices, faces, normals, colours, textures, given: 0, columns, surplus: 0 })
    }

    /// Reads the next vertex: its position, and the rest of its line.
    fn vertex<'a>(
        &self,
        source: &'a mut Source<'_>,
        number: u32,
    ) -> Result<(Position, &'a [u8]), FormatError> {
        let line = need_line(source, &format!("vertex {number} of {}", self.vertices))?;
        let mut rest = source.bytes(line);
        let mut vertex = [0.0; 3];
        for coordinate in &mut vertex {
            let token = next_token(&mut rest).unwrap_or_default();
            *coordinate = parse_f64(token).ok_or_else(|| bad(source, token, "a coordinate"))?;
        }
        Ok((vertex, rest))
    }

    /// Reads what stands before the points of a cloud.
    fn open(source: &mut Source<'_>, limits: Limits) -> Result<(Self, Header), FormatError> {
        let off = Self::parse(source)?;
        let points = u64::from(off.vertices);
        limits.check_points(points)?;
        let attributes = off.names().iter().map(|name| (*name).to_owned()).collect();
        let dropped = [(off.faces > 0, "face"), (off.textures, "texture coordinates")];
        let dropped = dropped.into_iter().filter(|(is_there, _)| *is_there);
        let dropped_properties = dropped.map(|(_, name)| name.to_owned()).collect();
        let header = Header { format: Format::Off, points: Some(points), attributes, dropped_properties };
        Ok((off, header))
    }

    /// Names of the attributes, in their order.
    fn names(&self) -> Vec<&'static str> {
        let mut names = Vec::new();
        if self.normals {
            names.extend(["nx", "ny", "nz"]);
        }
        if self.colours {
            names.extend(["red", "green", "blue"]);
        }
        names
    }
}

impl Points for OffHeader {
    fn append(&mut self, source: &mut Source<'_>, rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if to.columns.is_empty() {
            to.columns = self.columns.iter().map(TextColumn::empty).collect();
        }
        let rows = u32::try_from(rows).unwrap_or(u32::MAX);
        for number in self.given..self.vertices.min(self.given.saturating_add(rows)) {
            let (position, mut rest) = self.vertex(source, number)?;
            to.positions.push(position);
            for (column, numbers) in self.columns.iter_mut().zip(&mut to.columns) {
                column.push(numbers, next_token(&mut rest).unwrap_or_default());
            }
            let told = if self.textures { 2 } else { 0 };
            let more = std::iter::from_fn(|| next_token(&mut rest)).nth(told).is_some();
            self.surplus += u32::from(more);
            self.given += 1;
        }
        Ok(())
    }

    fn finish(self: Box<Self>, source: &mut Source<'_>) -> Result<Ending, FormatError> {
        for i in 0..self.faces {
            need_line(source, &format!("face {i} of {}", self.faces))?;
        }
        let mut ending = Ending::of_text(self.names().into_iter().map(str::to_owned).zip(&self.columns));
        if self.surplus > 0 {
            let (count, keyword) = (self.surplus, &self.keyword);
            ending
                .dropped_properties
                .push(format!("numbers behind {count} vertices that `{keyword}` does not tell of"));
        }
        Ok(ending)
    }
}

/// Reads an OFF file: a vertex or a face a line. What follows the coordinates of a vertex or the corners of
/// a face (colours, normals) is skipped.
pub(super) fn read_mesh(source: &mut Source<'_>) -> Result<Mesh, FormatError> {
    let header = OffHeader::parse(source)?;
    let mut vertices = Vec::new();
    for i in 0..header.vertices {
        vertices.push(header.vertex(source, i)?.0);
    }
    let mut polygons = Polygons::default();
    let mut corners = Vec::new();
    for i in 0..header.faces {
        let line = need_line(source, &format!("face {i} of {}", header.faces))?;
        let mut rest = source.bytes(line);
        corners.clear();
        for _ in 0..whole(source, &mut rest, "the number of corners")? {
            corners.push(whole(source, &mut rest, "the index of a vertex")?);
        }
        polygons.push(&corners, source.line());
    }
    polygons.into_mesh(vertices)
}

/// The length of the keyword at the front of a token.
fn keyword_len(token: &[u8]) -> Option<usize> {
    let prefix = [b"STCNOFF".as_slice(), b"CNOFF", b"STCOFF", b"STNOFF", b"STOFF", b"COFF", b"NOFF", b"OFF"]
        .into_iter()
        .find(|k| token.starts_with(k))?;
    token[prefix.len()..].iter().all(u8::is_ascii_digit).then_some(prefix.len())
}

/// The next line that holds more than a comment, without the comment.
fn need_line(source: &mut Source<'_>, what: &str) -> Result<Range<usize>, FormatError> {
    loop {
        let Some(line) = source.next_line()? else {
            return Err(FormatError::truncated(source.line(), format!("{what} is missing")));
        };
        let kept = strip_comment(source.bytes(line.clone())).len();
        let line = line.start..line.start + kept;
        if !source.bytes(line.clone()).iter().all(u8::is_ascii_whitespace) {
            return Ok(line);
        }
    }
}

fn whole(source: &Source<'_>, rest: &mut &[u8], what: &str) -> Result<u32, FormatError> {
    let token = next_token(rest).unwrap_or_default();
    let text = std::str::from_utf8(token).ok();
    text.and_then(|t| t.parse().ok()).ok_or_else(|| bad(source, token, what))
}

fn bad(source: &Source<'_>, token: &[u8], what: &str) -> FormatError {
    let at: Place = source.line();
    let found =
        if token.is_empty() { "the line ends".to_owned() } else { format!("{} stands", shown(token)) };
    FormatError::malformed(at, format!("{found} where {what} was expected"))
}
