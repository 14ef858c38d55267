//! Calibrations as people's tools write them: OpenCV (`FileStorage` YAML, Python's `yaml` and `json`), ROS 1 and 2 (files of
//! `camera_calibration`, `rostopic echo`, `ros2 topic echo`), Kalibr.
//!
//! One reader for all: names are compared without case, `_` and `-`, the matrix may be a list, a list of lists or a table
//! with `rows`, `cols` and `data`. What a name or a number means is never guessed: an unknown model, a number of coefficients
//! that no model has, two values that contradict each other and a picture that was cut or binned are errors.

use crate::camera::{Camera, CameraError, Intrinsics, Lens};
use crate::math::real::{Real, ZERO};
use serde_yaml_ng::Value;
use std::borrow::ToOwned;
use std::string::String;
use std::vec::Vec;

/// Why a text is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// Not YAML (JSON is).
    #[error("not YAML or JSON: {0}")]
    Syntax(#[from] serde_yaml_ng::Error),
    /// A field that every form has.
    #[error("{field} is missing; known names: {names}")]
    Missing {
        /// What it is.
        field: &'static str,
        /// Names under which it is known.
        names: &'static str,
    },
    /// A field of another shape.
    #[error("{field}: expected {expected}")]
    Shape {
        /// Its name in the file.
        field: String,
        /// What belongs there.
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
        /// A name.
        first: String,
        /// Another one.
        second: String,
    },
    /// A lens model or projection that is not understood.
    #[error(
        "{field}: '{model}' is not supported, expected plumb_bob, rational_polynomial, radtan, fisheye, equidistant or none"
    )]
    Model {
        /// Its name in the file.
        field: String,
        /// What it says.
        model: String,
    },
    /// A number of coefficients that the model does not have.
    #[error("distortion: {count} coefficients, but {model} has {expected}")]
    Coefficients {
        /// Of the file.
        count: usize,
        /// The model.
        model: &'static str,
        /// How many it has.
        expected: &'static str,
    },
    /// Skewed pixels.
    #[error("camera matrix: a skew of {0} is not supported, expected 0")]
    Skew(f64),
    /// What an uncalibrated driver publishes.
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
        /// The field.
        name: &'static str,
        /// The number.
        value: f64,
    },
    /// Numbers that make no camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
}

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
    let fields = Fields::of(&document(text)?)?;
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

/// The first document of a YAML text, less what OpenCV and `rostopic` write that is not YAML.
fn document(text: &str) -> Result<Value, CalibrationError> {
    let text = text.trim_start_matches('\u{feff}').trim_start();
    // OpenCV begins with a directive that YAML does not know; it and YAML's own are lines of their own.
    let text = match text.strip_prefix("%YAML") {
        Some(rest) => rest.split_once('\n').map_or("", |(_, body)| body),
        None => text,
    };
    let text = text.replace("!!opencv-matrix", "");
    let mut documents = serde_yaml_ng::Deserializer::from_str(&text);
    let first = documents.next().map(serde::Deserialize::deserialize);
    Ok(first.transpose()?.unwrap_or(Value::Null))
}

/// The fields of the one camera in a file.
#[derive(Debug)]
struct Fields {
    /// Name as written, name as compared, value.
    entries: Vec<(String, String, Value)>,
}

impl Fields {
    fn of(value: &Value) -> Result<Self, CalibrationError> {
        let fields = Self::list(value);
        // Kalibr has a table for each camera.
        let cameras: Vec<_> = fields
            .entries
            .iter()
            .filter(|(_, name, value)| {
                name.strip_prefix("cam").is_some_and(|n| n.parse::<u8>().is_ok())
                    && value.is_mapping()
            })
            .collect();
        match cameras.as_slice() {
            [] => Ok(fields),
            [(_, _, camera)] => Ok(Self::list(camera)),
            several => {
                let names: Vec<&str> = several.iter().map(|(name, ..)| name.as_str()).collect();
                Err(CalibrationError::Several(names.join(", ")))
            }
        }
    }

    fn list(value: &Value) -> Self {
        let entries = value.as_mapping().into_iter().flatten().filter_map(|(name, value)| {
            let name = name.as_str()?;
            let compared: String =
                name.chars().filter(|c| c.is_ascii_alphanumeric()).collect::<String>();
            Some((name.to_owned(), compared.to_ascii_lowercase(), value.clone()))
        });
        Self { entries: entries.collect() }
    }

    /// The one entry under these names; several must be equal.
    fn get(&self, names: &[&str]) -> Result<Option<(&str, &Value)>, CalibrationError> {
        let mut found: Option<(&str, &Value)> = None;
        for (name, compared, value) in &self.entries {
            if !names.contains(&compared.as_str()) {
                continue;
            }
            match found {
                Some((first, other)) if other != value => {
                    let (first, second) = (first.to_owned(), name.clone());
                    return Err(CalibrationError::Contradiction { first, second });
                }
                _ => found = Some((name, value)),
            }
        }
        Ok(found)
    }

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
            (Some((_, Value::Null)), _) | (None, Some(Model::None)) => Vec::new(),
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
            all[..reals.len()].copy_from_slice(&reals);
            Ok(Lens::Polynomial(all))
        };
        match model {
            Some(Model::Fisheye) => fisheye(),
            // OpenCV names no model in its own files, and both of its models may have four.
            None if reals.len() == 4 => Err(CalibrationError::Coefficients {
                count: 4,
                model: "a file that names no model",
                expected: "5 or more; say which: distortion_model: plumb_bob (k1, k2, p1, p2) or fisheye (k1, k2, k3, k4)",
            }),
            Some(Model::Polynomial) | None => polynomial(),
            // A driver without a model says so with zeros.
            Some(Model::None) if reals.iter().all(|k| *k == ZERO) => Ok(Lens::PINHOLE),
            Some(Model::None) => Err(CalibrationError::Coefficients {
                count: reals.len(),
                model: "no model",
                expected: "none but zeros; name the model as distortion_model",
            }),
        }
    }

    /// What all fields that name a model agree on; `None` where there is no such field.
    fn model(&self) -> Result<Option<Model>, CalibrationError> {
        let mut found: Option<(&str, Model)> = None;
        for (name, compared, value) in &self.entries {
            let model = if MODEL.contains(&compared.as_str()) {
                let text = match value {
                    Value::Null => "",
                    other => other.as_str().unwrap_or("?"),
                };
                match text.to_ascii_lowercase().as_str() {
                    "plumb_bob" | "rational_polynomial" | "radtan" | "opencv" => Model::Polynomial,
                    "fisheye" | "equidistant" | "opencv_fisheye" | "kannala_brandt" => {
                        Model::Fisheye
                    }
                    "none" | "" => Model::None,
                    // The projection; the distortion has a field of its own.
                    "pinhole" => continue,
                    _ => {
                        let (field, model) = (name.clone(), text.to_owned());
                        return Err(CalibrationError::Model { field, model });
                    }
                }
            } else if ["fisheyemodel", "fisheye", "isfisheye"].contains(&compared.as_str()) {
                match value {
                    Value::Bool(true) => Model::Fisheye,
                    Value::Number(number) if number.as_u64() == Some(1) => Model::Fisheye,
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
enum Model {
    Polynomial,
    Fisheye,
    None,
}

/// The numbers of a list, a list of lists, or a table with `data`.
fn numbers(name: &str, value: &Value) -> Result<Vec<f64>, CalibrationError> {
    let shape =
        || CalibrationError::Shape { field: name.to_owned(), expected: "a list of numbers" };
    if value.is_mapping() {
        let side =
            |key: &str| value.get(key).map(|side| side.as_u64().ok_or_else(shape)).transpose();
        let numbers = numbers(name, value.get("data").ok_or_else(shape)?)?;
        if let (Some(rows), Some(cols)) = (side("rows")?, side("cols")?)
            && rows.checked_mul(cols) != Some(numbers.len() as u64)
        {
            let (field, given) = (name.to_owned(), numbers.len());
            return Err(CalibrationError::Count { field, rows, cols, given });
        }
        return Ok(numbers);
    }
    let mut list = Vec::new();
    for item in value.as_sequence().ok_or_else(shape)? {
        match item {
            Value::Sequence(row) => {
                for number in row {
                    list.push(number.as_f64().ok_or_else(shape)?);
                }
            }
            number => list.push(number.as_f64().ok_or_else(shape)?),
        }
    }
    Ok(list)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::format;
    use std::string::ToString;
    use std::vec;

    /// A ROS file.
    fn ros(model: &str, coefficients: &str) -> String {
        format!(
            "image_width: 320\nimage_height: 256\ncamera_name: narrow\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: [300.0, \
             0, 160.0, 0, 310.0, 128.0, 0, 0, 1]\n{model}\ndistortion_coefficients:\n  rows: 1\n  cols: {}\n  data: \
             [{coefficients}]\nprojection_matrix: {{rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}}\n",
            coefficients.split(',').filter(|text| !text.trim().is_empty()).count(),
        )
    }

    fn polynomial(k: &[f64]) -> Lens {
        let mut all = [ZERO; 14];
        for (to, from) in all.iter_mut().zip(k) {
            *to = Real::from_num(*from);
        }
        Lens::Polynomial(all)
    }

    const FIVE: &str = "-0.3, 0.1, 0.001, -0.002, 0.0";
    const FOUR: &str = "-0.02, 0.01, -0.005, 0.001";

    #[test]
    fn models_under_all_their_names() {
        let five = polynomial(&[-0.3, 0.1, 0.001, -0.002]);
        let fisheye = Lens::Fisheye([-0.02, 0.01, -0.005, 0.001].map(Real::from_num));
        let many =
            [0.5, -0.2, 0.001, -0.002, 0.05, 0.8, -0.1, 0.03, 0.01, 0.0, 0.01, 0.0, 0.02, 0.03];
        let list = |count| many[..count].iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
        for (model, coefficients, lens) in [
            ("distortion_model: plumb_bob", FIVE.to_owned(), five),
            ("distortion_model: plumb_bob", "-0.3, 0.1, 0.001, -0.002".into(), five),
            ("distortion_model: plumb_bob", format!("{FIVE}, 0.0, 0.0, 0.0"), five),
            ("camera_model: plumb_bob", FIVE.into(), five),
            ("flags: 0", FIVE.into(), five),
            ("distortion_model: rational_polynomial", list(8), polynomial(&many[..8])),
            ("distortion_model: rational_polynomial", list(12), polynomial(&many[..12])),
            ("flags: 0", list(14), polynomial(&many)),
            ("distortion_model: fisheye", FOUR.into(), fisheye),
            ("distortion_model: equidistant", FOUR.into(), fisheye),
            ("camera_model: fisheye", FOUR.into(), fisheye),
            ("fisheye_model: 1", FOUR.into(), fisheye),
            ("camera_model: pinhole\ndistortion_model: equidistant", FOUR.into(), fisheye),
            ("distortion_model: none", String::new(), Lens::PINHOLE),
            ("distortion_model: \"\"", "0.0, 0.0, 0.0, 0.0, 0.0".into(), Lens::PINHOLE),
        ] {
            let camera =
                parse(&ros(model, &coefficients)).unwrap_or_else(|e| panic!("{model}: {e}"));
            assert_eq!(camera.intrinsics().lens, lens, "{model}");
            assert_eq!(camera.intrinsics().focal, [300, 310].map(Real::from_num));
        }
    }

    #[test]
    fn forms_of_many_tools() {
        let wanted = parse(&ros("distortion_model: plumb_bob", FIVE)).unwrap();
        let k = "[300.0, 0.0, 160.0, 0.0, 310.0, 128.0, 0.0, 0.0, 1.0]";
        let rows = "[[300.0, 0.0, 160.0], [0.0, 310.0, 128.0], [0.0, 0.0, 1.0]]";
        let opencv = |matrix: &str, distortion: &str| {
            format!(
                "image_width: 320\nimage_height: 256\nboard_width: 9\n{matrix}: !!opencv-matrix\n   rows: 3\n   cols: 3\n   \
                 dt: d\n   data: [ 3.0e+02, 0., 160., 0., 310.,\n       128., 0., 0., 1. ]\n{distortion}: !!opencv-matrix\n   \
                 rows: 5\n   cols: 1\n   dt: d\n   data: [ -0.3, 0.1, 1.0e-3, -2.0e-3, 0. ]\n"
            )
        };
        let mut texts = vec![
            format!("\u{feff}{}", ros("distortion_model: plumb_bob", FIVE)),
            ros("distortion_model: plumb_bob", FIVE).replace('\n', "\r\n"),
            // rostopic echo and ros2 topic echo.
            format!("height: 256\nwidth: 320\ndistortion_model: \"plumb_bob\"\nD: [{FIVE}]\nK: {k}\nbinning_x: 0\n"),
            format!(
                "header:\n  frame_id: camera\nheight: 256\nwidth: 320\ndistortion_model: plumb_bob\nd:\n- -0.3\n- 0.1\n- \
                 0.001\n- -0.002\n- 0.0\nk: {k}\nbinning_x: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  \
                 do_rectify: false\n---\nheight: 1\n"
            ),
            // Kalibr.
            "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [-0.3, 0.1, 0.001, -0.002]\n  distortion_model: radtan\n  \
             intrinsics: [300.0, 310.0, 160.0, 128.0]\n  resolution: [320, 256]\n  rostopic: /cam0/image_raw\n"
                .to_owned(),
            // Python's yaml and json of numpy's lists.
            format!("{{\"camera_matrix\": {rows}, \"dist_coeff\": [[{FIVE}]], \"image_size\": [320, 256]}}"),
            format!("mtx: {rows}\ndist: [[{FIVE}]]\nwidth: 320\nheight: 256\n"),
        ];
        for (matrix, distortion) in [
            ("camera_matrix", "distortion_coefficients"),
            ("Camera_Matrix", "Distortion_Coefficients"),
            ("cameraMatrix", "distCoeffs"),
            ("K", "D"),
            ("mtx", "dist"),
        ] {
            texts.push(format!("%YAML:1.0\n---\n{}", opencv(matrix, distortion)));
            texts.push(format!("%YAML 1.2\n---\n{}", opencv(matrix, distortion)));
            texts.push(opencv(matrix, distortion));
        }
        for text in texts {
            assert_eq!(parse(&text).unwrap_or_else(|e| panic!("{text}: {e}")), wanted, "{text}");
        }
    }

    #[test]
    fn what_is_not_understood_is_refused() {
        let good = ros("distortion_model: plumb_bob", FIVE);
        let fisheye = ros("distortion_model: fisheye", FOUR);
        for (text, wanted) in [
            (
                ros("distortion_model: thin_prism_fisheye", FOUR),
                "'thin_prism_fisheye' is not supported",
            ),
            (ros("camera_model: omni", FOUR), "camera_model: 'omni' is not supported"),
            (ros("distortion_model: 3", FOUR), "distortion_model: '?' is not supported"),
            (ros("distortion_model: fisheye", FIVE), "5 coefficients, but a fisheye has 4"),
            (
                ros("distortion_model: plumb_bob", "1, 2, 3"),
                "3 coefficients, but a polynomial lens has",
            ),
            (ros("flags: 0", FOUR), "4 coefficients, but a file that names no model has 5 or more"),
            (ros("distortion_model: ''", FIVE), "5 coefficients, but no model has none but zeros"),
            (
                ros("distortion_model: plumb_bob\ncamera_model: fisheye", FOUR),
                "say different things",
            ),
            (ros("distortion_model: plumb_bob\nfisheye_model: 1", FOUR), "say different things"),
            (ros("fisheye_model: yes please", FOUR), "fisheye_model: expected 0 or 1"),
            (good.replace("image_width: 320\n", ""), "image_width is missing"),
            (good.replace("rows: 3\n", "rows: 2\n"), "camera_matrix: 2x3, but 9 numbers"),
            (good.replace("300.0, 0,", "300.0, 1,"), "skew of 1"),
            (good.replace("300.0", ".nan"), "fx: NaN is out of range"),
            (good.replace("300.0", "0.5"), "focal length"),
            (good.replace("160.0", "1e4"), "optical axis"),
            (
                good.replace(
                    "[300.0, 0, 160.0, 0, 310.0, 128.0, 0, 0, 1]",
                    "[0, 0, 0, 0, 0, 0, 0, 0, 1]",
                ),
                "not calibrated",
            ),
            (good.replace("-0.3", "x"), "distortion_coefficients: expected a list"),
            (
                good.replace("distortion_coefficients", "my_coefficients"),
                "distortion_coefficients is missing",
            ),
            (good.replace("camera_matrix", "my_matrix"), "camera_matrix is missing; known names"),
            (
                format!("{good}K: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"),
                "camera_matrix and K say different",
            ),
            (format!("{fisheye}binning_x: 2\n"), "binning_x: cut or binned"),
            (
                format!("{fisheye}roi: {{x_offset: 8, y_offset: 0, height: 256, width: 200}}\n"),
                "roi: cut",
            ),
            ("cam0: {a: 1}\ncam1: {a: 1}\n".into(), "several cameras (cam0, cam1)"),
            ("a: [1".into(), "not YAML or JSON"),
            (String::new(), "image_width is missing"),
            ("5".into(), "image_width is missing"),
        ] {
            let error = parse(&text).map(drop).unwrap_err().to_string();
            assert!(error.contains(wanted), "{wanted}: {error}");
        }
        let whole = format!("{good}roi: {{x_offset: 0, y_offset: 0, height: 256, width: 320}}\n");
        assert!(parse(&whole).is_ok());
    }
}
