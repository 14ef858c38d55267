//! All figures of a report, as they stand in `report.json`.

use super::breakdown::{self, ClipTruth, Dimension, GroupFigures};
use super::collisions::CollisionFigures;
use super::curves;
use super::gallery::Mistake;
pub use super::matched::{IOUS, MethodMatches, hours, match_method};
use super::methods::MethodDetections;
use super::regressors::RegressorFigures;
use crate::shell::evaluate::bootstrap::{Bootstrap, Interval, LEVEL, RESAMPLES, SEED, Sampled};
use crate::shell::evaluate::matching::{ClipMatches, Match, WARMUP};
use crate::shell::evaluate::ranges::SpanRanges;
use crate::shell::evaluate::ranking::Ranking;
use crate::shell::evaluate::registration::RegistrationFigures;
use crate::shell::evaluate::reliability;
use crate::shell::evaluate::score::{self, FALSE_ALARMS, Scorer};
use crate::shell::evaluate::without_target::WithoutTarget;
use serde::Serialize;
use std::format;
use std::string::String;
use std::vec::Vec;

/// Place in [`IOUS`] of the one by which operating points, birds and the gallery are matched.
pub const LOOSE: usize = 1;

/// All figures of a report, as written to its JSON.
#[derive(Debug, Clone, Serialize)]
pub struct ReportFigures {
    /// Version of the program.
    pub lookout: &'static str,
    /// The split as the user named it.
    pub data: String,
    /// Clips, frames and boxes that the figures are of.
    pub flights: Flights,
    /// Parameters of the confidence intervals.
    pub bootstrap: BootstrapFigures,
    /// The figures of each method; the detector's own run is first.
    pub methods: Vec<MethodFigures>,
    /// Flights on a collision course alone; none where there is none.
    pub collisions: Option<CollisionFigures>,
    /// Algorithm 1 alone; none where the model has no regressors or no target can be followed.
    pub regressors: Option<RegressorFigures>,
    /// Main figures of each method.
    #[serde(flatten)]
    pub in_use: InUse,
    /// Targets that the first method never found.
    pub misses: Vec<Mistake>,
    /// Its false alarms of highest score.
    pub false_alarms: Vec<Mistake>,
}

/// Figures of the detector in use.
#[derive(Debug, Clone, Default, Serialize)]
pub struct InUse {
    /// Benchmark of the registration.
    pub registration: Option<RegistrationFigures>,
    /// Precision stated by the model against precision found.
    pub reliability: Vec<reliability::ReliabilityRow>,
    /// False reports an hour where nothing flies.
    pub without_target: Option<WithoutTarget>,
    /// Probability of a track over distance.
    pub ranges: Vec<SpanRanges>,
}

/// The data set; the first frames of each clip are left out.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Flights {
    /// Number of clips that were evaluated.
    pub clips: usize,
    /// Number of frames that were evaluated.
    pub frames: u64,
    /// Hours of flight that these frames last.
    pub hours: f64,
    /// Targets that must be found.
    pub targets: usize,
    /// Ground-truth boxes of birds, which are background.
    pub bird_boxes: usize,
    /// Clips without a single target.
    pub clips_without_target: usize,
    /// Length of the clips without a target, hours.
    pub hours_without_target: f64,
}

/// How confidence intervals were made.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct BootstrapFigures {
    /// Sampling unit of the bootstrap: clips.
    pub over: &'static str,
    /// Number of resamples.
    pub resamples: usize,
    /// Seed of the draws.
    pub seed: u64,
    /// Share of draws inside.
    pub level: f64,
}

/// The figures of a method.
#[derive(Debug, Clone, Serialize)]
pub struct MethodFigures {
    /// Name of the method in the report.
    pub name: String,
    /// Median time of a frame, milliseconds; none where it was not measured.
    pub median_ms_per_frame: Option<f64>,
    /// By intersection over union.
    pub at_iou: Vec<AtIou>,
    /// At certain scores, matched at IoU 0.3.
    pub operating_points: Vec<OperatingPoint>,
    /// By groups of targets.
    pub breakdowns: Vec<Breakdown>,
}

/// The figures at an intersection over union.
#[derive(Debug, Clone, Serialize)]
pub struct AtIou {
    /// Figures that `lookout score` prints.
    pub score: score::AccuracyReport,
    /// Area under the precision-recall curve.
    #[serde(rename = "AveP")]
    pub average_precision: Interval,
    /// AveP of the first method less that of this one, on the same draws.
    pub first_less_this: Option<Interval>,
    /// Recall at 1, 10, 100 false alarms in 1000 frames.
    pub recall_at_false_alarms_per_1000_frames: Vec<Interval>,
    /// Recall, precision (the best at that recall or more).
    pub precision_recall: Vec<[f64; 2]>,
    /// False alarms in an hour, recall.
    pub recall_at_false_alarms_per_hour: Vec<[f64; 2]>,
}

/// Operating point of a method at a score.
#[derive(Debug, Clone, Serialize)]
pub struct OperatingPoint {
    /// Largest number of false alarms in 1000 frames; `None`: at any score.
    pub limit_per_1000_frames: Option<u64>,
    /// The score; `None` where even the highest has too many.
    pub threshold: Option<f64>,
    /// Share of targets found.
    pub recall: Option<f64>,
    /// False alarms in all.
    pub false_alarms: usize,
    /// False alarms in an hour.
    pub false_alarms_per_hour: f64,
    /// Detections on ground-truth boxes of birds.
    pub bird_detections: usize,
    /// The same in 1000 boxes on birds.
    pub bird_detections_per_1000_bird_boxes: Option<f64>,
    /// False alarms in clips without a target.
    pub false_alarms_without_target: usize,
    /// The same in an hour; none where there is no such clip.
    pub false_alarms_without_target_per_hour: Option<f64>,
}

/// Figures by groups of targets.
#[derive(Debug, Clone, Serialize)]
pub struct Breakdown {
    /// Name of the property that groups are formed by.
    pub by: &'static str,
    /// The same with its unit.
    pub heading: &'static str,
    /// One entry a group of targets.
    pub groups: Vec<GroupFigures>,
}

/// Counts of clips, frames and targets that were measured on.
pub fn flights(matches: &[ClipMatches], truth: &[ClipTruth<'_>]) -> Flights {
    let mut flights = Flights { clips: matches.len(), ..Flights::default() };
    for (matches, truth) in matches.iter().zip(truth) {
        let hours = hours(truth);
        flights.frames += truth.frames;
        flights.hours += hours;
        flights.targets += matches.targets.len();
        flights.bird_boxes += matches.birds;
        if !truth.has_target {
            flights.clips_without_target += 1;
            flights.hours_without_target += hours;
        }
    }
    flights
}

/// Parameters of the intervals of this report.
pub fn bootstrap_figures() -> BootstrapFigures {
    BootstrapFigures { over: "clips", resamples: RESAMPLES, seed: SEED, level: LEVEL }
}

/// The figures of all methods.
pub fn methods(
    methods: &[MethodDetections],
    matches: &[MethodMatches],
    truth: &[ClipTruth<'_>],
) -> Vec<MethodFigures> {
    let bootstrap = Bootstrap::new(truth.len(), RESAMPLES, SEED);
    let dimensions = Dimension::all(truth);
    let mut first: Vec<Sampled> = Vec::new();
    let mut all: Vec<MethodFigures> = Vec::new();
    for (method, matches) in methods.iter().zip(matches) {
        let mut at_iou = Vec::new();
        let mut loose = Ranking::default();
        for (i, (iou, matches)) in IOUS.iter().zip(matches).enumerate() {
            let mut scorer = Scorer::new(*iou, WARMUP);
            matches.iter().for_each(|matches| scorer.add_matches(matches));
            let (report, ranking) = (scorer.clone().report(), scorer.ranking());
            let sampled = bootstrap.sample(&ranking, Ranking::average_precision);
            let first_less_this = all.first().map(|_| first[i].less(&sampled).interval());
            let recall = |limit: u64| {
                bootstrap
                    .sample(&ranking, |ranking, times| ranking.recall_at(times, limit))
                    .interval()
            };
            let hours = truth.iter().map(hours).sum();
            at_iou.push(AtIou {
                score: report,
                average_precision: sampled.interval(),
                first_less_this,
                recall_at_false_alarms_per_1000_frames: FALSE_ALARMS.map(recall).into(),
                precision_recall: curves::precision_recall(&ranking),
                recall_at_false_alarms_per_hour: curves::recall_per_hour(&ranking, hours),
            });
            if all.is_empty() {
                first.push(sampled);
            }
            if i == LOOSE {
                loose = ranking;
            }
        }
        let threshold = loose.threshold(FALSE_ALARMS[1]);
        let breakdown = |dimension: &Dimension| {
            let rankings: Vec<Vec<Ranking>> =
                matches.iter().map(|j| dimension.rankings(truth, j, &method.clips)).collect();
            let groups = breakdown::figures(dimension, &rankings, threshold, &bootstrap);
            Breakdown { by: dimension.name, heading: dimension.heading, groups }
        };
        all.push(MethodFigures {
            name: method.name.clone(),
            median_ms_per_frame: method.median_ms,
            operating_points: operating_points(&loose, &matches[LOOSE], truth),
            breakdowns: dimensions.iter().map(breakdown).collect(),
            at_iou,
        });
    }
    all
}

fn operating_points(
    ranking: &Ranking,
    matches: &[ClipMatches],
    truth: &[ClipTruth<'_>],
) -> Vec<OperatingPoint> {
    let flights = flights(matches, truth);
    let limits = FALSE_ALARMS.map(Some).into_iter().chain([None]);
    let point = |limit: Option<u64>| {
        let threshold = match limit {
            Some(limit) => ranking.threshold(limit),
            None => matches
                .iter()
                .flat_map(|j| j.detections.iter().map(|d| d.score))
                .min_by(f64::total_cmp),
        };
        let count = |clip: &ClipMatches, wanted: fn(Match) -> bool| {
            let counts = |score: f64| threshold.is_some_and(|threshold| score >= threshold);
            clip.detections.iter().filter(|d| counts(d.score) && wanted(d.kind)).count()
        };
        let all = |wanted| matches.iter().map(|clip| count(clip, wanted)).sum::<usize>();
        let is_alarm = |v| v == Match::FalsePositive;
        let false_alarms = all(is_alarm);
        let found = all(|v| matches!(v, Match::TruePositive(_)));
        let bird_detections = all(|v| v == Match::Ignored { bird: true });
        let without = matches.iter().zip(truth).filter(|(_, truth)| !truth.has_target);
        let without: usize = without.map(|(clip, _)| count(clip, is_alarm)).sum();
        let hours_without = flights.hours_without_target;
        OperatingPoint {
            limit_per_1000_frames: limit,
            threshold,
            recall: share(found, flights.targets),
            false_alarms,
            false_alarms_per_hour: if flights.hours > 0.0 {
                false_alarms as f64 / flights.hours
            } else {
                0.0
            },
            bird_detections,
            bird_detections_per_1000_bird_boxes: share(bird_detections * 1000, flights.bird_boxes),
            false_alarms_without_target: without,
            false_alarms_without_target_per_hour: (hours_without > 0.0)
                .then(|| without as f64 / hours_without),
        }
    };
    limits.map(point).collect()
}

fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

/// Label of a limit of false alarms.
pub fn limit_name(limit: Option<u64>) -> String {
    limit.map_or("any score".into(), |limit| format!("{limit} per 1000 frames"))
}
