//! Windows of the scan's stage on disk, so that a training that is ended in this stage goes on where it was.

use super::windows::Window;
use crate::scan::cascade::FEATURES;
use crate::shell::error::Error;
use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;
use std::{format, vec};

/// Target of a window that shows none.
const NO_TARGET: u32 = u32::MAX;

/// One file for each pass over the frames: the settings of the training, then the windows of the pass.
#[derive(Debug)]
pub struct WindowFiles {
    out: PathBuf,
    settings: String,
}

impl WindowFiles {
    /// Beside the model file `out`; files of other settings are not read.
    pub fn new(out: &Path, settings: &str) -> Self {
        Self { out: out.into(), settings: settings.into() }
    }

    fn path(out: &Path, pass: usize) -> PathBuf {
        out.with_extension(format!("windows-{pass}"))
    }

    /// Writes the windows of a pass: whole, or not at all.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn save(&self, pass: usize, windows: &[Window]) -> Result<(), Error> {
        let path = Self::path(&self.out, pass);
        let partial = self.out.with_extension("windows.tmp");
        let written = self.write(&partial, windows).and_then(|()| fs::rename(&partial, &path));
        written.map_err(Error::write(&path))
    }

    fn write(&self, path: &Path, windows: &[Window]) -> io::Result<()> {
        let mut file = BufWriter::new(File::create(path)?);
        file.write_all(&(self.settings.len() as u64).to_le_bytes())?;
        file.write_all(self.settings.as_bytes())?;
        write_windows(&mut file, windows)?;
        file.into_inner()?.sync_all()
    }

    /// The windows of a pass; none where they were not written, or with other settings.
    pub fn load(&self, pass: usize) -> Option<Vec<Window>> {
        let mut file = BufReader::new(File::open(Self::path(&self.out, pass)).ok()?);
        let mut number = || {
            let mut bytes = [0; 8];
            file.read_exact(&mut bytes).ok()?;
            Some(u64::from_le_bytes(bytes))
        };
        if number()? != self.settings.len() as u64 {
            return None;
        }
        let mut settings = vec![0; self.settings.len()];
        file.read_exact(&mut settings).ok()?;
        if settings != self.settings.as_bytes() {
            return None;
        }
        read_windows(&mut file).ok()
    }

    /// Removes the files of all passes beside the model file `out`.
    pub fn remove(out: &Path) {
        // Missing files need no removal, and files that stay do no harm.
        for pass in 0.. {
            if fs::remove_file(Self::path(out, pass)).is_err() {
                break;
            }
        }
    }
}

/// Writes the number of windows, then each: its target, whether it is held back, its values.
///
/// # Errors
/// The system's.
pub fn write_windows(file: &mut impl Write, windows: &[Window]) -> io::Result<()> {
    file.write_all(&(windows.len() as u64).to_le_bytes())?;
    for window in windows {
        file.write_all(&window.target.unwrap_or(NO_TARGET).to_le_bytes())?;
        file.write_all(&[window.held_back.into()])?;
        file.write_all(&window.values)?;
    }
    Ok(())
}

/// Reads what [`write_windows`] wrote.
///
/// # Errors
/// The system's; of a file that is cut short too.
pub fn read_windows(file: &mut impl Read) -> io::Result<Vec<Window>> {
    let mut bytes = [0; 8];
    file.read_exact(&mut bytes)?;
    let count = u64::from_le_bytes(bytes);
    let mut windows = Vec::new();
    for _ in 0..count {
        let (mut head, mut values) = ([0; 5], [0; FEATURES]);
        file.read_exact(&mut head)?;
        file.read_exact(&mut values)?;
        let [a, b, c, d, held_back] = head;
        let target = u32::from_le_bytes([a, b, c, d]);
        windows.push(Window {
            values,
            target: (target != NO_TARGET).then_some(target),
            held_back: held_back != 0,
        });
    }
    Ok(windows)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn windows(count: u32) -> Vec<Window> {
        let window = |i: u32| Window {
            values: core::array::from_fn(|f| (f as u32 * 7 + i) as u8),
            target: (!i.is_multiple_of(3)).then_some(i),
            held_back: i.is_multiple_of(2),
        };
        (0..count).map(window).collect()
    }

    fn facts(windows: &[Window]) -> Vec<(Option<u32>, bool, Vec<u8>)> {
        windows.iter().map(|w| (w.target, w.held_back, w.values.to_vec())).collect()
    }

    #[test]
    fn a_pass_is_read_back_with_the_same_settings_alone() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("m.lkm");
        let files = WindowFiles::new(&out, "{\"seed\":1}");
        assert!(files.load(0).is_none());
        files.save(0, &windows(7)).unwrap();
        files.save(1, &windows(0)).unwrap();
        assert_eq!(facts(&files.load(0).unwrap()), facts(&windows(7)));
        assert_eq!(files.load(1).unwrap().len(), 0);
        assert!(files.load(2).is_none());
        for other in ["{\"seed\":2}", "{\"seed\":10}", ""] {
            assert!(WindowFiles::new(&out, other).load(0).is_none(), "{other}");
        }
        // Cut short: as if it were not there.
        let path = folder.path().join("m.windows-0");
        let bytes = fs::read(&path).unwrap();
        for length in [0, 5, 20, 30, bytes.len() - 1] {
            fs::write(&path, &bytes[..length]).unwrap();
            assert!(files.load(0).is_none(), "{length}");
        }
        WindowFiles::remove(&out);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
