//! A temporary file for data that are written once and read once or several times, so that memory does not grow with the clips.

use super::file_error::FileError;
use std::format;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, PoisonError};
use std::vec::Vec;

/// An append-only file without a name; the system frees it when the last handle closes, also after a kill.
#[derive(Debug)]
pub struct Spool {
    path: PathBuf,
    file: Mutex<Contents>,
}

#[derive(Debug)]
struct Contents {
    file: File,
    length: u64,
}

impl Spool {
    /// Creates an empty file in the folder of `beside`, which need not exist itself.
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn create(beside: &Path) -> Result<Self, FileError> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = beside.file_name().unwrap_or_default().to_string_lossy();
        let name = format!(".{name}.{}.{number}.spool", std::process::id());
        let path = beside.with_file_name(name);
        let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path);
        let file = file.map_err(FileError::write(&path))?;
        // Where an open file cannot lose its name, it is removed when the spool is dropped.
        let _ = fs::remove_file(&path);
        Ok(Self { path, file: Mutex::new(Contents { file, length: 0 }) })
    }

    /// Appends `bytes`; their place, for [`Spool::read`].
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn append(&self, bytes: &[u8]) -> Result<Range<u64>, FileError> {
        let mut contents = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let start = contents.length;
        contents.write(start, bytes).map_err(|source| self.failed(source))?;
        contents.length += bytes.len() as u64;
        Ok(start..contents.length)
    }

    /// Replaces the contents of `into` by the bytes at `place`.
    ///
    /// # Errors
    /// [`FileError::Write`]: the file is the program's own.
    pub fn read(&self, place: Range<u64>, into: &mut Vec<u8>) -> Result<(), FileError> {
        let mut contents = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        into.resize((place.end - place.start) as usize, 0);
        contents.read(place.start, into).map_err(|source| self.failed(source))
    }

    fn failed(&self, source: io::Error) -> FileError {
        FileError::Write { path: self.path.clone(), source }
    }
}

impl Drop for Spool {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
    }
}

impl Contents {
    fn write(&mut self, start: u64, bytes: &[u8]) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(start))?;
        self.file.write_all(bytes)
    }

    fn read(&mut self, start: u64, into: &mut [u8]) -> io::Result<()> {
        self.file.seek(SeekFrom::Start(start))?;
        self.file.read_exact(into)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_appended_is_read_and_no_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let spool = Spool::create(&folder.path().join("a.lkm")).unwrap();
        let places = [&b"one"[..], b"", b"three"].map(|bytes| spool.append(bytes).unwrap());
        assert_eq!(places, [0..3, 3..3, 3..8]);
        let mut read = Vec::new();
        spool.read(3..8, &mut read).unwrap();
        assert_eq!(read, b"three");
        spool.read(1..4, &mut read).unwrap();
        assert_eq!(read, b"net");
        assert!(matches!(spool.read(5..9, &mut read), Err(FileError::Write { .. })));
        drop(spool);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(Spool::create(&folder.path().join("missing/a.lkm")).is_err());
    }
}
