//! Our errors as Python's exceptions: the program's words, in the type that a caller can tell apart.

use std::fmt::Display;
use std::io;
use std::path::Path;

use densecloud::PrepareError;
use densecloud_cascade::CascadeError;
use densecloud_formats::FormatError;
use densecloud_tiles::TilesError;
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

pyo3::import_exception!(densecloud._errors, DensecloudError);
pyo3::import_exception!(densecloud._errors, InvalidInputError);

/// What is no fault of the caller's.
pub(crate) fn failed(why: impl Display) -> PyErr {
    DensecloudError::new_err(why.to_string())
}

/// A cloud, an option or a file that cannot be: a `ValueError`, too.
pub(crate) fn invalid(why: impl Display) -> PyErr {
    InvalidInputError::new_err(why.to_string())
}

pub(crate) fn of_preparation(why: PrepareError) -> PyErr {
    match why {
        // Here these have another name.
        PrepareError::UnknownAttribute { .. } => invalid(format!("rules: {why}")),
        why => invalid(why),
    }
}

pub(crate) fn of_cascade(why: CascadeError) -> PyErr {
    match why {
        CascadeError::Backend(why) => failed(why),
        why => invalid(why),
    }
}

/// The system's, of a file: Python makes a `FileNotFoundError` and so on of it.
pub(crate) fn of_io(path: &Path, why: &io::Error) -> PyErr {
    match why.raw_os_error() {
        Some(number) => {
            let words = why.to_string();
            let words = words.split(" (os error").next().unwrap_or_default().to_owned();
            PyOSError::new_err((number, words, path.as_os_str().to_owned()))
        }
        None => PyOSError::new_err(format!("{}: {why}", path.display())),
    }
}

pub(crate) fn of_file(path: &Path, why: FormatError) -> PyErr {
    match why {
        FormatError::Io(why) => of_io(path, &why),
        why => invalid(format!("{}: {why}", path.display())),
    }
}

/// What goes wrong with tiles of this input, or in this folder.
pub(crate) fn of_tiles(path: &Path, why: TilesError) -> PyErr {
    match why {
        TilesError::Format(why) => of_file(path, why),
        TilesError::Prepare(why) => of_preparation(why),
        TilesError::Cascade(why) => of_cascade(why),
        TilesError::Tile { why: CascadeError::Backend(why), .. } => failed(why),
        TilesError::File { path, why } => of_io(&path, &why),
        TilesError::NoSpace { .. } => PyOSError::new_err(why.to_string()),
        TilesError::Tile { .. }
        | TilesError::NotInParts { .. }
        | TilesError::NoTile { .. }
        | TilesError::NotEmpty(_) => invalid(why),
        why => failed(why),
    }
}
