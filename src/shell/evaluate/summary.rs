//! All figures of a run, as `lookout eval` and `lookout score` print them: tables for a person, or one line of JSON.

use super::bootstrap::{Bootstrap, RESAMPLES, SEED};
use super::clip_run::{ClipResult, ScanCounts, ScanFigures};
use super::facts::Facts;
use super::kinds::{self, KindClip};
use super::matching::{self, ClipMatches, WARMUP};
use super::ranges::{self, SpanRanges};
use super::registration::RegistrationFigures;
use super::reliability::{self, WORKING_PRECISION};
use super::report::{IOUS, InUse, LOOSE};
use super::score::{AccuracyReport, FALSE_ALARMS, PRECISIONS, Scorer};
use super::splits::{Splits, UnusableClip};
use super::table::{Table, number};
use super::track_figures::TrackFigures;
use super::without_target::{QuietClip, WithoutTarget};
use crate::model::Model;
use crate::shell::error::Error;
use crate::shell::support::print::print_line;
use serde::Serialize;
use std::string::String;
use std::vec::Vec;
use std::{eprintln, format};

/// The score from which on detections count where one score must be chosen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct WorkingPoint {
    /// The score, log-odds; none: every detection.
    pub score: Option<f64>,
    /// The precision that the model states for it; none where it was given as a score.
    pub stated_precision: Option<f64>,
}

impl WorkingPoint {
    /// The score of `--threshold`, else the model's score for a precision of 0.9.
    pub fn new(model: Option<&Model<'_>>, least: Option<f64>) -> Self {
        if least.is_some() {
            return Self { score: least, stated_precision: None };
        }
        let score = model.and_then(|model| reliability::score_of(model, WORKING_PRECISION));
        Self { score, stated_precision: score.map(|_| WORKING_PRECISION) }
    }

    /// In words.
    fn name(&self) -> String {
        match (self.score, self.stated_precision) {
            (_, Some(precision)) => format!("at stated precision {precision}"),
            (Some(score), None) => format!("from score {score:.3}"),
            (None, None) => "at any score".into(),
        }
    }
}

/// Accuracy on the clips of one split.
#[derive(Debug, Clone, Serialize)]
struct SplitSummary {
    data: String,
    clips: usize,
    hours: f64,
    reports: Vec<AccuracyReport>,
}

/// All figures of a run.
#[derive(Debug, Clone, Serialize)]
pub struct EvaluationSummary {
    #[serde(skip_serializing_if = "Option::is_none")]
    method: Option<String>,
    data: Vec<String>,
    clips: usize,
    /// Length of all clips, hours.
    hours: f64,
    /// By intersection over union.
    reports: Vec<AccuracyReport>,
    /// By split, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    splits: Vec<SplitSummary>,
    working_point: WorkingPoint,
    #[serde(skip_serializing_if = "Option::is_none")]
    reliability: Option<Vec<reliability::ReliabilityRow>>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    kinds: Vec<kinds::KindRow>,
    #[serde(skip_serializing_if = "Option::is_none")]
    without_target: Option<WithoutTarget>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scan: Option<ScanFigures>,
    #[serde(skip_serializing_if = "Option::is_none")]
    registration: Option<RegistrationFigures>,
    #[serde(skip_serializing_if = "Option::is_none")]
    tracks: Option<TrackFigures>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    ranges: Vec<SpanRanges>,
    /// Clips that took no part.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    broken: Vec<UnusableClip>,
}

/// Inputs of a summary.
#[derive(Debug, Clone, Copy)]
pub struct SummaryInputs<'a> {
    /// Name of the method, where several are run.
    pub method: Option<&'a str>,
    /// Splits that were evaluated.
    pub splits: &'a Splits,
    /// One result a clip, in the order of the splits.
    pub results: &'a [ClipResult],
    /// The model; none where nothing is learned or detections are read from files.
    pub model: Option<&'a Model<'a>>,
    /// Least score of detections that count, log-odds.
    pub least: Option<f64>,
    /// Whether to print figures of tracks.
    pub tracks: bool,
    /// Field of view that stands in for missing `camera.json`, degrees.
    pub assumed_fov: f64,
}

/// Length of a clip, hours.
fn hours(result: &ClipResult, facts: &Facts) -> f64 {
    result.frames as f64 / facts.rate / 3600.0
}

impl EvaluationSummary {
    /// Summary of a run.
    pub fn new(parts: SummaryInputs<'_>) -> Self {
        let SummaryInputs { splits, results, model, .. } = parts;
        let clips = || splits.clips.iter().zip(results);
        let matches = IOUS.map(|iou| {
            let own = clips().map(|(clip, result)| {
                matching::match_detections(&clip.ground_truth, &result.found, iou, WARMUP)
            });
            own.collect::<Vec<ClipMatches>>()
        });
        let reports = |wanted: &dyn Fn(usize) -> bool| {
            let of_iou = |(iou, matches): (&f64, &Vec<ClipMatches>)| {
                let mut scorer = Scorer::new(*iou, WARMUP);
                let own = matches.iter().enumerate().filter(|(clip, _)| wanted(*clip));
                own.for_each(|(_, matches)| scorer.add_matches(matches));
                scorer.report()
            };
            IOUS.iter().zip(&matches).map(of_iou).collect::<Vec<AccuracyReport>>()
        };
        let lengths: Vec<f64> =
            results.iter().zip(&splits.facts).map(|(r, f)| hours(r, f)).collect();
        let split = |number: usize| SplitSummary {
            data: format!("{}", splits.folders[number].display()),
            clips: splits.split.iter().filter(|&&split| split == number).count(),
            hours: (0..lengths.len())
                .filter(|&clip| splits.split[clip] == number)
                .map(|clip| lengths[clip])
                .sum(),
            reports: reports(&|clip| splits.split[clip] == number),
        };
        let several = splits.folders.len() > 1;
        let loose = &matches[LOOSE];
        let point = WorkingPoint::new(model, parts.least);
        let mut scan = ScanCounts::default();
        results.iter().for_each(|result| scan.add(&result.scan));
        let tracks: Vec<_> = results.iter().filter_map(|result| result.tracks.as_ref()).collect();
        let all_followed = tracks.len() == results.len();
        let ranged: Vec<_> =
            tracks.iter().copied().zip(&splits.facts).filter(|_| all_followed).collect();
        let registration = results.iter().filter_map(|result| result.registration.as_ref());
        let quiet = (0..results.len()).filter(|&i| !splits.clips[i].ground_truth.has_target());
        let quiet: Vec<QuietClip<'_>> = quiet
            .map(|i| QuietClip {
                matches: &loose[i],
                tracks: results[i].tracks.as_ref(),
                facts: &splits.facts[i],
                hours: lengths[i],
            })
            .collect();
        let kinds: Vec<KindClip<'_>> = (0..results.len())
            .map(|i| KindClip {
                matches: &loose[i],
                textures: (results[i].frames > 0 && model.is_some())
                    .then_some(results[i].textures.as_slice()),
                facts: &splits.facts[i],
            })
            .collect();
        let bootstrap = Bootstrap::new(results.len(), RESAMPLES, SEED);
        Self {
            method: parts.method.map(Into::into),
            data: splits.folders.iter().map(|f| format!("{}", f.display())).collect(),
            clips: results.len(),
            hours: lengths.iter().sum(),
            reports: reports(&|_| true),
            splits: (0..splits.folders.len()).filter(|_| several).map(split).collect(),
            working_point: point,
            reliability: model
                .map(|model| reliability::rows(model, parts.least, loose, &bootstrap)),
            kinds: kinds::rows(&kinds, point.score),
            without_target: WithoutTarget::new(&quiet, point.score),
            scan: model.map(|_| scan.into()),
            registration: model.map(|_| RegistrationFigures::new(registration)),
            tracks: (parts.tracks && all_followed).then(|| TrackFigures::new(&tracks)),
            ranges: ranges::figures(&ranged),
            broken: splits.broken.clone(),
        }
    }

    /// The figures that a report shows beside its own.
    pub fn in_use(&self) -> InUse {
        InUse {
            registration: self.registration,
            reliability: self.reliability.clone().unwrap_or_default(),
            without_target: self.without_target.clone(),
            ranges: self.ranges.clone(),
        }
    }

    /// Prints it.
    ///
    /// # Errors
    /// [`Error::Write`](crate::shell::support::file_error::FileError::Write).
    #[allow(clippy::expect_used, reason = "numbers and names always make JSON")]
    pub fn print(&self, parts: SummaryInputs<'_>, json: bool) -> Result<(), Error> {
        if json {
            let text = serde_json::to_string(self).expect("numbers and names always make JSON");
            return Ok(print_line(&text)?);
        }
        for (split, number) in self.splits.iter().zip(1..) {
            let SplitSummary { data, clips, hours, reports } = split;
            let title = title(&format!("Split {number}: {data}"), *clips, *hours, reports);
            print_line(&format!("{title}\n\n{}\n", accuracy(reports).text()))?;
        }
        let name = match (&self.method, self.data.len()) {
            (Some(method), _) => format!("Method {method}, {}", self.data.join(", ")),
            (None, 1) => self.data.join(""),
            (None, splits) => format!("All {splits} splits together"),
        };
        let first = title(&name, self.clips, self.hours, &self.reports);
        print_line(&format!("{first}\n\n{}", accuracy(&self.reports).text()))?;
        let point = self.working_point.name();
        if let Some(rows) = self.reliability.as_ref().filter(|rows| !rows.is_empty()) {
            let table = reliability::table(rows).text();
            print_line(&format!(
                "\nReliability of the model's precisions, IoU {}\n{table}",
                IOUS[LOOSE]
            ))?;
        }
        if !self.kinds.is_empty() {
            print_line(&format!("\n{}", kinds::table(&self.kinds, &point).text()))?;
        }
        if let Some(quiet) = &self.without_target {
            print_line(&format!("\n{}\nDetections counted {point}.", quiet.table().text()))?;
        }
        if let (Some(scan), Some(registration)) = (&self.scan, &self.registration) {
            print_line(&format!("\n{}", detector_table(scan, registration).text()))?;
        }
        if let Some(tracks) = &self.tracks {
            print_line(&format!("\n{tracks}"))?;
            if !self.ranges.is_empty() {
                print_line(&format!("\n{}", ranges::table(&self.ranges).text()))?;
            }
            if tracks.assumed_cameras > 0 {
                print_line(&format!(
                    "\n{} of {} clips have no camera.json: a horizontal field of view of {} degrees is assumed (--fov).",
                    tracks.assumed_cameras, self.clips, parts.assumed_fov
                ))?;
            }
            if tracks.without_attitude > 0 {
                print_line(&format!(
                    "{} of {} clips are followed without attitudes, by the pictures' own motion.",
                    tracks.without_attitude, self.clips
                ))?;
            }
        }
        let small = |result: &ClipResult| (1..400).contains(&result.size.0);
        if parts.model.is_some() && parts.results.iter().any(small) {
            eprintln!(
                "lookout: frames less than 400 px wide: the shipped model is made for 640x480; lookout-mini.lkm is for small frames, \
                 or let them be scaled up with --frame 640x480"
            );
        }
        Ok(())
    }
}

fn title(name: &str, clips: usize, hours: f64, reports: &[AccuracyReport]) -> String {
    let (frames, targets) = reports.first().map_or((0, 0), |r| (r.frames, r.positives));
    let length = if hours > 0.0 { format!(" ({hours:.4} hours)") } else { String::new() };
    format!("{name}: {clips} clips, {frames} frames{length}, {targets} targets")
}

/// Accuracy at each intersection over union, side by side.
fn accuracy(reports: &[AccuracyReport]) -> Table {
    let columns: Vec<String> = reports.iter().map(|r| format!("IoU {}", r.iou)).collect();
    let mut heads = Vec::from(["Accuracy"]);
    heads.extend(columns.iter().map(String::as_str));
    let mut table = Table::new(&heads);
    let mut row = |name: String, cell: &dyn Fn(&AccuracyReport) -> String| {
        let cells: Vec<String> = [name].into_iter().chain(reports.iter().map(cell)).collect();
        table.row(&cells);
    };
    row("average precision (AveP)".into(), &|r| format!("{:.4}", r.average_precision));
    for (i, precision) in PRECISIONS.iter().enumerate() {
        row(format!("recall at precision {precision}"), &|r| {
            format!("{:.4}", r.recall_at_precision[i])
        });
    }
    for (i, limit) in FALSE_ALARMS.iter().enumerate() {
        let alarms = if *limit == 1 { "alarm" } else { "alarms" };
        row(format!("recall at {limit} false {alarms} in 1000 frames"), &|r| {
            format!("{:.4}", r.recall_at_false_alarms[i])
        });
    }
    row("detections that count".into(), &|r| format!("{}", r.detections));
    let Some(first) = reports.first() else { return table };
    for (i, share) in first.by_size.iter().enumerate() {
        row(format!("recall at any score, {} px ({} targets)", share.name, share.targets), &|r| {
            number(r.by_size[i].recall, 3)
        });
    }
    for (i, share) in first.by_class.iter().enumerate() {
        row(format!("recall at any score, {} ({} targets)", share.name, share.targets), &|r| {
            number(r.by_class[i].recall, 3)
        });
    }
    table
}

fn detector_table(scan: &ScanFigures, registration: &RegistrationFigures) -> Table {
    let mut table = Table::new(&["Detector", ""]);
    let mut row = |name: &str, value: String| table.row(&[name, &value]);
    row("windows scanned in a frame", format!("{:.0}", scan.windows_per_frame));
    row("windows kept in a frame", format!("{:.2}", scan.windows_kept_per_frame));
    row("windows beyond the limit, not classified", format!("{}", scan.dropped));
    row("share of targets that the scan proposes", number(scan.scan_recall, 4));
    row("frames registered, share", number(registration.share_registered, 4));
    row(
        "difference to the frame before, median (grey levels)",
        number(registration.residual_without, 2),
    );
    row("the same after registration", number(registration.residual, 2));
    row("the same, 95 % of the frames below", number(registration.residual_95, 2));
    table
}
