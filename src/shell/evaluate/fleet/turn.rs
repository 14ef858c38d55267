//! One clip of a shard after its turn, and the end of a shard: shared by the verbs that work on a manifest.

use super::FleetError;
use super::shard::Shard;
use crate::shell::error::Error;
use crate::shell::formats::clips::ClipsError;
use crate::shell::formats::ground_truth::TruthError;
use crate::shell::pipeline::PipelineError;
use crate::shell::sources::SourceError;
use crate::shell::support::file_error::FileError;
use crate::shell::support::interrupt::Ended;
use std::eprintln;
use std::string::{String, ToString};

/// One clip of a shard after its turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClipTurn {
    /// Its result was there.
    Before,
    /// Measured now.
    Now,
    /// It never can be; said now or before.
    Broken,
    /// It could not be read now.
    Unread,
}

/// The shard that was asked for, else the one that the engine's environment variables name, else all clips.
///
/// # Errors
/// [`Error::Forever`] of [`FleetError::Shard`].
pub fn shard(asked: Option<Shard>) -> Result<Shard, Error> {
    if let Some(shard) = asked {
        return Ok(shard);
    }
    let found = Shard::of_environment(|name| std::env::var(name).ok());
    Ok(match found.map_err(FleetError::forever)? {
        Some((shard, name)) => {
            eprintln!("lookout: shard {}/{} ({name})", shard.index, shard.count);
            shard
        }
        None => Shard::default(),
    })
}

/// Writes the reason of a clip that was not measured on standard error.
///
/// # Errors
/// Only those that keep all other clips from being done too: files that cannot be written.
pub fn note(
    clip: &str,
    done: Result<(ClipTurn, Option<String>), Error>,
) -> Result<ClipTurn, Error> {
    let (turn, reason) = match done {
        Ok(done) => done,
        Err(error @ Error::File(FileError::Write { .. })) => return Err(error),
        Err(error) => (ClipTurn::Unread, Some(error.to_string())),
    };
    if let Some(reason) = reason {
        eprintln!("lookout: {clip}: {}", reason.replace(['\r', '\n'], " "));
    }
    Ok(turn)
}

/// Counts the clips of a shard on standard error.
///
/// # Errors
/// [`FleetError::Unread`] where the same command may do more, else [`FleetError::Broken`], after which it will not.
pub fn end(shard: Shard, turns: &[ClipTurn]) -> Result<Ended, Error> {
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

/// Whether an error may be gone on another machine or at another time.
pub fn is_of_the_machine(error: &Error) -> bool {
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
