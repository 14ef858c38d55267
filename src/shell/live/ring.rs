//! A folder of numbered folders, of which the oldest give way: logs and recordings of limited size.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::{format, fs, io};

/// The numbered folders, oldest first, each with its size in bytes.
#[derive(Debug)]
pub struct Ring {
    root: PathBuf,
    folders: VecDeque<(PathBuf, u64)>,
    next: u64,
}

impl Ring {
    /// Takes up what is there already; the folder is made if it does not exist.
    ///
    /// # Errors
    /// The system's.
    pub fn open(root: &Path) -> io::Result<Self> {
        fs::create_dir_all(root)?;
        let mut found = std::vec::Vec::new();
        for entry in fs::read_dir(root)? {
            let entry = entry?;
            // What is not ours is left alone.
            let number = entry.file_name().to_str().and_then(|name| name.parse::<u64>().ok());
            if let Some(number) = number.filter(|_| entry.path().is_dir()) {
                found.push((number, entry.path()));
            }
        }
        found.sort();
        let next = found.last().map_or(1, |(number, _)| number + 1);
        let mut folders = VecDeque::new();
        for (_, path) in found {
            let bytes = size(&path)?;
            folders.push_back((path, bytes));
        }
        Ok(Self { root: root.into(), folders, next })
    }

    /// Starts the next folder.
    ///
    /// # Errors
    /// The system's.
    pub fn start(&mut self) -> io::Result<&Path> {
        let path = self.root.join(format!("{:06}", self.next));
        fs::create_dir(&path)?;
        self.next += 1;
        self.folders.push_back((path, 0));
        Ok(self.current().unwrap_or(&self.root))
    }

    /// The newest folder.
    pub fn current(&self) -> Option<&Path> {
        self.folders.back().map(|(path, _)| path.as_path())
    }

    /// Bytes in the newest folder.
    pub fn current_bytes(&self) -> u64 {
        self.folders.back().map_or(0, |(_, bytes)| *bytes)
    }

    /// Counts bytes written to the newest folder, and takes the oldest away while there are more than `folders`, or more
    /// bytes in all than `bytes`. The newest stays.
    ///
    /// # Errors
    /// The system's.
    pub fn wrote(&mut self, written: u64, folders: usize, bytes: u64) -> io::Result<()> {
        if let Some((_, current)) = self.folders.back_mut() {
            *current += written;
        }
        let all = |ring: &Self| ring.folders.iter().map(|(_, bytes)| bytes).sum::<u64>();
        while self.folders.len() > 1 && (self.folders.len() > folders || all(self) > bytes) {
            if let Some((oldest, _)) = self.folders.pop_front() {
                fs::remove_dir_all(oldest)?;
            }
        }
        Ok(())
    }
}

/// Bytes of all files below a folder.
fn size(folder: &Path) -> io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let metadata = entry.metadata()?;
        bytes += if metadata.is_dir() { size(&entry.path())? } else { metadata.len() };
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;
    use std::vec::Vec;

    fn names(root: &Path) -> Vec<String> {
        let entries = fs::read_dir(root).unwrap();
        let mut names: Vec<_> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn the_oldest_give_way_also_over_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("ring");
        let mut ring = Ring::open(&root).unwrap();
        for number in 0..4 {
            let path = ring.start().unwrap().join("file");
            fs::write(path, [number; 100]).unwrap();
            ring.wrote(100, 3, 1000).unwrap();
        }
        assert_eq!(names(&root), ["000002", "000003", "000004"]);
        fs::write(root.join("notes.txt"), "not ours").unwrap();
        let mut ring = Ring::open(&root).unwrap();
        assert_eq!(ring.current_bytes(), 100);
        ring.start().unwrap();
        ring.wrote(150, 9, 300).unwrap();
        assert_eq!(names(&root), ["000004", "000005", "notes.txt"]);
        // One that is too large alone stays: it is the newest.
        ring.wrote(900, 9, 300).unwrap();
        assert_eq!(names(&root), ["000005", "notes.txt"]);
    }
}
