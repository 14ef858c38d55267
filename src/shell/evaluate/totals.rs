//! Sums over clips that the figures of a run are made of. Clips are added one by one and not kept: memory grows with them
//! by the counts of right and wrong detections alone, 128 bytes a clip, which the intervals need.

use super::accuracy::AccuracyTally;
use super::bootstrap::{Bootstrap, RESAMPLES, SEED};
use super::clip_run::{ClipResult, ScanCounts};
use super::facts::Facts;
use super::kinds::{KindClip, KindTally};
use super::matching::{self, ClipMatches, WARMUP};
use super::ranges::RangeTally;
use super::registration::RegistrationTally;
use super::reliability::ReliabilityTally;
use super::report::{IOUS, LOOSE};
use super::score::AccuracyReport;
use super::splits::{Splits, UnusableClip};
use super::summary::{EvaluationSummary, SplitSummary, WorkingPoint};
use super::track_figures::TrackTally;
use super::without_target::{QuietClip, WithoutTargetTally};
use crate::model::Model;
use crate::shell::formats::clips::Clip;
use crate::shell::support::file_error::FileError;
use std::format;
use std::path::PathBuf;
use std::string::String;
use std::vec::Vec;

/// Settings of a summary.
#[derive(Debug, Clone, Copy)]
pub struct SummaryInputs<'a> {
    /// Name of the method, where several are run.
    pub method: Option<&'a str>,
    /// Folders of the splits that were evaluated.
    pub folders: &'a [PathBuf],
    /// The model; none where nothing is learned or detections are read from files.
    pub model: Option<&'a Model<'a>>,
    /// Least score of detections that count, log-odds.
    pub least: Option<f64>,
    /// Whether to print figures of tracks.
    pub tracks: bool,
    /// Field of view that stands in for missing `camera.json`, degrees.
    pub assumed_fov: f64,
}

/// Sums over the clips of one split, or of all.
#[derive(Debug)]
struct SplitTotals {
    clips: usize,
    hours: f64,
    reports: Vec<AccuracyTally>,
}

impl SplitTotals {
    fn new() -> Self {
        Self { clips: 0, hours: 0.0, reports: IOUS.map(AccuracyTally::new).into() }
    }

    fn add(&mut self, hours: f64, matches: &[ClipMatches]) -> Result<(), FileError> {
        self.clips += 1;
        self.hours += hours;
        self.reports.iter_mut().zip(matches).try_for_each(|(tally, own)| tally.add(own))
    }

    fn reports(self) -> Result<Vec<AccuracyReport>, FileError> {
        self.reports.into_iter().map(AccuracyTally::report).collect()
    }
}

/// Sums over clips.
#[derive(Debug)]
pub struct Totals<'a> {
    inputs: SummaryInputs<'a>,
    point: WorkingPoint,
    all: SplitTotals,
    /// By split, where there are several.
    splits: Vec<SplitTotals>,
    reliability: Option<ReliabilityTally>,
    kinds: KindTally,
    quiet: WithoutTargetTally,
    scan: ScanCounts,
    registration: RegistrationTally,
    tracks: TrackTally,
    ranges: RangeTally,
    /// Clips that were followed.
    followed: usize,
    small_frames: bool,
}

/// Length of a clip, hours.
fn hours(result: &ClipResult, facts: &Facts) -> f64 {
    result.frames as f64 / facts.rate / 3600.0
}

impl<'a> Totals<'a> {
    /// Of no clip.
    pub fn new(inputs: SummaryInputs<'a>) -> Self {
        let several = inputs.folders.len() > 1;
        Self {
            inputs,
            point: WorkingPoint::new(inputs.model, inputs.least),
            all: SplitTotals::new(),
            splits: inputs.folders.iter().filter(|_| several).map(|_| SplitTotals::new()).collect(),
            reliability: inputs.model.map(|model| ReliabilityTally::new(model, inputs.least)),
            kinds: KindTally::default(),
            quiet: WithoutTargetTally::default(),
            scan: ScanCounts::default(),
            registration: RegistrationTally::default(),
            tracks: TrackTally::default(),
            ranges: RangeTally::default(),
            followed: 0,
            small_frames: false,
        }
    }

    /// Adds a clip of the split number `split`.
    ///
    /// # Errors
    /// [`FileError::Write`] of a temporary file.
    pub fn add(
        &mut self,
        clip: &Clip,
        facts: &Facts,
        split: usize,
        result: &ClipResult,
    ) -> Result<(), FileError> {
        let hours = hours(result, facts);
        let matches = IOUS
            .map(|iou| matching::match_detections(&clip.ground_truth, &result.found, iou, WARMUP));
        let score = self.point.score;
        self.all.add(hours, &matches)?;
        if let Some(own) = self.splits.get_mut(split) {
            own.add(hours, &matches)?;
        }
        if let Some(loose) = matches.get(LOOSE) {
            if let Some(reliability) = &mut self.reliability {
                reliability.add(loose);
            }
            let seen = result.frames > 0 && self.inputs.model.is_some();
            let textures = seen.then_some(result.textures.as_slice());
            self.kinds.add(&KindClip { matches: loose, textures, facts }, score);
            if !clip.ground_truth.has_target() {
                let tracks = result.tracks.as_ref();
                self.quiet.add(&QuietClip { matches: loose, tracks, facts, hours }, score);
            }
        }
        self.scan.add(&result.scan);
        if let Some(registration) = &result.registration {
            self.registration.add(registration)?;
        }
        if let Some(tracks) = &result.tracks {
            self.followed += 1;
            self.tracks.add(tracks)?;
            self.ranges.add(tracks, facts)?;
        }
        self.small_frames |= (1..400).contains(&result.size.0);
        Ok(())
    }

    /// Adds the clips of `splits` with their results, in their order.
    ///
    /// # Errors
    /// As [`Totals::add`].
    pub fn add_all(&mut self, splits: &Splits, results: &[ClipResult]) -> Result<(), FileError> {
        let clips = splits.clips.iter().zip(&splits.facts).zip(&splits.split);
        clips
            .zip(results)
            .try_for_each(|(((clip, facts), split), result)| self.add(clip, facts, *split, result))
    }

    /// The figures; `broken` are the clips that took no part.
    ///
    /// # Errors
    /// As [`Totals::add`].
    pub fn finish(self, broken: &[UnusableClip]) -> Result<EvaluationSummary, FileError> {
        let SummaryInputs { method, folders, model, tracks, assumed_fov, .. } = self.inputs;
        let data: Vec<String> = folders.iter().map(|f| format!("{}", f.display())).collect();
        let SplitTotals { clips, hours, .. } = self.all;
        let all_followed = self.followed == clips;
        let bootstrap = Bootstrap::new(clips, RESAMPLES, SEED);
        let splits = data.iter().zip(self.splits).map(|(data, split)| {
            let SplitTotals { clips, hours, .. } = split;
            Ok(SplitSummary { data: data.clone(), clips, hours, reports: split.reports()? })
        });
        Ok(EvaluationSummary {
            splits: splits.collect::<Result<_, FileError>>()?,
            method: method.map(Into::into),
            data,
            clips,
            hours,
            reports: self.all.reports()?,
            working_point: self.point,
            reliability: self.reliability.map(|tally| tally.rows(&bootstrap)),
            kinds: self.kinds.rows(),
            without_target: self.quiet.figures(self.point.score),
            scan: model.map(|_| self.scan.into()),
            registration: model.map(|_| self.registration.figures()).transpose()?,
            tracks: (tracks && all_followed).then(|| self.tracks.figures()).transpose()?,
            ranges: if all_followed { self.ranges.figures()? } else { Vec::new() },
            broken: broken.to_vec(),
            assumed_fov,
            small_frames: self.small_frames && model.is_some(),
        })
    }
}
