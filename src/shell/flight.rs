//! The flight that a verb works on: the user's input, or one simulated in memory.

use super::error::Error;
use super::source::{self, FrameSource};
use std::boxed::Box;
use std::string::String;

/// The simulated flight, where there is no input.
#[derive(Debug, Clone, clap::Args)]
pub struct FlightArgs {
    /// Seed of the simulated flight
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
}

impl FlightArgs {
    /// The frames of `input`, or of the simulated flight.
    ///
    /// # Errors
    /// [`Error::Source`].
    pub fn open(&self, input: Option<&str>) -> Result<Box<dyn FrameSource>, Error> {
        match input {
            Some(input) => Ok(source::open(input)?),
            None => Err(Error::NoFrames { input: self.name(None) }),
        }
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
