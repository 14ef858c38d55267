//! `lookout eval --manifest M --out DIR`: the clips of a shard, each result a file.

use super::fetch;
use super::form::ResultForm;
use super::manifest::Manifest;
use super::outcome::{self, ClipOutcome};
use super::row::ManifestRow;
use super::settings::{self, RunFile};
use super::shard::Shard;
use super::turn::{self, ClipTurn};
use crate::model::Model;
use crate::shell::error::Error;
use crate::shell::evaluate::clip_run::{self, RunSettings};
use crate::shell::evaluate::track_metrics::FollowSettings;
use crate::shell::formats::detections::Decimal;
use crate::shell::pipeline::{DetectorArgs, ModelFile, PipelineError, on_clips};
use crate::shell::support::atomic_file;
use crate::shell::support::interrupt::{self, Ended};
use std::eprintln;
use std::format;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;

/// Inputs of a shard's run.
#[derive(Clone, Copy)]
pub struct ShardArgs<'a> {
    /// Clips of the run.
    pub manifest: &'a Manifest,
    /// The part of it; none: what the environment says, else all.
    pub shard: Option<Shard>,
    /// Folder of the run, shared by all shards.
    pub out: &'a Path,
    /// The detector's switches, with the model.
    pub detector: &'a DetectorArgs,
    /// How objects are followed.
    pub follow: &'a (dyn Fn(&Model<'_>) -> FollowSettings + Sync),
    /// Form of the results.
    pub form: ResultForm,
    /// Clips at a time; 0: one a processor core.
    pub jobs: usize,
}

/// Runs the clips of a shard that have no result yet.
///
/// # Errors
/// [`Error::Forever`] where the same would fail again: a model, manifest or shard that makes no sense, and, after all
/// others are done, clips that cannot be decoded. Other errors may be of the machine or its network.
pub fn run(args: ShardArgs<'_>) -> Result<Ended, Error> {
    let shard = turn::shard(args.shard)?;
    let file = ModelFile::load(args.detector.model.as_deref())?;
    let forever = |error: PipelineError| Error::Forever(Error::from(error).into());
    let model = file.parse().map_err(forever)?;
    let least = args.detector.least_score(&model).map_err(forever)?;
    let follow = (args.follow)(&model);
    let detector = DetectorArgs { model: None, ..args.detector.clone() };
    let version = env!("CARGO_PKG_VERSION");
    let FollowSettings { with_attitude, assumed_fov, strict, .. } = follow;
    let words = format!("{version} {detector:?} {with_attitude} {assumed_fov} {strict}");
    let common = RunFile {
        model: format!("{:08x}", file.checksum()),
        arguments: settings::hash(&words),
        least: least.map(|bits| Decimal::score(bits).to_f64()),
        tracks: strict,
        assumed_fov,
        form: args.form,
    };
    common.write(args.out, file.bytes(), &args.manifest.bytes)?;
    interrupt::watch()?;
    let rows: Vec<&ManifestRow> = {
        let rows = args.manifest.rows.iter().enumerate();
        rows.filter(|(place, _)| shard.holds(*place)).map(|(_, row)| row).collect()
    };
    let settings = RunSettings {
        model: Some(&model),
        detector: args.detector,
        follow: Some(follow),
        out: None,
    };
    let work = |index: usize, row: &&ManifestRow| turn(&args, &common, settings, index, row);
    let Some(turns) = on_clips::<_, Error, _>(&rows, args.jobs, &work)? else {
        eprintln!(
            "lookout: interrupted; the results so far are complete, the same command goes on"
        );
        return Ok(Ended::Interrupted);
    };
    turn::end(shard, &turns)
}

/// Measures one clip, unless its result is there. Only what keeps all others from being done too is an error.
fn turn(
    args: &ShardArgs<'_>,
    common: &RunFile,
    settings: RunSettings<'_>,
    index: usize,
    row: &ManifestRow,
) -> Result<ClipTurn, Error> {
    turn::note(&row.clip, try_turn(args, common, settings, index, row))
}

fn try_turn(
    args: &ShardArgs<'_>,
    common: &RunFile,
    settings: RunSettings<'_>,
    index: usize,
    row: &ManifestRow,
) -> Result<(ClipTurn, Option<String>), Error> {
    let fetched = fetch::fetch(row)?;
    let (row, folder) = match &fetched {
        Some(fetched) => (&fetched.row, fetched.folder()),
        None => (row, args.manifest.folder.as_path()),
    };
    let (clip, facts) = match row.clip(folder) {
        Err(error) if !turn::is_of_the_machine(&error) => {
            return unreadable(args, common, row, &error);
        }
        read => read?,
    };
    let name = outcome::content(&clip, &facts, &[])? + &common.suffix();
    let path: PathBuf = settings::clips(args.out).join(name);
    if path.is_file() {
        let reason = outcome::broken(&path)?;
        return Ok((if reason.is_some() { ClipTurn::Broken } else { ClipTurn::Before }, reason));
    }
    let kind = facts.kind.clone();
    let result = match clip_run::run(index, &clip, kind.as_deref(), settings, None) {
        // A decoder that was cut short leaves a result of a part of the frames.
        Ok(_) if interrupt::requested() => return Ok((ClipTurn::Unread, None)),
        Err(error) if turn::is_of_the_machine(&error) => return Err(error),
        Err(error) => Err(error.to_string()),
        Ok(result) => Ok(result),
    };
    let reason = result.as_ref().err().cloned();
    let bytes = outcome::encode(ClipOutcome { clip, facts, result }, common.form)?;
    atomic_file::write_beside_others(&path, &bytes).map_err(Error::write(&path))?;
    Ok((if reason.is_some() { ClipTurn::Broken } else { ClipTurn::Now }, reason))
}

/// Writes down that a clip's labels or facts make no sense; its contents are then those words.
fn unreadable(
    args: &ShardArgs<'_>,
    common: &RunFile,
    row: &ManifestRow,
    error: &Error,
) -> Result<(ClipTurn, Option<String>), Error> {
    let reason = error.to_string();
    let name = outcome::content_of_words(&format!("{row:?} {reason}")) + &common.suffix();
    let path = settings::clips(args.out).join(name);
    let outcome = ClipOutcome::broken(&row.clip, &reason);
    atomic_file::write_beside_others(&path, &outcome::encode(outcome, common.form)?)
        .map_err(Error::write(&path))?;
    Ok((ClipTurn::Broken, Some(reason)))
}
