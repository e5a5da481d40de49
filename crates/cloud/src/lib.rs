//! The point cloud as the rest of the library sees it: true coordinates, and the local frame in
//! which all geometry is computed.

mod attribute;
mod axes;
mod colour;
mod extra;
mod facts;
mod frame;
mod name;
mod origin;
mod role;

pub use attribute::{Attribute, Kind, Values, bytes_a_point};
pub use axes::{AmbiguousAxes, Axes, axes_of};
pub use colour::full_colour;
pub use extra::{Extra, FormatExtra};
pub use facts::{Facts, FactsSeen};
pub use frame::{Frame, FrameError};
pub use origin::{Column, Crs, Named, Origin, Sensors, Table};
pub use role::{Role, column_of, roles_of};

/// A position in the local [`Frame`]: `f32`, within about [-1, 1] on each axis.
pub type Point = [f32; 3];

/// A position in the file's own coordinates and units.
pub type Position = [f64; 3];

/// A cloud as read from a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Cloud {
    /// One entry a point, in the file's order and units. May hold non-finite values: see
    /// the crate `densecloud-cascade` for the rule about them.
    pub positions: Vec<Position>,
    /// What else the file tells of each point, in the file's order: one value a point.
    pub attributes: Vec<Attribute>,
    /// Names of what the reader saw and did not keep (lists, text, arrays), in the file's order.
    pub dropped_properties: Vec<String>,
    /// What else a person should know about how it was read, a sentence each: a count that is off, names that were
    /// changed, points that were left out.
    pub notes: Vec<String>,
    /// What else the file tells of the whole.
    pub origin: Origin,
}

/// A cloud of nothing but positions.
impl From<Vec<Position>> for Cloud {
    fn from(positions: Vec<Position>) -> Self {
        Self { positions, ..Self::default() }
    }
}

impl Cloud {
    /// What a person should know about what was read, a sentence each.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.notes.clone();
        if !self.dropped_properties.is_empty() {
            warnings.push(format!("not read: {}", self.dropped_properties.join(", ")));
        }
        warnings
    }
}
