//! Shared code of the fuzz targets.

use std::fs;
use std::path::PathBuf;

/// A place of this process among temporary files; `fuzz/run` has those in memory.
fn place(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("lookout-fuzz-{}-{name}", std::process::id()))
}

/// A file of this process that holds `data`, for readers that take a path.
pub fn file(name: &str, data: &[u8]) -> PathBuf {
    let path = place(name);
    fs::write(&path, data).expect("a file can be written");
    path
}

/// A folder of this process, for readers that take one.
pub fn folder(name: &str) -> PathBuf {
    let path = place(name);
    fs::create_dir_all(&path).expect("a folder can be made");
    path
}

/// Takes numbers from the front of the input; zeros when it is used up.
pub struct Input<'a>(pub &'a [u8]);

impl<'a> Input<'a> {
    /// The next byte.
    pub fn byte(&mut self) -> u8 {
        let Some((&first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        first
    }

    /// The next two bytes, little-endian.
    pub fn word(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// At most `count` bytes.
    pub fn bytes(&mut self, count: usize) -> &'a [u8] {
        let (head, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        head
    }

    /// Whether nothing is left.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}
