//! Wavefront OBJ, of which the vertices are points.

use std::io::Read;

use super::source::Source;
use super::text::{next_token, parse_f64, shown};
use super::xyz::Column;
use super::{Format, FormatError, Header, Limits};
use densecloud_cloud::{Attribute, Cloud, Values};

/// What a line before the first vertex may begin with.
const KEYWORDS: [&[u8]; 8] = [b"o", b"g", b"s", b"mtllib", b"usemtl", b"vn", b"vt", b"usemap"];

/// Whether text is OBJ: its first lines are such as stand there before vertices, and a vertex.
pub(super) fn is_obj(head: &[u8]) -> bool {
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

pub(super) fn header() -> Header {
    Header { format: Format::Obj, points: None, attributes: Vec::new(), dropped_properties: Vec::new() }
}

/// Reads the vertices, colours behind their coordinates, and normals where there are as many as vertices.
pub(super) fn read<R: Read>(source: &mut Source<R>, limits: Limits) -> Result<Cloud, FormatError> {
    let mut cloud = Cloud::default();
    let mut colours = [Column::new(), Column::new(), Column::new()];
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
                cloud.positions.push(three(source, &mut rest)?);
                if let Some(limit) = limits.max_points
                    && cloud.positions.len() as u64 > limit
                {
                    return Err(FormatError::TooManyPoints { points: cloud.positions.len() as u64, limit });
                }
                // One number more is a weight.
                let mut others: [&[u8]; 3] = [b""; 3];
                let mut tokens = std::iter::from_fn(|| next_token(&mut rest));
                others.fill_with(|| tokens.next().unwrap_or_default());
                let has = !others[2].is_empty();
                coloured |= has;
                for (column, token) in colours.iter_mut().zip(others) {
                    column.push(if has { token } else { b"" });
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
                if !cloud.dropped_properties.iter().any(|dropped| dropped == name) {
                    cloud.dropped_properties.push(name.to_owned());
                }
            }
        }
    }
    if coloured {
        for (name, column) in ["red", "green", "blue"].into_iter().zip(colours) {
            match column.into_values() {
                Some(values) => cloud.attributes.push(Attribute { name: name.into(), values }),
                None => cloud.dropped_properties.push(format!("{name} (text)")),
            }
        }
    }
    if normals[0].len() == cloud.positions.len() {
        for (name, values) in ["nx", "ny", "nz"].into_iter().zip(normals) {
            cloud.attributes.push(Attribute { name: name.into(), values: Values::F64(values) });
        }
    } else if !normals[0].is_empty() {
        cloud.dropped_properties.push("normals (not one a vertex)".to_owned());
    }
    Ok(cloud)
}

fn three<R: Read>(source: &Source<R>, rest: &mut &[u8]) -> Result<[f64; 3], FormatError> {
    let mut numbers = [0.0; 3];
    for number in &mut numbers {
        let token = next_token(rest).unwrap_or_default();
        *number = parse_f64(token).ok_or_else(|| {
            FormatError::malformed(source.line(), format!("{} where a coordinate was expected", shown(token)))
        })?;
    }
    Ok(numbers)
}
