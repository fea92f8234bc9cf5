//! The Python module `tirante._core`: the library with arrays of NumPy in and out. The package around it, with data
//! frames and documentation for its users, is in `python/tirante`.
//!
//! Numbers are those of the program, to the bit: everything here calls what the commands call.

mod event;
mod outcome;
mod signal;
mod site;
mod tracker;

/// The compiled part of the package `tirante`.
#[pyo3::pymodule]
mod _core {
    #[pymodule_export]
    use super::event::{Event, Records};
    #[pymodule_export]
    use super::outcome::Outcome;
    #[pymodule_export]
    use super::signal::{resonances, welch};
    #[pymodule_export]
    use super::site::Site;
    #[pymodule_export]
    use super::tracker::Tracker;
}

use numpy::{PyArray, PyArray1, PyArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A `ValueError` with the sentence of an error of the library.
fn refused(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// An array that takes over the memory of `values`, not to be written to: what hands it out keeps it.
fn kept<'py>(py: Python<'py>, values: Vec<f64>) -> PyResult<Bound<'py, PyArray1<f64>>> {
    locked(PyArray::from_vec(py, values))
}

/// The array, not to be written to.
fn locked<'py, D: numpy::ndarray::Dimension>(
    array: Bound<'py, PyArray<f64, D>>,
) -> PyResult<Bound<'py, PyArray<f64, D>>> {
    let flags = array.getattr("flags")?;
    flags.setattr("writeable", false)?;
    Ok(array)
}

/// Rows of `width` columns out of one vector.
fn table<'py>(py: Python<'py>, values: Vec<f64>, width: usize) -> PyResult<Bound<'py, numpy::PyArray2<f64>>> {
    let rows = values.len() / width.max(1);
    locked(PyArray::from_vec(py, values).reshape([rows, width])?)
}
