//! The program inside the package, and its table of options.

use std::ffi::OsString;
use std::path::PathBuf;

use densecloud::{PARAMETERS, Topic};
use densecloud_backends::library_lies_at;
use pyo3::prelude::*;

/// Runs the program with these arguments, its name first; gives its exit code. `library` is ONNX Runtime's, `missing` why there is none.
#[pyfunction]
pub(crate) fn program(
    py: Python<'_>,
    arguments: Vec<OsString>,
    library: Option<PathBuf>,
    missing: String,
) -> u8 {
    library_lies_at(library.ok_or(missing));
    py.detach(|| densecloud_cli::run(arguments))
}

/// Of each option its name, what its value is called (none of a switch), and what it is about.
#[pyfunction]
pub(crate) fn parameters() -> Vec<(&'static str, Option<&'static str>, &'static str)> {
    PARAMETERS.iter().map(|parameter| (parameter.name, parameter.value, topic(parameter.topic))).collect()
}

fn topic(topic: Topic) -> &'static str {
    match topic {
        Topic::Goal => "goal",
        Topic::Points => "points",
        Topic::Attributes => "attributes",
        Topic::Cascade => "cascade",
        Topic::Tiles => "tiles",
        Topic::Reading => "reading",
    }
}
