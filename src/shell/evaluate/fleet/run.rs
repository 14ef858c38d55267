//! `lookout eval --manifest M --out DIR`: the clips of a shard, each result a file.

use super::manifest::{Manifest, ManifestRow};
use super::outcome::{self, ClipOutcome};
use super::settings::{self, RunFile};
use super::shard::Shard;
use super::{FleetError, fetch};
use crate::model::Model;
use crate::shell::error::Error;
use crate::shell::evaluate::clip_run::{self, RunSettings};
use crate::shell::evaluate::track_metrics::FollowSettings;
use crate::shell::formats::clips::ClipsError;
use crate::shell::formats::detections::Decimal;
use crate::shell::formats::ground_truth::TruthError;
use crate::shell::pipeline::{DetectorArgs, ModelFile, PipelineError, on_clips};
use crate::shell::sources::SourceError;
use crate::shell::support::atomic_file;
use crate::shell::support::file_error::FileError;
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
    /// Clips at a time; 0: one a processor core.
    pub jobs: usize,
}

/// One clip of a shard after its turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ClipTurn {
    /// Its result was there.
    Before,
    /// Measured now.
    Now,
    /// It never can be; said now or before.
    Broken,
    /// It could not be read now.
    Unread,
}

/// Runs the clips of a shard that have no result yet.
///
/// # Errors
/// [`Error::Forever`] where the same would fail again: a model, manifest or shard that makes no sense, and, after all
/// others are done, clips that cannot be decoded. Other errors may be of the machine or its network.
pub fn run(args: ShardArgs<'_>) -> Result<Ended, Error> {
    let shard = match args.shard {
        Some(shard) => shard,
        None => of_environment()?,
    };
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
    let count = |turn: ClipTurn| turns.iter().filter(|t| **t == turn).count();
    let [now, before] = [ClipTurn::Now, ClipTurn::Before].map(count);
    let [broken, unread, all] = [count(ClipTurn::Broken), count(ClipTurn::Unread), turns.len()];
    let Shard { index, count } = shard;
    eprintln!("lookout: shard {index}/{count}: {now} clips measured, {before} were before");
    match (unread, broken) {
        (0, 0) => Ok(Ended::Complete),
        (0, broken) => Err(FleetError::Broken { broken, all }.forever()),
        (unread, _) => Err(Error::verb(FleetError::Unread { unread, all })),
    }
}

fn of_environment() -> Result<Shard, Error> {
    let found = Shard::of_environment(|name| std::env::var(name).ok());
    Ok(match found.map_err(FleetError::forever)? {
        Some((shard, name)) => {
            eprintln!("lookout: shard {}/{} ({name})", shard.index, shard.count);
            shard
        }
        None => Shard::default(),
    })
}

/// Measures one clip, unless its result is there. Only what keeps all others from being done too is an error.
fn turn(
    args: &ShardArgs<'_>,
    common: &RunFile,
    settings: RunSettings<'_>,
    index: usize,
    row: &ManifestRow,
) -> Result<ClipTurn, Error> {
    let done = try_turn(args, common, settings, index, row);
    let (turn, reason) = match done {
        Ok((turn, reason)) => (turn, reason),
        Err(error @ Error::File(FileError::Write { .. })) => return Err(error),
        Err(error) => (ClipTurn::Unread, Some(error.to_string())),
    };
    if let Some(reason) = reason {
        eprintln!("lookout: {}: {}", row.clip, reason.replace(['\r', '\n'], " "));
    }
    Ok(turn)
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
        Err(error) if !is_of_the_machine(&error) => return unreadable(args, common, row, &error),
        read => read?,
    };
    let name = outcome::content(&clip, &facts)? + &common.suffix();
    let path: PathBuf = settings::clips(args.out).join(name);
    if path.is_file() {
        let reason = outcome::broken(&path)?;
        return Ok((if reason.is_some() { ClipTurn::Broken } else { ClipTurn::Before }, reason));
    }
    let kind = facts.kind.clone();
    let result = match clip_run::run(index, &clip, kind.as_deref(), settings, None) {
        // A decoder that was cut short leaves a result of a part of the frames.
        Ok(_) if interrupt::requested() => return Ok((ClipTurn::Unread, None)),
        Err(error) if is_of_the_machine(&error) => return Err(error),
        Err(error) => Err(error.to_string()),
        Ok(result) => Ok(result),
    };
    let reason = result.as_ref().err().cloned();
    let bytes = outcome::encode(ClipOutcome { clip, facts, result });
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
    atomic_file::write_beside_others(&path, &outcome::encode(outcome))
        .map_err(Error::write(&path))?;
    Ok((ClipTurn::Broken, Some(reason)))
}

/// Whether an error may be gone on another machine or at another time.
fn is_of_the_machine(error: &Error) -> bool {
    match error {
        Error::File(_) | Error::Interrupt(_) => true,
        Error::Pipeline(error) => match error {
            PipelineError::Source(error) => is_of_the_source(error),
            PipelineError::File(FileError::Read { .. } | FileError::Write { .. })
            | PipelineError::Threads { .. } => true,
            _ => false,
        },
        Error::Source(error) => is_of_the_source(error),
        Error::Clips(error) => matches!(
            error,
            ClipsError::Read { .. }
                | ClipsError::NoFrames { .. }
                | ClipsError::Truth(TruthError::Read { .. })
        ),
        _ => false,
    }
}

fn is_of_the_source(error: &SourceError) -> bool {
    match error {
        SourceError::Open { .. } | SourceError::Read { .. } | SourceError::FfmpegMissing { .. } => {
            true
        }
        // Without a word of its own it was ended from outside: by a system without memory, for example.
        SourceError::Ffmpeg { message, .. } => message.starts_with("it ended with"),
        _ => false,
    }
}
