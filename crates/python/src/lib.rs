//! What of Python's package `densecloud` is in Rust. People call what is in `python/densecloud/`, which makes contiguous arrays
//! and text of what it is given; here, work is done on them by the same functions as behind every other door.
//!
//! Work runs on threads of its own while the caller's waits without the interpreter (`wait.rs`), so that other threads of
//! Python go on, and Ctrl-C stops it.

mod arrays;
mod errors;
mod files;
mod measures;
mod origin;
mod program;
mod tiles;
mod upsampler;
mod wait;

use pyo3::pymodule;

#[pymodule]
mod _densecloud {
    use pyo3::prelude::*;

    #[pymodule_export]
    use super::files::{places, read, read_bytes, write};
    #[pymodule_export]
    use super::measures::{evaluate, inspect};
    #[pymodule_export]
    use super::origin::Origin;
    #[pymodule_export]
    use super::program::{parameters, program};
    #[pymodule_export]
    use super::tiles::{Tiling, load, plan, upsample_file};
    #[pymodule_export]
    use super::upsampler::{Report, Upsampler};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
