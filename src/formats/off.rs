//! OFF (Object File Format): a keyword, three counts, vertices, faces.

use std::io::Read;
use std::ops::Range;

use super::mesh::Polygons;
use super::source::Source;
use super::text::{next_token, parse_f64, shown, strip_comment};
use super::{FormatError, Place};
use crate::geometry::Mesh;

/// Whether a file that begins with this token is an OFF file. `COFF`, `NOFF` and `STOFF` add colours,
/// normals and texture coordinates to vertices; some writers put the first count right behind.
pub(super) fn is_keyword(token: &[u8]) -> bool {
    keyword_len(token).is_some()
}

/// Reads an OFF file: a vertex or a face a line, `#` comments anywhere, counts on the keyword's line
/// or the next. What follows the coordinates of a vertex or the corners of a face (colours, normals)
/// is skipped.
pub(super) fn read_mesh<R: Read>(source: &mut Source<R>) -> Result<Mesh, FormatError> {
    let mut line = need_line(source, "the keyword `OFF`")?;
    {
        let mut rest = source.bytes(line.clone());
        let token = next_token(&mut rest).unwrap_or_default();
        let length = keyword_len(token).ok_or_else(|| bad(source, token, "the keyword `OFF`"))?;
        line.start = line.end - rest.len() - token.len() + length;
    }
    let mut counts = source.bytes(line.clone());
    if next_token(&mut counts) == Some(b"BINARY") {
        return Err(FormatError::Unrecognised { found: "binary OFF".into() });
    }
    if source.bytes(line.clone()).iter().all(u8::is_ascii_whitespace) {
        line = need_line(source, "the counts")?;
    }
    let mut rest = source.bytes(line);
    let vertex_count = whole(source, &mut rest, "the number of vertices")?;
    let face_count = whole(source, &mut rest, "the number of faces")?;

    let mut vertices = Vec::new();
    for i in 0..vertex_count {
        let line = need_line(source, &format!("vertex {i} of {vertex_count}"))?;
        let mut rest = source.bytes(line);
        let mut vertex = [0.0; 3];
        for coordinate in &mut vertex {
            let token = next_token(&mut rest).unwrap_or_default();
            *coordinate = parse_f64(token).ok_or_else(|| bad(source, token, "a coordinate"))?;
        }
        vertices.push(vertex);
    }
    let mut polygons = Polygons::default();
    let mut corners = Vec::new();
    for i in 0..face_count {
        let line = need_line(source, &format!("face {i} of {face_count}"))?;
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
fn need_line<R: Read>(source: &mut Source<R>, what: &str) -> Result<Range<usize>, FormatError> {
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

fn whole<R: Read>(source: &Source<R>, rest: &mut &[u8], what: &str) -> Result<u32, FormatError> {
    let token = next_token(rest).unwrap_or_default();
    let text = std::str::from_utf8(token).ok();
    text.and_then(|t| t.parse().ok()).ok_or_else(|| bad(source, token, what))
}

fn bad<R: Read>(source: &Source<R>, token: &[u8], what: &str) -> FormatError {
    let at: Place = source.line();
    let found =
        if token.is_empty() { "the line ends".to_owned() } else { format!("{} stands", shown(token)) };
    FormatError::malformed(at, format!("{found} where {what} was expected"))
}
