//! Settings of a simulated flight.

use std::borrow::ToOwned;
use std::string::String;

/// Manoeuvre of the other aircraft.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Manoeuvre {
    /// Flies across the view.
    Crossing,
    /// Stays where it is.
    Hover,
    /// Comes nearer on a constant bearing; contact is shortly after the end.
    Collision,
    /// Flies away from the camera.
    Receding,
    /// No other aircraft: every detection is a false alarm.
    None,
}

impl Manoeuvre {
    /// Its name in `camera.json` and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Crossing => "crossing",
            Self::Hover => "hover",
            Self::Collision => "collision",
            Self::Receding => "receding",
            Self::None => "none",
        }
    }
}

/// Settings of a simulated flight.
#[derive(Debug, Clone, PartialEq, clap::Args)]
pub struct SimulateSettings {
    /// Seed; the same seed gives the same bytes
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
    /// Length of the flight in seconds
    #[arg(long, value_name = "N", default_value = "5", value_parser = parse_seconds)]
    pub seconds: f64,
    /// Manoeuvre of the other aircraft
    #[arg(long, value_enum, default_value_t = Manoeuvre::Collision)]
    pub kind: Manoeuvre,
    /// Width of the frames in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 640, value_parser = clap::value_parser!(u32).range(64..=4096))]
    pub width: u32,
    /// Height of the frames in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 480, value_parser = clap::value_parser!(u32).range(64..=4096))]
    pub height: u32,
    /// Frames a second
    #[arg(long, value_name = "RATE", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=240))]
    pub fps: u32,
}

impl Default for SimulateSettings {
    fn default() -> Self {
        Self { seed: 1, seconds: 5.0, kind: Manoeuvre::Collision, width: 640, height: 480, fps: 30 }
    }
}

impl SimulateSettings {
    /// Number of frames; at least one.
    pub fn frames(&self) -> u64 {
        // Rounded by hand: a cast drops the fraction and is 0 for what is no number.
        ((self.seconds * f64::from(self.fps) + 0.5) as u64).max(1)
    }

    /// These settings clamped to the simulator's limits.
    pub(super) fn limited(&self) -> Self {
        Self {
            width: self.width.clamp(16, 4096),
            height: self.height.clamp(16, 4096),
            fps: self.fps.clamp(1, 1000),
            ..self.clone()
        }
    }
}

fn parse_seconds(text: &str) -> Result<f64, &'static str> {
    text.parse()
        .ok()
        .filter(|seconds| (0.01..=3600.0).contains(seconds))
        .ok_or("expected a number of seconds from 0.01 to 3600")
}
