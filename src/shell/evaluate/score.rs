//! Accuracy of matched clips: all clips together give one precision-recall curve (all-point interpolation), by the rules of the
//! project's independent scorer.

pub use super::matching::{Box4, DetectionRecord, WARMUP, must_be_found};

use super::matching::{self, ClipMatches, Match, SIZES, class, size};
use super::ranking::{ClipCount, RankedDetection, Ranking};
use crate::shell::formats::class::Class;
use crate::shell::formats::clips::GroundTruth;
use serde::ser::{Serialize, SerializeMap, Serializer};
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

/// Precisions at which recall is given.
pub const PRECISIONS: [f64; 3] = [0.5, 0.9, 0.95];
/// False alarms in 1000 frames at which recall is given.
pub const FALSE_ALARMS: [u64; 3] = [1, 10, 100];

/// Number of targets, and of those found.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    targets: usize,
    found: usize,
}

/// Targets, and those found at any score, by size and class.
#[derive(Debug, Clone, Default)]
pub struct Tallies {
    sizes: [Tally; SIZES.len()],
    classes: [Tally; Class::TARGETS.len()],
}

impl Tallies {
    /// Adds the targets of a clip.
    pub fn add(&mut self, matches: &ClipMatches) {
        for target in &matches.targets {
            self.sizes[size(&target.truth)].targets += 1;
            self.classes[class(&target.truth)].targets += 1;
        }
        for detection in &matches.detections {
            if let Match::TruePositive(index) = detection.kind {
                let target = &matches.targets[index].truth;
                self.sizes[size(target)].found += 1;
                self.classes[class(target)].found += 1;
            }
        }
    }

    /// Number of targets.
    pub fn targets(&self) -> usize {
        self.sizes.iter().map(|tally| tally.targets).sum()
    }

    /// Recall by size.
    pub fn by_size(&self) -> Vec<Share> {
        let sizes = self.sizes.iter().enumerate();
        sizes.map(|(i, tally)| share(matching::size_name(i), tally)).collect()
    }

    /// Recall by class, of those that occur.
    pub fn by_class(&self) -> Vec<Share> {
        let classes = Class::TARGETS.iter().zip(&self.classes);
        classes
            .filter(|(_, tally)| tally.targets > 0)
            .map(|(class, tally)| share(class.name().into(), tally))
            .collect()
    }
}

fn share(name: String, tally: &Tally) -> Share {
    Share {
        name,
        recall: (tally.targets > 0).then(|| tally.found as f64 / tally.targets as f64),
        targets: tally.targets,
    }
}

/// Accumulates matched clips into one report, all detections in memory: for figures over resamples, and the oracle of
/// `accuracy`.
#[derive(Debug, Clone)]
pub struct Scorer {
    iou: f64,
    warmup: u64,
    clips: Vec<ClipCount>,
    outcomes: Vec<RankedDetection>,
    tallies: Tallies,
}

impl Scorer {
    /// A detection is right when its intersection over union with a target is at least `iou`.
    pub fn new(iou: f64, warmup: u64) -> Self {
        Self { iou, warmup, clips: Vec::new(), outcomes: Vec::new(), tallies: Tallies::default() }
    }

    /// Matches a clip and adds it. The result depends on the order of clips only where scores are equal.
    pub fn add_clip(&mut self, truth: &GroundTruth, found: &[DetectionRecord]) {
        self.add_matches(&matching::match_detections(truth, found, self.iou, self.warmup));
    }

    /// Adds a clip that was matched at the same intersection over union.
    pub fn add_matches(&mut self, matches: &ClipMatches) {
        let clip = self.clips.len();
        self.clips.push(ClipCount { frames: matches.frames, targets: matches.targets.len() });
        self.tallies.add(matches);
        for detection in &matches.detections {
            self.outcomes.extend(detection.outcome(clip));
        }
    }

    /// Every detection that counts, in the order of its score.
    pub fn ranking(self) -> Ranking {
        Ranking::new(self.clips, self.outcomes)
    }

    /// The figures of all clips together.
    pub fn report(self) -> AccuracyReport {
        let (iou, tallies) = (self.iou, self.tallies.clone());
        let ranking = self.ranking();
        let all = ranking.whole();
        let curve = ranking.curve(&all);
        AccuracyReport {
            average_precision: ranking.average_precision(&all),
            iou,
            frames: ranking.clips().iter().map(|clip| clip.frames).sum(),
            positives: tallies.targets(),
            detections: ranking.outcomes().len(),
            recall_at_precision: PRECISIONS.map(|p| {
                curve.iter().filter(|c| c.precision >= p).map(|c| c.recall).fold(0.0, f64::max)
            }),
            recall_at_false_alarms: FALSE_ALARMS.map(|n| ranking.recall_at(&all, n)),
            by_size: tallies.by_size(),
            by_class: tallies.by_class(),
        }
    }
}

/// Share of targets of one kind that were found at any score.
#[derive(Debug, Clone, PartialEq)]
pub struct Share {
    /// Kind of footage, as the table of clips names it.
    pub name: String,
    /// Found of all, 0 to 1; none without targets.
    pub recall: Option<f64>,
    /// Number of targets in the ground truth.
    pub targets: usize,
}

/// Accuracy over all clips; as JSON in the form of the independent scorer.
#[derive(Debug, Clone, PartialEq)]
pub struct AccuracyReport {
    /// Area under the interpolated precision-recall curve, 0 to 1.
    pub average_precision: f64,
    /// Intersection over union from which a detection is right.
    pub iou: f64,
    /// Number of frames that were evaluated.
    pub frames: u64,
    /// Targets that must be found.
    pub positives: usize,
    /// Detections that are right or wrong; those on ignored boxes are neither.
    pub detections: usize,
    /// Best recall where precision is at least 0.5, 0.9, 0.95.
    pub recall_at_precision: [f64; 3],
    /// Recall where there are at most 1, 10, 100 false alarms in 1000 frames.
    pub recall_at_false_alarms: [f64; 3],
    /// Recall at any score by the longer side of the target in pixels.
    pub by_size: Vec<Share>,
    /// Recall at any score by class.
    pub by_class: Vec<Share>,
}

enum ReportField<'a> {
    Real(f64),
    Count(u64),
    Shares(&'a [Share]),
}

impl AccuracyReport {
    fn fields(&self) -> Vec<(String, ReportField<'_>)> {
        let mut fields = vec![
            ("AveP".into(), ReportField::Real(round(self.average_precision, 4))),
            ("iou".into(), ReportField::Real(self.iou)),
            ("frames".into(), ReportField::Count(self.frames)),
            ("positives".into(), ReportField::Count(self.positives as u64)),
            ("detections".into(), ReportField::Count(self.detections as u64)),
        ];
        for (precision, recall) in PRECISIONS.iter().zip(self.recall_at_precision) {
            let name = format!("recall_at_precision_{precision}");
            fields.push((name, ReportField::Real(round(recall, 4))));
        }
        for (count, recall) in FALSE_ALARMS.iter().zip(self.recall_at_false_alarms) {
            let name = format!("recall_at_{count}_false_alarms_per_1000_frames");
            fields.push((name, ReportField::Real(round(recall, 4))));
        }
        fields.push(("max_recall_by_size_px".into(), ReportField::Shares(&self.by_size)));
        fields.push(("max_recall_by_class".into(), ReportField::Shares(&self.by_class)));
        fields
    }
}

/// Rounds to a number of decimals, exact ties to even.
fn round(value: f64, digits: usize) -> f64 {
    format!("{value:.digits$}").parse().unwrap_or(value)
}

impl Serialize for AccuracyReport {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for (name, field) in self.fields() {
            match field {
                ReportField::Real(value) => map.serialize_entry(&name, &value)?,
                ReportField::Count(value) => map.serialize_entry(&name, &value)?,
                ReportField::Shares(shares) => map.serialize_entry(&name, &Shares(shares))?,
            }
        }
        map.end()
    }
}

struct Shares<'a>(&'a [Share]);

impl Serialize for Shares<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let entry = |s: &Share| (s.name.clone(), (s.recall.map(|r| round(r, 3)), s.targets));
        serializer.collect_map(self.0.iter().map(entry))
    }
}
