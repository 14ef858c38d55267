//! Camera files: OpenCV and ROS calibrations (YAML), and the flights' own `camera.json`.

use super::calibration;
use super::error::FormatError;
use crate::camera::attitude::Attitude;
use crate::camera::{Camera, Intrinsics, Lens};
use crate::math::real::{PI, Real};
use crate::shell::support::bounded_file;
use crate::shell::support::file_error::FileError;
use serde::{Deserialize, Serialize};
use std::format;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

/// Source of a camera's calibration and mounting.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Camera")]
pub struct CameraArgs {
    /// Calibration: YAML or JSON of OpenCV, ROS or Kalibr, or camera.json; default: that of the simulated flight, else --fov
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Horizontal field of view in degrees without a calibration; directions and ranges are then approximate
    #[arg(long, value_name = "DEGREES", default_value_t = 60.0)]
    pub fov: f64,
    /// Mounting of the camera on the vehicle: roll, pitch, yaw in degrees (pitch up, yaw to the right positive); 0,0,0
    /// looks forward
    #[arg(long, value_name = "ROLL,PITCH,YAW", value_delimiter = ',', allow_hyphen_values = true)]
    pub mounting: Vec<f64>,
}

impl CameraArgs {
    /// The camera for frames of this size; `own` is the calibration that comes with the source.
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
                let scaled = camera.scaled(width as u32, height as u32).ok_or_else(|| {
                    let reason = format!(
                        "calibrated at {}x{}, the frames are {width}x{height}, which is not a whole part or multiple; \
                         calibrate at their size",
                        spec.width, spec.height
                    );
                    FormatError::Camera { path: path.clone(), reason }
                })?;
                if scaled.intrinsics() != spec {
                    tracing::info!(
                        "{}: calibrated at {}x{}, scaled to {width}x{height}",
                        path.display(),
                        spec.width,
                        spec.height
                    );
                }
                scaled
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
        let angle =
            |degrees| Ok::<_, FormatError>(number("mounting", degrees).map_err(bad)? * PI / 180);
        let turn = Attitude::from_euler(angle(roll)?, angle(pitch)?, angle(yaw)?);
        Ok(camera.mounted(turn.compose(Attitude::FORWARD)))
    }
}

/// Contents of `camera.json`; pixel centres are at whole numbers there.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
pub struct CameraFile {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Focal lengths in pixels.
    pub fx: f64,
    /// Focal length along y in pixels.
    pub fy: f64,
    /// Optical axis in pixels.
    pub cx: f64,
    /// Optical axis along y in pixels.
    pub cy: f64,
    /// Manoeuvre of the other aircraft, where it is known.
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
        let [fx, fy] = [number("fx", self.fx)?, number("fy", self.fy)?];
        let [cx, cy] = [number("cx", self.cx)?, number("cy", self.cy)?];
        let intrinsics = Intrinsics {
            width: self.width,
            height: self.height,
            focal: [fx, fy],
            centre: [cx, cy],
            lens: Lens::PINHOLE,
        };
        Camera::new(intrinsics).map_err(|e| e.to_string())
    }
}

/// Reads a camera file.
///
/// # Errors
/// [`FileError::Read`], [`FormatError::Camera`] naming the field.
pub fn read(path: &Path) -> Result<Camera, FormatError> {
    let text = bounded_file::read_text(path).map_err(FileError::read(path))?;
    let json = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json"));
    let own = json
        && serde_json::from_str::<serde_json::Value>(&text)
            .is_ok_and(|v| v.get("fx").is_some_and(|fx| fx.is_number()));
    let camera =
        if own { from_json(&text) } else { calibration::parse(&text).map_err(|e| e.to_string()) };
    camera.map_err(|reason| FormatError::Camera { path: path.into(), reason })
}

fn from_json(text: &str) -> Result<Camera, String> {
    serde_json::from_str::<CameraFile>(text).map_err(|e| e.to_string())?.camera()
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

    #[test]
    fn the_file_s_name_is_no_matter_for_a_calibration() {
        let folder = tempfile::tempdir().unwrap();
        let json = r#"{"width": 640, "height": 480, "fps": 30, "fx": 560.0, "fy": 560.0, "cx": 319.5, "cy": 239.5, "kind": "hover"}"#;
        let path = folder.path().join("camera.json");
        fs::write(&path, json).unwrap();
        let middle = read(&path).unwrap().body(I28F4::from_num(320), I28F4::from_num(240));
        assert!(middle[0] > Real::from_num(0.999_999));
        let python = r#"{"camera_matrix": [[560.5, 0, 319.5], [0, 561, 239.5], [0, 0, 1]], "dist_coeffs": [[-0.2, 0.05, 0.001, -0.001, 0]], "image_width": 640, "image_height": 480}"#;
        fs::write(&path, python).unwrap();
        let yaml = folder.path().join("camera.yaml");
        fs::write(&yaml, ROS).unwrap();
        assert_eq!(read(&path).unwrap(), read(&yaml).unwrap());
    }

    #[test]
    fn a_calibration_of_another_size_is_scaled_by_whole_factors_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("camera.yaml");
        fs::write(&path, ROS).unwrap();
        let args = CameraArgs { camera: Some(path), ..CameraArgs::default() };
        for (width, height, focal) in [(640, 480, 560.5), (320, 240, 280.25), (1280, 960, 1121.0)] {
            let camera = args.camera(width, height, None).unwrap();
            assert_eq!(camera.intrinsics().focal[0], Real::from_num(focal));
            assert_eq!(camera.intrinsics().width as usize, width);
        }
        for (width, height) in [(640, 360), (320, 256), (480, 360)] {
            let error = args.camera(width, height, None).unwrap_err().to_string();
            assert!(error.contains("calibrated at 640x480, the frames are"), "{error}");
        }
    }

    #[test]
    fn errors_name_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cam.yaml");
        fs::write(&path, ROS.replace("plumb_bob", "omni")).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(
            error.contains("cam.yaml") && error.contains("distortion_model: 'omni'"),
            "{error}"
        );
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
