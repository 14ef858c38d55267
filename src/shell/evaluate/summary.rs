//! All figures of a run, as `lookout eval` and `lookout score` print them: tables for a person, or one line of JSON.

use super::clip_run::ScanFigures;
use super::kinds;
use super::ranges::{self, SpanRanges};
use super::registration::RegistrationFigures;
use super::reliability::{self, WORKING_PRECISION};
use super::report::{IOUS, InUse, LOOSE};
use super::score::{AccuracyReport, FALSE_ALARMS, PRECISIONS};
use super::splits::UnusableClip;
use super::table::{Table, number};
use super::track_figures::TrackFigures;
use super::without_target::WithoutTarget;
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
pub struct SplitSummary {
    /// Folder of the split, as the user named it.
    pub data: String,
    /// Number of clips.
    pub clips: usize,
    /// Length of the clips, hours.
    pub hours: f64,
    /// By intersection over union.
    pub reports: Vec<AccuracyReport>,
}

/// All figures of a run.
#[derive(Debug, Clone, Serialize)]
pub struct EvaluationSummary {
    /// Name of the method, where several are run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<String>,
    /// Folders of the splits.
    pub data: Vec<String>,
    /// Number of clips.
    pub clips: usize,
    /// Length of all clips, hours.
    pub hours: f64,
    /// By intersection over union.
    pub reports: Vec<AccuracyReport>,
    /// By split, where there are several.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub splits: Vec<SplitSummary>,
    /// Score from which on detections count where one must be chosen.
    pub working_point: WorkingPoint,
    /// The model's precisions against those found.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reliability: Option<Vec<reliability::ReliabilityRow>>,
    /// Recall by kind of encounter.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub kinds: Vec<kinds::KindRow>,
    /// False reports an hour on clips without a target.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub without_target: Option<WithoutTarget>,
    /// Counts of the scan.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scan: Option<ScanFigures>,
    /// Registration over all clips.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub registration: Option<RegistrationFigures>,
    /// Figures of tracks and warnings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracks: Option<TrackFigures>,
    /// Tracks by distance.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ranges: Vec<SpanRanges>,
    /// Clips that took no part.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub broken: Vec<UnusableClip>,
    /// Field of view that stands in for missing `camera.json`, degrees.
    #[serde(skip)]
    pub assumed_fov: f64,
    /// Whether there are frames smaller than the shipped model is made for.
    #[serde(skip)]
    pub small_frames: bool,
}

impl EvaluationSummary {
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
    pub fn print(&self, json: bool) -> Result<(), Error> {
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
                    tracks.assumed_cameras, self.clips, self.assumed_fov
                ))?;
            }
            if tracks.without_attitude > 0 {
                print_line(&format!(
                    "{} of {} clips are followed without attitudes, by the pictures' own motion.",
                    tracks.without_attitude, self.clips
                ))?;
            }
        }
        if self.small_frames {
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
