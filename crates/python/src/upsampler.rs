//! A model that is ready, and clouds that it makes dense.

use std::path::PathBuf;
use std::sync::Arc;

use densecloud::{Made, Options, Prepared, Request};
use densecloud_backends::{Model, ModelName, OnnxBackend, library_lies_at};
use densecloud_cascade::{LevelRunner, Observer, Patchwise};
use densecloud_cli::available_memory;
use densecloud_cloud::Cloud;
use densecloud_formats::Format;
use numpy::PyArray2;
use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::arrays::{self, Column};
use crate::errors;
use crate::files::options;
use crate::origin::Origin;
use crate::wait::waited;

/// A loaded model, and threads for it. Any number of threads of Python may share one.
#[pyclass(frozen)]
pub(crate) struct Upsampler {
    pub(crate) runner: Arc<dyn LevelRunner>,
    pub(crate) name: ModelName,
    pub(crate) pool: ThreadPool,
}

/// What is told of a result beside its points.
#[pyclass(frozen, get_all)]
#[derive(Debug)]
pub(crate) struct Report {
    points_in: u64,
    points_out: u64,
    provenance: String,
    warnings: Vec<String>,
}

impl From<densecloud::Report> for Report {
    fn from(report: densecloud::Report) -> Self {
        let densecloud::Report { points_in, points_out, provenance, warnings, .. } = report;
        Self { points_in, points_out, provenance, warnings }
    }
}

/// A dense cloud in Python's hands.
type Dense<'py> = (Bound<'py, PyArray2<f64>>, Vec<Column<'py>>, Origin, Report);

#[pymethods]
impl Upsampler {
    /// Loads ONNX Runtime from that path, once a process, and the model of a folder, or the one inside the package. `threads` of 0 is
    /// one a processor.
    #[new]
    fn new(py: Python<'_>, library: PathBuf, model: Option<PathBuf>, threads: usize) -> PyResult<Self> {
        library_lies_at(Ok(library));
        waited(py, None, |_| {
            let model = model.as_deref().map_or_else(Model::embedded, Model::load).map_err(errors::failed)?;
            let name = model.name();
            let backend = OnnxBackend::new(Arc::new(model)).map_err(errors::failed)?;
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().map_err(errors::failed)?;
            Ok(Self { runner: Arc::new(Patchwise::new(Arc::new(backend))), name, pool })
        })
    }

    /// The model's name, and the SHA-256 of its weights.
    #[getter]
    fn model(&self) -> (String, String) {
        (self.name.name.clone(), self.name.sha256.clone())
    }

    #[getter]
    fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    #[pyo3(signature = (points, columns, origin, pairs, hear=None))]
    fn upsample<'py>(
        &self,
        py: Python<'py>,
        points: Bound<'py, PyAny>,
        columns: Vec<Column<'py>>,
        origin: &Origin,
        pairs: Vec<(String, String)>,
        hear: Option<Py<PyAny>>,
    ) -> PyResult<Dense<'py>> {
        let options = origin.read_by(options(&pairs)?);
        let cloud = origin.cloud(&points, &columns)?;
        let (made, mut report) = waited(py, hear.as_ref(), |progress| {
            self.pool.install(|| self.made(cloud, origin.format, options, progress))
        })?;
        // What its file cannot hold is told when it is written.
        report.points_out = made.positions.len() as u64;
        report.warnings.extend(made.warnings());
        let points = arrays::array_of(py, made.positions)?;
        let origin = Origin::of_result(report.format, report.origin.clone());
        Ok((points, arrays::columns_of(py, made.attributes), origin, report.into()))
    }
}

impl Upsampler {
    pub(crate) fn made(
        &self,
        cloud: Cloud,
        format: Format,
        options: Options,
        observer: &dyn Observer,
    ) -> PyResult<(Made, densecloud::Report)> {
        let prepared = Prepared::new(cloud, format, options, &self.name).map_err(errors::of_preparation)?;
        self.check_memory(&prepared, available_memory())?;
        let Prepared { request, report } = prepared;
        let made = request.run(&*self.runner, observer).map_err(errors::of_cascade)?;
        Ok((made, report))
    }

    /// Refuses what would not fit into memory, by an estimate from above: the system ends a program that finds that out by itself.
    fn check_memory(&self, prepared: &Prepared, free: Option<u64>) -> PyResult<()> {
        let out = prepared.report.points_out;
        let needed = self.runner.demand().bytes(last_level(&prepared.request, out));
        let needed = needed.saturating_add(out.saturating_mul(prepared.attribute_bytes()));
        match free.filter(|free| needed > *free) {
            Some(free) => Err(PyMemoryError::new_err(format!(
                "{out} points out would take about {:.1} GB of memory, and {:.1} GB are free: ask for fewer, or let `upsample_file` \
                 work in tiles",
                needed as f64 / 1e9,
                free as f64 / 1e9
            ))),
            None => Ok(()),
        }
    }
}

/// Points of the last level before it is sampled, with what the settings add.
fn last_level(request: &Request, out: u64) -> u64 {
    let points = request.cloud.positions.len().max(1) as f64;
    let levels = (out as f64 / points).log2().ceil().max(1.0);
    (points * levels.exp2() * request.effort()) as u64
}
