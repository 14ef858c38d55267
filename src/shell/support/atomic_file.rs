//! Files that are whole at any time.

use std::collections::hash_map::RandomState;
use std::format;
use std::fs::{self, File};
use std::hash::BuildHasher;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Writes a file so that a loss of power leaves the old one or the new one.
///
/// # Errors
/// The system's.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    by(path, ".new", bytes)
}

/// The same where other processes, on other machines too, may write the file at the same time: one of theirs or ours is
/// there at the end, whole.
///
/// # Errors
/// The system's.
pub fn write_beside_others(path: &Path, bytes: &[u8]) -> io::Result<()> {
    by(path, &format!(".{:016x}.new", unique()), bytes)
}

/// A name in the folder of `path` that no other process takes, for a file that is written piece by piece and
/// [placed](place) when it is complete.
pub fn beside(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{:016x}.new", unique()));
    path.with_file_name(name)
}

/// Puts the complete file `new` at `path`, in the same folder.
///
/// # Errors
/// The system's.
pub fn place(new: &Path, path: &Path) -> io::Result<()> {
    File::open(new)?.sync_all()?;
    put(new, path)
}

/// A number that no other process has.
pub fn unique() -> u64 {
    // The keys of a hash map are the system's random numbers.
    RandomState::new().hash_one((std::process::id(), super::clock::unix_us()))
}

fn by(path: &Path, ending: &str, bytes: &[u8]) -> io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(ending);
    let new = path.with_file_name(name);
    let mut file = File::create(&new)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    put(&new, path)
}

/// Gives a complete file, which the system has stored, its name in place of the one that is there.
fn put(new: &Path, path: &Path) -> io::Result<()> {
    fs::rename(new, path)?;
    // The folder too, or the new name may be lost. Not every file system can.
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
        let _ = folder.sync_all();
    }
    Ok(())
}
