//! A flight simulated in memory.

use crate::shell::simulate::{SimulateSettings, SimulatedTruth, Simulator};
use crate::shell::sources::{Frame, FrameSource, SourceError};

/// Frames of a simulated flight, each rendered when it is read.
#[derive(Debug, Clone)]
pub struct Simulated {
    simulator: Simulator,
    truth: Option<SimulatedTruth>,
    next: u64,
}

impl Simulated {
    /// Prepares a flight; sizes are brought to 16..=4096 pixels and the rate to 1..=1000.
    pub fn new(settings: &SimulateSettings) -> Self {
        Self { simulator: Simulator::new(settings), truth: None, next: 0 }
    }

    /// Ground truth of the last frame read; `None` before the first.
    pub fn truth(&self) -> Option<&SimulatedTruth> {
        self.truth.as_ref()
    }
}

impl FrameSource for Simulated {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        if self.next == self.simulator.settings().frames() {
            return Ok(false);
        }
        self.truth = Some(self.simulator.render(self.next, frame));
        self.next += 1;
        Ok(true)
    }

    fn frame_count(&self) -> Option<u64> {
        Some(self.simulator.settings().frames())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::simulate::Manoeuvre;

    #[test]
    fn it_ends_after_its_frames() {
        let mut flight = Simulated::new(&SimulateSettings {
            seconds: 0.1,
            width: 64,
            height: 64,
            kind: Manoeuvre::None,
            ..SimulateSettings::default()
        });
        assert_eq!(flight.truth(), None);
        let mut frame = Frame::default();
        for time_us in [0, 33_333, 66_666] {
            assert!(flight.next_frame(&mut frame).unwrap());
            assert_eq!(frame.time_us, time_us);
            assert_eq!(flight.truth().unwrap().target, None);
        }
        assert!(!flight.next_frame(&mut frame).unwrap());
        assert_eq!(flight.frame_count(), Some(3));
    }
}
