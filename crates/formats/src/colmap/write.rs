//! Writing, as text and as records. Tracks are empty: which images see a new point is not known.

use std::io::Write;
use std::ops::Range;

use super::super::FormatError;
use super::super::kind::{Begun, FirstPass, Rows};
use super::ids::NewKeys;
use super::{ERROR, ID, TITLE};
use densecloud_cloud::{Attribute, Origin, Position, Role, column_of};

/// What COLMAP writes where it does not know how far a point is from its sightings.
const NO_ERROR: f64 = -1.0;

/// What is known of the points before the first one is written.
pub(super) struct Seen {
    binary: bool,
    points: u64,
    comments: Vec<String>,
    keys: NewKeys,
    colour: Option<Colour>,
    error: Option<usize>,
}

impl Seen {
    /// Nothing, of points with attributes of these names and types.
    pub(super) fn new(binary: bool, attributes: &[Attribute], origin: &Origin) -> Self {
        Self {
            binary,
            points: 0,
            comments: origin.comments.clone(),
            keys: NewKeys::new(origin),
            colour: Colour::find(attributes),
            error: attributes.iter().position(|a| a.name == ERROR),
        }
    }
}

impl FirstPass for Seen {
    fn see(
        &mut self,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        self.points += positions.len() as u64;
        if let Some(colour) = &mut self.colour {
            colour.see(attributes, from..from + positions.len());
        }
        Ok(())
    }

    fn begin(self: Box<Self>) -> Result<Begun, FormatError> {
        let Self { binary, points, comments, keys, colour, error } = *self;
        let header = if binary { points.to_le_bytes().to_vec() } else { title(points, &comments) };
        Ok((header, Box::new(ColmapRows { binary, keys, colour, error })))
    }
}

/// Lines, or records.
#[derive(Debug)]
struct ColmapRows {
    binary: bool,
    keys: NewKeys,
    colour: Option<Colour>,
    /// The place of the attribute.
    error: Option<usize>,
}

impl Rows for ColmapRows {
    fn put(
        &mut self,
        bytes: &mut Vec<u8>,
        positions: &[Position],
        attributes: &[Attribute],
        from: usize,
    ) -> Result<(), FormatError> {
        for (position, row) in positions.iter().zip(from..) {
            let key = self.keys.next(*position);
            let [x, y, z] = *position;
            let [red, green, blue] = self.colour.map_or([0; 3], |colour| colour.bytes(attributes, row));
            let error = self.error.map_or(NO_ERROR, |place| attributes[place].values.get(row));
            if self.binary {
                bytes.extend(key.to_le_bytes());
                bytes.extend(position.iter().flat_map(|c| c.to_le_bytes()));
                bytes.extend([red, green, blue]);
                bytes.extend(error.to_le_bytes());
                bytes.extend(0_u64.to_le_bytes());
            } else {
                writeln!(bytes, "{key} {x:?} {y:?} {z:?} {red} {green} {blue} {error:?}")?;
            }
        }
        Ok(())
    }
}

/// The comments before the points, as COLMAP writes them, then our own.
fn title(points: u64, comments: &[String]) -> Vec<u8> {
    let mut text = format!(
        "# 3D point list with one line of data per point:\n\
         #   {TITLE}, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n\
         # Number of points: {points}, mean track length: 0\n"
    );
    for comment in comments {
        text += &format!("# {}\n", comment.replace(char::is_control, " "));
    }
    text.into_bytes()
}

/// Names of attributes that have no place.
pub(super) fn not_held(attributes: &[Attribute]) -> Vec<String> {
    let colour = Colour::find(attributes).map(|mut colour| {
        colour.see(attributes, 0..attributes.first().map_or(0, |first| first.values.len()));
        colour
    });
    let places =
        colour.filter(|colour| colour.white().is_some()).map_or([usize::MAX; 3], |colour| colour.places);
    let is_held = |i: usize, name: &str| places.contains(&i) || name == ERROR || name == ID;
    let lost = attributes.iter().enumerate().filter(|(i, a)| !is_held(*i, &a.name));
    lost.map(|(_, a)| a.name.clone()).collect()
}

/// The attributes that are a colour.
#[derive(Debug, Clone, Copy)]
struct Colour {
    /// Of red, green and blue.
    places: [usize; 3],
    is_real: bool,
    /// The largest number of all.
    most: f64,
}

impl Colour {
    /// The colour, if there is one; none of its numbers is seen.
    fn find(attributes: &[Attribute]) -> Option<Self> {
        let names: Vec<&str> = attributes.iter().map(|a| a.name.as_str()).collect();
        let find = |role| column_of(&names, role);
        let places = [find(Role::Red)?, find(Role::Green)?, find(Role::Blue)?];
        let is_real = places.iter().all(|place| attributes[*place].values.kind().is_float());
        Some(Self { places, is_real, most: 0.0 })
    }

    fn see(&mut self, attributes: &[Attribute], rows: Range<usize>) {
        for place in self.places {
            let values = &attributes[place].values;
            self.most = rows.clone().map(|row| values.get(row)).fold(self.most, f64::max);
        }
    }

    /// What white is: 1 or 255; or 65,535, where a byte is a number's upper one. None where it is none of these.
    fn white(self) -> Option<f64> {
        let whites = [1.0, 255.0, 65_535.0].into_iter();
        whites.filter(|white| self.is_real || *white > 1.0).find(|white| self.most <= *white)
    }

    /// Of a point, in 8 bits; black where it is none.
    fn bytes(self, attributes: &[Attribute], row: usize) -> [u8; 3] {
        let Some(white) = self.white() else { return [0; 3] };
        self.places.map(|place| {
            let part = attributes[place].values.get(row);
            // Saturates, and turns NaN into 0.
            if white > 255.0 { (part / 256.0) as u8 } else { (part * 255.0 / white).round() as u8 }
        })
    }
}
