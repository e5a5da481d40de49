//! What a file tells of the cloud as a whole.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use super::{Extra, Values};

/// What a file tells beside its points, to be written again where the result's format has a place
/// for it. Cheap to clone.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Origin {
    /// The coordinate reference system.
    pub crs: Option<Crs>,
    /// Comments, a line each, in the file's order; provenance is among them.
    pub comments: Vec<String>,
    /// Where the sensor stood, in the file's own coordinates.
    pub sensor: Option<[f64; 3]>,
    /// Where the sensors stood, where there were several, or one in several places.
    pub sensors: Option<Arc<Sensors>>,
    /// How the sensor was turned there: a quaternion, the real part first.
    pub orientation: Option<[f64; 4]>,
    /// The file that gave attributes their names.
    pub named_in: Option<Named>,
    /// SHA-256 over all bytes of the file.
    pub sha256: Option<[u8; 32]>,
    /// PLY's elements other than `vertex`, in the file's order.
    pub tables: Arc<Vec<Table>>,
    /// What only the file's own format has a place for.
    pub extra: Option<Extra>,
}

/// Which attributes have their names from a file, and of what kind. In another file of that kind they are told apart by
/// the letter, where others go by what they mean.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Named {
    /// The kind of its format, such as `ply`.
    pub kind: &'static str,
    /// The names that it gave.
    pub names: Arc<[String]>,
}

impl Origin {
    /// Whether the attributes' names are those of a file of this kind.
    #[must_use]
    pub fn is_named_in(&self, kind: &str) -> bool {
        self.named_in.as_ref().is_some_and(|named| named.kind == kind)
    }

    /// Adds a comment of any text: its lines that hold anything, without control characters.
    pub fn comment(&mut self, text: &str) {
        for line in text.lines() {
            let line: String = line.chars().map(|c| if c == '\t' { ' ' } else { c }).collect();
            let line = line.replace(char::is_control, "");
            if !line.trim().is_empty() {
                self.comments.push(line.trim().to_owned());
            }
        }
    }

    /// Drops the tables that mean nothing beside other points ([`Table::refers_to_points`]) and gives
    /// their names.
    pub fn drop_references(&mut self) -> Vec<String> {
        let (dropped, kept): (Vec<Table>, Vec<Table>) =
            self.tables.iter().cloned().partition(Table::refers_to_points);
        self.tables = Arc::new(kept);
        dropped.into_iter().map(|table| table.name).collect()
    }
}

/// Where the sensors of a cloud of several scans stood.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensors {
    /// The attribute that tells of each point which scan it is of, counted from 0.
    pub attribute: String,
    /// Where each scan's sensor stood, in the file's own coordinates; none where the file does not say.
    pub places: Vec<Option<[f64; 3]>>,
}

impl Sensors {
    /// Where the sensor of a point stood, by the point's value of the [attribute](Self::attribute).
    #[must_use]
    pub fn of(&self, scan: f64) -> Option<[f64; 3]> {
        let is_number = scan.fract() == 0.0 && scan >= 0.0;
        // Saturates, which is beyond the end.
        self.places.get(scan as usize).copied().flatten().filter(|_| is_number)
    }
}

/// A coordinate reference system. As text ([`fmt::Display`], [`FromStr`]) it is one line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Crs {
    /// Codes of the EPSG register: `EPSG:2992`, or `EPSG:2992+5703` with one for heights.
    Epsg {
        /// A projected or geographic system.
        horizontal: u32,
        /// The system of the heights, where it is another.
        vertical: Option<u32>,
    },
    /// Well-known text, version 1 or 2, or whatever else the file has in its place.
    Wkt(String),
}

impl Crs {
    /// A name for people: the code, or the first quoted name in the well-known text.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Epsg { .. } => self.to_string(),
            Self::Wkt(text) => match text.split('"').nth(1) {
                Some(name) if !name.is_empty() => name.to_owned(),
                _ => text.chars().take(60).collect(),
            },
        }
    }
}

impl fmt::Display for Crs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Epsg { horizontal, vertical: None } => write!(f, "EPSG:{horizontal}"),
            Self::Epsg { horizontal, vertical: Some(vertical) } => write!(f, "EPSG:{horizontal}+{vertical}"),
            // Line ends mean nothing in well-known text, but would end a comment.
            Self::Wkt(text) => {
                let lines: Vec<&str> =
                    text.split(['\r', '\n', '\0']).map(str::trim).filter(|l| !l.is_empty()).collect();
                f.write_str(&lines.join(" "))
            }
        }
    }
}

impl FromStr for Crs {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let codes = text.trim().strip_prefix("EPSG:").and_then(|codes| match codes.split_once('+') {
            None => Some(Self::Epsg { horizontal: codes.parse().ok()?, vertical: None }),
            Some((horizontal, vertical)) => Some(Self::Epsg {
                horizontal: horizontal.parse().ok()?,
                vertical: Some(vertical.parse().ok()?),
            }),
        });
        Ok(codes.unwrap_or_else(|| Self::Wkt(text.trim().to_owned())))
    }
}

/// A table beside the points, as PLY has them: `face`, `camera`, `edge`.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// The element's name.
    pub name: String,
    /// Rows: the length of every column.
    pub rows: usize,
    /// The columns and their names.
    pub columns: Vec<(String, Column)>,
}

impl Table {
    /// Whether its rows are about points by their numbers, as those of a mesh's faces are: an integer
    /// column is named so (`vertex_indices`, `vertex1`, `point_id`), or the table is one of a mesh.
    #[must_use]
    pub fn refers_to_points(&self) -> bool {
        let mesh =
            ["face", "faces", "edge", "edges", "tristrips", "triangle", "triangles", "polygon", "cell"];
        mesh.contains(&self.name.as_str())
            || self.columns.iter().any(|(name, column)| {
                let (Column::Scalar(values) | Column::List { items: values, .. }) = column;
                !values.kind().is_float() && names_points(name)
            })
    }

    /// Bytes of its numbers.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let bytes = |values: &Values| (values.len() * values.kind().size()) as u64;
        let columns = self.columns.iter().map(|(_, column)| match column {
            Column::Scalar(values) => bytes(values),
            Column::List { lengths, items } => bytes(lengths) + bytes(items),
        });
        columns.sum()
    }
}

/// Whether a column of that name holds the numbers of points.
fn names_points(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let rest = ["vertices", "vertex", "points", "point"].iter().find_map(|word| name.strip_prefix(word));
    rest.map(|rest| rest.trim_start_matches('_')).is_some_and(|rest| {
        rest.chars().all(|c| c.is_ascii_digit()) || ["ind", "id", "list"].iter().any(|w| rest.starts_with(w))
    })
}

/// A column of a [`Table`].
#[derive(Debug, Clone, PartialEq)]
pub enum Column {
    /// A number a row.
    Scalar(Values),
    /// A list a row.
    List {
        /// How many items each row has, in the type that the file counts them in.
        lengths: Values,
        /// The items of all rows.
        items: Values,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coordinate_system_is_one_line_of_text_and_back() {
        for (text, name) in [
            ("EPSG:2992", "EPSG:2992"),
            ("EPSG:2992+5703", "EPSG:2992+5703"),
            ("PROJCS[\"NAD83 / Oregon\",GEOGCS[\"x\"]]", "NAD83 / Oregon"),
            ("EPSG:", "EPSG:"),
        ] {
            let crs: Crs = text.parse().expect("any text");
            assert_eq!((crs.to_string().as_str(), crs.name().as_str()), (text, name));
        }
        let lines = Crs::Wkt("A[\"b\",\r\n  C]\0".into());
        assert_eq!(lines.to_string(), "A[\"b\", C]");
    }

    #[test]
    fn a_comment_is_lines_without_control_characters() {
        let mut origin = Origin::default();
        origin.comment(" made by\tx \r\n\n\u{1b}[31mred\0");
        assert_eq!(origin.comments, ["made by x", "[31mred"]);
    }

    #[test]
    fn tables_about_points_by_their_numbers_are_told_from_others() {
        let table = |name: &str, column: &str, values: Values| Table {
            name: name.to_owned(),
            rows: values.len(),
            columns: vec![(column.to_owned(), Column::Scalar(values))],
        };
        let int = || Values::I32(vec![1]);
        let tables = [
            table("face", "flags", int()),
            table("link", "vertex1", int()),
            table("mark", "Point_Index", int()),
            table("camera", "point_size", int()),
            table("camera2", "viewport", int()),
            table("centre", "point", Values::F32(vec![1.0])),
        ];
        let mut origin = Origin { tables: Arc::new(tables.to_vec()), ..Origin::default() };
        assert_eq!(origin.drop_references(), ["face", "link", "mark"]);
        assert_eq!(*origin.tables, tables[3..]);
        assert_eq!(origin.tables[0].bytes(), 4);
    }
}
