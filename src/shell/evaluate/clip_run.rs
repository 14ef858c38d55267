//! Runs the detector on one clip and measures it.

use super::contrast::texture;
use super::matching::{DetectionRecord, WARMUP, must_be_found, rect};
use super::registration::{ClipRegistration, RegistrationWatch};
use super::report::{self, FrameMeasurements, Plan};
use super::track_metrics::{ClipTracks, ClipWatch, FollowSettings};
use crate::detector::Detections;
use crate::model::Model;
use crate::shell::error::Error;
use crate::shell::formats::clips::{Clip, TruthBox};
use crate::shell::formats::detections::{self, TextFile};
use crate::shell::pipeline::{self, DetectorArgs};
use crate::shell::sources::{Frame, FrameSource, SourceError};
use serde::{Deserialize, Serialize};
use std::boxed::Box;
use std::cell::Cell;
use std::fs;
use std::path::Path;
use std::time::Instant;
use std::vec::Vec;

/// Results of one clip.
#[derive(Debug, Default)]
pub struct ClipResult {
    /// Detections of all frames, in the order of the frames.
    pub found: Vec<DetectionRecord>,
    /// Counts of the scan.
    pub scan: ScanCounts,
    /// Time of each frame in the detector, milliseconds.
    pub times_ms: Vec<f64>,
    /// Size of the frames.
    pub size: (usize, usize),
    /// Frames of the clip.
    pub frames: u64,
    /// Frames a second by the frames' own times; none for one frame.
    pub rate: Option<f64>,
    /// Registration from frame to frame; none without a model.
    pub registration: Option<ClipRegistration>,
    /// Texture around each target that must be found, grey levels.
    pub textures: Vec<f64>,
    /// Additional data for a report.
    pub seen: Option<FrameMeasurements>,
    /// Results of tracker and alerts; `None` without `--tracks`.
    pub tracks: Option<ClipTracks>,
}

/// Counts of the scan, summed over frames.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct ScanCounts {
    frames: u64,
    windows: u64,
    kept: u64,
    dropped: u64,
    registered: u64,
    targets: u64,
    proposed: u64,
}

impl ScanCounts {
    fn add_frame(&mut self, detections: &Detections) {
        self.frames += 1;
        self.windows += u64::from(detections.windows);
        self.kept += u64::from(detections.kept);
        self.dropped += u64::from(detections.dropped);
        self.registered += u64::from(detections.registered);
    }

    /// Counts the frame's targets (those that the scorer counts) and which of them the scan handed on: a window whose
    /// middle is within half its nominal target of the target's, of half to twice its length.
    fn add_targets(&mut self, truth: &[TruthBox], detections: &Detections) {
        for target in truth.iter().filter(|t| must_be_found(t)) {
            let length = target.longer_side();
            let found = detections.proposals.iter().any(|rect| {
                let [x, y, side] = [rect.x, rect.y, rect.width].map(|v| v.to_num::<f64>());
                let dx = x + side / 2.0 - target.left - target.width / 2.0;
                let dy = y + side / 2.0 - target.top - target.height / 2.0;
                dx.abs().max(dy.abs()) <= side / 2.0 && (0.5..=2.0).contains(&(side / length))
            });
            self.targets += 1;
            self.proposed += u64::from(found);
        }
    }

    /// Adds the counts of another clip.
    pub fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.windows += other.windows;
        self.kept += other.kept;
        self.dropped += other.dropped;
        self.registered += other.registered;
        self.targets += other.targets;
        self.proposed += other.proposed;
    }
}

/// The scan's figures as they are printed.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ScanFigures {
    /// Number of frames.
    pub frames: u64,
    /// Windows evaluated in a frame.
    pub windows_per_frame: f64,
    /// Windows handed on in a frame.
    pub windows_kept_per_frame: f64,
    /// Windows handed on for which there was no room, in all.
    pub dropped: u64,
    /// Share of frames whose background motion was measured.
    pub share_registered: f64,
    /// Share of targets that a window handed on was on; none without targets.
    pub scan_recall: Option<f64>,
}

impl From<ScanCounts> for ScanFigures {
    fn from(counts: ScanCounts) -> Self {
        let a_frame = |count: u64| count as f64 / counts.frames.max(1) as f64;
        let targets = counts.targets;
        Self {
            frames: counts.frames,
            windows_per_frame: a_frame(counts.windows),
            windows_kept_per_frame: a_frame(counts.kept),
            dropped: counts.dropped,
            share_registered: a_frame(counts.registered),
            scan_recall: (targets > 0).then(|| counts.proposed as f64 / targets as f64),
        }
    }
}

/// Command-line options of a run.
#[derive(Debug, Clone, Copy)]
pub struct RunSettings<'a> {
    /// None where nothing is learned.
    pub model: Option<&'a Model<'a>>,
    /// Switches of the detector on the command line.
    pub detector: &'a DetectorArgs,
    /// Settings of the tracker; `None`: no tracking.
    pub follow: Option<FollowSettings>,
    /// Folder that detections are written to, one file a clip.
    pub out: Option<&'a Path>,
}

/// Runs a detector on clip number `index`; `kind` is its kind of encounter.
///
/// # Errors
/// Those of the clip's files, of the detector, of the files written.
pub fn run(
    index: usize,
    clip: &Clip,
    kind: Option<&str>,
    settings: RunSettings<'_>,
    plan: Option<&Plan>,
) -> Result<ClipResult, Error> {
    let input = clip.input.to_string_lossy();
    let mut result = ClipResult::default();
    let delivered = Cell::new(Instant::now());
    let mut source = Stamped { source: clip.open()?, delivered: &delivered };
    let path = settings.out.map(|out| report::path_of(out, clip));
    if let Some(folder) = path.as_deref().and_then(Path::parent) {
        fs::create_dir_all(folder).map_err(Error::write(folder))?;
    }
    let mut file = path.as_deref().map(TextFile::create).transpose()?;
    let lines = path.as_deref().map(|path| path.with_extension("jsonl"));
    let mut lines = lines.as_deref().map(TextFile::create).transpose()?;
    let mut watch = plan.map(|plan| plan.watch(clip, index));
    let tracks = settings.follow.filter(|_| settings.model.is_some());
    let mut tracks = tracks.map(|follow| ClipWatch::new(clip, kind, follow)).transpose()?;
    let mut registration = RegistrationWatch::default();
    let mut last_us = 0;
    let mut each = |number, frame: &Frame, detections: &Detections| {
        let time_ms = delivered.get().elapsed().as_secs_f64() * 1e3;
        result.times_ms.push(time_ms);
        result.size = (frame.width, frame.height);
        (result.frames, last_us) = (number, frame.time_us);
        result.scan.add_frame(detections);
        let truth = clip.ground_truth.frame(number);
        if number > WARMUP {
            result.scan.add_targets(truth, detections);
            let targets = truth.iter().filter(|t| must_be_found(t));
            result.textures.extend(targets.map(|t| texture(frame, &rect(t))));
        }
        registration.frame(frame, detections);
        let first = result.found.len();
        result.found.extend(detections::found(number, detections));
        if let Some(watch) = &mut watch {
            watch.frame(number, frame, &result.found[first..], time_ms);
        }
        if let Some(tracks) = &mut tracks {
            let (list, motion) = (&detections.list, &detections.motion);
            tracks.frame(number, frame.time_us, result.size, list, motion)?;
        }
        if let Some(file) = &mut file {
            file.write(&detections::mot_lines(number, detections))?;
        }
        if let Some(lines) = &mut lines {
            lines.write(&detections::json_line(number, frame.time_us, detections, None))?;
        }
        Ok(())
    };
    match settings.model {
        Some(model) => {
            pipeline::run::<Error>(&input, &mut source, model, settings.detector, &mut each)?
        }
        None => {
            let threshold = settings.detector.threshold;
            pipeline::run_difference::<Error>(&input, &mut source, threshold, &mut each)?
        }
    };
    result.rate = (result.frames > 1 && last_us > 0)
        .then(|| (result.frames - 1) as f64 * 1e6 / last_us as f64);
    result.registration = settings.model.map(|_| registration.finish());
    result.seen = watch.map(report::MeasuringObserver::finish);
    result.tracks = tracks.map(ClipWatch::finish);
    Ok(result)
}

/// A source that notes when it delivered its last frame: what comes after is the detector's time.
struct Stamped<'a> {
    source: Box<dyn FrameSource>,
    delivered: &'a Cell<Instant>,
}

impl FrameSource for Stamped<'_> {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        let more = self.source.next_frame(frame);
        self.delivered.set(Instant::now());
        more
    }
}
