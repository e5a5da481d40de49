//! What clouds are like, and how near one is to another.

use std::path::PathBuf;

use densecloud_cascade::Target;
use densecloud_cli::{Inspection, score};
use densecloud_formats::read_mesh_file;
use densecloud_geometry::SurfaceDistance;
use pyo3::prelude::*;

use crate::arrays::{self, Column};
use crate::errors;
use crate::origin::Origin;
use crate::wait::waited;

/// What `densecloud inspect --json` tells, of a cloud that may come from a file, and may be made of another.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "Python calls it by name")]
pub(crate) fn inspect(
    py: Python<'_>,
    points: Bound<'_, PyAny>,
    columns: Vec<Column<'_>>,
    origin: &Origin,
    path: Option<PathBuf>,
    sample: usize,
    ratio: f64,
    source: Option<Bound<'_, PyAny>>,
) -> PyResult<String> {
    let cloud = origin.cloud(&points, &columns)?;
    let source = source.as_ref().map(arrays::positions).transpose()?;
    Target::Ratio(ratio).points_out(1).map_err(errors::invalid)?;
    if sample == 0 {
        return Err(errors::invalid("a sample of 0 measures nothing; give 1 or more"));
    }
    waited(py, None, |_| {
        let mut inspection = Inspection::of(&cloud, origin.format, sample).map_err(errors::invalid)?;
        if let Some(path) = &path {
            inspection = inspection.made_of_file(path);
        }
        if let Some(source) = &source {
            inspection =
                inspection.against(source).map_err(|why| errors::invalid(format!("source: {why}")))?;
        }
        inspection.ratio = ratio;
        Ok(inspection.json().to_string())
    })
}

/// The scores of `densecloud evaluate`, of one cloud.
#[pyfunction]
pub(crate) fn evaluate(
    py: Python<'_>,
    points: Bound<'_, PyAny>,
    reference: Bound<'_, PyAny>,
    mesh: Option<PathBuf>,
    tolerance: f64,
) -> PyResult<String> {
    let (points, reference) = (arrays::positions(&points)?, arrays::positions(&reference)?);
    waited(py, None, |_| {
        let read = |path: &PathBuf| read_mesh_file(path).map_err(|why| errors::of_file(path, why));
        let surface = mesh.as_ref().map(read).transpose()?.as_ref().map(SurfaceDistance::new);
        let scores = score(&points, &reference, surface.as_ref(), tolerance).map_err(errors::invalid)?;
        serde_json::to_string(&scores).map_err(errors::failed)
    })
}
