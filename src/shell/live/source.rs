//! Opens the live source that the settings name.

use super::config::ServiceConfig;
pub use super::live_source::{CaptureInfo, LiveError, LiveSource};
use super::paced::{Paced, Rewind};
use super::source_setting::SourceSetting;
use super::stream;
use crate::camera::Camera;
use crate::shell::error::Error;
use crate::shell::formats::camera_file::{CameraArgs, CameraFile};
use crate::shell::link::Inbound;
use crate::shell::simulate::source::Simulated;
use crate::shell::simulate::{FlightTelemetry, Manoeuvre, SimulateSettings, Simulator};
use crate::shell::sources;
use crossbeam_channel::Sender;
use std::boxed::Box;
use std::ffi::OsString;
use std::format;
use std::path::Path;

/// Makes the source of the settings; telemetry of a simulated vehicle goes into the channel.
pub type OpenSource = dyn Fn(&ServiceConfig, &Sender<Inbound>) -> Result<Box<dyn LiveSource>, LiveError>
    + Send
    + Sync;

fn simulated(config: &ServiceConfig, kind: Manoeuvre) -> SimulateSettings {
    SimulateSettings {
        kind,
        seconds: 20.0,
        width: config.camera.width.max(64),
        height: config.camera.height.max(64),
        fps: config.camera.rate,
        ..SimulateSettings::default()
    }
}

/// Opens the source that the settings name.
///
/// # Errors
/// [`LiveError::Gone`], [`LiveError::Broken`].
pub fn open(
    config: &ServiceConfig,
    heard: &Sender<Inbound>,
) -> Result<Box<dyn LiveSource>, LiveError> {
    let mut telemetry = None;
    let rewind: Rewind = match &config.source {
        SourceSetting::Camera(path) => return super::v4l2::open(path, &config.camera),
        SourceSetting::Address(address) => {
            return stream::open(stream::receiver(address, config), None, config);
        }
        SourceSetting::Program { words, raw } => {
            return stream::open(words.iter().map(OsString::from).collect(), *raw, config);
        }
        SourceSetting::File(path) if is_pipe(path) => {
            if config.stream.latency_ms.is_none() {
                let path = path.display();
                let reason = format!("file:{path} is a pipe, live: give stream.latency_ms");
                return Err(LiveError::Gone(reason));
            }
            let input = format!("file:{}", path.display());
            return stream::open(stream::receiver(&input, config), None, config);
        }
        SourceSetting::File(path) => {
            let path = path.clone();
            Box::new(move || sources::open(&path))
        }
        SourceSetting::Simulated(kind) => {
            let settings = simulated(config, *kind);
            telemetry = Some((FlightTelemetry::of(&settings), heard.clone()));
            Box::new(move || Ok(Box::new(Simulated::new(&settings))))
        }
    };
    Ok(Box::new(Paced::new(rewind, config.repeat, telemetry)))
}

/// Whether `path` is a pipe, a socket or a device: something that gives data when somebody writes it.
fn is_pipe(path: &Path) -> bool {
    path.metadata().is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}

/// Calibration that comes with the source.
///
/// # Errors
/// As [`CameraFile::beside`].
pub fn own_camera(config: &ServiceConfig) -> Result<Option<CameraFile>, Error> {
    match &config.source {
        SourceSetting::File(path) => Ok(CameraFile::beside(path)?),
        SourceSetting::Simulated(kind) => {
            Ok(Some(Simulator::new(&simulated(config, *kind)).camera()))
        }
        SourceSetting::Camera(_) | SourceSetting::Address(_) | SourceSetting::Program { .. } => {
            Ok(None)
        }
    }
}

/// The camera until the first frame comes, which may have another size where a file or a stream is read.
///
/// # Errors
/// As [`ServiceConfig::camera`].
pub fn first_camera(config: &ServiceConfig, own: Option<&CameraFile>) -> Result<Camera, Error> {
    let size = (config.camera.width as usize, config.camera.height as usize);
    match &config.source {
        SourceSetting::File(_) | SourceSetting::Address(_) | SourceSetting::Program { .. } => {
            let fov = config.camera.field_of_view;
            Ok(CameraArgs { fov, ..CameraArgs::default() }.camera(size.0, size.1, None)?)
        }
        SourceSetting::Camera(_) | SourceSetting::Simulated(_) => config.camera(size, own),
    }
}
