//! LAS and LAZ, by the `las` crate: every point format, extra bytes, and COPC as the LAZ that it is.
//!
//! The crate reads and writes headers and compressed blocks; the fields of a point are taken from its
//! bytes and put there by [`layout`], and the records are read by [`records`], since the crate knows only
//! the first of those after the points.

mod crs;
mod layout;
mod read;
mod records;
mod write;

pub(super) use read::{open, read};
pub(super) use write::encode;
