//! A folder of numbered folders of limited total size, the oldest of which are removed: logs and recordings.
//!
//! Only folders that carry the ring's own mark are ever removed.

use crate::shell::support::lock;
use std::collections::VecDeque;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::vec::Vec;
use std::{format, fs, io};

/// File that marks a folder as made by a ring.
const MARK: &str = ".lookout";
/// File that only one process at a time may lock.
const LOCK: &str = ".lookout.lock";

/// The numbered folders, oldest first, each with its size in bytes.
#[derive(Debug)]
pub struct FolderRing {
    root: PathBuf,
    folders: VecDeque<(PathBuf, u64)>,
    next: u64,
    /// Held as long as the ring is open.
    _lock: File,
}

/// Whether a disk had no room.
pub fn is_full(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded)
}

impl FolderRing {
    /// Takes up the folders of an earlier run; `root` is made if it does not exist.
    ///
    /// # Errors
    /// The system's; `ResourceBusy` where another process has this ring open.
    pub fn open(root: &Path) -> io::Result<Self> {
        fs::create_dir_all(root)?;
        let lock = lock::take(&root.join(LOCK))?;
        let (mut found, mut next) = (Vec::new(), 1);
        for entry in fs::read_dir(root)? {
            let entry = entry?;
            let name = entry.file_name();
            let digits = name.to_str().filter(|name| name.bytes().all(|c| c.is_ascii_digit()));
            let Some(number) = digits.and_then(|digits| digits.parse::<u64>().ok()) else {
                continue;
            };
            next = next.max(number.saturating_add(1));
            if entry.file_type()?.is_dir() && is_marked(&entry.path()) {
                found.push((number, entry.path()));
            }
        }
        found.sort();
        let mut folders = VecDeque::new();
        for (_, path) in found {
            let bytes = size(&path)?;
            folders.push_back((path, bytes));
        }
        Ok(Self { root: root.into(), folders, next, _lock: lock })
    }

    /// Starts the next folder, or goes on with the newest one where nothing was written to it. Where this fails, nothing is
    /// left behind.
    ///
    /// # Errors
    /// The system's.
    pub fn start(&mut self) -> io::Result<&Path> {
        if !self.folders.back().is_some_and(|(path, bytes)| *bytes == 0 && is_empty(path)) {
            // Somebody may have removed it.
            fs::create_dir_all(&self.root)?;
            let path = self.root.join(format!("{:06}", self.next));
            fs::create_dir(&path)?;
            // An empty file, which a full disk may still take: the mark has content.
            if let Err(error) = fs::write(path.join(MARK), "made by lookout\n") {
                remove(&path);
                return Err(error);
            }
            self.next += 1;
            self.folders.push_back((path, 0));
        }
        Ok(self.current().unwrap_or(&self.root))
    }

    /// Takes the newest folder away again, as when its first files could not be written.
    pub fn abandon(&mut self) {
        if let Some((path, _)) = self.folders.pop_back() {
            remove(&path);
        }
    }

    /// Path of the newest folder; `None` before the first one.
    pub fn current(&self) -> Option<&Path> {
        self.folders.back().map(|(path, _)| path.as_path())
    }

    /// Bytes in the newest folder.
    pub fn current_bytes(&self) -> u64 {
        self.folders.back().map_or(0, |(_, bytes)| *bytes)
    }

    /// Takes the oldest folder away where there are more than `least`; `false` where there are not.
    pub fn give_way(&mut self, least: usize) -> bool {
        if self.folders.len() <= least {
            return false;
        }
        self.folders.pop_front().is_some_and(|(oldest, _)| {
            remove(&oldest);
            true
        })
    }

    /// Counts bytes written to the newest folder, and takes the oldest away while there are more than `folders`, or more
    /// bytes in all than `bytes`. The newest stays.
    pub fn wrote(&mut self, written: u64, folders: usize, bytes: u64) {
        if let Some((_, current)) = self.folders.back_mut() {
            *current += written;
        }
        let all = |ring: &Self| ring.folders.iter().map(|(_, bytes)| bytes).sum::<u64>();
        while self.folders.len() > folders || all(self) > bytes {
            if !self.give_way(1) {
                break;
            }
        }
    }
}

fn is_marked(folder: &Path) -> bool {
    fs::symlink_metadata(folder.join(MARK)).is_ok_and(|mark| mark.is_file())
}

/// Whether there is nothing in a folder but the mark.
fn is_empty(folder: &Path) -> bool {
    is_marked(folder) && fs::read_dir(folder).is_ok_and(|entries| entries.count() == 1)
}

/// Removes a folder of ours.
fn remove(folder: &Path) {
    let removed = fs::remove_dir_all(folder);
    if let Err(error) = removed.or_else(|error| match error.kind() {
        ErrorKind::NotFound => Ok(()),
        _ => Err(error),
    }) {
        tracing::warn!("{}: cannot be removed: {error}", folder.display());
    }
}

/// Bytes of all files below a folder, but for the mark.
fn size(folder: &Path) -> io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let metadata = entry.metadata()?;
        if metadata.is_dir() {
            bytes += size(&entry.path())?;
        } else if entry.file_name() != MARK {
            bytes += metadata.len();
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;

    fn names(root: &Path) -> Vec<String> {
        let entries = fs::read_dir(root).unwrap();
        let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<_> = names.filter(|name| name != LOCK).collect();
        names.sort();
        names
    }

    #[test]
    fn the_oldest_give_way_also_over_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("ring");
        let mut ring = FolderRing::open(&root).unwrap();
        for number in 0..4 {
            let path = ring.start().unwrap().join("file");
            fs::write(path, [number; 100]).unwrap();
            ring.wrote(100, 3, 1000);
        }
        assert_eq!(names(&root), ["000002", "000003", "000004"]);
        assert_eq!(FolderRing::open(&root).unwrap_err().kind(), ErrorKind::ResourceBusy);
        drop(ring);
        let mut ring = FolderRing::open(&root).unwrap();
        assert_eq!(ring.current_bytes(), 100);
        ring.start().unwrap();
        ring.wrote(150, 9, 300);
        assert_eq!(names(&root), ["000004", "000005"]);
        // One that is too large alone stays: it is the newest.
        ring.wrote(900, 9, 300);
        assert_eq!(names(&root), ["000005"]);
    }

    #[test]
    fn folders_of_others_stay() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        for own in ["100", "2025", "000001"] {
            fs::create_dir(root.join(own)).unwrap();
            fs::write(root.join(own).join("DSC1.JPG"), [0; 1000]).unwrap();
        }
        let mut ring = FolderRing::open(root).unwrap();
        assert_eq!(ring.current(), None);
        for _ in 0..5 {
            let path = ring.start().unwrap().join("file");
            fs::write(path, [0; 100]).unwrap();
            ring.wrote(100, 1, 100);
        }
        while ring.give_way(0) {}
        assert_eq!(names(root), ["000001", "100", "2025"]);
        assert_eq!(fs::read(root.join("100/DSC1.JPG")).unwrap().len(), 1000);
        assert!(ring.start().unwrap().ends_with("002031"));
    }

    #[test]
    fn an_empty_folder_is_used_again() {
        let folder = tempfile::tempdir().unwrap();
        for _ in 0..3 {
            let mut ring = FolderRing::open(folder.path()).unwrap();
            assert!(ring.start().unwrap().ends_with("000001"));
            assert!(ring.start().unwrap().ends_with("000001"));
        }
        fs::remove_dir_all(folder.path().join("000001")).unwrap();
        let mut ring = FolderRing::open(folder.path()).unwrap();
        fs::write(ring.start().unwrap().join("file"), "x").unwrap();
        ring.wrote(1, 9, 9);
        ring.abandon();
        assert_eq!(names(folder.path()), [""; 0]);
    }
}
