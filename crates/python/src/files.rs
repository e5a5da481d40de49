//! Clouds from files and into them.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use densecloud::survey::{GLANCE, Survey};
use densecloud::{Options, Report};
use densecloud_cli::{PROVENANCE, beside, write_file};
use densecloud_cloud::{Cloud, Facts, Role, column_of};
use densecloud_formats::{
    CloudReader, Format, FormatError, Header, Limits, Reading, encode, read_cloud_file_as,
};
use densecloud_geometry::check_count;
use numpy::PyArray2;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;

use crate::arrays::{self, Column};
use crate::errors;
use crate::origin::Origin;
use crate::wait::waited;

/// A cloud in Python's hands: its points, its attributes, and what is told of the whole.
pub(crate) type Parts<'py> = (Bound<'py, PyArray2<f64>>, Vec<Column<'py>>, Origin);

/// Options by their names in the table.
pub(crate) fn options(pairs: &[(String, String)]) -> PyResult<Options> {
    Options::parse(pairs).map_err(errors::invalid)
}

/// Reads a file, in the way that the options say.
#[pyfunction]
pub(crate) fn read(py: Python<'_>, path: PathBuf, pairs: Vec<(String, String)>) -> PyResult<Parts<'_>> {
    let reading = options(&pairs)?.reading;
    let read = waited(py, None, |_| {
        let read = read_cloud_file_as(&path, &reading).map_err(|why| errors::of_file(&path, why))?;
        check_count(read.0.positions.len()).map_err(errors::invalid)?;
        Ok(read)
    })?;
    parts(py, read, reading)
}

/// Reads what a file of any format has, in the way that the options say.
#[pyfunction]
pub(crate) fn read_bytes<'py>(
    py: Python<'py>,
    bytes: PyBackedBytes,
    pairs: Vec<(String, String)>,
) -> PyResult<Parts<'py>> {
    let reading = options(&pairs)?.reading;
    let read = waited(py, None, |_| {
        let opened =
            CloudReader::open_as(&bytes[..], Limits::default(), &reading).map_err(errors::invalid)?;
        let header = opened.header().clone();
        let cloud = opened.read().map_err(errors::invalid)?;
        check_count(cloud.positions.len()).map_err(errors::invalid)?;
        Ok((cloud, header))
    })?;
    parts(py, read, reading)
}

fn parts(py: Python<'_>, read: (Cloud, Header), reading: Reading) -> PyResult<Parts<'_>> {
    let (mut cloud, header) = read;
    let origin = Origin::of_file(&mut cloud, &header, reading);
    Ok((arrays::array_of(py, cloud.positions)?, arrays::columns_of(py, cloud.attributes), origin))
}

/// Among columns of these names, the places of those that mean what our names say.
#[pyfunction]
pub(crate) fn places(names: Vec<String>, roles: Vec<String>) -> Vec<Option<usize>> {
    let place = |role: &String| {
        let role = Role::all().find(|known| known.name() == *role)?;
        column_of(&names, role)
    };
    roles.iter().map(place).collect()
}

/// Writes a cloud in the format that the name asks for, and the provenance beside it where that has no place for comments. Gives
/// what a person should know.
#[pyfunction]
#[pyo3(signature = (path, points, columns, origin, provenance=None))]
pub(crate) fn write(
    py: Python<'_>,
    path: PathBuf,
    points: Bound<'_, PyAny>,
    columns: Vec<Column<'_>>,
    origin: &Origin,
    provenance: Option<String>,
) -> PyResult<Vec<String>> {
    let cloud = origin.cloud(&points, &columns)?;
    let from = origin.format;
    waited(py, None, |_| {
        let Written { format, cloud, warnings } = Written::of(&path, cloud, from)?;
        let Cloud { positions, attributes, origin, .. } = &cloud;
        written(&path, |sink| Ok(encode(sink, format, positions, attributes, origin).map(drop)?))?;
        if let Some(line) = provenance.filter(|_| !format.holds_comments()) {
            write_provenance(&path, &line)?;
        }
        Ok(warnings)
    })
}

/// Writes a file that is there whole or not at all.
pub(crate) fn written(
    path: &Path,
    encode: impl FnOnce(&mut (dyn Write + Send)) -> Result<(), WriteError>,
) -> PyResult<()> {
    write_file(path, encode).map_err(|why| match why {
        WriteError::Format(why) => errors::of_file(path, why),
        WriteError::Raised(why) => why,
    })
}

/// Writes where a result comes from beside it.
pub(crate) fn write_provenance(path: &Path, line: &str) -> PyResult<()> {
    let beside = beside(path, PROVENANCE);
    written(&beside, |sink| Ok(writeln!(sink, "{line}").map_err(FormatError::from)?))
}

/// Why a file was not written.
#[derive(Debug, thiserror::Error)]
pub(crate) enum WriteError {
    #[error(transparent)]
    Format(#[from] FormatError),
    #[error(transparent)]
    Raised(PyErr),
}

impl From<io::Error> for WriteError {
    fn from(why: io::Error) -> Self {
        Self::Format(why.into())
    }
}

/// A cloud that is ready for its file.
struct Written {
    format: Format,
    cloud: Cloud,
    warnings: Vec<String>,
}

impl Written {
    fn of(path: &Path, mut cloud: Cloud, from: Format) -> PyResult<Self> {
        let wanted = Format::of_output(path).map_err(|why| errors::of_file(path, why))?;
        let mut format = Format::of_result(wanted, from, !cloud.attributes.is_empty());
        if !format.is_like(from)
            && let Ok(survey) = Survey::of(&cloud.positions, GLANCE)
        {
            format = format.fine_enough(survey.bounds, survey.spacing.median);
        }
        let facts = |i: usize| Facts::of(&cloud.attributes[i].values);
        let adaptation = from.adaptation(&cloud.attributes, &facts, format);
        adaptation.apply(&mut cloud.attributes);
        let warnings = told(format, &cloud, adaptation.told);
        Ok(Self { format, cloud, warnings })
    }
}

/// What a file of that format has no place for or other names for.
fn told(format: Format, cloud: &Cloud, told: Option<String>) -> Vec<String> {
    let points = cloud.positions.len() as u64;
    let mut report = Report {
        format,
        origin: cloud.origin.clone(),
        provenance: String::new(),
        points_in: points,
        points_out: points,
        warnings: told.into_iter().collect(),
    };
    let lost = format.cannot_hold(&cloud.attributes, &cloud.origin);
    report.tell_losses(&lost, &format.renamed(&cloud.attributes, &cloud.origin));
    report.warnings
}
