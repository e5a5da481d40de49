//! Files under names, wherever they are kept: there whole or not at all.
//!
//! | file | holds |
//! |---|---|
//! | `blobs` | the trait of whatever keeps files |
//! | `folder` | the files of one folder |
//! | `objects` | the objects of a bucket |
//! | `address` | addresses of both, and what they lead to |
//! | `settings` | what it takes to reach a store |
//!
//! All but the first two come with the cargo feature `s3`, which is on unless left out.
//!
//! Whoever uses these traits knows nothing of where files lie, and nothing here knows what they are.

#[cfg(feature = "s3")]
mod address;
mod blobs;
mod folder;
#[cfg(feature = "s3")]
mod objects;
#[cfg(feature = "s3")]
mod settings;

#[cfg(feature = "s3")]
pub use address::{Address, AddressError, Scheme, open, open_object};
pub use blobs::{BlobReader, BlobWriter, Blobs, Listed};
pub use folder::Folder;
#[cfg(feature = "s3")]
pub use objects::Objects;
#[cfg(feature = "s3")]
pub use settings::{Patience, Settings};
