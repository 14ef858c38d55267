//! `lookout mine` and `lookout fit`: training in two steps that alternate, so that the windows of the scan are looked for on
//! many machines. The model is that of `lookout train`, byte for byte.

use super::args::TrainArgs;
use super::parts::{self, PartFiles};
use super::report::TrainingReport;
use super::stages::Trainer;
use super::{Mining, TrainError, train};
use crate::model::Model;
use crate::shell::error::Error;
use crate::shell::evaluate::fleet::shard::Shard;
use crate::shell::evaluate::fleet::turn;
use crate::shell::support::atomic_file;
use crate::shell::support::interrupt::{self, Ended};
use std::path::PathBuf;
use std::{eprintln, fs};

/// Command-line arguments of `lookout mine`.
#[derive(Debug, Clone, clap::Args)]
pub struct MineArgs {
    /// Only every Nth clip, from the Ith on, from 0; without it as Slurm, Kubernetes (with JOB_COMPLETIONS) or AWS Batch say
    /// in the environment, else all
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    shard: Option<Shard>,
    /// Write the windows as CSV too, for LightGBM (see --scan-from): 1 for a target and 0 for none, then the values of the
    /// features
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    train: TrainArgs,
}

/// Command-line arguments of `lookout fit`.
#[derive(Debug, Clone, clap::Args)]
pub struct FitArgs {
    #[command(flatten)]
    train: TrainArgs,
}

/// Looks for the windows of the next pass in the clips of a shard.
///
/// # Errors
/// [`Error`] of clips that cannot be read and files that cannot be written; [`TrainError::NotMined`].
pub fn run_mine(args: &MineArgs) -> Result<Ended, Error> {
    let shard = turn::shard(args.shard)?;
    let (train, _) = args.train.fitted()?;
    check(&train)?;
    let recipe = train.recipe()?;
    let settings = serde_json::to_string(&train).unwrap_or_default();
    let files = PartFiles::new(&train.out, &settings);
    let passes = Trainer::passes(&train, &recipe);
    let pass = files.newest(passes);
    let bytes = files.model(pass).unwrap_or_default();
    if files.has(pass, shard, &bytes) && args.csv.is_none() {
        eprintln!("lookout: pass {pass}, shard {}/{}: mined before", shard.index, shard.count);
        return Ok(Ended::Complete);
    }
    if train.rendered.render > 0 {
        let there = fs::read_dir(train.flights())
            .map_or(0, |entries| entries.flatten().filter(|entry| entry.path().is_dir()).count());
        if there < train.rendered.render {
            return Err(TrainError::NotRendered { path: train.flights() }.into());
        }
    }
    interrupt::watch()?;
    let report = TrainingReport::without_log();
    let trainer = Trainer::load(&train, recipe, &report, Some(shard))?;
    let model = match bytes.as_slice() {
        [] => None,
        bytes => Some(Model::parse(bytes).map_err(TrainError::Model)?),
    };
    let clips = trainer.mined(&report, pass, model.as_ref())?;
    if interrupt::requested() {
        eprintln!("lookout: interrupted; nothing of this shard was written");
        return Ok(Ended::Interrupted);
    }
    if let Some(path) = &args.csv {
        atomic_file::write(path, &parts::csv(&clips)).map_err(Error::write(path))?;
    }
    let path = files.save((pass, shard), &bytes, &clips)?;
    let windows: usize = clips.iter().map(|clip| clip.windows.len()).sum();
    eprintln!(
        "lookout: pass {pass} of {passes}, shard {}/{}: {windows} windows of {} clips in {}",
        shard.index,
        shard.count,
        clips.len(),
        path.display()
    );
    Ok(Ended::Complete)
}

/// Grows trees on the windows of all shards, up to the next pass that must be mined, or to the model.
///
/// # Errors
/// As `lookout train`; [`TrainError::MissingShards`] and [`TrainError::Mined`] of the files of shards.
pub fn run_fit(args: &FitArgs) -> Result<Ended, Error> {
    check(&args.train)?;
    train(&args.train, Mining::Elsewhere)
}

fn check(args: &TrainArgs) -> Result<(), Error> {
    if args.from.is_some() || args.calibrate.is_some() {
        return Err(TrainError::NotMined.into());
    }
    Ok(())
}
