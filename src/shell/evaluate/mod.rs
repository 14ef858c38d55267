//! `lookout eval`: accuracy on a folder of clips, with a report if wanted. `lookout score`: the same for detections that are there already.

pub mod matching;
pub mod ranking;
pub mod report;
pub mod score;
pub mod track_metrics;

use super::error::Error;
use super::formats::clips::{self, Clip, TruthBox};
use super::formats::detections::{self, TextFile};
use super::pipeline::methods::MethodName;
use super::pipeline::{self, DetectorArgs, ModelFile};
use super::sources::{self, Frame, FrameSource, SourceError};
use super::support::interrupt::{self, Ended};
use crate::detector::Detections;
use crate::model::Model;
use crate::shell::pipeline::on_clips;
use crate::shell::support::print::print_line;
use crate::tracking::Settings;
use crate::tracking::tracker;
use report::{IOUS, Plan, ReportArgs, Seen};
use score::{Found, Report, Scorer, WARMUP};
use serde::Serialize;
use std::boxed::Box;
use std::cell::Cell;
use std::path::PathBuf;
use std::string::{String, ToString};
use std::time::Instant;
use std::vec::Vec;
use std::{eprintln, format, fs};
use track_metrics::{ClipWatch, Figures};

/// Why a split cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// No clip of a folder has a name that was asked for.
    #[error("{}: no clip in it whose name contains '{}'", path.display(), names.join("' or '"))]
    NoClips {
        /// The folder.
        path: PathBuf,
        /// What was asked for.
        names: Vec<String>,
    },
    /// A folder that holds detections of none of the clips.
    #[error("{}: no CLIP.txt in it for any clip of the split; give the folder with its detections", path.display())]
    NoDetections {
        /// The folder.
        path: PathBuf,
    },
    /// Two methods of one name.
    #[error("--external {name}: two methods of this name; take another name for one of them")]
    SameName {
        /// The name.
        name: String,
    },
}

impl From<EvaluateError> for Error {
    fn from(error: EvaluateError) -> Self {
        Self::verb(error)
    }
}

/// Which clips.
#[derive(Debug, Clone, clap::Args)]
pub struct SplitArgs {
    /// Folder of clips, each with gt.txt and a video or pictures
    #[arg(value_name = "DATA_SPLIT")]
    data: PathBuf,
    /// Only clips whose names contain one of these
    #[arg(long, value_name = "TEXT", value_delimiter = ',')]
    clips: Vec<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Follow what was found and tell how good tracks and warnings are; the clips need camera.json and truth.csv
    #[arg(long)]
    tracks: bool,
    /// Follow without the vehicle's attitude, by the picture alone
    #[arg(long, requires = "tracks")]
    no_attitude: bool,
}

impl SplitArgs {
    fn clips(&self) -> Result<Vec<Clip>, Error> {
        let mut clips = clips::clips(&self.data)?;
        clips.retain(|clip| {
            self.clips.is_empty() || self.clips.iter().any(|text| clip.name.contains(text))
        });
        if clips.is_empty() {
            return Err(EvaluateError::NoClips {
                path: self.data.clone(),
                names: self.clips.clone(),
            }
            .into());
        }
        Ok(clips)
    }

    fn watch<'a>(
        &self,
        clip: &'a Clip,
        model: Option<&Model<'_>>,
    ) -> Result<Option<ClipWatch<'a>>, Error> {
        let track = model.map(|model| tracker::Settings::calibrated(model.calibration()));
        let settings = Settings { track: track.unwrap_or_default(), ..Settings::default() };
        let watch = || ClipWatch::new(clip, !self.no_attitude, settings);
        self.tracks.then(watch).transpose()
    }
}

/// What `lookout eval` can be told.
#[derive(Debug, Clone, clap::Args)]
pub struct EvalArgs {
    #[command(flatten)]
    split: SplitArgs,
    #[command(flatten)]
    detector: DetectorArgs,
    /// Methods to run beside each other; a report always has ours
    #[arg(long, value_name = "METHOD", value_enum, value_delimiter = ',', default_value = "ours")]
    method: Vec<MethodName>,
    /// Folder with METHOD.lkm for each method but ours, whose model is --model
    #[arg(long, value_name = "DIR", default_value = "methods")]
    models: PathBuf,
    /// Write CLIP.txt (MOTChallenge) and CLIP.jsonl (with motion) for every clip into this folder, of other methods than ours into its folder METHOD
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArgs,
    /// Clips to work on at a time; 0: one a processor core
    #[arg(long, value_name = "N", default_value_t = 0)]
    jobs: usize,
}

/// What `lookout score` can be told.
#[derive(Debug, Clone, clap::Args)]
pub struct ScoreArgs {
    #[command(flatten)]
    split: SplitArgs,
    /// Folder with CLIP.txt (MOTChallenge) for every clip; a clip without a file has no detections
    #[arg(value_name = "DETECTIONS")]
    detections: PathBuf,
}

/// What one clip gave.
#[derive(Debug, Default)]
struct ClipResult {
    found: Vec<Found>,
    scan: ScanCounts,
    /// Time of each frame, milliseconds.
    times_ms: Vec<f64>,
    /// What a report needs beside.
    seen: Option<Seen>,
    tracks: Option<track_metrics::ClipResult>,
}

/// What the scan did, summed over frames.
#[derive(Debug, Clone, Copy, Default)]
struct ScanCounts {
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
        for target in truth.iter().filter(|t| score::must_be_found(t)) {
            let length = target.width.max(target.height);
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

    fn add(&mut self, other: &Self) {
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
#[derive(Debug, Serialize)]
struct ScanFigures {
    frames: u64,
    windows_per_frame: f64,
    windows_kept_per_frame: f64,
    dropped: u64,
    share_registered: f64,
    scan_recall: f64,
}

impl From<ScanCounts> for ScanFigures {
    fn from(counts: ScanCounts) -> Self {
        let a_frame = |count: u64| count as f64 / counts.frames.max(1) as f64;
        Self {
            frames: counts.frames,
            windows_per_frame: a_frame(counts.windows),
            windows_kept_per_frame: a_frame(counts.kept),
            dropped: counts.dropped,
            share_registered: a_frame(counts.registered),
            scan_recall: counts.proposed as f64 / counts.targets.max(1) as f64,
        }
    }
}

/// Runs the detector on every clip and prints the figures.
///
/// # Errors
/// [`Error`] of the first clip in alphabetical order that has one; the files of complete clips stay.
pub fn run(args: &EvalArgs) -> Result<Ended, Error> {
    let runs = runs(args, args.report.wanted())?;
    let models = runs.iter().map(Run::model).collect::<Result<Vec<_>, Error>>()?;
    for model in models.iter().flatten() {
        args.detector.least_score(model)?;
    }
    let clips = args.split.clips()?;
    let mut plan = Plan::new(&args.report, &args.split.data, &clips)?;
    interrupt::watch()?;
    for (run, model) in runs.iter().zip(&models) {
        if let Some(out) = &run.out {
            fs::create_dir_all(out).map_err(Error::write(out))?;
        }
        // The others came before, so that the report can look at their detections on our run's frames.
        let ours = run.method == MethodName::Ours;
        let watched = plan.as_ref().filter(|_| ours);
        let work =
            |index: usize, clip: &Clip| run_clip(index, clip, run, model.as_ref(), args, watched);
        let Some(results) = on_clips::<_, Error>(&clips, args.jobs, &work)? else {
            eprintln!(
                "lookout: interrupted; the files of the clips done so far are complete, no figures"
            );
            return Ok(Ended::Interrupted);
        };
        let mut counts = ScanCounts::default();
        results.iter().for_each(|result| counts.add(&result.scan));
        // Without a model there is no scan.
        let scan = model.is_some().then(|| counts.into());
        let name = (runs.len() > 1 || !ours).then(|| run.method.to_string());
        print(
            name.as_deref(),
            &reports(&clips, &results),
            scan,
            figures(&results),
            args.split.json,
        )?;
        if ours {
            if let (Some(mut plan), Some(model)) = (plan.take(), model) {
                plan.measure_regressors(&clips, model, &args.detector, args.jobs)?;
                let runs = results.into_iter().filter_map(|r| Some((r.found, r.seen?))).collect();
                return plan.write(&args.split.data, &clips, runs, args.jobs);
            }
        } else if let Some(plan) = &mut plan {
            let mut times_ms = Vec::new();
            let mut found = Vec::new();
            for result in results {
                times_ms.extend(result.times_ms);
                found.push(result.found);
            }
            plan.add(run.method.to_string(), found, times_ms)?;
        }
    }
    Ok(Ended::Complete)
}

/// A method about to run.
struct Run {
    method: MethodName,
    /// None where nothing is learned.
    file: Option<ModelFile>,
    /// Folder for its detections.
    out: Option<PathBuf>,
}

impl Run {
    fn model(&self) -> Result<Option<Model<'_>>, Error> {
        Ok(self.file.as_ref().map(ModelFile::parse).transpose()?)
    }
}

/// The runs that were asked for, each once; ours last, and always there with a report.
fn runs(args: &EvalArgs, report: bool) -> Result<Vec<Run>, Error> {
    let mut methods: Vec<MethodName> = Vec::new();
    for method in &args.method {
        if *method != MethodName::Ours && !methods.contains(method) {
            methods.push(*method);
        }
    }
    if report || args.method.contains(&MethodName::Ours) {
        methods.push(MethodName::Ours);
    }
    let prepare = |method: MethodName| {
        let file = match method {
            MethodName::Ours => Some(ModelFile::load(args.detector.model.as_deref())?),
            MethodName::Difference => None,
            _ => Some(ModelFile::of_method(&args.models, method)?),
        };
        let own = |out: &PathBuf| match method {
            MethodName::Ours => out.clone(),
            _ => out.join(method.to_string()),
        };
        Ok(Run { method, file, out: args.out.as_ref().map(own) })
    };
    methods.into_iter().map(prepare).collect()
}

/// Prints the figures of detections in files.
///
/// # Errors
/// [`Error`] naming the file and the line.
pub fn run_score(args: &ScoreArgs) -> Result<Ended, Error> {
    report::readable(&args.detections)?;
    let score = |clip: &Clip| {
        let path = report::path_of(&args.detections, clip);
        let found = if path.exists() { detections::read_mot(&path)? } else { Vec::new() };
        let Some(mut watch) = args.split.watch(clip, None)? else {
            return Ok(ClipResult { found, ..ClipResult::default() });
        };
        let frames = detections::read_json(&path.with_extension("jsonl"), watch.size)?;
        for (number, (time_us, frame)) in (1..).zip(&frames) {
            watch.frame(number, *time_us, &frame.list, &frame.motion);
        }
        Ok(ClipResult { found, tracks: Some(watch.finish()), ..ClipResult::default() })
    };
    let clips = args.split.clips()?;
    let results = clips.iter().map(score).collect::<Result<Vec<ClipResult>, Error>>()?;
    print(None, &reports(&clips, &results), None, figures(&results), args.split.json)?;
    Ok(Ended::Complete)
}

fn run_clip(
    index: usize,
    clip: &Clip,
    run: &Run,
    model: Option<&Model<'_>>,
    args: &EvalArgs,
    plan: Option<&Plan>,
) -> Result<ClipResult, Error> {
    let input = format!("{}", clip.input.display());
    let mut result = ClipResult::default();
    let delivered = Cell::new(Instant::now());
    let mut source = Stamped { source: sources::open(&clip.input)?, delivered: &delivered };
    let path = run.out.as_deref().map(|out| report::path_of(out, clip));
    let mut file = path.as_deref().map(TextFile::create).transpose()?;
    let lines = path.as_deref().map(|path| path.with_extension("jsonl"));
    let mut lines = lines.as_deref().map(TextFile::create).transpose()?;
    let mut watch = plan.map(|plan| plan.watch(clip, index));
    let mut tracks = args.split.watch(clip, model)?;
    let detector = &args.detector;
    let mut each = |number, frame: &Frame, detections: &Detections| {
        let time_ms = delivered.get().elapsed().as_secs_f64() * 1e3;
        result.times_ms.push(time_ms);
        result.scan.add_frame(detections);
        if number > WARMUP {
            result.scan.add_targets(clip.ground_truth.frame(number), detections);
        }
        let first = result.found.len();
        result.found.extend(detections::found(number, detections));
        if let Some(watch) = &mut watch {
            watch.frame(number, frame, &result.found[first..], time_ms);
        }
        if let Some(tracks) = &mut tracks {
            tracks.frame(number, frame.time_us, &detections.list, &detections.motion);
        }
        if let Some(file) = &mut file {
            file.write(&detections::mot_lines(number, detections))?;
        }
        if let Some(lines) = &mut lines {
            lines.write(&detections::json_line(number, frame.time_us, detections, None))?;
        }
        Ok(())
    };
    match model {
        Some(model) => pipeline::run::<Error>(&input, &mut source, model, detector, &mut each)?,
        None => {
            pipeline::run_difference::<Error>(&input, &mut source, detector.threshold, &mut each)?
        }
    };
    result.seen = watch.map(report::Watch::finish);
    result.tracks = tracks.map(ClipWatch::finish);
    Ok(result)
}

/// A source that tells when it delivered its last frame: what comes after is the detector's time.
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

fn reports(clips: &[Clip], results: &[ClipResult]) -> [Report; IOUS.len()] {
    IOUS.map(|iou| {
        let mut scorer = Scorer::new(iou, WARMUP);
        for (clip, result) in clips.iter().zip(results) {
            scorer.add_clip(&clip.ground_truth, &result.found);
        }
        scorer.report()
    })
}

/// The figures of the tracks, if these were asked for.
fn figures(results: &[ClipResult]) -> Option<Figures> {
    let clips = results.iter().map(|result| result.tracks.clone()).collect::<Option<Vec<_>>>();
    clips.map(|clips| Figures::new(&clips))
}

fn print(
    method: Option<&str>,
    reports: &[Report],
    scan: Option<ScanFigures>,
    tracks: Option<Figures>,
    json: bool,
) -> Result<(), Error> {
    if json {
        #[derive(Serialize)]
        struct All<'a> {
            #[serde(skip_serializing_if = "Option::is_none")]
            method: Option<&'a str>,
            reports: &'a [Report],
            #[serde(skip_serializing_if = "Option::is_none")]
            scan: Option<ScanFigures>,
            #[serde(skip_serializing_if = "Option::is_none")]
            tracks: Option<Figures>,
        }
        let all = All { method, reports, scan, tracks };
        return Ok(print_line(
            &serde_json::to_string(&all).expect("numbers and names always make JSON"),
        )?);
    }
    if let Some(method) = method {
        print_line(&format!("method: {method}"))?;
    }
    for report in reports {
        print_line(&format!("{report}\n"))?;
    }
    if let Some(scan) = scan {
        print_line(&format!(
            "windows_per_frame: {:.1}\nwindows_kept_per_frame: {:.2}\ndropped: {}\nshare_registered: {:.3}\nscan_recall: {:.4}",
            scan.windows_per_frame,
            scan.windows_kept_per_frame,
            scan.dropped,
            scan.share_registered,
            scan.scan_recall
        ))?;
    }
    if let Some(tracks) = tracks {
        print_line(&format!("\n{tracks}"))?;
    }
    Ok(())
}
