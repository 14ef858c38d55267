//! Totals of a run of the service, and its state in words.

use super::stages::Stages;
use crate::detector::digest::Digest;
use crate::mavlink::messages::status::LookoutState;
use crate::shell::support::histogram::Histogram;
use std::fmt;
use std::format;
use std::string::String;
use std::vec::Vec;

/// Totals of a run.
#[derive(Debug, Default)]
pub struct ServiceSummary {
    /// Number of frames that the detector processed.
    pub frames: u64,
    /// Frames left out because the detector was busy.
    pub dropped: u32,
    /// Frames lost on the way from the camera.
    pub missed: u32,
    /// Number of times the source was opened.
    pub opened: u32,
    /// All detections, as `lookout replay --digest` has them from the score on with which tracks go on.
    pub digest: Digest,
    /// Time of each stage.
    pub stages: Stages,
    /// From exposure to the last byte sent.
    pub sent: Histogram,
    /// Objects without a place on the map, in words; empty where all had one.
    pub unplaced: String,
}

impl fmt::Display for ServiceSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { frames, dropped, missed, opened, digest, stages, sent, unplaced } = self;
        writeln!(
            f,
            "{frames} frames looked at, {dropped} left out as the detector was busy, {missed} lost on the way; source \
             opened {opened} times; digest {:016x}",
            digest.value()
        )?;
        f.write_str(&stages.table(sent))?;
        f.write_str(unplaced)
    }
}

/// The state as the log names it.
pub(super) fn state_in_words(state: LookoutState) -> String {
    match state {
        LookoutState::Starting => "starting, no frame yet".into(),
        LookoutState::Watching => "watching for traffic".into(),
        LookoutState::Stalled => "no frames, traffic is not watched".into(),
        LookoutState::Slow => "the detector is too slow, traffic is not watched".into(),
        LookoutState::Ending => "ending".into(),
        LookoutState::NoAutopilot => "watching, but the autopilot is gone".into(),
        LookoutState::Blind(blind) => {
            let reasons: Vec<_> = blind.reasons().collect();
            format!("blind: {}; traffic is not watched", reasons.join(", "))
        }
    }
}
