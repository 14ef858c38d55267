//! Where a live lookout's frames come from.

use super::config::Config;
pub use super::live_source::{LiveError, LiveSource, Taken};
use super::paced::Paced;
use crate::camera::Camera;
use crate::shell::error::Error;
use crate::shell::formats::camera_file::{CameraArgs, CameraFile};
use crate::shell::link::Inbound;
use crate::shell::simulate::source::Simulated;
use crate::shell::simulate::{Kind, SimulateSettings, Simulator, Telemetry};
use crate::shell::sources::{self, FrameSource, SourceError};
use clap::ValueEnum;
use crossbeam_channel::Sender;
use std::boxed::Box;
use std::path::Path;
use std::string::String;

/// Makes a source as the settings say; what a simulated vehicle tells goes into the channel.
pub type Open =
    dyn Fn(&Config, &Sender<Inbound>) -> Result<Box<dyn LiveSource>, LiveError> + Send + Sync;

/// The form of `source` in the settings.
enum Named<'a> {
    Camera(&'a Path),
    File(&'a str),
    Simulated(SimulateSettings),
}

fn named(config: &Config) -> Named<'_> {
    match config.source.split_once(':') {
        Some(("file", path)) => Named::File(path),
        Some(("simulate", kind)) => Named::Simulated(SimulateSettings {
            kind: Kind::from_str(kind, false).unwrap_or(Kind::None),
            seconds: 20.0,
            width: config.camera.width.max(64),
            height: config.camera.height.max(64),
            fps: config.camera.rate,
            ..SimulateSettings::default()
        }),
        Some((_, path)) => Named::Camera(Path::new(path)),
        None => Named::Camera(Path::new(&config.source)),
    }
}

/// Opens the source that the settings name.
///
/// # Errors
/// [`LiveError::Gone`], [`LiveError::Broken`].
pub fn open(config: &Config, heard: &Sender<Inbound>) -> Result<Box<dyn LiveSource>, LiveError> {
    let rewind: Box<dyn FnMut() -> Result<Box<dyn FrameSource>, SourceError>> = match named(config)
    {
        Named::Camera(path) => return super::v4l2::open(path, &config.camera),
        Named::File(path) => {
            let path = String::from(path);
            Box::new(move || sources::open(&path))
        }
        Named::Simulated(settings) => Box::new(move || Ok(Box::new(Simulated::new(&settings)))),
    };
    let telemetry = match named(config) {
        Named::Simulated(settings) => Some((Telemetry::of(&settings), heard.clone())),
        _ => None,
    };
    Ok(Box::new(Paced::new(rewind, config.repeat, telemetry)))
}

/// What the source itself knows of its camera.
///
/// # Errors
/// As [`CameraFile::beside`].
pub fn own_camera(config: &Config) -> Result<Option<CameraFile>, Error> {
    match named(config) {
        Named::Camera(_) => Ok(None),
        Named::File(path) => Ok(CameraFile::beside(Path::new(path))?),
        Named::Simulated(settings) => Ok(Some(Simulator::new(&settings).camera())),
    }
}

/// The camera until the first frame comes, which may have another size where a file is read.
///
/// # Errors
/// As [`Config::camera`].
pub fn first_camera(config: &Config, own: Option<&CameraFile>) -> Result<Camera, Error> {
    let size = (config.camera.width as usize, config.camera.height as usize);
    match named(config) {
        Named::File(_) => {
            let fov = config.camera.field_of_view;
            Ok(CameraArgs { fov, ..CameraArgs::default() }.camera(size.0, size.1, None)?)
        }
        Named::Camera(_) | Named::Simulated(_) => config.camera(size, own),
    }
}
