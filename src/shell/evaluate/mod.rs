//! `lookout eval`: accuracy on folders of clips, with a report if wanted. `lookout score`: the same for detections in files.
//!
//! In: clips with ground truth, a model or files of detections. Each clip is run once (`clip_run`), its detections are
//! matched to the labels (`matching`), matches are ranked by score (`ranking`, `score`), and figures are taken over all
//! clips (`summary`). Out: tables on standard output, JSON, detections, and the page of `report`.

pub mod accuracy;
pub mod bootstrap;
pub mod clip_run;
pub mod coco;
pub mod contrast;
pub mod facts;
pub mod fleet;
pub mod kinds;
pub mod matching;
pub mod poisson;
pub mod ranges;
pub mod ranking;
pub mod registration;
pub mod reliability;
pub mod report;
pub mod score;
pub mod settle;
pub mod splits;
pub mod summary;
pub mod table;
pub mod totals;
pub mod track_figures;
pub mod track_metrics;
pub mod without_target;

use super::error::Error;
use super::formats::clips::Clip;
use super::formats::detections::{self, Decimal};
use super::pipeline::methods::MethodName;
use super::pipeline::on_clips;
use super::pipeline::{DetectorArgs, ModelFile};
use super::sources::Frame;
use super::support::interrupt::{self, Ended};
use crate::model::Model;
use crate::tracking::{TrafficSettings, tracker};
use clip_run::{ClipResult, RunSettings};
use facts::Facts;
use fleet::form::ResultForm;
use fleet::manifest::Manifest;
use fleet::run::ShardArgs;
use fleet::shard::Shard;
use matching::DetectionRecord;
use report::{Plan, ReportArgs};
use settle::{of_the_clip, settle};
use splits::Splits;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{eprintln, fs};
use totals::{SummaryInputs, Totals};
use track_metrics::{ClipWatch, FollowSettings};

/// Why clips cannot be evaluated.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// No clip of a folder has one of the names given.
    #[error("{}: no clip in it whose name contains '{}'", path.display(), names.join("' or '"))]
    NoClips {
        /// Path of the folder.
        path: PathBuf,
        /// The names given.
        names: Vec<String>,
    },
    /// A folder that holds detections of none of the clips.
    #[error("{}: no CLIP.txt in it for any clip of the split; give the folder with its detections", path.display())]
    NoDetections {
        /// Path of the folder.
        path: PathBuf,
    },
    /// A manifest without a folder for results.
    #[error("--manifest: results are files; name their folder with --out DIR")]
    NoRunFolder,
    /// A manifest with other methods.
    #[error("--manifest: one method at a time, ours; leave --method out")]
    OtherMethods,
    /// Two methods of one name.
    #[error("--external {name}: two methods of this name; take another name for one of them")]
    SameName {
        /// Name that is not known.
        name: String,
    },
    /// Clips that could not be measured.
    #[error("{broken} of {all} clips left out, see above; the figures are of the others")]
    BrokenClips {
        /// Number of clips that could not be read.
        broken: usize,
        /// Number of all clips.
        all: usize,
    },
}

impl From<EvaluateError> for Error {
    fn from(error: EvaluateError) -> Self {
        Self::verb(error)
    }
}

/// Clips to measure on, and how to follow objects.
#[derive(Debug, Clone, clap::Args)]
pub struct SplitArgs {
    /// Only clips whose names contain one of these
    #[arg(long, value_name = "TEXT", value_delimiter = ',')]
    clips: Vec<String>,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
    /// Print figures of tracks and warnings; directions and times are compared where there are camera.json and truth.csv
    #[arg(long)]
    tracks: bool,
    /// Track without the vehicle's attitude, by the background's motion
    #[arg(long, requires = "tracks")]
    no_attitude: bool,
    /// Horizontal field of view in degrees that is assumed for clips without camera.json
    #[arg(long, value_name = "DEGREES", default_value_t = 60.0)]
    fov: f64,
}

impl SplitArgs {
    fn follow(&self, model: Option<&Model<'_>>) -> FollowSettings {
        let track = model.map(|model| tracker::TrackerSettings::calibrated(model.calibration()));
        FollowSettings {
            tracking: TrafficSettings {
                track: track.unwrap_or_default(),
                ..TrafficSettings::default()
            },
            with_attitude: !self.no_attitude,
            assumed_fov: self.fov,
            strict: self.tracks,
        }
    }
}

/// Command-line arguments of `lookout eval`.
#[derive(Debug, Clone, clap::Args)]
pub struct EvalArgs {
    /// Folders of clips: subfolders with gt.txt and a video or pictures, MOTChallenge sequences, or NAME.mp4 with NAME.txt;
    /// figures are taken over all of them together
    #[arg(
        value_name = "DATA_SPLIT",
        required_unless_present = "manifest",
        conflicts_with = "manifest"
    )]
    data: Vec<PathBuf>,
    /// The clips of this list (`lookout manifest`). With --out DIR each clip's result is a file in DIR, a run that was ended
    /// goes on where it was, and `lookout merge DIR` prints the figures
    #[arg(long, value_name = "FILE", conflicts_with_all = ["report", "external", "json"])]
    manifest: Option<PathBuf>,
    /// Only every Nth clip of the manifest, from the Ith on, from 0; without it as Slurm, Kubernetes (with JOB_COMPLETIONS)
    /// or AWS Batch say in the environment, else all
    #[arg(long, value_name = "I/N", requires = "manifest", value_parser = Shard::parse)]
    shard: Option<Shard>,
    #[command(flatten)]
    split: SplitArgs,
    #[command(flatten)]
    detector: DetectorArgs,
    /// Methods to compare; a report always has ours
    #[arg(long, value_name = "METHOD", value_enum, value_delimiter = ',', default_value = "ours")]
    method: Vec<MethodName>,
    /// Folder with METHOD.lkm for each method but ours, whose model is --model
    #[arg(long, value_name = "DIR", default_value = "methods")]
    models: PathBuf,
    /// With --manifest: the run's folder, which all shards share. Else: write CLIP.txt (MOTChallenge) and CLIP.jsonl (with
    /// motion) for every clip into this folder, of other methods than ours into its folder METHOD
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// With --manifest: write results as Parquet files instead of lines of JSON
    #[cfg(feature = "parquet")]
    #[arg(long, requires = "manifest")]
    parquet: bool,
    #[command(flatten)]
    report: ReportArgs,
    /// Clips to process at a time; 0: one per processor core
    #[arg(long, value_name = "N", default_value_t = 0)]
    jobs: usize,
}

/// Command-line arguments of `lookout score`.
#[derive(Debug, Clone, clap::Args)]
pub struct ScoreArgs {
    /// Folders of clips, as `lookout eval` takes them
    #[arg(value_name = "DATA_SPLIT", required = true)]
    data: Vec<PathBuf>,
    #[command(flatten)]
    split: SplitArgs,
    /// Folder with CLIP.txt (MOTChallenge) for the clips, CLIP.jsonl beside it for --tracks; a clip without a file has no
    /// detections
    #[arg(value_name = "DETECTIONS")]
    detections: PathBuf,
    /// Write ground_truth.json and detections.json in COCO's form into this folder
    #[arg(long, value_name = "DIR")]
    coco_out: Option<PathBuf>,
}

/// Runs the detector on every clip and prints the figures.
///
/// # Errors
/// [`Error`] where nothing can be measured or a file cannot be written;
/// [`Error::BrokenClips`](crate::shell::evaluate::EvaluateError::BrokenClips) after everything else where clips had to be
/// left out. The files of complete clips stay.
pub fn run(args: &EvalArgs) -> Result<Ended, Error> {
    if let Some(manifest) = &args.manifest {
        return run_manifest(args, manifest);
    }
    let runs = runs(args, args.report.wanted())?;
    let models = runs.iter().map(MethodRun::model).collect::<Result<Vec<_>, Error>>()?;
    for model in models.iter().flatten() {
        args.detector.least_score(model)?;
    }
    let mut splits = Splits::read(&args.data, &args.split.clips)?;
    let mut plan = Plan::new(&args.report, &splits)?;
    interrupt::watch()?;
    for (run, model) in runs.iter().zip(&models) {
        if let Some(out) = &run.out {
            fs::create_dir_all(out).map_err(Error::write(out))?;
        }
        // The others came before, so that the report can look at their detections on our run's frames.
        let ours = run.method == MethodName::Ours;
        let watched = plan.as_ref().filter(|_| ours);
        let settings = RunSettings {
            model: model.as_ref(),
            detector: &args.detector,
            follow: Some(args.split.follow(model.as_ref())),
            out: run.out.as_deref(),
        };
        let work = |index: usize, clip: &Clip| {
            let kind = splits.facts[index].kind.as_deref();
            of_the_clip(clip_run::run(index, clip, kind, settings, watched))
        };
        let Some(tried) = on_clips::<_, Error, _>(&splits.clips, args.jobs, &work)? else {
            eprintln!(
                "lookout: interrupted; the files of the clips done so far are complete, no figures"
            );
            return Ok(Ended::Interrupted);
        };
        let results = settle(tried, &mut splits, plan.as_mut());
        if results.is_empty() {
            break;
        }
        let name = (runs.len() > 1 || !ours).then(|| run.method.to_string());
        let least = model.as_ref().map(|model| args.detector.least_score(model)).transpose()?;
        let parts = SummaryInputs {
            method: name.as_deref(),
            folders: &splits.folders,
            model: model.as_ref(),
            least: least.flatten().map(|bits| Decimal::score(bits).to_f64()),
            tracks: args.split.tracks,
            assumed_fov: args.split.fov,
        };
        let mut totals = Totals::new(parts);
        totals.add_all(&splits, &results)?;
        let summary = totals.finish(&splits.broken)?;
        summary.print(args.split.json)?;
        if ours {
            if let (Some(mut plan), Some(model)) = (plan.take(), model) {
                plan.measure_regressors(&splits.clips, model, &args.detector, args.jobs)?;
                let runs = results.into_iter().filter_map(|r| Some((r.found, r.seen?))).collect();
                if plan.write(&splits, summary.in_use(), runs, args.jobs)? == Ended::Interrupted {
                    return Ok(Ended::Interrupted);
                }
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
    splits.note_labels();
    splits.complain()?;
    Ok(Ended::Complete)
}

/// Runs the clips of a manifest into a folder.
fn run_manifest(args: &EvalArgs, manifest: &Path) -> Result<Ended, Error> {
    let manifest = Manifest::read(manifest, &args.split.clips)?;
    let Some(out) = &args.out else { return Err(EvaluateError::NoRunFolder.into()) };
    if args.method != [MethodName::Ours] {
        return Err(EvaluateError::OtherMethods.into());
    }
    #[cfg(feature = "parquet")]
    let form = if args.parquet { ResultForm::Parquet } else { ResultForm::Lines };
    #[cfg(not(feature = "parquet"))]
    let form = ResultForm::Lines;
    fleet::run::run(ShardArgs {
        manifest: &manifest,
        shard: args.shard,
        out,
        detector: &args.detector,
        follow: &|model| args.split.follow(Some(model)),
        form,
        jobs: args.jobs,
    })
}

/// A method about to run.
struct MethodRun {
    method: MethodName,
    /// None where nothing is learned.
    file: Option<ModelFile>,
    /// Folder for its detections.
    out: Option<PathBuf>,
}

impl MethodRun {
    fn model(&self) -> Result<Option<Model<'_>>, Error> {
        Ok(self.file.as_ref().map(ModelFile::parse).transpose()?)
    }
}

/// The runs given on the command line, each once; ours last, and always there with a report.
fn runs(args: &EvalArgs, report: bool) -> Result<Vec<MethodRun>, Error> {
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
        Ok(MethodRun { method, file, out: args.out.as_ref().map(own) })
    };
    methods.into_iter().map(prepare).collect()
}

/// Prints the figures of detections in files.
///
/// # Errors
/// [`Error`] naming the file and the line; [`Error::NoDetections`](crate::shell::evaluate::EvaluateError::NoDetections)
/// where no clip has a file.
pub fn run_score(args: &ScoreArgs) -> Result<Ended, Error> {
    report::readable(&args.detections)?;
    let mut splits = Splits::read(&args.data, &args.split.clips)?;
    let there = |clip: &Clip| report::path_of(&args.detections, clip).exists();
    let without: Vec<&str> =
        splits.clips.iter().filter(|clip| !there(clip)).map(|clip| clip.name.as_str()).collect();
    if without.len() == splits.clips.len() {
        return Err(EvaluateError::NoDetections { path: args.detections.clone() }.into());
    }
    if !without.is_empty() {
        eprintln!(
            "lookout: {} of {} clips have no file and count as without detections: {}",
            without.len(),
            splits.clips.len(),
            without.join(", ")
        );
    }
    let score = |(clip, facts): (&Clip, &Facts)| {
        // Broken detections are no broken clip: to leave them out would flatter their maker.
        let path = report::path_of(&args.detections, clip);
        let found = if path.exists() { detections::read_mot(&path)? } else { Vec::new() };
        of_the_clip(score_clip(args, clip, facts.kind.as_deref(), found))
    };
    let tried = splits.clips.iter().zip(&splits.facts).map(score);
    let tried = tried.collect::<Result<Vec<_>, Error>>()?;
    let results = settle(tried, &mut splits, None);
    if results.is_empty() {
        splits.complain()?;
    }
    let parts = SummaryInputs {
        method: None,
        folders: &splits.folders,
        model: None,
        least: None,
        tracks: args.split.tracks,
        assumed_fov: args.split.fov,
    };
    let mut totals = Totals::new(parts);
    totals.add_all(&splits, &results)?;
    totals.finish(&splits.broken)?.print(args.split.json)?;
    if let Some(folder) = &args.coco_out {
        let found: Vec<_> = results.iter().map(|result| result.found.as_slice()).collect();
        coco::write(folder, &splits.clips, &found)?;
    }
    splits.note_labels();
    splits.complain()?;
    Ok(Ended::Complete)
}

/// The detections of one clip from its files; its frames are not read, except for their size where tracks are evaluated.
fn score_clip(
    args: &ScoreArgs,
    clip: &Clip,
    kind: Option<&str>,
    found: Vec<DetectionRecord>,
) -> Result<ClipResult, Error> {
    let frames = clip.frame_count().unwrap_or(0);
    let result = ClipResult { found, frames, ..ClipResult::default() };
    if !args.split.tracks {
        return Ok(result);
    }
    let size = match clip.info.size {
        Some((width, height)) => (width as usize, height as usize),
        None => {
            let mut first = Frame::default();
            clip.open()?.next_frame(&mut first)?;
            (first.width, first.height)
        }
    };
    let mut watch = ClipWatch::new(clip, kind, args.split.follow(None))?;
    let lines = report::path_of(&args.detections, clip).with_extension("jsonl");
    let frames = if lines.exists() { detections::read_json(&lines, size)? } else { Vec::new() };
    for (number, (time_us, frame)) in (1..).zip(&frames) {
        watch.frame(number, *time_us, size, &frame.list, &frame.motion)?;
    }
    Ok(ClipResult { size, tracks: Some(watch.finish()), ..result })
}
