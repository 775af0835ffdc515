//! Recorded telemetry as arrays.

use crate::arrays::array;
use crate::errors::failure;
use haptic_show::recorder::Recording as HostRecording;
use numpy::PyArrayDyn;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use pyo3::types::{PyIterator, PyList};
use std::path::PathBuf;

/// Rows of telemetry with named columns.
///
/// `recording["tip_x_m"]` is one column, shape (rows,); `recording.data` has all columns, shape (rows, columns). Column
/// names end with their unit. `step` counts control periods since the board started. A state is 0 disarmed, 1 armed, 2
/// checking polarity, 3 fault. `pandas.DataFrame(dict(recording))` converts to pandas.
#[pyclass(frozen, module = "haptic_bridge")]
pub struct Recording {
    pub columns: Vec<String>,
    pub rows: Vec<Vec<f64>>,
    pub about: Vec<String>,
    pub torn: bool,
}

#[pymethods]
impl Recording {
    /// Names of the columns, with units.
    #[getter]
    fn columns(&self) -> Vec<String> {
        self.columns.clone()
    }
    /// All numbers, shape (rows, columns).
    #[getter]
    fn data<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        array(py, self.rows.concat(), &[self.rows.len(), self.columns.len()])
    }
    /// The comment lines of the file.
    #[getter]
    fn about(&self) -> Vec<String> {
        self.about.clone()
    }
    /// True if the file ended within a line, which was skipped.
    #[getter]
    fn torn(&self) -> bool {
        self.torn
    }
    fn __len__(&self) -> usize {
        self.rows.len()
    }
    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let Some(column) = self.columns.iter().position(|column| column == name) else {
            return Err(PyKeyError::new_err(format!("no column {name}; there are {}", self.columns.join(", "))));
        };
        array(py, self.rows.iter().map(|row| row[column]).collect(), &[self.rows.len()])
    }

    /// Names of the columns, for `dict(recording)`.
    fn keys(&self) -> Vec<String> {
        self.columns.clone()
    }
    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyIterator>> {
        PyList::new(py, &self.columns)?.try_iter()
    }
    fn __contains__(&self, name: &str) -> bool {
        self.columns.iter().any(|column| column == name)
    }
    fn __repr__(&self) -> String {
        format!("<Recording: {} rows of {}>", self.rows.len(), self.columns.join(", "))
    }
}

/// Reads a recording of `haptic record`, MCAP or CSV. An incomplete file is read up to its last complete line or chunk,
/// and `torn` is then true.
#[pyfunction]
pub fn read_recording(py: Python<'_>, path: PathBuf) -> PyResult<Recording> {
    let HostRecording { about, columns, rows, torn } = py.detach(|| HostRecording::load(&path)).map_err(failure)?;
    Ok(Recording { columns, rows, about, torn })
}
