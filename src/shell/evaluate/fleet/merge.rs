//! `lookout merge DIR`: the report of a run, from the results of its clips. Memory holds one clip at a time.

use super::FleetError;
use super::manifest::Manifest;
use super::outcome::{self, ClipOutcome};
use super::row::ManifestRow;
use super::settings::{self, RunFile};
use crate::shell::error::Error;
use crate::shell::evaluate::settle;
use crate::shell::evaluate::splits::{self, UnusableClip};
use crate::shell::evaluate::totals::{SummaryInputs, Totals};
use crate::shell::pipeline::ModelFile;
use crate::shell::support::interrupt::Ended;
use std::collections::BTreeMap;
use std::eprintln;
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
    let (folders, numbers) = manifest.splits();
    let has_result = |row: &&ManifestRow| files.contains_key(&row.clip);
    let missing: Vec<String> =
        manifest.rows.iter().filter(|row| !has_result(row)).map(|row| row.clip.clone()).collect();
    if !missing.is_empty() && !args.partial {
        return Err(Error::verb(FleetError::Missing { missing, all: manifest.rows.len() }));
    }
    let mut totals = Totals::new(SummaryInputs {
        method: None,
        folders: &folders,
        model: Some(&model),
        least: common.least,
        tracks: common.tracks,
        assumed_fov: common.assumed_fov,
    });
    // One clip is in memory at a time.
    let (mut broken, mut notes, mut measured) = (Vec::new(), Vec::new(), 0);
    for (row, number) in manifest.rows.iter().zip(numbers) {
        let Some(path) = files.get(&row.clip) else { continue };
        let ClipOutcome { mut clip, mut facts, result } = outcome::read(path)?;
        match result {
            Ok(result) => {
                settle::measured(&mut clip, &mut facts, &result);
                totals.add(&clip, &facts, number, &result)?;
                notes.extend(splits::label_notes(&clip));
                measured += 1;
            }
            Err(reason) => broken.push(UnusableClip { clip: clip.name, reason }),
        }
    }
    let reason = String::from("no result yet");
    broken.extend(missing.into_iter().map(|clip| UnusableClip { clip, reason: reason.clone() }));
    if measured > 0 {
        totals.finish(&broken)?.print(args.json)?;
    }
    notes.iter().for_each(|note| eprintln!("{note}"));
    splits::complain(&broken, measured)?;
    Ok(Ended::Complete)
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
