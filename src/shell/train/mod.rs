//! Training: from flights with known targets to a model file.
//!
//! In the order of the paper: the scan with hard negatives, the regressors of Algorithm 1, then cubes compensated with
//! them, on these the classifier and the box. Then what fits boxes to objects, which is no part of the paper, and at last
//! what scores are worth, measured on the clips held back. Each stage is saved when it ends; a run that was interrupted
//! goes on after the last one. The core's own code computes every value that is learned from.

pub mod boost;
mod calibrate;
mod cubes;
mod file;
mod fits;
mod footage;
mod labels;
mod look;
mod paste;
mod pool;
mod report;
mod stages;
mod windows;

use super::error::Error;
use super::pipeline::Ablation;
use super::pipeline::ModelFile;
use super::pipeline::methods::{MethodName, Recipe, Sees};
use super::pipeline::scaled::FrameSize;
use super::support::interrupt::Ended;
use crate::channels::history::History;
use crate::model::{Method, Model, Section};
use crate::shell::pipeline::PipelineError;
use crate::shell::support::file_error::FileError;
use crate::stcube::compensation::Alignment;
use file::Parts;
use report::Report;
use stages::Trainer;
use std::borrow::ToOwned;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::time::Instant;
use std::vec::Vec;

/// Why training cannot begin or go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// Training cannot go on.
    #[error("training: {reason}; give more flights with targets, or other settings")]
    Training {
        /// What stands in the way.
        reason: String,
    },
    /// A method that is not trained.
    #[error("{method} learns nothing: run it with `lookout eval DATA_SPLIT --method {method}`")]
    NothingToLearn {
        /// The method.
        method: MethodName,
    },
}

impl From<TrainError> for Error {
    fn from(error: TrainError) -> Self {
        Self::verb(error)
    }
}

/// What the classifier of cubes minimises.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CubeLoss {
    /// exp(-y F), by Newton steps: gentle AdaBoost.
    Adaboost,
    /// ln(1 + exp(-y F)): scores are log-odds; outliers weigh less.
    Logistic,
}

/// What the older slices of cubes follow: [`Alignment`] on the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Following {
    /// The background's motion: an object's own motion shows as change.
    Background,
    /// The object, by Algorithm 1 of the paper.
    Regressors,
    /// The window's picture, by its optical flow.
    Flow,
}

impl From<Following> for Alignment {
    fn from(following: Following) -> Self {
        match following {
            Following::Background => Self::Background,
            Following::Regressors => Self::Regressors,
            Following::Flow => Self::Flow,
        }
    }
}

/// What `lookout train` can be told.
#[derive(Debug, Clone, clap::Args, serde::Serialize)]
pub struct TrainArgs {
    /// Folders of clips with ground truth, each weighing the same
    #[arg(required = true, value_name = "DATA")]
    pub data: Vec<PathBuf>,
    /// Model file to write; a partial one beside it lets an interrupted run go on
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub out: PathBuf,
    /// Model card whose generated part is written anew (default: README.md beside the model; FILE.md for other methods)
    #[arg(long, value_name = "FILE")]
    #[serde(skip)]
    pub card: Option<PathBuf>,
    /// Seed of all that is drawn at random
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Frames to learn from, in each folder
    #[arg(long, default_value_t = 1800)]
    pub samples: usize,
    /// Only measure anew what the scores of this model are worth, on the clips of DATA that were held back from it
    #[arg(long, value_name = "MODEL")]
    #[serde(skip)]
    pub calibrate: Option<PathBuf>,
    /// Take the scan and the regressors of Algorithm 1 from this model instead of learning them: for methods that share them
    #[arg(long, value_name = "MODEL")]
    pub from: Option<PathBuf>,
    /// Every how many clips one is held back to decide when to stop; 0: none
    #[arg(long, default_value_t = 8)]
    pub hold_back: usize,
    /// Learn from frames scaled to this size: for a smaller camera
    #[arg(long, value_name = "WxH")]
    pub frame: Option<FrameSize>,
    /// Keep of older frames their halves alone, and look at cubes of the newest slice: for small boards
    #[arg(long)]
    pub half_history: bool,
    /// Levels of the pyramid for each doubling of the target's size
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=4))]
    pub scales_per_octave: u8,
    /// Trees of the scan
    #[arg(long, default_value_t = 256)]
    pub scan_trees: usize,
    /// Depth of the scan's trees
    #[arg(long, default_value_t = 3)]
    pub scan_depth: u8,
    /// Part of each step that the scan's trees take: with large steps fewer trees reject a window, for small boards
    #[arg(long, default_value_t = 0.1)]
    pub scan_shrinkage: f64,
    /// Share of the held-back targets that the scan's rejection thresholds keep
    #[arg(long, default_value_t = 0.93)]
    pub scan_keep: f64,
    /// Rounds of hard-negative mining for the scan
    #[arg(long, default_value_t = 3)]
    pub mining: usize,
    /// Trees of each regressor, at most
    #[arg(long, default_value_t = 400)]
    pub regressor_trees: usize,
    /// Trees of the classifier of cubes, at most
    #[arg(long, default_value_t = 800)]
    pub cube_trees: usize,
    /// Depth of the classifier's trees
    #[arg(long, default_value_t = 4)]
    pub cube_depth: u8,
    /// Loss of the classifier: gentle AdaBoost as in the paper, or its logistic sister
    #[arg(long, value_enum, default_value_t = CubeLoss::Logistic)]
    pub cube_loss: CubeLoss,
    /// Features to choose from for cubes
    #[arg(long, default_value_t = 2500)]
    pub features: usize,
    /// Candidates of each frame that cubes are cut for
    #[arg(long, default_value_t = 24)]
    pub candidates: usize,
    /// Show the frames as they are: not mirrored, not smaller, contrast unchanged
    #[arg(long)]
    pub plain: bool,
    /// Objects of other clips pasted into a copy of each clip whose camera's attitude is known (truth.csv, camera.json)
    #[arg(long, default_value_t = 0)]
    pub paste: usize,
    /// The method to train; what follows changes it
    #[arg(long, value_enum, default_value_t)]
    pub method: MethodName,
    /// What the older slices of cubes follow
    #[arg(long, value_enum)]
    pub alignment: Option<Following>,
    /// What to leave out.
    #[command(flatten)]
    #[serde(flatten)]
    pub ablation: Ablation,
}

impl TrainArgs {
    /// What is to be trained.
    fn recipe(&self) -> Result<Recipe, Error> {
        let name = self.method;
        let recipe = name.recipe().ok_or(TrainError::NothingToLearn { method: name })?;
        let alignment = self.alignment.map_or(recipe.method.alignment, Alignment::from);
        let scales_per_octave = self.scales_per_octave;
        let method = self.ablation.of(recipe.method);
        let history = if self.half_history { History::Half } else { method.history };
        let method = Method { alignment, scales_per_octave, history, ..method };
        // Without older slices there is nothing to see in them.
        let sees = if history.slices() == 1 { Sees::Newest } else { recipe.sees };
        let fit = recipe.fit && history == History::Full;
        Ok(Recipe { method, sees, fit, ..recipe })
    }

    /// What is there before the first stage.
    fn start(&self, recipe: &Recipe) -> Result<Parts, Error> {
        let mut parts = Parts::new(recipe.method);
        if let Some(path) = &self.from {
            let file = ModelFile::load(Some(path))?;
            let model = file.parse()?;
            if model.method().registration != recipe.method.registration {
                return Err(PipelineError::MethodModel {
                    method: self.method,
                    path: path.clone(),
                    reason: "one of both looks at registered frames, its scan cannot be shared"
                        .into(),
                }
                .into());
            }
            let shared =
                [Section::Scan, Section::PatchFeatures, Section::Horizontal, Section::Vertical];
            parts.take(&model, &shared);
        }
        Ok(parts)
    }

    /// Where the model card goes.
    fn card(&self) -> PathBuf {
        self.card.clone().unwrap_or_else(|| match self.method {
            MethodName::Ours => self.out.with_file_name("README.md"),
            _ => self.out.with_extension("md"),
        })
    }
}

/// Trains a model.
///
/// # Errors
/// [`Error`] when clips cannot be read or files not written; finished stages stay in the partial model.
pub fn run(args: &TrainArgs) -> Result<Ended, Error> {
    if let Some(model) = &args.calibrate {
        return recalibrate(args, model);
    }
    let started = Instant::now();
    let recipe = args.recipe()?;
    let settings = serde_json::to_string(args).unwrap_or_default();
    let partial = args.out.with_extension("lkm.partial");
    let resumed = resume(&partial, &settings);
    let mut report = Report::create(&args.out.with_extension("jsonl"), resumed.is_some())?;
    let mut parts = match resumed {
        Some(parts) => parts,
        None => args.start(&recipe)?,
    };
    let trainer = Trainer::load(args, recipe, &report)?;
    // Without cubes or older slices there is nothing to compensate; without cubes, of their trees only those of the box.
    let stages = match (recipe.method.stcube, recipe.method.history) {
        (true, History::Full) => &[Section::Scan, Section::Horizontal, Section::Cube][..],
        (true, History::Half) => &[Section::Scan, Section::Cube],
        (false, _) => &[Section::Scan, Section::BoxX],
    };
    for &stage in stages.iter().chain(recipe.fit.then_some(&Section::FitX)) {
        if parts.has_trees(stage) {
            report.note(&std::format!("{stage:?}: there already"))?;
            continue;
        }
        match stage {
            Section::Scan => trainer.scan(&mut parts, &mut report)?,
            Section::Horizontal => trainer.regressors(&mut parts, &mut report)?,
            Section::FitX => trainer.fits(&mut parts, &mut report)?,
            _ => trainer.cubes(&mut parts, &mut report)?,
        }
        if super::support::interrupt::requested() {
            return Ok(Ended::Interrupted);
        }
        parts.set_provenance(&settings);
        write(&partial, &parts.encode())?;
    }
    parts.set_provenance(&settings);
    let summary = trainer.summary();
    drop(trainer);
    let Some(precision) = calibrate(&mut parts, args, args.hold_back)? else {
        return Ok(Ended::Interrupted);
    };
    report.note(&std::format!("precision: {precision}"))?;
    let bytes = parts.encode();
    write(&args.out, &bytes)?;
    report.card(&args.card(), &args.out, &bytes, &summary, &precision, started.elapsed())?;
    fs::remove_file(&partial)
        .map_err(|source| FileError::Write { path: partial.clone(), source })?;
    Ok(Ended::Complete)
}

/// Puts in what the scores are worth and tells it in words; none after Ctrl-C.
fn calibrate(
    parts: &mut Parts,
    args: &TrainArgs,
    hold_back: usize,
) -> Result<Option<String>, Error> {
    let bytes = parts.encode();
    let model = Model::parse(&bytes).map_err(|e| TrainError::Training { reason: e.to_string() })?;
    let knots = calibrate::measure(&args.data, hold_back, args.frame, &model)?;
    Ok(knots.map(|knots| {
        parts.set_calibration(&knots);
        calibrate::in_words(&knots)
    }))
}

/// Measures anew what the scores of a model are worth; held back were the clips that its provenance says.
fn recalibrate(args: &TrainArgs, path: &Path) -> Result<Ended, Error> {
    let file = ModelFile::load(Some(path))?;
    let model = file.parse()?;
    let mut parts = Parts::of(&model);
    let provenance: serde_json::Value =
        serde_json::from_str(model.provenance()).unwrap_or_default();
    let hold_back = provenance["hold_back"].as_u64().map_or(args.hold_back, |n| n as usize);
    let Some(precision) = calibrate(&mut parts, args, hold_back)? else {
        return Ok(Ended::Interrupted);
    };
    let bytes = parts.encode();
    write(&args.out, &bytes)?;
    report::refresh_card(&args.card(), &args.out, &bytes, &precision)?;
    std::eprintln!("precision: {precision}");
    Ok(Ended::Complete)
}

/// The finished stages of an earlier run with the same settings.
fn resume(partial: &Path, settings: &str) -> Option<Parts> {
    let bytes = fs::read(partial).ok()?;
    let model = Model::parse(&bytes).ok()?;
    (model.provenance() == settings).then(|| Parts::of(&model))
}

/// Writes a file so that it is whole or not there: under another name first.
fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".tmp");
    let temporary = path.with_file_name(name);
    let failed = |path: &Path| {
        let path = path.to_path_buf();
        move |source| FileError::Write { path, source }
    };
    fs::write(&temporary, bytes).map_err(failed(&temporary))?;
    Ok(fs::rename(&temporary, path).map_err(failed(path))?)
}

/// The command that gave these settings, for the card.
fn command() -> String {
    let words: Vec<String> = std::env::args().skip(1).map(|a| a.to_string()).collect();
    std::format!("lookout {}", words.join(" "))
}
