//! A file that cannot be read or written, with advice.

use std::io;
use std::path::{Path, PathBuf};

/// The name of standard output in messages.
pub const STDOUT: &str = "standard output";

/// A file or folder that the system refuses.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It cannot be read.
    #[error("{}: cannot read: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// It cannot be written.
    #[error("{}: cannot write: {source}{}", path.display(), advice(source))]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
}

impl FileError {
    /// For `map_err`: `path` cannot be read.
    pub fn read(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Read { path: path.into(), source }
    }

    /// For `map_err`: `path` cannot be written.
    pub fn write(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::Write { path: path.into(), source }
    }

    /// Whether the reader of our standard output has left, which is no fault.
    pub fn is_closed_pipe(&self) -> bool {
        matches!(self, Self::Write { source, path }
            if source.kind() == io::ErrorKind::BrokenPipe && path == Path::new(STDOUT))
    }
}

/// The remedy for a failed write.
fn advice(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; make room or write elsewhere, what was written before is kept"
        }
        io::ErrorKind::NotFound => "; make its folder first",
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "; write to a folder of your own"
        }
        io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => {
            "; a file stands where a folder is needed"
        }
        _ => "",
    }
}
