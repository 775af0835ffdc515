//! Converts between numpy arrays and Rust numbers.

use crate::errors::RequestError;
use numpy::{IxDyn, PyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Rows of numbers from an array of shape [..., width], where `shape` is the shape without its last dimension.
pub struct Rows {
    pub shape: Vec<usize>,
    pub rows: Vec<Vec<f64>>,
}

/// Reads rows of `width` numbers from anything that numpy can convert.
pub fn rows(what: &str, input: &Bound<'_, PyAny>, width: usize) -> PyResult<Rows> {
    // Requires an aligned array in C order, because an array that was received over a network may be unaligned.
    let array = input.py().import("numpy")?.call_method1("require", (input, "float64", ["C", "A"]))?;
    let array: PyReadonlyArrayDyn<'_, f64> = array.extract()?;
    let shape = array.shape().to_vec();
    match shape.split_last() {
        Some((last, leading)) if *last == width => {
            let flat: Vec<f64> = array.as_array().iter().copied().collect();
            let rows = if width == 0 { Vec::new() } else { flat.chunks(width).map(<[f64]>::to_vec).collect() };
            Ok(Rows { shape: leading.to_vec(), rows })
        }
        _ => Err(RequestError::new_err(format!(
            "{what} has the shape {shape:?}, but its last dimension must be {width}"
        ))),
    }
}

impl Rows {
    /// Returns one row for each of `poses`. A single row applies to all poses.
    pub fn broadcast_to(self, what: &str, poses: &Rows) -> PyResult<Vec<Vec<f64>>> {
        match self.rows.len() {
            1 if self.shape.is_empty() => Ok(vec![self.rows[0].clone(); poses.rows.len()]),
            _ if self.shape == poses.shape => Ok(self.rows),
            _ => Err(RequestError::new_err(format!(
                "{what} has the shape {:?}, but the poses have {:?}; give one, or one for each pose",
                self.shape, poses.shape
            ))),
        }
    }
}

/// Creates an array of this shape, in C order.
pub fn array<'py>(py: Python<'py>, values: Vec<f64>, shape: &[usize]) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    PyArray::from_vec(py, values).reshape(IxDyn(shape))
}

/// Creates an array of one dimension.
pub fn list<'py, T: Copy + Into<f64>>(py: Python<'py>, values: &[T]) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    array(py, values.iter().map(|value| (*value).into()).collect(), &[values.len()])
}
