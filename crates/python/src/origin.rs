//! What a cloud of Python's keeps of where it comes from, beside its arrays.

use densecloud::Options;
use densecloud_cloud::{Cloud, Origin as Whole};
use densecloud_formats::{Format, Header, PlyEncoding, Reading, Scalar};
use densecloud_geometry::check_count;
use pyo3::prelude::*;

use crate::arrays::{self, Column};
use crate::errors;

/// What is told of a whole cloud: its format, what else its file says, and how that was read.
#[pyclass(frozen)]
#[derive(Debug, Clone)]
pub(crate) struct Origin {
    /// The format that it came in, or that its result has.
    pub(crate) format: Format,
    whole: Whole,
    /// How its file was read.
    reading: Reading,
    dropped: Vec<String>,
    notes: Vec<String>,
}

impl Origin {
    /// Of a cloud that was read; its points and attributes are taken out.
    pub(crate) fn of_file(cloud: &mut Cloud, header: &Header, reading: Reading) -> Self {
        Self {
            format: header.format,
            whole: std::mem::take(&mut cloud.origin),
            reading,
            dropped: std::mem::take(&mut cloud.dropped_properties),
            notes: std::mem::take(&mut cloud.notes),
        }
    }

    /// Of a result in this format.
    pub(crate) fn of_result(format: Format, whole: Whole) -> Self {
        Self { format, whole, reading: Reading::default(), dropped: Vec::new(), notes: Vec::new() }
    }

    /// The cloud that has these points and attributes. Copies them.
    pub(crate) fn cloud(&self, points: &Bound<'_, PyAny>, columns: &[Column<'_>]) -> PyResult<Cloud> {
        let positions = arrays::positions(points)?;
        check_count(positions.len()).map_err(errors::invalid)?;
        Ok(Cloud {
            positions,
            attributes: arrays::attributes(columns)?,
            dropped_properties: self.dropped.clone(),
            notes: self.notes.clone(),
            origin: self.whole.clone(),
        })
    }

    /// The options with what is known of the reading.
    pub(crate) fn read_by(&self, options: Options) -> Options {
        Options { reading: self.reading.clone(), ..options }
    }
}

#[pymethods]
impl Origin {
    /// Of arrays: as a file of binary PLY, in 32 bits or in 64.
    #[new]
    fn new(single: bool) -> Self {
        let scalar = if single { Scalar::F32 } else { Scalar::F64 };
        Self::of_result(Format::Ply { encoding: PlyEncoding::BinaryLittleEndian, scalar }, Whole::default())
    }

    /// What is left of it once points were taken out: it is no longer the file's cloud.
    fn changed(&self) -> Self {
        let mut own = self.clone();
        own.whole.sha256 = None;
        own.dropped.extend(own.whole.drop_references());
        own
    }

    /// The same with more that a person should know about how it was read.
    fn noted(&self, notes: Vec<String>) -> Self {
        let mut own = self.clone();
        own.notes.extend(notes);
        own
    }

    #[getter]
    fn format(&self) -> String {
        self.format.to_string()
    }

    #[getter]
    fn crs(&self) -> Option<String> {
        self.whole.crs.as_ref().map(ToString::to_string)
    }

    #[getter]
    fn comments(&self) -> Vec<String> {
        self.whole.comments.clone()
    }

    #[getter]
    fn sensor(&self) -> Option<[f64; 3]> {
        self.whole.sensor
    }

    #[getter]
    fn sha256(&self) -> Option<String> {
        self.whole.sha256.map(hex::encode)
    }

    /// What a person should know about how it was read.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        let (notes, dropped_properties) = (self.notes.clone(), self.dropped.clone());
        Cloud { notes, dropped_properties, ..Cloud::default() }.warnings()
    }
}
