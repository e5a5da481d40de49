//! Wavefront OBJ: its vertices are read as points.

use std::fmt;

use super::columns::TextColumn;
use super::kind::{FormatKind, Mark, Opened, ReadOnly};
use super::reader::{Block, ColumnName, Ending, Points};
use super::source::Source;
use super::text::{next_token, parse_f64, shown};
use super::{Format, FormatError, Header, Limits, Reading};
use densecloud_cloud::{Kind, Values};

/// What a line before the first vertex may begin with.
const KEYWORDS: [&[u8]; 8] = [b"o", b"g", b"s", b"mtllib", b"usemtl", b"vn", b"vt", b"usemap"];

/// Whether text is OBJ: its first lines are such as stand there before vertices, and a vertex.
fn is_obj(head: &[u8]) -> bool {
    for line in head.split(|b| matches!(b, b'\n' | b'\r')) {
        let mut rest = uncommented(line);
        match next_token(&mut rest) {
            None => {}
            Some(b"v") => {
                let numbers = std::iter::from_fn(|| next_token(&mut rest));
                return numbers.filter(|token| parse_f64(token).is_some()).count() >= 3;
            }
            Some(keyword) if KEYWORDS.contains(&keyword) => {}
            Some(_) => return false,
        }
    }
    false
}

/// `line` without a comment. Two slashes begin none here: they stand in faces.
fn uncommented(line: &[u8]) -> &[u8] {
    line.split(|b| *b == b'#').next().unwrap_or_default()
}

/// OBJ, which has no choices.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Obj;

impl FormatKind for Obj {
    const MARK: Mark = Mark::Lines(is_obj);
    const NAMES: &'static [&'static str] = &["obj"];
    const BEGINNING: Option<&'static str> = Some("lines such as `v 1 2 3`");
    const MEDIA_TYPES: &'static [&'static str] = &[];
    const EXTENSIONS: &'static [&'static str] = &[];

    fn from_extension(extension: &str) -> Option<Self> {
        (extension == "obj").then_some(Self)
    }

    fn from_media_type(_media_type: &str) -> Option<Self> {
        None
    }

    fn open(_source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        let (attributes, dropped_properties) = (Vec::new(), Vec::new());
        let header = Header { format: Format::Obj, points: None, attributes, dropped_properties };
        Ok(Opened { header, points: Box::new(ObjPoints { limits, ending: None }) })
    }
}

impl ReadOnly for Obj {
    fn media_type(&self) -> &'static str {
        "model/obj"
    }
}

impl fmt::Display for Obj {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("OBJ")
    }
}

/// The vertices, all at once: normals stand behind them, and only then is it known whether each has one.
struct ObjPoints {
    limits: Limits,
    /// Once they are read.
    ending: Option<Ending>,
}

impl Points for ObjPoints {
    fn append(&mut self, source: &mut Source<'_>, _rows: usize, to: &mut Block) -> Result<(), FormatError> {
        if self.ending.is_none() {
            self.ending = Some(read(source, self.limits, to)?);
        }
        Ok(())
    }

    fn finish(self: Box<Self>, _source: &mut Source<'_>) -> Result<Ending, FormatError> {
        Ok(self.ending.unwrap_or_else(|| Ending::of_text(std::iter::empty())))
    }
}

/// Reads the vertices, colours behind their coordinates, and normals where there are as many as vertices.
fn read(source: &mut Source<'_>, limits: Limits, to: &mut Block) -> Result<Ending, FormatError> {
    let mut dropped: Vec<String> = Vec::new();
    let mut colours = [TextColumn::new(), TextColumn::new(), TextColumn::new()];
    let mut shades = [(); 3].map(|()| Values::new(Kind::I64));
    let mut coloured = false;
    let mut normals = [Vec::new(), Vec::new(), Vec::new()];
    let mut continued = false;
    while let Some(range) = source.next_line()? {
        let line = uncommented(source.bytes(range));
        let goes_on = line.trim_ascii_end().ends_with(b"\\");
        if std::mem::replace(&mut continued, goes_on) {
            continue;
        }
        let mut rest = line;
        match next_token(&mut rest).unwrap_or_default() {
            b"v" => {
                to.positions.push(three(source, &mut rest)?);
                limits.check_points(to.positions.len() as u64)?;
                // One number more is a weight.
                let mut others: [&[u8]; 3] = [b""; 3];
                let mut tokens = std::iter::from_fn(|| next_token(&mut rest));
                others.fill_with(|| tokens.next().unwrap_or_default());
                let has = !others[2].is_empty();
                coloured |= has;
                for ((column, numbers), token) in colours.iter_mut().zip(&mut shades).zip(others) {
                    column.push(numbers, if has { token } else { b"" });
                }
            }
            b"vn" => {
                let normal = three(source, &mut rest)?;
                for (column, value) in normals.iter_mut().zip(normal) {
                    column.push(value);
                }
            }
            token if token.first().is_some_and(|b| b.is_ascii_digit() || matches!(b, b'-' | b'.')) => {
                let why = format!("{} where a line of an OBJ file begins with a word", shown(token));
                return Err(FormatError::malformed(source.line(), why));
            }
            keyword => {
                let name = match keyword {
                    b"f" => "face",
                    b"l" => "line",
                    b"vt" => "texture coordinates",
                    _ => continue,
                };
                if !dropped.iter().any(|dropped| dropped == name) {
                    dropped.push(name.to_owned());
                }
            }
        }
    }
    let names = ["red", "green", "blue"].map(str::to_owned);
    let columns = names.into_iter().zip(&colours).take(if coloured { 3 } else { 0 });
    let mut ending = Ending::of_text(columns);
    if coloured {
        to.columns.extend(shades);
    }
    dropped.append(&mut ending.dropped_properties);
    ending.dropped_properties = dropped;
    if normals[0].len() == to.positions.len() {
        for (name, values) in ["nx", "ny", "nz"].into_iter().zip(normals) {
            ending.columns.push(Some(ColumnName { name: name.to_owned(), kind: Kind::F64 }));
            to.columns.push(Values::F64(values));
        }
    } else if !normals[0].is_empty() {
        ending.dropped_properties.push("normals (not one a vertex)".to_owned());
    }
    Ok(ending)
}

fn three(source: &Source<'_>, rest: &mut &[u8]) -> Result<[f64; 3], FormatError> {
    let mut numbers = [0.0; 3];
    for number in &mut numbers {
        let token = next_token(rest).unwrap_or_default();
        *number = parse_f64(token).ok_or_else(|| {
            FormatError::malformed(source.line(), format!("{} where a coordinate was expected", shown(token)))
        })?;
    }
    Ok(numbers)
}
