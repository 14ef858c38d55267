//! A V4L2 camera as a live source.

use super::config::CameraConfig;
use super::live_source::{LiveError, LiveSource};
use std::boxed::Box;
use std::path::Path;

/// Opens the camera of a video node.
///
/// # Errors
/// [`LiveError::Gone`] with the reason, also for what only a person can mend: the settings may be right for the camera
/// that is plugged in next.
#[cfg(target_os = "linux")]
pub fn open(path: &Path, config: &CameraConfig) -> Result<Box<dyn LiveSource>, LiveError> {
    use crate::shell::sources::v4l2::{CameraSettings, V4l2Camera};
    use std::string::ToString;
    let gone = |reason: std::string::String| LiveError::Gone(reason);
    let format = config.format.as_deref().map(str::parse).transpose().map_err(gone)?;
    let settings = CameraSettings {
        width: config.width,
        height: config.height,
        rate: Some(config.rate),
        format,
        controls: config.controls.clone(),
    };
    let camera = V4l2Camera::open(path, &settings).map_err(|error| gone(error.to_string()))?;
    let (format, width, height) = camera.format();
    tracing::info!(%format, width, height, rate = ?camera.rate(), "{}: camera", path.display());
    Ok(Box::new(camera))
}

#[cfg(target_os = "linux")]
impl LiveSource for crate::shell::sources::v4l2::V4l2Camera {
    fn next(
        &mut self,
        frame: &mut crate::shell::sources::Frame,
        timeout: std::time::Duration,
    ) -> Result<super::live_source::CaptureInfo, LiveError> {
        use crate::shell::sources::v4l2::V4l2Error;
        use std::string::ToString;
        let taken = Self::next(self, frame, timeout).map_err(|error| match error {
            V4l2Error::Timeout => LiveError::Timeout,
            error => LiveError::Gone(error.to_string()),
        })?;
        Ok(super::live_source::CaptureInfo {
            missed: taken.missed + taken.damaged,
            passed_over: taken.passed_over,
        })
    }
}

/// Elsewhere than on Linux there are no such cameras.
///
/// # Errors
/// [`LiveError::Gone`], always.
#[cfg(not(target_os = "linux"))]
pub fn open(path: &Path, _: &CameraConfig) -> Result<Box<dyn LiveSource>, LiveError> {
    Err(LiveError::Gone(std::format!("{}: cameras need Linux; give file:PATH", path.display())))
}
