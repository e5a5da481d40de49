//! NumPy's arrays and our columns.

use densecloud_cloud::{Attribute, Position, Values};
use numpy::ndarray::Array2;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use crate::errors;

/// A column as Python has it: its name and its array.
pub(crate) type Column<'py> = (String, Bound<'py, PyAny>);

/// The positions of an array of N x 3 doubles or floats in C's order. Copies.
pub(crate) fn positions(array: &Bound<'_, PyAny>) -> PyResult<Vec<Position>> {
    if let Ok(doubles) = array.extract::<PyReadonlyArray2<'_, f64>>() {
        check_width(doubles.shape())?;
        return Ok(doubles.as_slice()?.as_chunks::<3>().0.to_vec());
    }
    let floats: PyReadonlyArray2<'_, f32> = array.extract()?;
    check_width(floats.shape())?;
    let (rows, _) = floats.as_slice()?.as_chunks::<3>();
    Ok(rows.iter().map(|row| row.map(f64::from)).collect())
}

fn check_width(shape: &[usize]) -> PyResult<()> {
    if shape[1] == 3 { Ok(()) } else { Err(PyTypeError::new_err("points are an array of N x 3")) }
}

/// The attributes of one-dimensional arrays of numbers. Copies.
pub(crate) fn attributes(columns: &[Column<'_>]) -> PyResult<Vec<Attribute>> {
    let attribute = |(name, array): &Column<'_>| Ok(Attribute { name: name.clone(), values: values(array)? });
    columns.iter().map(attribute).collect()
}

fn values(array: &Bound<'_, PyAny>) -> PyResult<Values> {
    macro_rules! each {
        ($($kind:ident $number:ty),*) => {
            $(if let Ok(column) = array.extract::<PyReadonlyArray1<'_, $number>>() {
                return Ok(Values::$kind(column.as_slice()?.to_vec()));
            })*
        };
    }
    each!(I8 i8, U8 u8, I16 i16, U16 u16, I32 i32, U32 u32, I64 i64, U64 u64, F32 f32, F64 f64);
    Err(PyTypeError::new_err("an attribute is a one-dimensional array of numbers"))
}

/// An array of N x 3 doubles. Does not copy.
pub(crate) fn array_of(py: Python<'_>, positions: Vec<Position>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let rows = positions.len();
    let array = Array2::from_shape_vec((rows, 3), positions.into_flattened()).map_err(errors::failed)?;
    Ok(PyArray2::from_owned_array(py, array))
}

/// An array for each attribute. Does not copy.
pub(crate) fn columns_of(py: Python<'_>, attributes: Vec<Attribute>) -> Vec<Column<'_>> {
    attributes.into_iter().map(|Attribute { name, values }| (name, array_of_values(py, values))).collect()
}

fn array_of_values(py: Python<'_>, values: Values) -> Bound<'_, PyAny> {
    densecloud_cloud::each_kind!(values, column => PyArray1::from_vec(py, column).into_any())
}
