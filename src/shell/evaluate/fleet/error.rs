//! Why a part of a fleet's work cannot be done.

use crate::shell::error::Error;
use std::format;
use std::path::PathBuf;
use std::string::String;
use std::vec::Vec;

/// Why a part of a fleet's work cannot be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FleetError {
    /// A manifest that does not say what it should.
    #[error("{} line {line}: {reason}; the first line is clip,split,path,labels,telemetry,tags, see `lookout manifest`", path.display())]
    Manifest {
        /// Path of the file.
        path: PathBuf,
        /// The line, from 1.
        line: u64,
        /// Fault, in words.
        reason: String,
    },
    /// A shard that is none.
    #[error("{name} {value}: {reason}")]
    Shard {
        /// Where it was said: `--shard`, or an environment variable.
        name: String,
        /// Value that was given.
        value: String,
        /// Fault of the value.
        reason: &'static str,
    },
    /// A clip whose files cannot be fetched.
    #[error("{url}: cannot be fetched: {reason}")]
    Fetch {
        /// Address that was to be fetched.
        url: String,
        /// In words.
        reason: String,
    },
    /// Clips of a shard that can never be measured.
    #[error(
        "{broken} of {all} clips of this shard cannot be measured, see above; trying again gives the same"
    )]
    Broken {
        /// How many.
        broken: usize,
        /// Number of all shards or clips.
        all: usize,
    },
    /// Clips of a shard that could not be read this time.
    #[error(
        "{unread} of {all} clips of this shard could not be read, see above; the same command tries them again"
    )]
    Unread {
        /// How many.
        unread: usize,
        /// Number of all shards or clips.
        all: usize,
    },
    /// A result that cannot be read.
    #[error("{}: {reason}; remove it and run the shard again", path.display())]
    Result {
        /// Path of the file.
        path: PathBuf,
        /// Fault, in words.
        reason: String,
    },
    /// A Parquet manifest that does not say what it should.
    #[error("{}: no manifest: {reason}; columns clip, split, path, labels, telemetry and tags, see `lookout manifest`", path.display())]
    Table {
        /// Path of the file.
        path: PathBuf,
        /// Fault, in words.
        reason: String,
    },
    /// A Parquet file, and a program without the feature for it.
    #[error("{}: this program has no Parquet; build it with --features parquet, or {instead}", path.display())]
    NoParquet {
        /// Path of the file.
        path: PathBuf,
        /// Another way to the same.
        instead: &'static str,
    },
    /// Two results of one clip.
    #[error("{clip}: two results, {} and {}: the clip changed during the run; remove that of the old contents", files[0].display(), files[1].display())]
    TwoResults {
        /// Name of the clip.
        clip: String,
        /// Paths of both files.
        files: [PathBuf; 2],
    },
    /// Clips without a result.
    #[error("{} of {all} clips have no result yet ({}); run their shards again, or give --partial for a report of the others", missing.len(), first(missing))]
    Missing {
        /// Their names.
        missing: Vec<String>,
        /// Clips of the manifest.
        all: usize,
    },
}

/// The first names of a list.
fn first(names: &[String]) -> String {
    let shown = names.iter().take(5).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > 5 { format!("{shown}, ...") } else { shown }
}

impl FleetError {
    /// As an error of a verb after which the same must not be tried again.
    pub fn forever(self) -> Error {
        Error::Forever(Error::verb(self).into())
    }
}
