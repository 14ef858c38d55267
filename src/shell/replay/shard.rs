//! `lookout replay --manifest M --shard I/N --out DIR`: the flights of a list, each into a file of lines of JSON.
//!
//! A file is named by the clip, its contents, the model and the arguments, and is there whole or not at all: a run that was
//! ended goes on where it was, on any number of machines.

use super::{ReplayArgs, prepared, replay};
use crate::model::Model;
use crate::shell::error::Error;
use crate::shell::evaluate::facts::Facts;
use crate::shell::evaluate::fleet::fetch;
use crate::shell::evaluate::fleet::manifest::Manifest;
use crate::shell::evaluate::fleet::outcome;
use crate::shell::evaluate::fleet::row::ManifestRow;
use crate::shell::evaluate::fleet::settings;
use crate::shell::evaluate::fleet::shard::Shard;
use crate::shell::evaluate::fleet::turn::{self, ClipTurn};
use crate::shell::formats::clips::{Clip, ClipsError, GroundTruth};
use crate::shell::formats::seqinfo::SeqInfo;
use crate::shell::pipeline::{ModelFile, on_clips};
use crate::shell::sources;
use crate::shell::support::atomic_file;
use crate::shell::support::interrupt::{self, Ended};
use crate::tracking::tracker::TrackerSettings;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{eprintln, format, fs};

/// Arguments for many flights.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Many flights")]
pub struct ReplayShardArgs {
    /// The flights of this list (`lookout manifest`; labels are not needed), each into a file of --out DIR with the lines of
    /// --jsonl; a run that was ended goes on where it was
    #[arg(long, value_name = "FILE", requires = "out", conflicts_with_all = ["input", "detections", "jsonl", "annotate", "digest", "tlog_in", "tlog_out"])]
    pub manifest: Option<PathBuf>,
    /// Only every Nth flight of the list, from the Ith on, from 0; without it as Slurm, Kubernetes (with JOB_COMPLETIONS) or
    /// AWS Batch say in the environment, else all
    #[arg(long, value_name = "I/N", requires = "manifest", value_parser = Shard::parse)]
    shard: Option<Shard>,
    /// Folder for the files, which all shards share
    #[arg(long, value_name = "DIR", requires = "manifest")]
    out: Option<PathBuf>,
    /// Flights to process at a time; 0: one per processor core
    #[arg(long, value_name = "N", default_value_t = 0, requires = "manifest")]
    jobs: usize,
}

/// A run over the flights of a shard.
struct ReplayRun<'a> {
    args: ReplayArgs,
    threshold: i32,
    tracks: TrackerSettings,
    model: &'a Model<'a>,
    /// Folder of the manifest.
    folder: PathBuf,
    out: PathBuf,
    /// End of the names of its files.
    suffix: String,
}

/// Replays the flights of a shard that have no file yet.
///
/// # Errors
/// As `lookout eval --manifest`: [`Error::Forever`] where the same would fail again.
pub fn run(args: &ReplayArgs, manifest: &Path) -> Result<Ended, Error> {
    let ReplayShardArgs { shard, jobs, .. } = args.many;
    let shard = turn::shard(shard)?;
    let manifest = Manifest::read(manifest, &[])?;
    let file = ModelFile::load(args.detector.model.as_deref())?;
    let forever = |error: Error| Error::Forever(error.into());
    let model = file.parse().map_err(|error| forever(error.into()))?;
    let (args, threshold, tracks) = prepared(args, &model).map_err(forever)?;
    let out = args.many.out.clone().unwrap_or_default();
    fs::create_dir_all(&out).map_err(Error::write(&out))?;
    let mut words = args.clone();
    words.detector.model = None;
    (words.threads, words.many) = (0, ReplayShardArgs::default());
    let words = format!("{} {words:?} {threshold}", env!("CARGO_PKG_VERSION"));
    let suffix = format!("-{:08x}-{}", file.checksum(), settings::hash(&words));
    let run = ReplayRun {
        args,
        threshold,
        tracks,
        model: &model,
        folder: manifest.folder.clone(),
        out,
        suffix,
    };
    interrupt::watch()?;
    let rows = manifest.rows.iter().enumerate().filter(|(place, _)| shard.holds(*place));
    let rows: Vec<&ManifestRow> = rows.map(|(_, row)| row).collect();
    let work = |_: usize, row: &&ManifestRow| turn::note(&row.clip, run.turn(row));
    let Some(turns) = on_clips::<_, Error, _>(&rows, jobs, &work)? else {
        eprintln!("lookout: interrupted; the files so far are complete, the same command goes on");
        return Ok(Ended::Interrupted);
    };
    turn::end(shard, &turns)
}

impl ReplayRun<'_> {
    /// Replays one flight, unless its file is there.
    fn turn(&self, row: &ManifestRow) -> Result<(ClipTurn, Option<String>), Error> {
        let fetched = fetch::fetch(row)?;
        let (row, folder) = match &fetched {
            Some(fetched) => (&fetched.row, fetched.folder()),
            None => (row, self.folder.as_path()),
        };
        let clip = clip(row, folder)?;
        let log = (!row.telemetry.is_empty()).then(|| folder.join(&row.telemetry));
        let more: Vec<PathBuf> = log.clone().into_iter().collect();
        let content = outcome::content(&clip, &Facts::default(), &more)?;
        let path = self.out.join(format!("{}-{content}{}.jsonl", safe(&row.clip), self.suffix));
        let broken = path.with_extension("broken");
        if let Ok(reason) = fs::read_to_string(&broken) {
            return Ok((ClipTurn::Broken, Some(reason)));
        }
        if path.is_file() {
            return Ok((ClipTurn::Before, None));
        }
        let new = atomic_file::beside(&path);
        let args = ReplayArgs {
            input: Some(clip.input),
            jsonl: Some(new.clone()),
            telemetry: self.args.telemetry.clone().with_log(log),
            ..self.args.clone()
        };
        match replay(&args, self.threshold, self.tracks, self.model) {
            Ok(Ended::Complete) if !interrupt::requested() => {
                atomic_file::place(&new, &path).map_err(Error::write(&path))?;
                Ok((ClipTurn::Now, None))
            }
            ended => {
                // A file of a part of the frames; one that stays is never taken for a result.
                let _ = fs::remove_file(&new);
                let Err(error) = ended else { return Ok((ClipTurn::Unread, None)) };
                if interrupt::requested() || turn::is_of_the_machine(&error) {
                    return Err(error);
                }
                let reason = error.to_string();
                let written = atomic_file::write_beside_others(&broken, reason.as_bytes());
                written.map_err(Error::write(&broken))?;
                Ok((ClipTurn::Broken, Some(reason)))
            }
        }
    }
}

/// The flight of a row, without labels.
fn clip(row: &ManifestRow, folder: &Path) -> Result<Clip, Error> {
    let path = folder.join(&row.path);
    let (directory, input) = if path.is_dir() {
        let input = sources::clip_input(&path);
        let input = input.ok_or_else(|| ClipsError::NoFrames { path: path.clone() })?;
        (path, input)
    } else {
        (path.parent().unwrap_or(Path::new("")).into(), path)
    };
    Ok(Clip {
        name: row.clip.clone(),
        directory,
        input,
        ground_truth: GroundTruth::default(),
        info: SeqInfo::default(),
    })
}

/// A name that is one part of a path.
fn safe(name: &str) -> String {
    let fits = |c: char| c.is_alphanumeric() || ".-_".contains(c);
    name.chars().map(|c| if fits(c) { c } else { '_' }).collect()
}
