//! The flight that a verb works on: the user's input, or one simulated in memory.

use crate::shell::error::Error;
use crate::shell::formats::camera_file::CameraFile;
use crate::shell::simulate::source::Simulated;
use crate::shell::simulate::{SimulateSettings, Simulator, Telemetry};
use crate::shell::sources::{self, FrameSource};
use std::boxed::Box;
use std::path::Path;
use std::string::String;

/// The simulated flight, where there is no input.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Simulated flight", mut_arg("kind", |kind| kind.long("simulate")))]
pub struct FlightArgs {
    #[command(flatten)]
    settings: SimulateSettings,
}

impl FlightArgs {
    /// The frames of `input`, or of the simulated flight.
    ///
    /// # Errors
    /// [`Error::Source`].
    pub fn open(&self, input: Option<&str>) -> Result<Box<dyn FrameSource>, Error> {
        match input {
            Some(input) => Ok(sources::open(input)?),
            None => Ok(Box::new(Simulated::new(&self.settings))),
        }
    }

    /// What is known of the camera beforehand: that of the simulated flight, or `camera.json` beside the input.
    ///
    /// # Errors
    /// As [`CameraFile::beside`].
    pub fn camera(&self, input: Option<&str>) -> Result<Option<CameraFile>, Error> {
        match input {
            Some(input) => Ok(CameraFile::beside(Path::new(input))?),
            None => Ok(Some(Simulator::new(&self.settings).camera())),
        }
    }

    /// The telemetry of the simulated flight.
    pub fn telemetry(&self, input: Option<&str>) -> Option<Telemetry> {
        input.is_none().then(|| Telemetry::of(&self.settings))
    }

    /// What errors call it.
    pub fn name(&self, input: Option<&str>) -> String {
        match input {
            Some("-") => "standard input".into(),
            Some(input) => input.into(),
            None => "the simulated flight".into(),
        }
    }
}
