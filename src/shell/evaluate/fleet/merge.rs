//! `lookout merge DIR`: the report of a run, from the results of its clips.

use super::FleetError;
use super::manifest::Manifest;
use super::outcome;
use super::settings::{self, RunFile};
use crate::shell::error::Error;
use crate::shell::evaluate::clip_run::ClipResult;
use crate::shell::evaluate::settle;
use crate::shell::evaluate::splits::{Splits, UnusableClip};
use crate::shell::evaluate::summary::{EvaluationSummary, SummaryInputs};
use crate::shell::pipeline::ModelFile;
use crate::shell::support::interrupt::Ended;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// Command-line arguments of `lookout merge`.
#[derive(Debug, Clone, clap::Args)]
pub struct MergeArgs {
    /// The folder that `lookout eval --manifest .. --out` wrote to
    #[arg(value_name = "DIR")]
    run: PathBuf,
    /// Print one line of JSON
    #[arg(long)]
    json: bool,
    /// Clips without a result count as left out
    #[arg(long)]
    partial: bool,
}

/// Prints the figures of a run: byte for byte those of `lookout eval` on all of its clips.
///
/// # Errors
/// [`FleetError::Missing`] where shards are not done; as `lookout eval` where clips were left out.
pub fn run(args: &MergeArgs) -> Result<Ended, Error> {
    let common = RunFile::read(&args.run)?;
    let manifest = Manifest::read(&args.run.join("manifest.csv"), &[])?;
    let file = ModelFile::load(Some(&common.model_path(&args.run)))?;
    let model = file.parse()?;
    let files = results(&args.run, &common)?;
    let (mut splits, numbers) = manifest.splits();
    let mut tried = Vec::new();
    let mut missing = Vec::new();
    for (row, number) in manifest.rows.iter().zip(numbers) {
        let Some(path) = files.get(&row.clip) else {
            missing.push(row.clip.clone());
            continue;
        };
        tried.push(take(path, number, &mut splits)?);
    }
    if !missing.is_empty() && !args.partial {
        return Err(Error::verb(FleetError::Missing { missing, all: manifest.rows.len() }));
    }
    let results = settle::settle(tried, &mut splits, None);
    let reason = String::from("no result yet");
    splits
        .broken
        .extend(missing.into_iter().map(|clip| UnusableClip { clip, reason: reason.clone() }));
    if !results.is_empty() {
        let parts = SummaryInputs {
            method: None,
            splits: &splits,
            results: &results,
            model: Some(&model),
            least: common.least,
            tracks: common.tracks,
            assumed_fov: common.assumed_fov,
        };
        EvaluationSummary::new(parts).print(parts, args.json)?;
    }
    splits.note_labels();
    splits.complain()?;
    Ok(Ended::Complete)
}

/// Puts a clip into the splits; gives its result.
fn take(
    path: &Path,
    number: usize,
    splits: &mut Splits,
) -> Result<Result<ClipResult, String>, Error> {
    let outcome = outcome::read(path)?;
    splits.clips.push(outcome.clip);
    splits.facts.push(outcome.facts);
    splits.split.push(number);
    Ok(outcome.result)
}

/// The results of a run's present model and arguments, by clip.
fn results(run: &Path, common: &RunFile) -> Result<BTreeMap<String, PathBuf>, Error> {
    let folder = settings::clips(run);
    let suffix = common.suffix();
    let mut found: BTreeMap<String, PathBuf> = BTreeMap::new();
    for entry in fs::read_dir(&folder).map_err(Error::read(&folder))? {
        let path = entry.map_err(Error::read(&folder))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if !name.ends_with(&suffix) {
            continue;
        }
        let clip = outcome::name(&path)?;
        if let Some(other) = found.insert(clip.clone(), path.clone()) {
            return Err(Error::verb(FleetError::TwoResults { clip, files: [other, path] }));
        }
    }
    Ok(found)
}
