//! Training: from flights with known targets to a model file.
//!
//! In the order of the paper: the scan with hard negatives, the regressors of Algorithm 1, then cubes compensated with
//! them, on these the classifier and the box. Then the fit of boxes to objects, which is no part of the paper, and at last
//! the table of precisions, measured on the clips held back. Each stage is saved when it ends; a run that was interrupted
//! goes on after the last one. The core's own code computes every value that is learned from.

mod adapt;
mod args;
pub mod boost;
mod calibrate;
mod collection;
mod cubes;
mod error;
mod file;
mod fits;
mod footage;
mod growth;
mod labels;
mod lightgbm;
mod listing;
mod look;
mod mine;
mod parts;
mod paste;
mod patch;
mod playback;
mod pool;
mod rendered;
mod report;
mod rows;
mod scan;
mod stage;
mod stages;
mod visit;
mod window_files;
mod windows;

pub use args::{CubeLoss, Following, TrainArgs};
pub use error::TrainError;
pub use mine::{FitArgs, MineArgs, run_fit, run_mine};

use super::error::Error;
use super::pipeline::methods::{MethodName, Recipe};
use super::pipeline::{ModelFile, PipelineError};
use super::support::atomic_file;
use super::support::interrupt::{self, Ended};
use crate::model::{Model, Section};
use boost::TrainedForest;
use file::{ModelSections, TrainingFiles};
use report::TrainingReport;
use stage::TrainingStage;
use stages::Trainer;
use std::path::Path;
use std::string::{String, ToString};
use std::vec::Vec;
use std::{eprintln, format, fs};

/// Trains a model.
///
/// # Errors
/// [`Error`] when clips cannot be read or files not written; finished stages stay in the partial model.
pub fn run(args: &TrainArgs) -> Result<Ended, Error> {
    if let Some(model) = &args.calibrate {
        return recalibrate(args, model);
    }
    train(args, Mining::Here)
}

/// Where the windows of the scan are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mining {
    /// In this process.
    Here,
    /// By `lookout mine`, in shards.
    Elsewhere,
}

/// Trains a model, or goes on up to the windows that are still to be mined elsewhere.
fn train(args: &TrainArgs, mining: Mining) -> Result<Ended, Error> {
    if args.data.is_empty() && args.rendered.render == 0 {
        return Err(TrainError::OnlyEmpty { adapts: args.from.is_some() }.into());
    }
    let (args, remark) = args.fitted()?;
    let recipe = args.recipe()?;
    let settings = serde_json::to_string(&args).unwrap_or_default();
    if !args.again && finished(&args.out, &settings).is_some() {
        eprintln!(
            "{}: trained with these settings already; --again trains it anew",
            args.out.display()
        );
        return Ok(Ended::Complete);
    }
    let files = TrainingFiles::beside(&args.out);
    let resumed = finished(&files.partial, &settings);
    let elsewhere = mining == Mining::Elsewhere;
    let goes_on = resumed.is_some() || elsewhere && files.log.is_file();
    let mut report = TrainingReport::create(&files.log, goes_on)?;
    if let Some(remark) = remark {
        report.note(remark)?;
    }
    let (parts, adapts) = start(&args, &recipe)?;
    let stages = args.stages(&recipe, adapts);
    let done = |parts: &ModelSections, stage: TrainingStage| match stage {
        // The model to adapt has all trees: only a partial model is an adapted one.
        TrainingStage::Adaptation => resumed.is_some(),
        _ => stage.forests().iter().all(|&section| parts.has_trees(section)),
    };
    let mut parts = resumed.clone().unwrap_or(parts);
    if args.rendered.render > 0 {
        rendered::render(&args, &report)?;
    }
    if interrupt::requested() {
        return Ok(Ended::Interrupted);
    }
    if elsewhere && !done(&parts, TrainingStage::Scan) {
        report.stage(&stages, 0)?;
        // No clip is looked through before their windows are all there.
        let trainer = Trainer::without_clips(&args, recipe);
        let (windows, shards) = (files.windows(&settings), files.parts(&settings));
        if let Some(pass) = trainer.scan(&mut parts, &mut report, &windows, Some(&shards))? {
            let passes = Trainer::passes(&args, &recipe);
            report.note(&format!(
                "pass {pass} of {passes} is to be mined: lookout mine --shard I/N for each shard, then lookout fit again"
            ))?;
            return Ok(Ended::Complete);
        }
        if interrupt::requested() {
            return Ok(Ended::Interrupted);
        }
        parts.set_provenance(&settings);
        write(&files.partial, &parts.encode())?;
    }
    let trainer = Trainer::load(&args, recipe, &report, None)?;
    for (number, &stage) in stages.iter().enumerate() {
        if done(&parts, stage) {
            report.note(&format!("{}: done before", stage.title()))?;
            continue;
        }
        report.stage(&stages, number)?;
        match stage {
            TrainingStage::Scan => {
                trainer.scan(&mut parts, &mut report, &files.windows(&settings), None)?;
            }
            TrainingStage::Compensation => trainer.regressors(&mut parts, &mut report)?,
            TrainingStage::Cubes | TrainingStage::Boxes => {
                trainer.cubes(&mut parts, &mut report)?
            }
            TrainingStage::Fits => trainer.fits(&mut parts, &mut report)?,
            TrainingStage::Adaptation => trainer.adapt(&mut parts, &mut report)?,
        }
        if interrupt::requested() {
            return Ok(Ended::Interrupted);
        }
        parts.set_provenance(&settings);
        write(&files.partial, &parts.encode())?;
    }
    parts.set_provenance(&settings);
    let summary = trainer.summary();
    drop(trainer);
    report.note("measuring the precision of scores on the clips held back")?;
    let Some(precision) = calibrate(&mut parts, &args, args.hold_back)? else {
        return Ok(Ended::Interrupted);
    };
    let bytes = parts.encode();
    write(&args.out, &bytes)?;
    report.finish(&args, &bytes, &summary, &precision)?;
    files.remove()?;
    Ok(Ended::Complete)
}

/// The sections of the model before the first stage, and whether it is a model to adapt.
fn start(args: &TrainArgs, recipe: &Recipe) -> Result<(ModelSections, bool), Error> {
    let mut parts = ModelSections::new(recipe.method);
    let Some(path) = &args.from else { return Ok((parts, false)) };
    let file = ModelFile::load(Some(path))?;
    let model = file.parse()?;
    let whole = ModelSections::of(&model);
    if args.method == MethodName::Ours
        && model.method() == recipe.method
        && whole.has_trees(Section::Cube)
    {
        return Ok((whole, true));
    }
    if model.method().registration != recipe.method.registration {
        let error = PipelineError::MethodModel {
            method: args.method,
            path: path.clone(),
            reason: "one of both looks at registered frames, its scan cannot be shared".into(),
        };
        return Err(error.into());
    }
    let shared = [Section::Scan, Section::PatchFeatures, Section::Horizontal, Section::Vertical];
    parts.take(&model, &shared);
    Ok((parts, false))
}

/// Puts in the table of precisions; gives it in words, none after Ctrl-C.
fn calibrate(
    parts: &mut ModelSections,
    args: &TrainArgs,
    hold_back: usize,
) -> Result<Option<String>, Error> {
    let bytes = parts.encode();
    let model = Model::parse(&bytes).map_err(TrainError::Model)?;
    let knots = calibrate::measure(args, hold_back, &model)?;
    Ok(knots.map(|knots| {
        parts.set_calibration(&knots);
        calibrate::in_words(&knots)
    }))
}

/// Measures the table of precisions of a model again; held back were the clips that its provenance says.
fn recalibrate(args: &TrainArgs, path: &Path) -> Result<Ended, Error> {
    let file = ModelFile::load(Some(path))?;
    let model = file.parse()?;
    let mut parts = ModelSections::of(&model);
    let provenance: serde_json::Value =
        serde_json::from_str(model.provenance()).unwrap_or_default();
    let hold_back = provenance["hold_back"].as_u64().map_or(args.hold_back, |n| n as usize);
    if let Some(margin) = args.scan_margin {
        let mut scan = TrainedForest::from(*model.scan());
        // Scores of the scan are in Q8.
        scan.raise_reject_thresholds((margin * 256.0) as i32);
        parts.set_forest(Section::Scan, &scan);
    }
    let Some(precision) = calibrate(&mut parts, args, hold_back)? else {
        return Ok(Ended::Interrupted);
    };
    let bytes = parts.encode();
    write(&args.out, &bytes)?;
    if let Some(card) = &args.card {
        report::refresh_card(card, &args.out, &bytes, &precision)?;
    }
    eprintln!("precision on the clips held back (IoU 0.3): {precision}");
    Ok(Ended::Complete)
}

/// The model at `path`, if it was trained with these settings.
fn finished(path: &Path, settings: &str) -> Option<ModelSections> {
    let bytes = fs::read(path).ok()?;
    let model = Model::parse(&bytes).ok()?;
    (model.provenance() == settings).then(|| ModelSections::of(&model))
}

/// Writes a file so that it is whole or not there.
fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    atomic_file::write(path, bytes).map_err(Error::write(path))
}

/// The command that gave these settings, for the card.
fn command() -> String {
    let words: Vec<String> = std::env::args().skip(1).map(|a| a.to_string()).collect();
    format!("lookout {}", words.join(" "))
}
