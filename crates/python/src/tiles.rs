//! Clouds that memory does not hold: files into files, and the steps of that one by one.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use densecloud::Options;
use densecloud_formats::{CloudReader, Format, encode, set_temp_folder};
use densecloud_tiles::{Folder, Input, Large, TileSize, TilesError, Work};
use pyo3::prelude::*;

use crate::errors;
use crate::files::{WriteError, options, write_provenance, written};
use crate::upsampler::{Report, Upsampler};
use crate::wait::{Progress, waited};

/// Makes a file of a file, as `densecloud upsample` does: in tiles, where the cloud is large.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "Python calls it by name")]
pub(crate) fn upsample_file(
    py: Python<'_>,
    upsampler: &Upsampler,
    input: PathBuf,
    output: PathBuf,
    pairs: Vec<(String, String)>,
    temp: Option<PathBuf>,
    resume: bool,
    hear: Option<Py<PyAny>>,
) -> PyResult<Report> {
    let options = for_file(&input, &output, &pairs)?;
    let temp = temp.unwrap_or_else(std::env::temp_dir);
    let file = FileWork { upsampler, input, output, options, temp, resume };
    let report = waited(py, hear.as_ref(), |progress| upsampler.pool.install(|| file.run(progress)))?;
    Ok(report.into())
}

/// The options of a work whose result has that name.
fn for_file(input: &Path, output: &Path, pairs: &[(String, String)]) -> PyResult<Options> {
    let options = options(pairs)?;
    let format = Format::of_output_from(output, input, &options.reading);
    Ok(Options { format: format.map_err(|why| errors::of_file(output, why))?, ..options })
}

/// A file that is to become another.
struct FileWork<'a> {
    upsampler: &'a Upsampler,
    input: PathBuf,
    output: PathBuf,
    options: Options,
    /// The folder for temporary files.
    temp: PathBuf,
    resume: bool,
}

impl FileWork<'_> {
    fn run(self, progress: &Progress) -> PyResult<densecloud::Report> {
        set_temp_folder(&self.temp).map_err(|why| errors::of_io(&self.temp, &why))?;
        let (reader, tile_points) = open(&self.input, &self.options)?;
        let read = Input::read(reader, tile_points).map_err(|why| errors::of_file(&self.input, why))?;
        let report = match read {
            Input::Small(cloud, header) => {
                let (made, mut report) =
                    self.upsampler.made(*cloud, header.format, self.options.clone(), progress)?;
                report.complete(&made);
                written(&self.output, |sink| {
                    Ok(encode(sink, report.format, &made.positions, &made.attributes, &report.origin)
                        .map(drop)?)
                })?;
                report
            }
            Input::Large(large) => self.in_tiles(*large, tile_points, progress)?,
        };
        if !report.format.holds_comments() {
            write_provenance(&self.output, &report.provenance)?;
        }
        Ok(report)
    }

    fn in_tiles(
        &self,
        input: Large<'_>,
        tile_points: u64,
        progress: &Progress,
    ) -> PyResult<densecloud::Report> {
        let fail = |why| errors::of_tiles(&self.input, why);
        let folder = match self.resume {
            true => Folder::kept(&self.temp, &absolute(&self.output)),
            false => Folder::temporary(&self.temp),
        };
        let folder = folder.map_err(fail)?;
        let work = self.upsampler.work(&self.options, tile_points, progress);
        let tiling = match folder.has_plan() {
            true => densecloud_tiles::Tiling::resumed(input, &work, &folder),
            false => densecloud_tiles::plan(input, &work, &folder),
        };
        let tiling = Arc::new(tiling.map_err(fail)?);
        let mut report = None;
        written(&self.output, |sink| {
            report = Some(tiling.run_into(&work, sink).map_err(|why| self.unwritten(why))?);
            Ok(())
        })?;
        // What is gone on with stays until it is done.
        if self.resume {
            folder.remove().map_err(fail)?;
        }
        report.ok_or_else(|| errors::failed("there is no result"))
    }

    /// By now the input is read: what has a format is the result.
    fn unwritten(&self, why: TilesError) -> WriteError {
        match why {
            TilesError::Format(why) => WriteError::Format(why),
            why => WriteError::Raised(errors::of_tiles(&self.input, why)),
        }
    }
}

/// Opens a file, and tells how many points a tile of it has.
fn open(path: &Path, options: &Options) -> PyResult<(CloudReader<'static>, u64)> {
    let reader = CloudReader::open_path(path, &options.reading).map_err(|why| errors::of_file(path, why))?;
    let points = TileSize::of(options).points(options.goal, reader.header()).map_err(errors::invalid)?;
    Ok((reader, points))
}

fn absolute(output: &Path) -> String {
    std::path::absolute(output).unwrap_or_else(|_| output.to_owned()).display().to_string()
}

impl Upsampler {
    fn work<'a>(&'a self, options: &'a Options, tile_points: u64, progress: &'a Progress) -> Work<'a> {
        Work { options, model: &self.name, runner: &*self.runner, tile_points, watch: progress }
    }
}

/// A cloud that is cut into tiles, in a folder.
#[pyclass(frozen)]
pub(crate) struct Tiling {
    inner: densecloud_tiles::Tiling,
    path: PathBuf,
}

/// Cuts a file's cloud into tiles, in a new or empty folder.
#[pyfunction]
pub(crate) fn plan(
    py: Python<'_>,
    upsampler: &Upsampler,
    input: PathBuf,
    folder: PathBuf,
    output: Option<PathBuf>,
    pairs: Vec<(String, String)>,
) -> PyResult<Tiling> {
    let options = match &output {
        Some(output) => for_file(&input, output, &pairs)?,
        None => options(&pairs)?,
    };
    let fail = |why| errors::of_tiles(&input, why);
    waited(py, None, |progress| {
        upsampler.pool.install(|| {
            let place = Folder::new(&folder).map_err(fail)?;
            let (reader, tile_points) = open(&input, &options)?;
            // However few points there are, they are tiles here.
            let large = match Input::read(reader, 0).map_err(|why| errors::of_file(&input, why))? {
                Input::Large(large) => *large,
                Input::Small(..) => return Err(errors::invalid("there are no points")),
            };
            let work = upsampler.work(&options, tile_points, progress);
            let inner = densecloud_tiles::plan(large, &work, &place).map_err(fail)?;
            Ok(Tiling { inner, path: folder })
        })
    })
}

/// What was planned in a folder.
#[pyfunction]
pub(crate) fn load(py: Python<'_>, folder: PathBuf) -> PyResult<Tiling> {
    waited(py, None, |_| {
        let inner = densecloud_tiles::Tiling::load(&Folder::at(&folder));
        Ok(Tiling { inner: inner.map_err(|why| errors::of_tiles(&folder, why))?, path: folder })
    })
}

#[pymethods]
impl Tiling {
    fn __len__(&self) -> usize {
        self.inner.len() as usize
    }

    #[getter]
    fn folder(&self) -> PathBuf {
        self.path.clone()
    }

    #[getter]
    fn report(&self) -> Report {
        self.inner.report().clone().into()
    }

    /// Points of the input, of a tile's own and around it, and of its part of the result.
    fn points(&self, tile: u32) -> PyResult<[u64; 3]> {
        let last = self.inner.len().saturating_sub(1);
        if tile > last {
            return Err(self.fail(TilesError::NoTile { tile, last }));
        }
        Ok(self.inner.points(tile))
    }

    fn not_done(&self) -> PyResult<Vec<u32>> {
        self.inner.not_done().map_err(|why| self.fail(why))
    }

    /// Makes the part of one tile, and gives its points.
    #[pyo3(signature = (upsampler, tile, hear=None))]
    fn run(
        &self,
        py: Python<'_>,
        upsampler: &Upsampler,
        tile: u32,
        hear: Option<Py<PyAny>>,
    ) -> PyResult<u64> {
        self.inner.check(&upsampler.name).map_err(|why| self.fail(why))?;
        waited(py, hear.as_ref(), |progress| {
            let run = || self.inner.run(tile, &*upsampler.runner, progress);
            upsampler.pool.install(run).map_err(|why| self.fail(why))
        })
    }

    /// Writes the parts of all tiles into one file, of the format that was planned.
    fn join(&self, py: Python<'_>, output: PathBuf) -> PyResult<Report> {
        let format = self.inner.report().format;
        match Format::of_output(&output) {
            Ok(Some(named)) if !named.is_named_like(format) => {
                let why = format!("{}: the tiles are planned for {format}", output.display());
                return Err(errors::invalid(why));
            }
            _ => {}
        }
        let report = waited(py, None, |_| {
            let mut report = None;
            written(&output, |sink| {
                let joined = self.inner.join().and_then(|join| join.write(sink));
                report = Some(joined.map_err(|why| match why {
                    TilesError::Format(why) => WriteError::Format(why),
                    why => WriteError::Raised(self.fail(why)),
                })?);
                Ok(())
            })?;
            report.ok_or_else(|| errors::failed("there is no result"))
        })?;
        if !report.format.holds_comments() {
            write_provenance(&output, &report.provenance)?;
        }
        Ok(report.into())
    }

    /// Removes the plan and all parts.
    fn remove(&self) -> PyResult<()> {
        Folder::at(&self.path).remove_plan().map_err(|why| self.fail(why))
    }
}

impl Tiling {
    fn fail(&self, why: TilesError) -> PyErr {
        errors::of_tiles(&self.path, why)
    }
}
