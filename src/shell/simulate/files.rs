//! Output of simulated and rendered flights: errors, text files, pictures, progress.

use crate::shell::formats::camera_file::CameraFile;
use crate::shell::render::{RenderError, RenderSettingsError};
use crate::shell::sources::Frame;
use image::ImageEncoder;
use image::codecs::png::PngEncoder;
use indicatif::{ProgressBar, ProgressStyle};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Why a flight cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulateError {
    /// The system failed while writing.
    #[error("{}: cannot be written: {source}; what is complete before it stays usable", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Pictures, clips or models to render from cannot be read.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// A file of settings, or options, that cannot be used.
    #[error("{}: {source}; what can be set is in src/shell/render/default.toml", path.display())]
    Settings {
        /// The file, or the options.
        path: PathBuf,
        /// The field and what is expected.
        source: RenderSettingsError,
    },
    /// A video cannot be encoded.
    #[error("{}: {reason}; --png writes pictures without ffmpeg", path.display())]
    Encoder {
        /// Path of the video.
        path: PathBuf,
        /// Words of ffmpeg or of the system.
        reason: String,
    },
    /// Something is there already.
    #[error("{}: not empty; give a new folder, or remove what is in it", path.display())]
    NotEmpty {
        /// Path of the folder.
        path: PathBuf,
    },
}

/// First line of `truth.csv`.
pub(super) const TRUTH_HEADER: &str = "frame,time_s,yaw_rad,pitch_rad,roll_rad,id,azimuth_rad,elevation_rad,range_m,time_to_contact_s\n";

/// Contents of `camera.json`.
#[derive(serde::Serialize)]
pub(super) struct FlightFile {
    #[serde(flatten)]
    pub camera: CameraFile,
    pub fps: u32,
    pub spans_m: Vec<f64>,
    /// Radial distortion: undistorted radius = distorted radius (1 - k1 r^2), r in focal lengths.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub k1: Option<f64>,
}

pub(super) fn failed(path: &Path) -> impl FnOnce(io::Error) -> SimulateError {
    |source| SimulateError::Write { path: path.into(), source }
}

pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), SimulateError> {
    fs::write(path, bytes).map_err(failed(path))
}

/// A text file that is complete after every line.
pub(super) struct Lines {
    path: PathBuf,
    file: File,
}

impl Lines {
    pub(super) fn create(path: PathBuf) -> Result<Self, SimulateError> {
        let file = File::create(&path).map_err(failed(&path))?;
        Ok(Self { path, file })
    }

    pub(super) fn add(&mut self, text: &str) -> Result<(), SimulateError> {
        self.file.write_all(text.as_bytes()).map_err(failed(&self.path))
    }
}

pub(super) fn png(frame: &Frame) -> io::Result<Vec<u8>> {
    let (width, height) = (frame.width as u32, frame.height as u32);
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&frame.pixels, width, height, image::ExtendedColorType::L8)
        .map_err(io::Error::other)?;
    Ok(bytes)
}

#[allow(clippy::expect_used, reason = "the template is a constant")]
pub(super) fn progress_bar(frames: u64) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} {msg}, {per_sec}, {eta} left");
    ProgressBar::new(frames).with_style(style.expect("the template is a constant"))
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_full_disk_is_named() {
        let full = Path::new("/dev/full");
        let error = write(full, b"picture").unwrap_err().to_string();
        assert!(error.starts_with("/dev/full: cannot be written: "), "{error}");
        let mut lines = Lines::create(full.into()).unwrap();
        let error = lines.add("1,1,2,3,4,5\n").unwrap_err().to_string();
        assert!(error.starts_with("/dev/full: cannot be written: "), "{error}");
    }
}
