//! Errors of text files and camera files.

use crate::shell::support::file_error::FileError;
use std::path::PathBuf;
use std::string::String;

/// Why a file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FormatError {
    /// The system refuses the file.
    #[error(transparent)]
    File(#[from] FileError),
    /// A camera file or option that makes no camera.
    #[error("{}: {reason}", path.display())]
    Camera {
        /// The file, or the options.
        path: PathBuf,
        /// The field, and what is expected.
        reason: String,
    },
    /// A line of a text file that is not understood.
    #[error("{} line {line}: {reason}", path.display())]
    Line {
        /// Path of the file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The field, and what is expected.
        reason: String,
    },
}
