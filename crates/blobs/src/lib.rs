//! Files under names, wherever they are kept: there whole or not at all.
//!
//! | file | holds |
//! |---|---|
//! | `blobs` | the trait of whatever keeps files |
//! | `folder` | the files of one folder |
//!
//! Whoever uses these traits knows nothing of where files lie, and nothing here knows what they are.

mod blobs;
mod folder;

pub use blobs::{BlobReader, BlobWriter, Blobs, Listed};
pub use folder::Folder;
