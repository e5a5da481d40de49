//! densecloud turns a sparse, noisy 3D point cloud into a dense one: up to sixty-four times the points, on the surface
//! that the sparse ones hint at.
//!
//! [`Upsampler`] is the way in. It holds a model, and makes clouds dense by [`Options`]:
//!
//! ```no_run
//! use densecloud::{Options, Upsampler};
//!
//! let upsampler = Upsampler::new()?;
//! let positions: Vec<[f64; 3]> = vec![/* … */];
//! let dense = upsampler.upsample(positions, Options::parse(&[("ratio", "4")])?)?;
//! for warning in &dense.report.warnings {
//!     eprintln!("warning: {warning}");
//! }
//! let [x, y, z] = dense.positions[0];
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The model is inside the library; the runtime that computes it is ONNX Runtime's shared library (1.24 or newer), found at
//! `ORT_DYLIB_PATH`, beside the program, or where the system's loader looks. Python's package `onnxruntime` has it.
//!
//! # What happens to a cloud
//!
//! 1. [`Prepared::new`] checks options against the cloud, measures it ([`survey`]), and decides the number of points, the
//!    format and what the result's file will tell of the whole, [`provenance`] among it.
//! 2. [`Request::run`] runs the [cascade] over a [`LevelRunner`](cascade::LevelRunner), and gives the new points their
//!    [`attributes`].
//! 3. [`Dense::write`] writes it, in any [format](formats) that is written.
//!
//! The program `densecloud`, its server and its jobs do the same through the same functions, so all of them give the same
//! bytes for the same input, model, options and seed, on any number of threads.
//!
//! # What it takes
//!
//! Time is proportional to the points out: a core makes some 45,000 a second at the default settings. Memory is 250 to 310 bytes a point out. Work is
//! stopped within one patch by an [`Observer`](cascade::Observer), which also hears how far it is. Coordinates may be in any
//! unit and as far from the origin as 64-bit floats go.
//!
//! A cloud that memory does not hold is worked on in tiles by `densecloud-tiles`, through the same options.
//!
//! Many callers at once are better served by `densecloud-engine`, which queues, shares threads and memory fairly and knows
//! deadlines; over the network by `densecloud-server`.

pub mod attributes;
pub mod clean;
mod options;
mod outline;
mod parameters;
mod prepared;
pub mod provenance;
mod request;
pub mod surface;
pub mod survey;
mod upsampler;

pub use densecloud_backends as backends;
pub use densecloud_cascade as cascade;
pub use densecloud_cloud as cloud;
pub use densecloud_formats as formats;
pub use densecloud_geometry as geometry;

pub use options::{OptionError, Options};
pub use outline::{Outline, Outlined};
pub use parameters::{LEAST_TILE, PARAMETERS, Parameter, Topic, Value, position};
pub use prepared::{PrepareError, Prepared, Report, check_rules};
pub use request::{Made, Request};
pub use upsampler::{Dense, Input, UpsampleError, Upsampler};
