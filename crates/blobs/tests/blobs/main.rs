//! What keeps blobs, through its trait.

#[cfg(feature = "s3")]
mod faults;
mod folder;
#[cfg(feature = "s3")]
mod objects;
mod suite;
