//! Camera files: OpenCV and ROS calibrations (YAML), and the flights' own `camera.json`.

use super::error::FormatError;
use crate::camera::attitude::Attitude;
use crate::camera::{Camera, Intrinsics};
use crate::math::real::{PI, Real};
use crate::shell::support::bounded_file;
use crate::shell::support::file_error::FileError;
use serde::{Deserialize, Serialize};
use std::borrow::ToOwned;
use std::format;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

/// Where a camera's numbers are from.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Camera")]
pub struct CameraArgs {
    /// Calibration: OpenCV or ROS YAML, or camera.json; default: that of the simulated flight, else --fov
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Horizontal field of view in degrees where there is no calibration; directions and ranges are rough then
    #[arg(long, value_name = "DEGREES", default_value_t = 60.0)]
    pub fov: f64,
    /// How the camera is turned on the vehicle: roll, pitch, yaw in degrees (nose up, to the right); 0,0,0 looks forward
    #[arg(long, value_name = "ROLL,PITCH,YAW", value_delimiter = ',', allow_hyphen_values = true)]
    pub mounting: Vec<f64>,
}

impl CameraArgs {
    /// The camera for frames of this size; `own` is what the source knows of it.
    ///
    /// # Errors
    /// [`FormatError::Camera`] naming the file and the field, [`FileError::Read`].
    pub fn camera(
        &self,
        width: usize,
        height: usize,
        own: Option<&CameraFile>,
    ) -> Result<Camera, FormatError> {
        let bad = |reason: String| FormatError::Camera { path: "--fov, --mounting".into(), reason };
        let camera = match (&self.camera, own) {
            (Some(path), _) => {
                let camera = read(path)?;
                let spec = camera.intrinsics();
                if (spec.width as usize, spec.height as usize) != (width, height) {
                    let reason = format!(
                        "calibrated at {}x{}, the frames are {width}x{height}; calibrate at their size",
                        spec.width, spec.height
                    );
                    return Err(FormatError::Camera { path: path.clone(), reason });
                }
                camera
            }
            (None, Some(own)) => own.camera().map_err(bad)?,
            (None, None) => {
                let view = number("fov", self.fov).map_err(bad)? * PI / 180;
                Camera::from_field_of_view(width as u32, height as u32, view)
                    .map_err(|e| bad(e.to_string()))?
            }
        };
        let [roll, pitch, yaw] = match self.mounting.as_slice() {
            [] => return Ok(camera),
            [roll, pitch, yaw] => [*roll, *pitch, *yaw],
            other => return Err(bad(format!("--mounting has {} angles, expected 3", other.len()))),
        };
        let mut angles = [Real::ZERO; 3];
        for (angle, degrees) in angles.iter_mut().zip([roll, pitch, yaw]) {
            *angle = number("mounting", degrees).map_err(bad)? * PI / 180;
        }
        let turn = Attitude::from_euler(angles[0], angles[1], angles[2]);
        Ok(camera.mounted(turn.after(Attitude::FORWARD)))
    }
}

/// What `camera.json` says; pixel centres are at whole numbers there.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
pub struct CameraFile {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Focal lengths in pixels.
    pub fx: f64,
    /// See `fx`.
    pub fy: f64,
    /// Optical axis in pixels.
    pub cx: f64,
    /// See `cx`.
    pub cy: f64,
    /// What the other aircraft does, where it is known.
    #[serde(default)]
    pub kind: Option<String>,
}

impl CameraFile {
    /// The one beside a flight's frames: in the clip's folder that `input` is, or in the folder that it lies in. `None` when
    /// there is none.
    ///
    /// # Errors
    /// [`FormatError::Camera`] when there is one that is not understood.
    pub fn beside(input: &Path) -> Result<Option<Self>, FormatError> {
        let folders = [Some(input), input.parent()];
        for folder in folders.into_iter().flatten() {
            let path = folder.join("camera.json");
            if let Ok(text) = bounded_file::read_text(&path) {
                let file = serde_json::from_str(&text);
                return file
                    .map(Some)
                    .map_err(|e| FormatError::Camera { path, reason: e.to_string() });
            }
        }
        Ok(None)
    }

    /// The camera.
    ///
    /// # Errors
    /// The field and what is expected.
    pub fn camera(&self) -> Result<Camera, String> {
        intrinsics(
            (self.width, self.height),
            [("fx", self.fx), ("fy", self.fy), ("cx", self.cx), ("cy", self.cy)],
            &[],
        )
    }
}

/// A matrix as OpenCV (`!!opencv-matrix`) and ROS write it.
#[derive(Debug, Deserialize)]
struct Matrix {
    rows: usize,
    cols: usize,
    data: Vec<f64>,
}

/// An OpenCV or ROS calibration.
#[derive(Debug, Deserialize)]
struct Calibration {
    #[serde(alias = "width")]
    image_width: u32,
    #[serde(alias = "height")]
    image_height: u32,
    #[serde(alias = "Camera_Matrix")]
    camera_matrix: Matrix,
    #[serde(alias = "Distortion_Coefficients", alias = "dist_coeffs")]
    distortion_coefficients: Option<Matrix>,
    distortion_model: Option<String>,
}

/// Reads a camera file.
///
/// # Errors
/// [`FileError::Read`], [`FormatError::Camera`] naming the field.
pub fn read(path: &Path) -> Result<Camera, FormatError> {
    let text = bounded_file::read_text(path).map_err(FileError::read(path))?;
    let json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    let camera = if json { from_json(&text) } else { from_yaml(&text) };
    camera.map_err(|reason| FormatError::Camera { path: path.into(), reason })
}

fn from_json(text: &str) -> Result<Camera, String> {
    serde_json::from_str::<CameraFile>(text).map_err(|e| e.to_string())?.camera()
}

fn from_yaml(text: &str) -> Result<Camera, String> {
    // OpenCV begins with a directive that YAML does not know.
    let text = match text.strip_prefix("%YAML:") {
        Some(rest) => rest.split_once('\n').map_or("", |(_, body)| body),
        None => text,
    };
    let text = text.replace("!!opencv-matrix", "");
    let calibration: Calibration = serde_yaml_ng::from_str(&text).map_err(|e| e.to_string())?;
    let Calibration { image_width, image_height, camera_matrix, .. } = &calibration;
    let plane = |matrix: &Matrix, name: &str| {
        if matrix.rows.checked_mul(matrix.cols) != Some(matrix.data.len()) {
            let (rows, cols, given) = (matrix.rows, matrix.cols, matrix.data.len());
            return Err(format!("{name}: {rows}x{cols}, but {given} numbers"));
        }
        Ok(())
    };
    plane(camera_matrix, "camera_matrix")?;
    let &[fx, skew, cx, _, fy, cy, ..] = camera_matrix.data.as_slice() else {
        return Err("camera_matrix: expected 3x3 numbers".to_owned());
    };
    if skew != 0.0 {
        return Err(format!("camera_matrix: a skew of {skew} is not supported, expected 0"));
    }
    match calibration.distortion_model.as_deref() {
        None | Some("plumb_bob" | "radtan") => {}
        Some(other) => {
            return Err(format!(
                "distortion_model: '{other}' is not supported, expected plumb_bob (k1, k2, p1, p2, k3)"
            ));
        }
    }
    let distortion = match &calibration.distortion_coefficients {
        Some(matrix) => {
            plane(matrix, "distortion_coefficients")?;
            matrix.data.as_slice()
        }
        None => &[],
    };
    let focal = [("fx", fx), ("fy", fy), ("cx", cx), ("cy", cy)];
    intrinsics((*image_width, *image_height), focal, distortion)
}

fn intrinsics(
    (width, height): (u32, u32),
    numbers: [(&str, f64); 4],
    distortion: &[f64],
) -> Result<Camera, String> {
    let mut values = [Real::ZERO; 4];
    for (value, (name, given)) in values.iter_mut().zip(numbers) {
        *value = number(name, given)?;
    }
    let mut coefficients = [Real::ZERO; 5];
    if let Some(more) = distortion.get(5..)
        && more.iter().any(|k| *k != 0.0)
    {
        return Err(format!(
            "distortion_coefficients: {} numbers, expected at most 5 (k1, k2, p1, p2, k3)",
            distortion.len()
        ));
    }
    for (value, given) in coefficients.iter_mut().zip(distortion) {
        *value = number("distortion_coefficients", *given)?;
    }
    let [fx, fy, cx, cy] = values;
    let intrinsics =
        Intrinsics { width, height, focal: [fx, fy], centre: [cx, cy], distortion: coefficients };
    Camera::new(intrinsics).map_err(|e| e.to_string())
}

/// A number that fits, in fixed point.
pub(crate) fn number(name: &str, value: f64) -> Result<Real, String> {
    if value.is_finite() && value.abs() < 1e9 {
        Ok(Real::from_num(value))
    } else {
        Err(format!("{name}: {value} is out of range"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fixed::types::I28F4;
    use std::fs;

    const ROS: &str = "image_width: 640\nimage_height: 480\ncamera_name: narrow\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
        data: [560.5, 0, 319.5, 0, 561, 239.5, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  \
        cols: 5\n  data: [-0.2, 0.05, 0.001, -0.001, 0]\n";

    const OPENCV: &str = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   \
        cols: 3\n   dt: d\n   data: [ 5.605e+02, 0., 3.195e+02, 0., 561., 2.395e+02, 0., 0., 1. ]\n\
        distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ -0.2, 0.05, 1.0e-3, -1.0e-3, 0. ]\n";

    #[test]
    fn both_forms_are_the_same_camera() {
        let camera = from_yaml(ROS).unwrap();
        assert_eq!(from_yaml(OPENCV).unwrap(), camera);
        assert_eq!(camera.intrinsics().focal[0], Real::from_num(560.5));
        assert_eq!(camera.intrinsics().distortion[1], Real::from_num(0.05));
        let json = r#"{"width": 640, "height": 480, "fps": 30, "fx": 560.0, "fy": 560.0, "cx": 319.5, "cy": 239.5, "kind": "hover"}"#;
        let middle = from_json(json).unwrap().body(I28F4::from_num(320), I28F4::from_num(240));
        assert!(middle[0] > Real::from_num(0.999_999));
    }

    #[test]
    fn errors_name_file_and_field() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cam.yaml");
        for (from, to, reason) in [
            ("image_width: 640\n", "", "image_width"),
            ("rows: 3", "rows: 2", "camera_matrix: 2x3, but 9 numbers"),
            ("560.5", "0.5", "focal length"),
            ("560.5", ".nan", "fx: NaN is out of range"),
            ("plumb_bob", "fisheye", "distortion_model: 'fisheye'"),
            ("-0.2", "x", "distortion_coefficients"),
            ("319.5", "1e4", "optical axis"),
        ] {
            fs::write(&path, ROS.replace(from, to)).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains("cam.yaml") && error.contains(reason), "{error}");
        }
    }

    #[test]
    fn arguments() {
        let args =
            CameraArgs { fov: 60.0, mounting: std::vec![0.0, -90.0, 0.0], ..Default::default() };
        let down = args.camera(640, 480, None).unwrap();
        assert!(down.body(I28F4::from_num(320), I28F4::from_num(240))[2] > Real::from_num(0.9999));
        for bad in [
            CameraArgs { fov: 0.0, ..Default::default() },
            CameraArgs { fov: 60.0, mounting: std::vec![1.0], ..Default::default() },
            CameraArgs { fov: f64::NAN, ..Default::default() },
        ] {
            assert!(bad.camera(640, 480, None).is_err());
        }
        assert!(args.camera(0, 0, None).is_err());
    }
}
