//! Metrics, controls, reports and pictures.
//!
//! [`score`] compares a dense cloud with a reference cloud and, where there is one, with the mesh
//! that both describe. It gives two blocks of numbers:
//!
//! - [`Published`]: the field's own, so that tables can be compared. Each cloud is scaled by itself,
//!   distances are squared, the distance to the surface goes one way. They are easy to game:
//!   repeating the input scores a perfect P2F.
//! - [`Corrected`]: one scale for both clouds, true distances, both ways, and uniformity.
//!
//! [`controls`] makes the rows to print beside them: what a perfect method would score, and what
//! methods score that learn nothing. A [`Report`] is the whole table.

pub(crate) mod controls;
mod files;
mod metrics;
mod nearest;
pub(crate) mod picture;
mod report;
mod sphere;
mod table;

pub(crate) use files::{FileKind, FileSet, SetError};
pub use metrics::{Corrected, DEFAULT_TOLERANCE, MetricError, Published, Scores, score};
pub(crate) use report::{CascadeSettings, Method, Report, Row, Settings};
