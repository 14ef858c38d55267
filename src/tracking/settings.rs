//! Settings of the tracker, and their values from a model's calibration.

use crate::math::real::{ONE, Real, ZERO, ratio};
use crate::model::calibration::{self, Calibration};

/// Share of a model's detections (Q16) that are right from the score on that starts a track, on the hardest clips held back
/// from training. Starting and confirming go by the score of each frame alone: that of all frames, an average itself, is
/// late. With it in both places, 0.5 and 0.5, tracks cover 0.75 of the targets' frames of `airborne/train` with 1.0 false
/// tracks a minute, and warn of 10 of 24 contacts; with the values here 0.78, 0.2 and 15.
const START_PRECISION: u32 = calibration::ONE / 2;

/// The same for the average of the frames' own scores that confirms one. With 0.6 `airborne/train` is covered by 0.81 with
/// 0.35 false tracks a minute, and 24 rendered flights have 26 of them instead of 18.
const CONFIRM_PRECISION: u32 = calibration::ONE / 10 * 7;

/// The same for the score of all frames that continues one: where something is expected, weak evidence will do.
const KEEP_PRECISION: u32 = calibration::ONE / 4;

/// Starting, confirming and ending tracks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrackerSettings {
    /// Detections (M) of the last [`TrackerSettings::confirm_window`] frames from which on a track is confirmed; 1 to 32.
    pub confirm_hits: u8,
    /// Frames (N) that count for it; `confirm_hits` to 32.
    pub confirm_window: u8,
    /// Time without a detection after which a confirmed track ends, in microseconds; 0 to 10 s.
    pub coast_us: i64,
    /// Least score by its frame alone of a detection that starts a track, Q16 log-odds.
    pub start_score: i32,
    /// Least [`Track::mean_log_odds`](crate::tracking::tracker::Track::mean_log_odds) from which on a track is confirmed,
    /// Q16 log-odds.
    pub confirm_score: i32,
    /// Least score of a detection that continues a track, Q16 log-odds.
    pub keep_score: i32,
    /// Random acceleration of directions, in radians a second after a second; 0.001 to 10.
    pub agility: Real,
    /// Random change of the growth, per second after a second; 0.001 to 10.
    pub growth_agility: Real,
    /// Error of a detection's place in parts of its size; 0 to 1. A pixel comes to it.
    pub place_error: Real,
    /// Error of the logarithm of a detection's size; 0 to 1. A quarter of a pixel comes to it.
    pub size_error: Real,
    /// How long that error stays alike, in seconds; 0 to 10. The object itself turns, and boxes change slowly. Default 0.15:
    /// with it errors of times to contact are 1.01 times what is stated (`airborne/train`), with 0.2 0.93, with 0.12 1.06.
    pub size_memory: Real,
}

impl Default for TrackerSettings {
    /// Values measured on `airborne/train`; scores for a model without a calibration.
    fn default() -> Self {
        Self {
            confirm_hits: 6,
            confirm_window: 15,
            coast_us: 700_000,
            start_score: -92_000,
            confirm_score: -92_000 + (1 << 14),
            keep_score: -3 << 16,
            agility: ratio(1, 100),
            growth_agility: ratio(2, 100),
            place_error: ratio(6, 100),
            size_error: ratio(12, 100),
            size_memory: ratio(15, 100),
        }
    }
}

impl TrackerSettings {
    /// The defaults with the scores that a model's calibration gives, as far as its table reaches.
    pub fn calibrated(table: &Calibration<'_>) -> Self {
        let default = Self::default();
        let start_score = table.threshold(START_PRECISION).unwrap_or(default.start_score);
        let confirm_score = table.threshold(CONFIRM_PRECISION).unwrap_or(default.confirm_score);
        let keep_score = table.threshold(KEEP_PRECISION).unwrap_or(default.keep_score);
        Self {
            start_score,
            confirm_score: confirm_score.max(start_score),
            keep_score: keep_score.min(start_score),
            ..default
        }
    }

    /// Every value within its range.
    pub(super) fn limited(self) -> Self {
        let window = self.confirm_window.clamp(1, 32);
        Self {
            confirm_window: window,
            confirm_hits: self.confirm_hits.clamp(1, window),
            coast_us: self.coast_us.clamp(0, 10_000_000),
            agility: self.agility.clamp(ratio(1, 1000), Real::from_num(10)),
            growth_agility: self.growth_agility.clamp(ratio(1, 1000), Real::from_num(10)),
            place_error: self.place_error.clamp(ZERO, ONE),
            size_error: self.size_error.clamp(ZERO, ONE),
            size_memory: self.size_memory.clamp(ZERO, Real::from_num(10)),
            ..self
        }
    }
}
