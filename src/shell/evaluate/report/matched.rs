//! Detections of each method, matched to the ground truth of each clip.

use super::breakdown::ClipTruth;
use super::methods::MethodDetections;
use crate::shell::evaluate::matching::{self, ClipMatches, WARMUP};
use crate::shell::formats::clips::Clip;
use std::vec::Vec;

/// Intersections over union by which detections are matched.
pub const IOUS: [f64; 2] = [0.5, 0.3];

/// The detections of a method, matched: by intersection over union and clip.
pub type MethodMatches = Vec<Vec<ClipMatches>>;

/// Matches a method's detections.
pub fn match_method(clips: &[Clip], method: &MethodDetections) -> MethodMatches {
    let matched = |iou| {
        let clips = clips.iter().zip(&method.clips);
        clips
            .map(|(c, d)| matching::match_detections(&c.ground_truth, &d.found, iou, WARMUP))
            .collect()
    };
    IOUS.map(matched).into()
}

/// Hours that the frames of a clip last. The scorer's count of frames ends with the last box, which a flight without a
/// target may not have.
pub fn hours(truth: &ClipTruth<'_>) -> f64 {
    truth.frames as f64 / truth.facts.rate / 3600.0
}
