//! Runtimes behind [`densecloud_cascade::Backend`], and the files of a model.
//!
//! [`OnnxBackend`] runs a [`Model`] on ONNX Runtime, with kernels of our own for what costs most.

mod library;
mod model;
mod onnx;
mod operators;

pub use library::{library_lies_at, log_errors_to};
pub use model::{Card, Model, ModelName, UnitFile};
pub use onnx::OnnxBackend;

use densecloud_cascade::{Backend, BackendError, Batch, Demand, Output, SKIP_NEIGHBOURS, Session, UnitShape};
