//! The front door: a model that is ready, and clouds that it makes dense.

use std::fmt;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::Arc;

use densecloud_backends::{Model, ModelName, OnnxBackend};
use densecloud_cascade::{BackendError, CascadeError, LevelRunner, Observer, Patchwise, Silent};
use densecloud_cloud::{Attribute, Cloud, Position};
use densecloud_formats::{Format, FormatError, PlyEncoding, Reading, Scalar, encode, read_cloud_file_as};

use crate::options::Options;
use crate::prepared::{PrepareError, Prepared, Report};

/// A model, ready to run. Any number of threads may share one.
///
/// Work runs on the current rayon pool: the global one with a thread a processor, or another's inside
/// `pool.install(|| …)`. The result does not depend on which, nor on the number of its threads.
///
/// ```no_run
/// use densecloud::{Options, Upsampler};
///
/// let upsampler = Upsampler::new()?;
/// let options = Options::parse(&[("ratio", "8"), ("keep_input", "true")])?;
/// let report = upsampler.upsample_file("scan.laz".as_ref(), "dense.laz".as_ref(), options)?;
/// println!("{} -> {} points", report.points_in, report.points_out);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Upsampler {
    runner: Arc<dyn LevelRunner>,
    model: ModelName,
}

impl fmt::Debug for Upsampler {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Upsampler")
            .field("model", &self.model)
            .field("provider", &self.runner.provider())
            .finish_non_exhaustive()
    }
}

/// A cloud to work on, and the format that it came in.
#[derive(Debug, Clone, PartialEq)]
pub struct Input {
    /// The cloud.
    pub cloud: Cloud,
    /// The result's format, where the options name no other.
    pub format: Format,
}

/// A dense cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct Dense {
    /// Exactly as many positions as were asked for, in the input's coordinates.
    pub positions: Vec<Position>,
    /// What else is known of each point.
    pub attributes: Vec<Attribute>,
    /// What is told of the whole: warnings, provenance, the format for [`Dense::write`].
    pub report: Report,
}

/// Why there is no dense cloud.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UpsampleError {
    /// The runtime or the model cannot be loaded.
    #[error(transparent)]
    Backend(#[from] BackendError),
    /// A file cannot be read or written.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The options do not fit the cloud.
    #[error(transparent)]
    Prepare(#[from] PrepareError),
    /// The cascade refused the cloud, failed, or was stopped.
    #[error(transparent)]
    Cascade(#[from] CascadeError),
}

impl Upsampler {
    /// The model inside the library, on ONNX Runtime.
    ///
    /// # Errors
    /// [`UpsampleError::Backend`] where ONNX Runtime's library is not found: it is looked for at `ORT_DYLIB_PATH`, beside
    /// the program, and where the system's loader looks.
    pub fn new() -> Result<Self, UpsampleError> {
        Self::with_model(Model::embedded()?)
    }

    /// A model of one's own, on ONNX Runtime: [`Model::load`] reads a folder.
    ///
    /// # Errors
    /// As [`Upsampler::new`].
    pub fn with_model(model: Model) -> Result<Self, UpsampleError> {
        let name = model.name();
        let backend = OnnxBackend::new(Arc::new(model))?;
        Ok(Self::with_runner(Arc::new(Patchwise::new(Arc::new(backend))), name))
    }

    /// Runs on `runner` instead of ONNX Runtime. `model` is the name and hash that provenance gives for its weights.
    #[must_use]
    pub fn with_runner(runner: Arc<dyn LevelRunner>, model: ModelName) -> Self {
        Self { runner, model }
    }

    /// Makes a cloud dense: a [`Cloud`], a vector of positions, or a file's [`Input`].
    ///
    /// Cost and memory: those of [`densecloud_cascade::upsample`].
    ///
    /// # Errors
    /// [`UpsampleError`].
    pub fn upsample(&self, input: impl Into<Input>, options: Options) -> Result<Dense, UpsampleError> {
        self.upsample_watched(input, options, &Silent)
    }

    /// As [`Upsampler::upsample`]; `observer` hears how far it is, and may stop it.
    ///
    /// # Errors
    /// The same; [`CascadeError::Cancelled`] where the observer stops it.
    pub fn upsample_watched(
        &self,
        input: impl Into<Input>,
        options: Options,
        observer: &dyn Observer,
    ) -> Result<Dense, UpsampleError> {
        let Input { cloud, format } = input.into();
        let Prepared { request, mut report } = Prepared::new(cloud, format, options, &self.model)?;
        let made = request.run(&*self.runner, observer)?;
        report.complete(&made);
        Ok(Dense { positions: made.positions, attributes: made.attributes, report })
    }

    /// Reads `input`, makes it dense and writes `output`: in the format of the options, else in the one that the extension
    /// of `output` names, else in the input's.
    ///
    /// If writing fails, an incomplete `output` is left behind. A format without comments has no place for provenance, which
    /// is in the [`Report`] alone then.
    ///
    /// # Errors
    /// The same; [`FormatError::NotWritten`] for an extension such as `.stl` or `.obj`, which nothing is written as; text may
    /// have any that its input has.
    pub fn upsample_file(
        &self,
        input: &Path,
        output: &Path,
        mut options: Options,
    ) -> Result<Report, UpsampleError> {
        match options.format {
            None => options.format = Format::of_output_from(output, input, &options.reading)?,
            Some(format) if !format.is_written() => {
                return Err(FormatError::NotWritten(format!("{format} is read only")).into());
            }
            Some(_) => {}
        }
        let dense = self.upsample(Input::read_as(input, &options.reading)?, options)?;
        let file = BufWriter::new(File::create(output).map_err(FormatError::from)?);
        dense.write(file)?;
        Ok(dense.report)
    }
}

impl Input {
    /// Reads a file in any format that [`densecloud_formats`] knows, by its content.
    ///
    /// # Errors
    /// As [`read_cloud_file_as`].
    pub fn read(path: &Path) -> Result<Self, FormatError> {
        Self::read_as(path, &Reading::default())
    }

    /// As [`Input::read`], in the way that a person asks for.
    ///
    /// # Errors
    /// As [`read_cloud_file_as`].
    pub fn read_as(path: &Path, reading: &Reading) -> Result<Self, FormatError> {
        let (cloud, header) = read_cloud_file_as(path, reading)?;
        Ok(Self { cloud, format: header.format })
    }
}

/// Written as binary PLY in 64 bits, where nothing else is asked for.
impl From<Cloud> for Input {
    fn from(cloud: Cloud) -> Self {
        let format = Format::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar: Scalar::F64 };
        Self { cloud, format }
    }
}

/// As a cloud of nothing but positions.
impl From<Vec<Position>> for Input {
    fn from(positions: Vec<Position>) -> Self {
        Cloud::from(positions).into()
    }
}

impl Dense {
    /// Writes it in the format of its [`Report`]: the bytes that the program would have written.
    ///
    /// # Errors
    /// [`FormatError`]: the sink fails, or a number is beyond what the format holds.
    pub fn write(&self, sink: impl Write) -> Result<(), FormatError> {
        let Report { format, origin, .. } = &self.report;
        encode(sink, *format, &self.positions, &self.attributes, origin).map(drop)
    }
}
