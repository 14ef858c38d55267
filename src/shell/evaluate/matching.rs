//! Matching of detections to ground truth: true positives, false positives, or ignored, by the rules of the project's
//! independent scorer (`score.py`).
//!
//! Within a frame detections are matched greedily in the order of their scores: each to the free target with the largest
//! intersection over union, if that reaches the threshold. Birds, targets cut by the frame's edge and targets too small are
//! ignored: a detection with half of its area on one counts neither way.

use super::ranking::{RankedDetection, surest_first};
use crate::shell::formats::class::Class;
use crate::shell::formats::clips::{GroundTruth, TruthBox};
use std::collections::BTreeMap;
use std::format;
use std::string::String;
use std::vec::Vec;

pub use crate::shell::formats::detections::{Box4, DetectionRecord};

/// Frames at the start of a clip that are left out by default: the st-cube is not full yet.
pub const WARMUP: u64 = 3;

/// Shortest longer side in pixels of a target that must be found.
const MIN_TARGET: f64 = 8.0;
/// Lower bounds of the classes of size, pixels of the longer side.
pub const SIZES: [f64; 5] = [MIN_TARGET, 16.0, 24.0, 40.0, 70.0];

/// Result of matching one detection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Match {
    /// It found the target of this index.
    TruePositive(usize),
    /// A false alarm.
    FalsePositive,
    /// It lies on something that counts neither way.
    Ignored {
        /// Whether that is a bird.
        bird: bool,
    },
}

/// A detection and the result of matching it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Matched {
    /// Its place in the list that was matched.
    pub index: usize,
    /// Score of the detection, log-odds.
    pub score: f64,
    /// Result of the match.
    pub kind: Match,
}

impl Matched {
    /// Its entry in the ranking; none where it is ignored. `clip` is the clip's number.
    pub fn outcome(&self, clip: usize) -> Option<RankedDetection> {
        let hit = match self.kind {
            Match::TruePositive(_) => true,
            Match::FalsePositive => false,
            Match::Ignored { .. } => return None,
        };
        Some(RankedDetection { score: self.score, hit, clip })
    }
}

/// A target that must be found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExpectedTarget {
    /// The frame, from 1.
    pub frame: u64,
    /// Box of the ground truth.
    pub truth: TruthBox,
}

/// The detections of a clip, matched.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ClipMatches {
    /// Number of frames that were evaluated.
    pub frames: u64,
    /// Targets that must be found, in the order of frames and of the ground truth.
    pub targets: Vec<ExpectedTarget>,
    /// Ground-truth boxes of birds, which are background.
    pub birds: usize,
    /// Detections in the order of frames, highest score first.
    pub detections: Vec<Matched>,
}

/// Matches the detections of a clip, its first `warmup` frames left out. A detection is right when its intersection over
/// union with a target is at least `iou`.
pub fn match_detections(
    truth: &GroundTruth,
    found: &[DetectionRecord],
    iou: f64,
    warmup: u64,
) -> ClipMatches {
    let mut frames: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
    for (index, detection) in found.iter().enumerate() {
        frames.entry(detection.frame).or_default().push(index);
    }
    let last_found = frames.keys().next_back().copied().unwrap_or(0);
    let last = truth.last_frame().max(last_found);
    for frame in warmup + 1..=truth.last_frame() {
        frames.entry(frame).or_default();
    }
    let mut matches = ClipMatches { frames: last.saturating_sub(warmup), ..ClipMatches::default() };
    for (frame, mut indices) in frames.into_iter().filter(|f| f.0 > warmup) {
        indices.sort_by(|&a, &b| surest_first(found[a].score, found[b].score));
        matches.add_frame(frame, truth.frame(frame), found, &indices, iou);
    }
    matches
}

impl ClipMatches {
    fn add_frame(
        &mut self,
        frame: u64,
        truth: &[TruthBox],
        found: &[DetectionRecord],
        indices: &[usize],
        iou: f64,
    ) {
        let (targets, ignored): (Vec<&TruthBox>, Vec<&TruthBox>) =
            truth.iter().partition(|t| must_be_found(t));
        let first = self.targets.len();
        self.targets.extend(targets.iter().map(|&&truth| ExpectedTarget { frame, truth }));
        self.birds += truth.iter().filter(|t| t.class == Class::Bird).count();
        let mut free: Vec<usize> = (first..self.targets.len()).collect();
        for &index in indices {
            let DetectionRecord { rect: detection, score, .. } = found[index];
            let mut best = None;
            let mut best_iou = iou;
            for (place, &target) in free.iter().enumerate() {
                let target = rect(&self.targets[target].truth);
                let shared = intersection(&detection, &target);
                let union = area(&detection) + area(&target) - shared;
                let iou = if shared > 0.0 { shared / union } else { 0.0 };
                // The later one of equals, as the independent scorer has it.
                if iou >= best_iou {
                    (best, best_iou) = (Some(place), iou);
                }
            }
            let on = |t: &&&TruthBox| half_inside(&detection, &rect(t));
            let kind = if let Some(place) = best {
                Match::TruePositive(free.remove(place))
            } else if ignored.iter().any(|t| on(&t)) {
                Match::Ignored { bird: ignored.iter().filter(on).any(|t| t.class == Class::Bird) }
            } else {
                Match::FalsePositive
            };
            self.detections.push(Matched { index, score, kind });
        }
    }
}

/// Whether a target must be found; the others are ignored.
pub fn must_be_found(target: &TruthBox) -> bool {
    target.is_target(MIN_TARGET)
}

/// The place of a target's size in [`SIZES`].
pub fn size(target: &TruthBox) -> usize {
    size_of(&rect(target))
}

/// The place of a box's size in [`SIZES`]; too small ones count as the smallest.
pub fn size_of(rect: &Box4) -> usize {
    let side = rect[2].max(rect[3]);
    SIZES.iter().rposition(|&s| s <= side).unwrap_or(0)
}

/// The pixels of a class of size in words.
pub fn size_name(index: usize) -> String {
    match SIZES.get(index + 1) {
        Some(next) => format!("{}-{next}", SIZES[index]),
        None => format!("{}-", SIZES[index]),
    }
}

/// The place of a target's class in [`Class::TARGETS`]; birds are no targets.
pub fn class(target: &TruthBox) -> usize {
    Class::TARGETS.iter().position(|&class| class == target.class).unwrap_or(0)
}

/// Where a labelled object is.
pub fn rect(target: &TruthBox) -> Box4 {
    [target.left, target.top, target.width, target.height]
}

fn area(rect: &Box4) -> f64 {
    rect[2] * rect[3]
}

fn intersection(a: &Box4, b: &Box4) -> f64 {
    let span = |i: usize| (a[i] + a[i + 2]).min(b[i] + b[i + 2]) - a[i].max(b[i]);
    span(0).max(0.0) * span(1).max(0.0)
}

fn half_inside(detection: &Box4, ignored: &Box4) -> bool {
    let shared = intersection(detection, ignored);
    shared > 0.0 && shared / area(detection) >= 0.5
}
