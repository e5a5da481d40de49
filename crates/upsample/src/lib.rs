//! densecloud turns a sparse, noisy 3D point cloud into a dense one.

pub mod attributes;
mod options;
mod prepared;
pub mod provenance;
mod request;
pub mod survey;

pub use options::{OptionError, Options, PARAMETERS, Parameter, Topic, Value};
pub use prepared::{PrepareError, Prepared, Report};
pub use request::Request;
