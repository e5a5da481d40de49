//! What keeps blobs, through its trait.

mod folder;
mod suite;
