//! Calibrations as people's tools write them: OpenCV (`FileStorage` YAML, Python's `yaml` and `json`), ROS 1 and 2 (files of
//! `camera_calibration`, `rostopic echo`, `ros2 topic echo`), Kalibr.
//!
//! One reader for all: names are compared without case, `_` and `-`, the matrix may be a list, a list of lists or a table
//! with `rows`, `cols` and `data`. Nothing is guessed: an unknown model, a number of coefficients that no model has, two
//! values that contradict each other and a picture that was cut or binned are errors.

mod error;
mod fields;
#[cfg(test)]
mod tests;

pub use error::CalibrationError;

use crate::camera::{Camera, Intrinsics, Lens};
use crate::math::real::{Real, ZERO};
use fields::{CameraFields, document, numbers};
use serde_yaml_ng::Value;
use std::borrow::ToOwned;
use std::string::String;
use std::vec::Vec;

const MATRIX: &[&str] = &["cameramatrix", "k", "mtx", "intrinsicmatrix"];
const COEFFICIENTS: &[&str] = &[
    "distortioncoefficients",
    "distortioncoeffs",
    "distcoeffs",
    "distcoeff",
    "distcoefs",
    "distortion",
    "dist",
    "d",
];
const WIDTH: &[&str] = &["imagewidth", "width"];
const HEIGHT: &[&str] = &["imageheight", "height"];
const SIZE: &[&str] = &["resolution", "imagesize"];
const MODEL: &[&str] = &["distortionmodel", "cameramodel", "model"];

/// Reads a calibration.
///
/// # Errors
/// [`CalibrationError`].
pub fn parse(text: &str) -> Result<Camera, CalibrationError> {
    let fields = CameraFields::of(&document(text)?)?;
    fields.refuse_cut()?;
    let (width, height) = fields.size()?;
    let [fx, fy, cx, cy] = fields.pinhole()?;
    let lens = fields.lens()?;
    let number = |name, value: f64| real(name, value);
    Ok(Camera::new(Intrinsics {
        width,
        height,
        focal: [number("fx", fx)?, number("fy", fy)?],
        centre: [number("cx", cx)?, number("cy", cy)?],
        lens,
    })?)
}

/// A number that fits, in fixed point.
fn real(name: &'static str, value: f64) -> Result<Real, CalibrationError> {
    if value.is_finite() && value.abs() < 1e9 {
        Ok(Real::from_num(value))
    } else {
        Err(CalibrationError::Range { name, value })
    }
}

impl CameraFields {
    fn size(&self) -> Result<(u32, u32), CalibrationError> {
        let side = |(name, value): (&str, &Value)| {
            let side = value.as_u64().and_then(|side| u32::try_from(side).ok());
            side.ok_or_else(|| CalibrationError::Shape {
                field: name.to_owned(),
                expected: "a whole number of pixels",
            })
        };
        let missing = |field| CalibrationError::Missing {
            field,
            names: "image_width and image_height, width and height, resolution",
        };
        if let Some((name, value)) = self.get(SIZE)? {
            let Some([width, height]) = value.as_sequence().map(Vec::as_slice) else {
                let (field, expected) = (name.to_owned(), "[width, height]");
                return Err(CalibrationError::Shape { field, expected });
            };
            return Ok((side((name, width))?, side((name, height))?));
        }
        let width = self.get(WIDTH)?.ok_or_else(|| missing("image_width"))?;
        let height = self.get(HEIGHT)?.ok_or_else(|| missing("image_height"))?;
        Ok((side(width)?, side(height)?))
    }

    /// fx, fy, cx, cy.
    fn pinhole(&self) -> Result<[f64; 4], CalibrationError> {
        if let Some((name, value)) = self.get(&["intrinsics"])? {
            let numbers = numbers(name, value)?;
            let four = <[f64; 4]>::try_from(numbers.as_slice());
            return four.map_err(|_| CalibrationError::Shape {
                field: name.to_owned(),
                expected: "[fx, fy, cx, cy]",
            });
        }
        let (name, value) = self.get(MATRIX)?.ok_or(CalibrationError::Missing {
            field: "camera_matrix",
            names: "camera_matrix, K, mtx, intrinsics",
        })?;
        let numbers = numbers(name, value)?;
        if numbers.iter().take(8).all(|number| *number == 0.0) {
            return Err(CalibrationError::Uncalibrated);
        }
        match numbers.as_slice() {
            &[fx, skew, cx, zero, fy, cy, a, b, one]
                if [zero, a, b, one] == [0.0, 0.0, 0.0, 1.0] =>
            {
                if skew == 0.0 {
                    Ok([fx, fy, cx, cy])
                } else {
                    Err(CalibrationError::Skew(skew))
                }
            }
            _ => Err(CalibrationError::Shape {
                field: name.to_owned(),
                expected: "the nine numbers fx 0 cx, 0 fy cy, 0 0 1",
            }),
        }
    }

    fn lens(&self) -> Result<Lens, CalibrationError> {
        let model = self.model()?;
        let k = match (self.get(COEFFICIENTS)?, model) {
            (Some((_, Value::Null)), _) | (None, Some(DistortionModel::None)) => Vec::new(),
            (Some((name, value)), _) => numbers(name, value)?,
            (None, _) => {
                return Err(CalibrationError::Missing {
                    field: "distortion_coefficients",
                    names: "distortion_coefficients, distortion_coeffs, dist_coeffs, dist, D; a lens without distortion \
                            has distortion_model: none",
                });
            }
        };
        let mut reals = Vec::new();
        for value in &k {
            reals.push(real("distortion", *value)?);
        }
        let fisheye = || match reals.as_slice() {
            &[k1, k2, k3, k4] => Ok(Lens::Fisheye([k1, k2, k3, k4])),
            other => Err(CalibrationError::Coefficients {
                count: other.len(),
                model: "a fisheye",
                expected: "4 (k1, k2, k3, k4)",
            }),
        };
        let polynomial = || {
            if ![0, 4, 5, 8, 12, 14].contains(&reals.len()) {
                return Err(CalibrationError::Coefficients {
                    count: reals.len(),
                    model: "a polynomial lens",
                    expected: "4, 5, 8, 12 or 14 (k1, k2, p1, p2, k3 to k6, s1 to s4, tau_x, tau_y)",
                });
            }
            let mut all = [ZERO; 14];
            all.iter_mut().zip(&reals).for_each(|(to, from)| *to = *from);
            Ok(Lens::Polynomial(all))
        };
        match model {
            Some(DistortionModel::Fisheye) => fisheye(),
            // OpenCV names no model in its own files, and both of its models may have four.
            None if reals.len() == 4 => Err(CalibrationError::Coefficients {
                count: 4,
                model: "a file that names no model",
                expected: "5 or more; say which: distortion_model: plumb_bob (k1, k2, p1, p2) or fisheye (k1, k2, k3, k4)",
            }),
            Some(DistortionModel::Polynomial) | None => polynomial(),
            // A driver without a model says so with zeros.
            Some(DistortionModel::None) if reals.iter().all(|k| *k == ZERO) => Ok(Lens::PINHOLE),
            Some(DistortionModel::None) => Err(CalibrationError::Coefficients {
                count: reals.len(),
                model: "no model",
                expected: "none but zeros; name the model as distortion_model",
            }),
        }
    }

    /// The lens model by all fields that name one; `None` where there is no such field.
    fn model(&self) -> Result<Option<DistortionModel>, CalibrationError> {
        let mut found: Option<(&str, DistortionModel)> = None;
        for (name, compared, value) in &self.entries {
            let model = if MODEL.contains(&compared.as_str()) {
                let text = match value {
                    Value::Null => "",
                    other => other.as_str().unwrap_or("?"),
                };
                match text.to_ascii_lowercase().as_str() {
                    "plumb_bob" | "rational_polynomial" | "radtan" | "opencv" => {
                        DistortionModel::Polynomial
                    }
                    "fisheye" | "equidistant" | "opencv_fisheye" | "kannala_brandt" => {
                        DistortionModel::Fisheye
                    }
                    "none" | "" => DistortionModel::None,
                    // The projection; the distortion has a field of its own.
                    "pinhole" => continue,
                    _ => {
                        let (field, model) = (name.clone(), text.to_owned());
                        return Err(CalibrationError::Model { field, model });
                    }
                }
            } else if ["fisheyemodel", "fisheye", "isfisheye"].contains(&compared.as_str()) {
                match value {
                    Value::Bool(true) => DistortionModel::Fisheye,
                    Value::Number(number) if number.as_u64() == Some(1) => DistortionModel::Fisheye,
                    Value::Bool(false) => continue,
                    Value::Number(number) if number.as_u64() == Some(0) => continue,
                    _ => {
                        let (field, expected) = (name.clone(), "0 or 1");
                        return Err(CalibrationError::Shape { field, expected });
                    }
                }
            } else {
                continue;
            };
            match found {
                Some((first, other)) if other != model => {
                    let (first, second) = (first.to_owned(), name.clone());
                    return Err(CalibrationError::Contradiction { first, second });
                }
                _ => found = Some((name, model)),
            }
        }
        Ok(found.map(|(_, model)| model))
    }

    /// ROS: pictures of which a part is used, or whose pixels are merged, have another camera than the one calibrated.
    fn refuse_cut(&self) -> Result<(), CalibrationError> {
        for (name, names) in [("binning_x", ["binningx"]), ("binning_y", ["binningy"])] {
            if self.get(&names)?.is_some_and(|(_, value)| value.as_u64().is_some_and(|n| n > 1)) {
                return Err(CalibrationError::Binned(name));
            }
        }
        if let Some((_, roi)) = self.get(&["roi"])? {
            let roi = Self::list(roi);
            let used = |(_, name, value): &(String, String, Value)| {
                name != "dorectify" && value.as_f64().is_some_and(|value| value != 0.0)
            };
            let (full_width, full_height) = self.size()?;
            let side = |name| roi.get(&[name]).ok().flatten().and_then(|(_, value)| value.as_u64());
            let whole = [side("xoffset"), side("yoffset")] == [Some(0); 2]
                && [side("width"), side("height")]
                    == [Some(full_width.into()), Some(full_height.into())];
            if roi.entries.iter().any(used) && !whole {
                return Err(CalibrationError::Binned("roi"));
            }
        }
        Ok(())
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum DistortionModel {
    Polynomial,
    Fisheye,
    None,
}
