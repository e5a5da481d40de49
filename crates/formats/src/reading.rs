//! What a person knows of a file that its content may not tell.

use std::fmt;
use std::str::FromStr;

use super::registry;
use super::text::quoted_fields;
use super::{Decimal, Separator};
use densecloud_cloud::Position;

/// How a file is to be read, where its content does not tell, or tells something else. The default leaves all to the
/// content.
///
/// ```
/// use densecloud_formats::{CloudReader, Limits, Reading};
///
/// let text = "1;7,5;8;9\n2;7;8,5;9\n";
/// let reading = Reading { axes: Some("2,3,4".parse()?), ..Reading::default() };
/// let cloud = CloudReader::open_as(text.as_bytes(), Limits::default(), &reading)?.read()?;
/// assert_eq!(cloud.positions, [[7.5, 8.0, 9.0], [7.0, 8.5, 9.0]]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Reading {
    /// The file's format. Some have nothing that they could be recognised by.
    pub format: Option<InputFormat>,
    /// Which columns of text are the coordinates.
    pub axes: Option<AxisColumns>,
    /// What stands between two columns of text.
    pub separator: Option<Separator>,
    /// What stands before the fraction of a number in text.
    pub decimal: Option<Decimal>,
    /// Where the points lie that are read; all of them where nobody says. Of COPC no others are decompressed but those in the
    /// same nodes.
    pub bounds: Option<Bounds>,
}

/// The option that an error message advises: its name on the command line.
pub(crate) const AXES: &str = "--axes";
pub(crate) const SEPARATOR: &str = "--separator";
pub(crate) const DECIMAL: &str = "--decimal";

impl Reading {
    /// The names of the options that are given and that a format which heeds `heeded` has no use for.
    pub(crate) fn unheeded(&self, heeded: &[&str]) -> Vec<&'static str> {
        let given = [
            (AXES, self.axes.is_some()),
            (SEPARATOR, self.separator.is_some()),
            (DECIMAL, self.decimal.is_some()),
        ];
        given
            .into_iter()
            .filter(|(name, given)| *given && !heeded.contains(name))
            .map(|(name, _)| name)
            .collect()
    }
}

/// Text that is none of the values that it may be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text:?}; there are {}", known.join(", "))]
#[non_exhaustive]
pub struct UnknownName {
    /// What was given.
    pub text: String,
    /// What it may be.
    pub known: Vec<&'static str>,
}

impl UnknownName {
    pub(crate) fn new(text: &str, known: &[&'static str]) -> Self {
        Self { text: text.to_owned(), known: known.to_vec() }
    }
}

/// The name of a format that is read, such as `ply` or `text`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InputFormat(&'static str);

impl InputFormat {
    /// All names.
    pub const NAMES: &'static [&'static str] = &registry::NAMES;

    /// The name.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.0
    }
}

impl fmt::Display for InputFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}

impl FromStr for InputFormat {
    type Err = UnknownName;

    /// Case is ignored.
    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let name = Self::NAMES.iter().find(|name| name.eq_ignore_ascii_case(text));
        name.map(|name| Self(name)).ok_or_else(|| UnknownName::new(text, Self::NAMES))
    }
}

/// The columns of x, y and z: each by its name or, counted from 1, by its number. As text: `Easting,Northing,Height` or
/// `2,3,4`; a name that holds a comma stands in quotes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AxisColumns([String; 3]);

impl AxisColumns {
    /// Where these columns stand, counted from 0, in a table of `width` columns, which have these names or none. A name is
    /// taken in its own case where there is one, else in any; a number that is no name counts columns.
    ///
    /// # Errors
    /// There is no such column, or there are several; or two axes are the same one.
    pub fn places(&self, names: &[String], width: usize) -> Result<[usize; 3], String> {
        let mut places = [0; 3];
        for (place, column) in places.iter_mut().zip(&self.0) {
            *place = find(column, names, width)?;
        }
        let [x, y, z] = places;
        if x == y || y == z || x == z {
            return Err(format!("{AXES} {self}: two of them are one column"));
        }
        Ok(places)
    }
}

fn find(column: &str, names: &[String], width: usize) -> Result<usize, String> {
    let all = |fits: &dyn Fn(&str) -> bool| -> Vec<usize> {
        (0..names.len()).filter(|i| fits(&names[*i])).collect()
    };
    let exact = all(&|name| name == column);
    let found =
        if exact.is_empty() { all(&|name| name.to_lowercase() == column.to_lowercase()) } else { exact };
    match (found.as_slice(), column.parse::<usize>()) {
        ([place], _) => Ok(*place),
        ([], Ok(number)) if (1..=width).contains(&number) => Ok(number - 1),
        ([], Ok(number)) => Err(format!("{AXES}: there is no column {number}; there are {width}")),
        ([], Err(_)) if names.is_empty() => Err(format!(
            "{AXES}: there is no column `{column}`; the columns have no names, but numbers from 1 to {width}"
        )),
        ([], Err(_)) => Err(format!("{AXES}: there is no column `{column}`; there are {}", names.join(", "))),
        (several, _) => {
            let numbers: Vec<String> = several.iter().map(|place| (place + 1).to_string()).collect();
            Err(format!(
                "{AXES}: `{column}` names the columns {}; give the number of one",
                numbers.join(" and ")
            ))
        }
    }
}

impl fmt::Display for AxisColumns {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, column) in self.0.iter().enumerate() {
            let comma = if i == 0 { "" } else { "," };
            if column.contains([',', '"']) {
                write!(f, "{comma}\"{}\"", column.replace('"', "\"\""))?;
            } else {
                write!(f, "{comma}{column}")?;
            }
        }
        Ok(())
    }
}

impl FromStr for AxisColumns {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let columns = quoted_fields(text, b',').unwrap_or_default();
        let columns: Vec<String> = columns.iter().map(|(column, _)| column.trim().to_owned()).collect();
        match <[String; 3]>::try_from(columns) {
            Ok(columns) if columns.iter().all(|column| !column.is_empty()) => Ok(Self(columns)),
            _ => Err(format!("{text:?} is not three columns A,B,C: names, or numbers from 1")),
        }
    }
}

/// A box of space, with its least corner and without its greatest, so that a point is in exactly one of boxes that lie side by
/// side. As text: `MINX,MINY,MAXX,MAXY`, of any height, or `MINX,MINY,MINZ,MAXX,MAXY,MAXZ`.
///
/// ```
/// use densecloud_formats::Bounds;
///
/// let bounds: Bounds = "0,0,10,20".parse()?;
/// assert!(bounds.contains(&[0.0, 19.9, -7.0]) && !bounds.contains(&[10.0, 5.0, 0.0]));
/// # Ok::<(), String>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    least: Position,
    greatest: Position,
}

/// None of its numbers is NaN.
impl Eq for Bounds {}

impl Bounds {
    /// The box of these corners; none where it has no extent along an axis, or a coordinate is no number.
    #[must_use]
    pub fn new(least: Position, greatest: Position) -> Option<Self> {
        let has_extent = least.iter().zip(&greatest).all(|(least, greatest)| least < greatest);
        has_extent.then_some(Self { least, greatest })
    }

    /// Whether a point is inside. One without a coordinate is not.
    #[must_use]
    pub fn contains(&self, point: &Position) -> bool {
        (0..3).all(|axis| self.least[axis] <= point[axis] && point[axis] < self.greatest[axis])
    }

    /// Whether a box that has both of its corners, given along each axis, has a place in common with this one.
    pub(crate) fn meets(&self, other: [[f64; 2]; 3]) -> bool {
        (0..3).all(|axis| other[axis][0] < self.greatest[axis] && self.least[axis] <= other[axis][1])
    }
}

impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x, y, z], [to_x, to_y, to_z]) = (self.least, self.greatest);
        if z == f64::NEG_INFINITY && to_z == f64::INFINITY {
            return write!(f, "{x},{y},{to_x},{to_y}");
        }
        write!(f, "{x},{y},{z},{to_x},{to_y},{to_z}")
    }
}

impl FromStr for Bounds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "{text:?} is not a box MINX,MINY,MAXX,MAXY or MINX,MINY,MINZ,MAXX,MAXY,MAXZ, each least below its greatest"
            )
        };
        let numbers = text.split(',').map(|number| number.trim().parse::<f64>());
        let numbers: Vec<f64> = numbers.collect::<Result<_, _>>().map_err(|_| wrong())?;
        let corners = match numbers[..] {
            [x, y, to_x, to_y] => ([x, y, f64::NEG_INFINITY], [to_x, to_y, f64::INFINITY]),
            [x, y, z, to_x, to_y, to_z] => ([x, y, z], [to_x, to_y, to_z]),
            _ => return Err(wrong()),
        };
        Self::new(corners.0, corners.1).ok_or_else(wrong)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(axes: &str, names: &[&str], width: usize) -> Result<[usize; 3], String> {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        axes.parse::<AxisColumns>()?.places(&names, width)
    }

    #[test]
    fn columns_are_found_by_name_and_by_number() {
        let names = ["id", "East, grid", "North", "H", "h", "7"];
        assert_eq!(places("\"East, grid\",north,H", &names, 6), Ok([1, 2, 3]));
        assert_eq!(places("3, 2, h", &names, 6), Ok([2, 1, 4]));
        assert_eq!(places("7,1,2", &names, 6), Ok([5, 0, 1]), "a name before a number");
        assert_eq!(places("2,3,4", &[], 4), Ok([1, 2, 3]));
        for (axes, names, part) in [
            ("x,North,H", &names[..], "no column `x`; there are id, East, grid, North, H, h, 7"),
            ("x,y,z", &[], "the columns have no names, but numbers from 1 to 6"),
            ("8,1,2", &names, "no column 8; there are 6"),
            ("0,1,2", &names, "no column 0"),
            ("North,3,H", &names, "two of them are one column"),
            ("a,B,C", &["A", "A", "b", "c"], "`a` names the columns 1 and 2"),
            ("a,b", &[], "not three columns"),
            ("a,,b", &[], "not three columns"),
            ("\"a,b,c", &[], "not three columns"),
        ] {
            let why = places(axes, names, 6).expect_err(axes);
            assert!(why.contains(part), "{axes}: {why}");
        }
    }

    #[test]
    fn boxes_side_by_side_have_each_point_once() {
        let read = |text: &str| text.parse::<Bounds>();
        let [left, right] = ["0,0,1,2", "1,0,2,2"].map(|text| read(text).expect(text));
        for x in [0.0, 0.5, 1.0, 1.999] {
            let point = [x, 0.0, 1e9];
            assert!(left.contains(&point) != right.contains(&point), "{x}");
        }
        for outside in [[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [-0.1, 1.0, 0.0], [f64::NAN, 1.0, 0.0]] {
            assert!(!left.contains(&outside) && !right.contains(&outside), "{outside:?}");
        }
        let deep = read(" -1, -1, 3.5, 1, 1, 4e0").expect("a box");
        assert!(deep.contains(&[0.0, 0.0, 3.5]) && !deep.contains(&[0.0, 0.0, 4.0]));
        for bounds in [left, right, deep] {
            assert_eq!(read(&bounds.to_string()), Ok(bounds));
        }
        for text in ["", "1,2,3", "0,0,0,1", "1,0,0,1", "0,0,nan,1", "0,0,1,1,1", "0,0,1,1,1,x", "0;0;1;1"] {
            let why = read(text).expect_err(text);
            assert!(why.contains("is not a box MINX,MINY,MAXX,MAXY or"), "{why}");
        }
    }

    #[test]
    fn what_is_told_is_read_as_the_same() {
        for axes in ["x,y,z", "\"a,b\",\"say \"\"h\"\"\",c d"] {
            let read: AxisColumns = axes.parse().expect(axes);
            assert_eq!(read.to_string(), axes);
        }
        for name in InputFormat::NAMES {
            let upper: InputFormat = name.to_uppercase().parse().expect(name);
            assert_eq!((upper.name(), upper.to_string().as_str()), (*name, *name));
        }
        let why = "docx".parse::<InputFormat>().expect_err("no format").to_string();
        assert!(why.starts_with("\"docx\"; there are ply, ") && why.ends_with(", text"), "{why}");
    }
}
