//! Frames in, detections out.

use crate::model::{Model, refused};
use lookout::detector::{Config, Detections, Detector as Core};
use lookout::image::Image;
use lookout::model::calibration::ONE;
use lookout::shell::formats::detections::{Decimal, SCORE_BITS, rect};
use lookout::shell::pipeline::{DetectorArgs, Memory, ModelFile, PipelineError};
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use self_cell::{MutBorrow, self_cell};
use std::sync::{Arc, Mutex, PoisonError};

/// Time from a frame to the next where none is given, microseconds.
const PERIOD_US: i64 = 33_333;

/// A box and its score.
#[pyclass(frozen, get_all, module = "lookout_detector")]
#[derive(Clone)]
pub struct Detection {
    /// Left, top, width, height in pixels.
    r#box: (f64, f64, f64, f64),
    /// Log-odds.
    score: f64,
}

#[pymethods]
impl Detection {
    fn __repr__(&self) -> String {
        let (left, top, width, height) = self.r#box;
        format!("Detection(box=({left}, {top}, {width}, {height}), score={})", self.score)
    }
}

/// What a detector borrows from.
struct Owner {
    model: Arc<ModelFile>,
    memory: MutBorrow<Memory>,
}

type Running<'a> = Core<'a, 'a>;

self_cell!(
    struct Cell {
        owner: Owner,
        #[not_covariant]
        dependent: Running,
    }
);

/// The detector of frames of one size.
struct State {
    cell: Option<(Cell, (usize, usize))>,
    last_us: Option<i64>,
}

/// Finds flying objects in the frames of one moving camera.
#[pyclass(frozen, module = "lookout_detector")]
pub struct Detector {
    model: Model,
    args: DetectorArgs,
    state: Mutex<State>,
}

#[pymethods]
impl Detector {
    #[new]
    #[pyo3(signature = (model = None, *, threshold = None, min_precision = 0.9))]
    fn new(
        model: Option<&Model>,
        threshold: Option<f64>,
        min_precision: Option<f64>,
    ) -> PyResult<Self> {
        let model = model.cloned().map_or_else(Model::shipped, Ok)?;
        let mut args = DetectorArgs::default();
        match (threshold, min_precision) {
            (Some(score), _) if score.is_finite() => {
                args.threshold = Some((score * f64::from(1 << SCORE_BITS)).round() as i32);
            }
            (None, Some(precision)) if precision > 0.0 && precision <= 1.0 => {
                args.min_precision = Some((precision * f64::from(ONE)) as u32);
            }
            (None, None) => {}
            _ => {
                let reason = "threshold is a finite score, min_precision above 0 and at most 1";
                return Err(PyValueError::new_err(reason));
            }
        }
        let parsed = model.file().parse().map_err(refused)?;
        args.least_score(&parsed).map_err(refused)?;
        let state = Mutex::new(State { cell: None, last_us: None });
        Ok(Self { model, args, state })
    }

    /// The model in use.
    #[getter]
    fn model(&self) -> Model {
        self.model.clone()
    }

    /// Bytes of the detector's memory; 0 before the first frame, whose size it depends on.
    #[getter]
    fn memory(&self) -> usize {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let Some((_, (width, height))) = &state.cell else { return 0 };
        let config = self.config((*width, *height));
        config.map_or(0, |config| Memory::new(&config).len_bytes())
    }

    #[pyo3(signature = (frame, time_us = None))]
    fn process(
        &self,
        py: Python<'_>,
        frame: &Bound<'_, PyAny>,
        time_us: Option<i64>,
    ) -> PyResult<Vec<Detection>> {
        let frame: PyReadonlyArray2<'_, u8> = frame.extract().map_err(|_| {
            let given = frame.get_type();
            PyTypeError::new_err(format!(
                "expected a grey frame, a numpy array of shape (height, width) and dtype uint8, not {given}; \
                 colours become grey by cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)"
            ))
        })?;
        let [height, width] = [0, 1].map(|axis| frame.as_array().shape()[axis]);
        let copy: Vec<u8>;
        // A slice is there for columns one behind the other too.
        let rows = frame.as_slice().ok().filter(|_| frame.is_c_contiguous());
        let pixels = match rows {
            Some(pixels) => pixels,
            None => {
                copy = frame.as_array().iter().copied().collect();
                &copy
            }
        };
        py.detach(|| self.find(pixels, (width, height), time_us))
    }

    /// Begins anew, as with the first frame of another flight.
    fn reset(&self) {
        *self.state.lock().unwrap_or_else(PoisonError::into_inner) =
            State { cell: None, last_us: None };
    }
}

impl Detector {
    fn config(&self, (width, height): (usize, usize)) -> Result<Config, PipelineError> {
        let model = self.model.file().parse()?;
        self.args.config(&model, width, height)
    }

    fn start(&self, size: (usize, usize)) -> PyResult<Cell> {
        let config = self.config(size).map_err(refused)?;
        let memory = MutBorrow::new(Memory::new(&config));
        Cell::try_new(Owner { model: Arc::clone(self.model.file()), memory }, |owner| {
            let model = owner.model.parse().map_err(refused)?;
            let memory = owner.memory.borrow_mut();
            memory.detector(&model, config).map_err(|e| PyValueError::new_err(e.to_string()))
        })
    }

    fn find(
        &self,
        pixels: &[u8],
        size: (usize, usize),
        time_us: Option<i64>,
    ) -> PyResult<Vec<Detection>> {
        if pixels.is_empty() {
            return Err(PyValueError::new_err("a frame without pixels"));
        }
        let value = |error: &dyn std::fmt::Display| PyValueError::new_err(error.to_string());
        let frame = Image::packed(pixels, size.0, size.1).map_err(|e| value(&e))?;
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let State { cell, last_us } = &mut *state;
        let next = last_us.map_or(0, |last| last.saturating_add(PERIOD_US));
        let time_us = time_us.unwrap_or(next);
        if cell.is_none() {
            *cell = Some((self.start(size)?, size));
        }
        let Some((running, known)) = cell else { return Ok(Vec::new()) };
        if *known != size {
            let (width, height) = *known;
            let reason = format!(
                "a frame of {}x{} after frames of {width}x{height}; call reset(), or make a detector for each camera",
                size.0, size.1
            );
            return Err(PyValueError::new_err(reason));
        }
        let mut found = Detections::default();
        let processed =
            running.with_dependent_mut(|_, core| core.process(frame, time_us, &mut found));
        processed.map_err(|e| value(&e))?;
        *last_us = Some(time_us);
        let list = found.list.iter().map(|detection| {
            let [left, top, width, height] = rect(detection).map(Decimal::to_f64);
            let score = Decimal::score(detection.score).to_f64();
            Detection { r#box: (left, top, width, height), score }
        });
        Ok(list.collect())
    }
}
