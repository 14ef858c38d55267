//! One process at a time for a folder or a file.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Error, ErrorKind};
use std::path::Path;

/// Takes the lock `path`, a file that is made where there is none; it is held until the returned file is closed, also by
/// a `kill -9`.
///
/// # Errors
/// `ResourceBusy` where another process holds it; the system's where the file cannot be made.
pub fn take(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new().create(true).truncate(false).write(true).open(path)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => {
            Err(Error::new(ErrorKind::ResourceBusy, "used by another lookout"))
        }
        // A file system without locks.
        Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => Ok(file),
        Err(TryLockError::Error(error)) => Err(error),
    }
}
