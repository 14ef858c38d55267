//! Lines on standard output.

use super::file_error::{FileError, STDOUT};
use std::io::{self, Write};
use std::path::Path;

/// Writes `line` and a line feed to standard output.
///
/// # Errors
/// [`FileError::Write`]; [`FileError::is_closed_pipe`] when its reader has left.
pub fn print_line(line: &str) -> Result<(), FileError> {
    writeln!(io::stdout().lock(), "{line}").map_err(FileError::write(Path::new(STDOUT)))
}
