//! The flight that a verb works on: the user's input, or one simulated in memory.

use crate::shell::error::Error;
use crate::shell::formats::camera_file::CameraFile;
use crate::shell::simulate::source::Simulated;
use crate::shell::simulate::{FlightTelemetry, SimulateSettings, Simulator};
use crate::shell::sources::{self, FrameSource};
use clap::parser::ValueSource;
use std::boxed::Box;
use std::path::Path;
use std::string::String;

/// The simulated flight where there is no input, and the rate of pictures where the input has none.
#[derive(Debug, Clone)]
pub struct FlightArgs {
    settings: SimulateSettings,
    /// `--fps` where the user gave it.
    rate: Option<u32>,
}

impl clap::FromArgMatches for FlightArgs {
    fn from_arg_matches(matches: &clap::ArgMatches) -> Result<Self, clap::Error> {
        let settings = SimulateSettings::from_arg_matches(matches)?;
        let given = matches.value_source("fps") == Some(ValueSource::CommandLine);
        Ok(Self { rate: given.then_some(settings.fps), settings })
    }

    fn update_from_arg_matches(&mut self, matches: &clap::ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl clap::Args for FlightArgs {
    fn augment_args(command: clap::Command) -> clap::Command {
        let command = command.next_help_heading("Simulated flight");
        SimulateSettings::augment_args(command).mut_arg("kind", |kind| kind.long("simulate")).mut_arg("fps", |fps| {
            fps.help("Frames a second; also of a folder of pictures, which has times.csv, camera.json or 30 otherwise")
        })
    }

    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        Self::augment_args(command)
    }
}

impl FlightArgs {
    /// The frames of `input`, or of the simulated flight.
    ///
    /// # Errors
    /// [`Error::Source`].
    pub fn open(&self, input: Option<&Path>) -> Result<Box<dyn FrameSource>, Error> {
        match input {
            Some(input) => Ok(sources::open_at(input, self.rate)?),
            None => Ok(Box::new(Simulated::new(&self.settings))),
        }
    }

    /// Calibration that comes with the input: that of the simulated flight, or `camera.json` beside it.
    ///
    /// # Errors
    /// As [`CameraFile::beside`].
    pub fn camera(&self, input: Option<&Path>) -> Result<Option<CameraFile>, Error> {
        match input {
            Some(input) => Ok(CameraFile::beside(input)?),
            None => Ok(Some(Simulator::new(&self.settings).camera())),
        }
    }

    /// The telemetry of the simulated flight.
    pub fn telemetry(&self, input: Option<&Path>) -> Option<FlightTelemetry> {
        input.is_none().then(|| FlightTelemetry::of(&self.settings))
    }

    /// Name of the source in errors and outputs.
    pub fn name(&self, input: Option<&Path>) -> String {
        match input {
            Some(input) if input == Path::new("-") => "standard input".into(),
            Some(input) => input.to_string_lossy().into_owned(),
            None => "the simulated flight".into(),
        }
    }
}
