//! A model file.

use lookout::model::Model as Parsed;
use lookout::model::calibration::ONE;
use lookout::shell::formats::detections::Decimal;
use lookout::shell::pipeline::{ModelFile, PipelineError};
use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;

/// A model: the one in the program, or a file that `lookout train` wrote.
#[pyclass(frozen, module = "lookout_detector")]
#[derive(Clone)]
pub struct Model {
    file: Arc<ModelFile>,
}

/// The exception for an error of the program's.
pub fn refused(error: PipelineError) -> PyErr {
    match error {
        PipelineError::File(_) => PyOSError::new_err(error.to_string()),
        _ => PyValueError::new_err(error.to_string()),
    }
}

impl Model {
    /// The shipped one.
    pub fn shipped() -> PyResult<Self> {
        Self::new(None)
    }

    /// The file, which was parsed before.
    pub fn file(&self) -> &Arc<ModelFile> {
        &self.file
    }

    fn parsed(&self) -> PyResult<Parsed<'_>> {
        self.file.parse().map_err(refused)
    }
}

#[pymethods]
impl Model {
    #[new]
    #[pyo3(signature = (path = None))]
    fn new(path: Option<PathBuf>) -> PyResult<Self> {
        let file = ModelFile::load(path.as_deref()).map_err(refused)?;
        file.parse().map_err(refused)?;
        Ok(Self { file: Arc::new(file) })
    }

    /// CRC-32, as the model's card has it.
    #[getter]
    fn checksum(&self) -> u32 {
        self.file.checksum()
    }

    /// The settings that it was trained with, as JSON.
    #[getter]
    fn provenance(&self) -> PyResult<String> {
        Ok(self.parsed()?.provenance().to_owned())
    }

    /// Scores and the precision measured for detections of that score or more, by score.
    #[getter]
    fn precisions(&self) -> PyResult<Vec<(f64, f64)>> {
        let knots = self.parsed()?.calibration().knots();
        let pair = |score, precision: u32| {
            (Decimal::score(score).to_f64(), f64::from(precision) / f64::from(ONE))
        };
        Ok(knots.map(|knot| pair(knot.score, knot.precision)).collect())
    }

    fn __repr__(&self) -> String {
        format!("Model(checksum=0x{:08x}, bytes={})", self.file.checksum(), self.file.bytes().len())
    }
}
