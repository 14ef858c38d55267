//! Accuracy of detections on clips with ground truth, by the rules of the project's independent scorer.
//!
//! Within a frame the surest detection chooses first: it takes the free target with the largest intersection over union, if that
//! reaches the threshold. Birds, targets cut by the frame's edge and targets too small are ignored: a detection with half of its area
//! on one counts neither way. All clips together give one precision-recall curve (all-point interpolation).

use super::clips::{GroundTruth, TruthBox};
use serde::ser::{Serialize, SerializeMap, Serializer};
use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::fmt;
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

/// A box in pixels: left, top, width, height.
pub type Box4 = [f64; 4];

/// A detection as written to a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// The frame, from 1.
    pub frame: u64,
    /// Where it is.
    pub rect: Box4,
    /// Larger is surer.
    pub score: f64,
}

/// Frames at the start of a clip that are left out by default: the st-cube is not full yet.
pub const WARMUP: u64 = 3;

/// Shortest longer side in pixels of a target that must be found.
const MIN_TARGET: f64 = 8.0;
const BIRD: u32 = 4;
const PRECISIONS: [f64; 3] = [0.5, 0.9, 0.95];
const FALSE_ALARMS: [u64; 3] = [1, 10, 100];
/// Lower bounds of the classes of size, pixels of the longer side.
const SIZES: [f64; 5] = [MIN_TARGET, 16.0, 24.0, 40.0, 70.0];
const CLASSES: [(u32, &str); 3] = [(1, "drone"), (2, "airplane"), (3, "helicopter")];

/// How many targets there were, and how many of them were found.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    targets: usize,
    found: usize,
}

/// Gathers clips and judges them together.
#[derive(Debug, Clone)]
pub struct Scorer {
    iou: f64,
    warmup: u64,
    frames: u64,
    /// Score of every detection that counts, and whether it is a target, in the order of clips, frames and scores.
    outcomes: Vec<(f64, bool)>,
    sizes: [Tally; SIZES.len()],
    classes: [Tally; CLASSES.len()],
}

impl Scorer {
    /// A detection is right when its intersection over union with a target is at least `iou`.
    pub fn new(iou: f64, warmup: u64) -> Self {
        Self {
            iou,
            warmup,
            frames: 0,
            outcomes: Vec::new(),
            sizes: Default::default(),
            classes: Default::default(),
        }
    }

    /// Adds a clip. The result depends on the order of clips only where scores are equal.
    pub fn add_clip(&mut self, truth: &GroundTruth, found: &[Found]) {
        let mut frames: BTreeMap<u64, Vec<&Found>> = BTreeMap::new();
        for detection in found {
            frames.entry(detection.frame).or_default().push(detection);
        }
        let last_found = frames.keys().next_back().copied().unwrap_or(0);
        let last = truth.last_frame().max(last_found);
        self.frames += last.saturating_sub(self.warmup);
        for frame in self.warmup + 1..=truth.last_frame() {
            frames.entry(frame).or_default();
        }
        let warmup = self.warmup;
        for (frame, mut found) in frames.into_iter().filter(|f| f.0 > warmup) {
            found.sort_by(|a, b| surest_first(b.score, a.score));
            self.add_frame(truth.frame(frame), &found);
        }
    }

    fn add_frame(&mut self, targets: &[TruthBox], found: &[&Found]) {
        let (mut free, ignored): (Vec<&TruthBox>, Vec<&TruthBox>) =
            targets.iter().partition(|t| must_be_found(t));
        for target in &free {
            self.size(target).targets += 1;
            self.class(target).targets += 1;
        }
        for detection in found {
            let mut best = None;
            let mut best_iou = self.iou;
            for (index, target) in free.iter().enumerate() {
                let shared = intersection(&detection.rect, &rect(target));
                let union = area(&detection.rect) + area(&rect(target)) - shared;
                let iou = if shared > 0.0 { shared / union } else { 0.0 };
                // The later one of equals, as the independent scorer has it.
                if iou >= best_iou {
                    (best, best_iou) = (Some(index), iou);
                }
            }
            if let Some(index) = best {
                let target = free.remove(index);
                self.size(target).found += 1;
                self.class(target).found += 1;
                self.outcomes.push((detection.score, true));
            } else if !ignored.iter().any(|t| half_inside(&detection.rect, &rect(t))) {
                self.outcomes.push((detection.score, false));
            }
        }
    }

    fn size(&mut self, target: &TruthBox) -> &mut Tally {
        let side = target.width.max(target.height);
        &mut self.sizes[SIZES.iter().rposition(|&s| s <= side).unwrap_or(0)]
    }

    fn class(&mut self, target: &TruthBox) -> &mut Tally {
        &mut self.classes[CLASSES.iter().position(|c| c.0 == target.class).unwrap_or(0)]
    }

    /// The figures of all clips together.
    pub fn report(mut self) -> Report {
        let positives: usize = self.sizes.iter().map(|s| s.targets).sum();
        self.outcomes.sort_by(|a, b| surest_first(b.0, a.0));
        let curve = curve(&self.outcomes, positives);
        let share = |name: String, tally: &Tally| Share {
            name,
            recall: (tally.targets > 0).then(|| tally.found as f64 / tally.targets as f64),
            targets: tally.targets,
        };
        let size_name = |i: usize| match SIZES.get(i + 1) {
            Some(next) => format!("{}-{next}", SIZES[i]),
            None => format!("{}-", SIZES[i]),
        };
        Report {
            average_precision: average_precision(&curve),
            iou: self.iou,
            frames: self.frames,
            positives,
            detections: self.outcomes.len(),
            recall_at_precision: PRECISIONS
                .map(|p| curve.iter().filter(|c| c.1 >= p).map(|c| c.0).fold(0.0, f64::max)),
            recall_at_false_alarms: FALSE_ALARMS
                .map(|n| recall_at(&self.outcomes, positives, n * self.frames)),
            by_size: self.sizes.iter().enumerate().map(|(i, t)| share(size_name(i), t)).collect(),
            by_class: CLASSES
                .iter()
                .zip(&self.classes)
                .filter(|(_, tally)| tally.targets > 0)
                .map(|((_, name), tally)| share((*name).into(), tally))
                .collect(),
        }
    }
}

/// Whether a target must be found; the others are ignored.
pub fn must_be_found(target: &TruthBox) -> bool {
    target.class != BIRD
        && target.visibility >= 1.0
        && target.width.max(target.height) >= MIN_TARGET
}

/// Read scores are finite; equal ones keep their order.
fn surest_first(b: f64, a: f64) -> Ordering {
    b.partial_cmp(&a).unwrap_or(Ordering::Equal)
}

fn rect(target: &TruthBox) -> Box4 {
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

/// Recall and precision at each score that occurs; `outcomes` are sorted, surest first.
fn curve(outcomes: &[(f64, bool)], positives: usize) -> Vec<(f64, f64)> {
    let mut right = 0;
    let mut seen = 0;
    outcomes
        .chunk_by(|a, b| a.0 == b.0)
        .map(|equals| {
            right += equals.iter().filter(|o| o.1).count();
            seen += equals.len();
            (right as f64 / positives.max(1) as f64, right as f64 / seen as f64)
        })
        .collect()
}

/// Area under the curve whose precision is the best at that recall or more.
fn average_precision(curve: &[(f64, f64)]) -> f64 {
    let mut envelope = curve.to_vec();
    for i in (1..envelope.len()).rev() {
        envelope[i - 1].1 = envelope[i - 1].1.max(envelope[i].1);
    }
    let mut last = 0.0;
    envelope.iter().fold(0.0, |sum, &(recall, precision)| {
        let step = recall - last;
        last = recall;
        sum + step * precision
    })
}

/// Recall down to the last detection before there are more than `thousandths` / 1000 false alarms.
fn recall_at(outcomes: &[(f64, bool)], positives: usize, thousandths: u64) -> f64 {
    let mut right = 0;
    let mut wrong = 0;
    for &(_, hit) in outcomes {
        if hit {
            right += 1;
        } else {
            wrong += 1;
        }
        if wrong * 1000 > thousandths {
            break;
        }
    }
    right as f64 / positives.max(1) as f64
}

/// Share of targets of one kind that were found at any score.
#[derive(Debug, Clone, PartialEq)]
pub struct Share {
    /// The kind.
    pub name: String,
    /// Found of all, 0 to 1; none without targets.
    pub recall: Option<f64>,
    /// How many there were.
    pub targets: usize,
}

/// What the clips gave together; printed (and as JSON) in the form of the independent scorer.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Area under the interpolated precision-recall curve, 0 to 1.
    pub average_precision: f64,
    /// Intersection over union from which a detection is right.
    pub iou: f64,
    /// Frames judged.
    pub frames: u64,
    /// Targets that must be found.
    pub positives: usize,
    /// Detections that count.
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

enum Field<'a> {
    Real(f64),
    Count(u64),
    Shares(&'a [Share]),
}

impl Report {
    fn fields(&self) -> Vec<(String, Field<'_>)> {
        let mut fields = vec![
            ("AveP".into(), Field::Real(round(self.average_precision, 4))),
            ("iou".into(), Field::Real(self.iou)),
            ("frames".into(), Field::Count(self.frames)),
            ("positives".into(), Field::Count(self.positives as u64)),
            ("detections".into(), Field::Count(self.detections as u64)),
        ];
        for (precision, recall) in PRECISIONS.iter().zip(self.recall_at_precision) {
            let name = format!("recall_at_precision_{precision}");
            fields.push((name, Field::Real(round(recall, 4))));
        }
        for (count, recall) in FALSE_ALARMS.iter().zip(self.recall_at_false_alarms) {
            let name = format!("recall_at_{count}_false_alarms_per_1000_frames");
            fields.push((name, Field::Real(round(recall, 4))));
        }
        fields.push(("max_recall_by_size_px".into(), Field::Shares(&self.by_size)));
        fields.push(("max_recall_by_class".into(), Field::Shares(&self.by_class)));
        fields
    }
}

/// To so many decimals, exact ties to even.
fn round(value: f64, digits: usize) -> f64 {
    format!("{value:.digits$}").parse().unwrap_or(value)
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let share = |s: &Share| {
            let recall = s.recall.map_or("None".into(), |r| format!("{:?}", round(r, 3)));
            format!("'{}': [{recall}, {}]", s.name, s.targets)
        };
        let lines: Vec<String> = self
            .fields()
            .iter()
            .map(|(name, field)| match field {
                Field::Real(value) => format!("{name}: {value:?}"),
                Field::Count(value) => format!("{name}: {value}"),
                Field::Shares(shares) => {
                    let shares: Vec<String> = shares.iter().map(share).collect();
                    format!("{name}: {{{}}}", shares.join(", "))
                }
            })
            .collect();
        f.write_str(&lines.join("\n"))
    }
}

impl Serialize for Report {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for (name, field) in self.fields() {
            match field {
                Field::Real(value) => map.serialize_entry(&name, &value)?,
                Field::Count(value) => map.serialize_entry(&name, &value)?,
                Field::Shares(shares) => map.serialize_entry(&name, &Shares(shares))?,
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
