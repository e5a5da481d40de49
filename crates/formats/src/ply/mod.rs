//! Stanford PLY: a text header that lists elements and their properties, then rows of numbers.

mod cloud;
mod header;
mod mesh;
mod rows;

pub(super) use cloud::{describe, read_cloud};
pub(super) use header::{PlyHeader, kind_name, parse};
pub(super) use mesh::read_mesh;
