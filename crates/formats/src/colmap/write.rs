//! Writing, as text and as records. Tracks are empty: which images see a new point is not known.

use std::io::Write;
use std::ops::Range;

use super::super::FormatError;
use super::super::kind::{Begun, FirstPass, Rows};
use super::super::names::Meanings;
use super::ids::NewKeys;
use super::{ID, NO_ERROR, TITLE};
use densecloud_cloud::{Attribute, Origin, Position, Role};

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
        let meanings = Meanings::of(attributes);
        Self {
            binary,
            points: 0,
            comments: origin.comments.clone(),
            keys: NewKeys::new(origin),
            colour: Colour::find(attributes, &meanings),
            error: meanings.usual(Role::Error),
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
            let error = self.error.map(|place| attributes[place].values.get(row));
            let error = error.filter(|error| error.is_finite()).unwrap_or(NO_ERROR);
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
pub(super) fn not_held(attributes: &[Attribute], origin: &Origin) -> Vec<String> {
    let meanings = Meanings::of(attributes);
    let colour = Colour::find(attributes, &meanings).map(|mut colour| {
        colour.see(attributes, 0..attributes.first().map_or(0, |first| first.values.len()));
        colour
    });
    let places =
        colour.filter(|colour| colour.white().is_some()).map_or([usize::MAX; 3], |colour| colour.places);
    let error = meanings.usual(Role::Error);
    let has_keys = NewKeys::new(origin).has_source();
    let is_held = |i: usize, name: &str| places.contains(&i) || error == Some(i) || name == ID && has_keys;
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
    fn find(attributes: &[Attribute], meanings: &Meanings) -> Option<Self> {
        let [red, green, blue] = [Role::Red, Role::Green, Role::Blue].map(|part| meanings.usual(part));
        let places = [red?, green?, blue?];
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
