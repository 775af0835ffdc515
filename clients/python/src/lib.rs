//! The module `haptic_bridge._native`, whose classes and functions the Python package `haptic_bridge` exports.
//! `haptic_bridge/_native.pyi` has the types of arguments and results.
#![forbid(unsafe_code)]

mod arrays;
mod board;
mod device;
mod errors;
mod measure;
mod recording;
mod simulation;

use pyo3::prelude::*;

/// The exports of `haptic_bridge`.
#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("HapticError", py.get_type::<errors::HapticError>())?;
    module.add("RequestError", py.get_type::<errors::RequestError>())?;
    module.add("ImpossibleError", py.get_type::<errors::ImpossibleError>())?;
    module.add("LinkError", py.get_type::<errors::LinkError>())?;
    module.add("UnansweredError", py.get_type::<errors::UnansweredError>())?;
    module.add("RefusedError", py.get_type::<errors::RefusedError>())?;
    module.add_class::<device::PyDevice>()?;
    module.add_class::<device::Scene>()?;
    module.add_class::<simulation::Simulation>()?;
    module.add_class::<board::Board>()?;
    module.add_class::<board::State>()?;
    module.add_class::<recording::Recording>()?;
    module.add_function(wrap_pyfunction!(measure::measure_range, module)?)?;
    module.add_function(wrap_pyfunction!(board::boards, module)?)?;
    module.add_function(wrap_pyfunction!(recording::read_recording, module)?)
}
