//! Reasons why a text is no calibration.

use crate::camera::CameraError;
use std::string::String;

/// Why a text is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// Not YAML (JSON is).
    #[error("not YAML or JSON: {0}")]
    Syntax(#[from] serde_yaml_ng::Error),
    /// A field that every form has.
    #[error("{field} is missing; known names: {names}")]
    Missing {
        /// Name of the field at fault.
        field: &'static str,
        /// Names under which it is known.
        names: &'static str,
    },
    /// A field of another shape.
    #[error("{field}: expected {expected}")]
    Shape {
        /// Its name in the file.
        field: String,
        /// The expected form.
        expected: &'static str,
    },
    /// A matrix whose numbers are not as many as it says.
    #[error("{field}: {rows}x{cols}, but {given} numbers")]
    Count {
        /// Its name in the file.
        field: String,
        /// Rows that it says.
        rows: u64,
        /// Columns that it says.
        cols: u64,
        /// Numbers that it has.
        given: usize,
    },
    /// Two names for one thing, and two values.
    #[error("{first} and {second} say different things; keep the right one")]
    Contradiction {
        /// Name of one field.
        first: String,
        /// Name of the other field.
        second: String,
    },
    /// A lens model or projection that is not understood.
    #[error(
        "{field}: '{model}' is not supported, expected plumb_bob, rational_polynomial, radtan, fisheye, equidistant or none"
    )]
    Model {
        /// Its name in the file.
        field: String,
        /// Distortion model that the file names.
        model: String,
    },
    /// A number of coefficients that the model does not have.
    #[error("distortion: {count} coefficients, but {model} has {expected}")]
    Coefficients {
        /// Number of coefficients in the file.
        count: usize,
        /// Distortion model of the file.
        model: &'static str,
        /// Its numbers of coefficients.
        expected: &'static str,
    },
    /// A camera matrix with skew.
    #[error("camera matrix: a skew of {0} is not supported, expected 0")]
    Skew(f64),
    /// The zeros that an uncalibrated driver publishes.
    #[error("camera matrix: all zeros, the camera is not calibrated; run the calibration first")]
    Uncalibrated,
    /// Several cameras in one file.
    #[error("several cameras ({0}); keep the one that lookout uses")]
    Several(String),
    /// A picture that is a part of the sensor's or has merged pixels.
    #[error(
        "{0}: cut or binned pictures are not supported; calibrate with the pictures that lookout gets"
    )]
    Binned(&'static str),
    /// A number that does not fit.
    #[error("{name}: {value} is out of range")]
    Range {
        /// Name of the field at fault.
        name: &'static str,
        /// Number that is out of range.
        value: f64,
    },
    /// Values out of a camera's range.
    #[error(transparent)]
    Camera(#[from] CameraError),
}
