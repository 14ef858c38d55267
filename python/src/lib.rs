//! The detector and the program as a Python module; what it offers is described in `lookout_detector/_native.pyi`.

mod detector;
mod model;

use pyo3::prelude::*;
use std::ffi::OsString;

/// Runs the program with these words, the first of them its name; gives the exit status.
#[pyfunction]
fn run(py: Python<'_>, words: Vec<OsString>) -> u8 {
    py.detach(|| lookout::shell::program::run(words, None))
}

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<model::Model>()?;
    module.add_class::<detector::Detector>()?;
    module.add_class::<detector::Detection>()?;
    module.add_function(wrap_pyfunction!(run, module)?)
}
