//! E57, by the `e57` crate: all scans of a file as one cloud, and back.
//!
//! The format has columns of fixed names for what scanners tell of a point. Surface normals are in the
//! extension `nor` that libe57 documents; every other attribute is in one of our own, `densecloud`, whose
//! columns are the attributes' names ([`tag`]).

mod check;
mod column;
mod read;
mod write;

use std::fmt;
use std::io::Write;

use ::e57::RecordName;

use super::kind::{Choices, FormatKind, Mark, Opened};
use super::source::Source;
use super::spool::Spool;
use super::{Format, FormatError, Limits, Reading};
use densecloud_cloud::{Attribute, Origin, Position, Role};

/// E57, which has no choices.
#[derive(Debug, Clone, Copy)]
pub(crate) struct E57;

impl FormatKind for E57 {
    const MARK: Mark = Mark::Bytes(|head| head.starts_with(b"ASTM-E57"));
    const NAMES: &'static [&'static str] = &["e57"];
    const BEGINNING: Option<&'static str> = Some("`ASTM-E57`");
    const MEDIA_TYPES: &'static [&'static str] = &["model/e57"];
    const EXTENSIONS: &'static [&'static str] = &["e57"];

    fn from_extension(extension: &str) -> Option<Self> {
        (extension == "e57").then_some(Self)
    }

    fn from_media_type(media_type: &str) -> Option<Self> {
        (media_type == "model/e57").then_some(Self)
    }

    fn open(source: &mut Source<'_>, limits: Limits, _reading: &Reading) -> Result<Opened, FormatError> {
        Ok(Opened { header: read::open(source)?, points: Box::new(read::E57Points::new(limits)) })
    }
}

impl Choices for E57 {
    fn media_type(&self) -> &'static str {
        "model/e57"
    }

    fn of_result(&self, _input: Format, _names: bool) -> Format {
        Format::E57
    }

    fn not_held(&self, attributes: &[Attribute], origin: &Origin) -> Vec<String> {
        let mut lost = write::not_held(attributes);
        if write::loses_sensors(attributes, origin) {
            lost.push("the sensors' places".to_owned());
        }
        lost.extend(origin.extra.iter().flat_map(|extra| extra.lost_elsewhere()));
        lost
    }

    fn holds_sensor(&self) -> bool {
        true
    }

    fn renamed(&self, attributes: &[Attribute], origin: &Origin) -> Vec<(String, String)> {
        write::renamed(attributes, origin)
    }

    fn whole_numbers(&self) -> &'static [Role] {
        &[
            Role::Red,
            Role::Green,
            Role::Blue,
            Role::Row,
            Role::Column,
            Role::ReturnNumber,
            Role::NumberOfReturns,
            Role::ColourInvalid,
            Role::IntensityInvalid,
            Role::TimeInvalid,
        ]
    }

    fn is_packed(&self) -> bool {
        true
    }

    fn is_streamed(&self) -> bool {
        false
    }

    fn is_made_in_parts(&self) -> bool {
        false
    }

    fn encode(
        &self,
        sink: &mut dyn Write,
        positions: &[Position],
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<(), FormatError> {
        std::io::copy(&mut self.spooled(positions, attributes, origin)?, sink)?;
        Ok(())
    }

    fn spooled(
        &self,
        positions: &[Position],
        attributes: &[Attribute],
        origin: &Origin,
    ) -> Result<Spool, FormatError> {
        write::encode(positions, attributes, origin)
    }
}

impl fmt::Display for E57 {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("E57")
    }
}

/// The extension of surface normals, and its address.
const NORMALS: (&str, &str) = ("nor", "http://www.libe57.org/E57_NOR_surface_normals.txt");

/// The extension of all other attributes.
const OURS: (&str, &str) = ("densecloud", "urn:densecloud:e57:attributes");

/// What begins the column's name of an attribute whose own would mean something else. No other name
/// begins so: an escape follows its first dash with a digit or a letter.
const GUARD: &str = "_--";

/// The format's own names, which the crate takes for them in any namespace.
const RESERVED: [&str; 20] = [
    "cartesianX",
    "cartesianY",
    "cartesianZ",
    "cartesianInvalidState",
    "sphericalRange",
    "sphericalAzimuth",
    "sphericalElevation",
    "sphericalInvalidState",
    "intensity",
    "isIntensityInvalid",
    "colorRed",
    "colorGreen",
    "colorBlue",
    "isColorInvalid",
    "rowIndex",
    "columnIndex",
    "returnCount",
    "returnIndex",
    "timeStamp",
    "isTimeStampInvalid",
];

/// What the format has columns for, and the attributes that these are. The number of a return is counted from 0 in the
/// file, and from 1 as an attribute, as LAS has it.
const STANDARD: [(RecordName, Role, &str); 12] = [
    (RecordName::ColorRed, Role::Red, "red"),
    (RecordName::ColorGreen, Role::Green, "green"),
    (RecordName::ColorBlue, Role::Blue, "blue"),
    (RecordName::IsColorInvalid, Role::ColourInvalid, "color_invalid"),
    (RecordName::Intensity, Role::Intensity, "intensity"),
    (RecordName::IsIntensityInvalid, Role::IntensityInvalid, "intensity_invalid"),
    (RecordName::RowIndex, Role::Row, "row_index"),
    (RecordName::ColumnIndex, Role::Column, "column_index"),
    (RecordName::ReturnIndex, Role::ReturnNumber, "return_number"),
    (RecordName::ReturnCount, Role::NumberOfReturns, "number_of_returns"),
    (RecordName::TimeStamp, Role::Time, "timestamp"),
    (RecordName::IsTimeStampInvalid, Role::TimeInvalid, "timestamp_invalid"),
];

/// The attribute that tells the scan of each point where there are several.
const SCAN: &str = "scan";

/// The column's name of an attribute: XML allows few characters, so others are their codes between dashes.
fn tag(name: &str) -> String {
    let mut tag = String::new();
    for c in name.chars() {
        if c.is_ascii_alphanumeric() || c == '_' {
            tag.push(c);
        } else {
            tag += &format!("-{:X}-", u32::from(c));
        }
    }
    let first = tag.chars().next();
    let xml = tag.get(..3).is_some_and(|start| start.eq_ignore_ascii_case("xml"));
    if xml || RESERVED.contains(&tag.as_str()) || !first.is_some_and(|c| c.is_ascii_alphabetic() || c == '_')
    {
        tag.insert_str(0, GUARD);
    }
    tag
}

/// The attribute's name of a column: what [`tag`] was given.
fn untag(tag: &str) -> String {
    let mut rest = tag.strip_prefix(GUARD).unwrap_or(tag);
    let mut name = String::new();
    while let Some((plain, after)) = rest.split_once('-') {
        let code = after.split_once('-').and_then(|(code, after)| {
            let c = char::from_u32(u32::from_str_radix(code, 16).ok()?)?;
            Some((c, after))
        });
        // Not one of ours.
        let Some((c, after)) = code else { return tag.to_owned() };
        name += plain;
        name.push(c);
        rest = after;
    }
    name + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_a_column_and_back() {
        for (name, column) in [
            ("curvature", "curvature"),
            ("a b", "a-20-b"),
            ("", "_--"),
            ("_-", "_-2D-"),
            ("_--x", "_-2D--2D-x"),
            ("9", "_--9"),
            ("-", "_---2D-"),
            ("xmlns", "_--xmlns"),
            ("timeStamp", "_--timeStamp"),
            ("grün😀", "gr-FC-n-1F600-"),
        ] {
            assert_eq!(tag(name), column);
            assert_eq!(untag(column), name, "{column}");
        }
        assert_eq!(untag("a-b"), "a-b", "of other programs");
    }
}
