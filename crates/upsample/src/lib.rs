//! densecloud turns a sparse, noisy 3D point cloud into a dense one.

pub mod attributes;
pub mod provenance;
mod request;
pub mod survey;

pub use request::Request;
