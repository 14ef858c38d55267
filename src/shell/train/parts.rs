//! Windows that were mined on many machines: one file a shard and pass, joined in the order of the clips.
//!
//! Beside the model `M.lkm`, `M.mined-P.I-of-N` has the windows of pass P that shard I found, `M.round-P.lkm` the model that
//! pass P mines against; the first pass needs none. Both know the settings of the training, a file of windows also the
//! model's checksum: windows against another model are never joined.

use super::TrainError;
use super::window_files::{read_windows, write_windows};
use super::windows::Window;
use crate::model::{self, Model};
use crate::shell::error::Error;
use crate::shell::evaluate::fleet::shard::Shard;
use crate::shell::support::atomic_file;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, vec};

/// First bytes of a file of windows.
const MAGIC: [u8; 8] = *b"LKMINED1";

/// Windows of one clip.
#[derive(Debug)]
pub struct MinedClip {
    /// Number of the clip among all clips.
    pub number: u32,
    /// Frames that were shown.
    pub frames: u32,
    /// Windows, in the order of the frames.
    pub windows: Vec<Window>,
}

/// Windows of all shards.
#[derive(Debug)]
pub struct JoinedWindows {
    /// Windows in the order of clips and frames.
    pub windows: Vec<Window>,
    /// Number of clips.
    pub clips: usize,
    /// Number of frames that were shown.
    pub frames: usize,
}

/// The files of a training in shards.
#[derive(Debug)]
pub struct PartFiles {
    out: PathBuf,
    settings: String,
}

impl PartFiles {
    /// Beside the model file `out`.
    pub fn new(out: &Path, settings: &str) -> Self {
        Self { out: out.into(), settings: settings.into() }
    }

    /// Settings of the training.
    pub fn settings(&self) -> &str {
        &self.settings
    }

    fn path(&self, pass: usize, shard: Shard) -> PathBuf {
        self.out.with_extension(format!("mined-{pass}.{}-of-{}", shard.index, shard.count))
    }

    fn round(&self, pass: usize) -> PathBuf {
        self.out.with_extension(format!("round-{pass}.lkm"))
    }

    /// Bytes of the model that `pass` mines against; `None` where there is none of these settings.
    pub fn model(&self, pass: usize) -> Option<Vec<u8>> {
        let bytes = fs::read(self.round(pass)).ok()?;
        let fits = Model::parse(&bytes).ok()?.provenance() == self.settings;
        fits.then_some(bytes)
    }

    /// Writes the model that `pass` mines against; its provenance are the settings.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn save_model(&self, pass: usize, bytes: &[u8]) -> Result<(), Error> {
        let path = self.round(pass);
        atomic_file::write(&path, bytes).map_err(Error::write(&path))
    }

    /// The pass that is to be mined: that of the newest model, else the first.
    pub fn newest(&self, passes: usize) -> usize {
        (1..passes).rev().find(|&pass| self.model(pass).is_some()).unwrap_or(0)
    }

    /// Whether the windows of a shard against `model` (empty: none) are there.
    pub fn has(&self, pass: usize, shard: Shard, model: &[u8]) -> bool {
        self.load(&self.path(pass, shard), model).is_ok()
    }

    /// Writes the windows of a shard: whole, or not at all.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn save(
        &self,
        (pass, shard): (usize, Shard),
        model: &[u8],
        clips: &[MinedClip],
    ) -> Result<PathBuf, Error> {
        let path = self.path(pass, shard);
        let new = atomic_file::beside(&path);
        let written = self.write(&new, model, clips).and_then(|()| atomic_file::place(&new, &path));
        if let Err(source) = written {
            // Half a file is of no use; the first error is returned.
            let _ = fs::remove_file(&new);
            return Err(Error::write(&path)(source));
        }
        Ok(path)
    }

    fn write(&self, path: &Path, model: &[u8], clips: &[MinedClip]) -> io::Result<()> {
        let mut file = BufWriter::new(File::create(path)?);
        file.write_all(&MAGIC)?;
        file.write_all(&model::checksum(model).to_le_bytes())?;
        file.write_all(&(self.settings.len() as u32).to_le_bytes())?;
        file.write_all(self.settings.as_bytes())?;
        file.write_all(&(clips.len() as u32).to_le_bytes())?;
        for clip in clips {
            file.write_all(&clip.number.to_le_bytes())?;
            file.write_all(&clip.frames.to_le_bytes())?;
            write_windows(&mut file, &clip.windows)?;
        }
        file.flush()
    }

    /// The windows in a file.
    ///
    /// # Errors
    /// Its fault, in words.
    fn load(&self, path: &Path, model: &[u8]) -> Result<Vec<MinedClip>, String> {
        let file = File::open(path).map_err(|error| error.to_string())?;
        let mut file = BufReader::new(file);
        let short = |_: io::Error| "it is cut short".to_string();
        let mut magic = [0; 8];
        file.read_exact(&mut magic).map_err(short)?;
        if magic != MAGIC {
            return Err("it holds no windows".into());
        }
        let checksum = number(&mut file).map_err(short)?;
        let length = number(&mut file).map_err(short)?;
        let mut settings = Vec::new();
        (&mut file).take(length.into()).read_to_end(&mut settings).map_err(short)?;
        if settings.len() < length as usize {
            return Err("it is cut short".into());
        }
        if settings != self.settings.as_bytes() {
            return Err("it was mined with other settings".into());
        }
        if checksum != model::checksum(model) {
            return Err("it was mined against another model".into());
        }
        let count = number(&mut file).map_err(short)?;
        let mut clips = Vec::new();
        for _ in 0..count {
            let (clip, frames) =
                (number(&mut file).map_err(short)?, number(&mut file).map_err(short)?);
            let windows = read_windows(&mut file).map_err(short)?;
            clips.push(MinedClip { number: clip, frames, windows });
        }
        Ok(clips)
    }

    /// The windows of all shards of a pass; `None` where no shard was mined yet.
    ///
    /// # Errors
    /// [`TrainError::MissingShards`], [`TrainError::Mined`] of a file that does not fit.
    pub fn join(&self, pass: usize, model: &[u8]) -> Result<Option<JoinedWindows>, Error> {
        let found = self.shards(pass)?;
        let Some(&(count, _)) = found.first() else { return Ok(None) };
        let other = found.iter().any(|shard| shard.0 != count);
        let missing = (0..count).filter(|&index| !found.contains(&(count, index)));
        let missing: Vec<String> = missing.map(|index| index.to_string()).collect();
        if other || !missing.is_empty() {
            return Err(TrainError::MissingShards { pass, missing, count, other }.into());
        }
        let mut clips: BTreeMap<u32, MinedClip> = BTreeMap::new();
        for index in 0..count {
            let path = self.path(pass, Shard { index, count });
            let wrong = |reason| TrainError::Mined { path: path.clone(), reason };
            for clip in self.load(&path, model).map_err(wrong)? {
                let number = clip.number;
                if clips.insert(number, clip).is_some() {
                    return Err(wrong(format!("another shard has clip {number} too")).into());
                }
            }
        }
        let frames = clips.values().map(|clip| clip.frames as usize).sum();
        let (count, clips) = (clips.len(), clips.into_values());
        let windows = clips.flat_map(|clip| clip.windows).collect();
        Ok(Some(JoinedWindows { windows, clips: count, frames }))
    }

    /// Number of shards and index of the files of a pass.
    fn shards(&self, pass: usize) -> Result<BTreeSet<(usize, usize)>, Error> {
        let stem = self.out.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let begin = format!("{stem}.mined-{pass}.");
        let mut found = BTreeSet::new();
        for name in self.names()? {
            let part = name.strip_prefix(&begin).and_then(|rest| rest.split_once("-of-"));
            let number = |text: &str| text.parse::<usize>().ok();
            if let Some((Some(index), Some(count))) = part.map(|(i, n)| (number(i), number(n)))
                && index < count
            {
                found.insert((count, index));
            }
        }
        Ok(found)
    }

    fn names(&self) -> Result<Vec<String>, Error> {
        let folder = match self.out.parent() {
            Some(folder) if folder != Path::new("") => folder,
            _ => Path::new("."),
        };
        let entries = fs::read_dir(folder).map_err(Error::read(folder))?;
        Ok(entries.flatten().map(|e| e.file_name().to_string_lossy().into_owned()).collect())
    }

    /// Removes the files of all passes.
    pub fn remove(out: &Path) {
        let files = Self::new(out, "");
        let stem = out.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let (mined, round) = (format!("{stem}.mined-"), format!("{stem}.round-"));
        for name in files.names().unwrap_or_default() {
            if name.starts_with(&mined) || name.starts_with(&round) {
                // Files that stay do no harm.
                let _ = fs::remove_file(out.with_file_name(name));
            }
        }
    }
}

fn number(file: &mut impl Read) -> io::Result<u32> {
    let mut bytes = [0; 4];
    file.read_exact(&mut bytes)?;
    Ok(u32::from_le_bytes(bytes))
}

/// The windows of a file of several shards as lines of CSV: 1 for a target and 0 for none, then the value of each feature.
/// Windows of clips that are held back are left out.
pub fn csv(clips: &[MinedClip]) -> Vec<u8> {
    let mut bytes = vec![];
    for window in clips.iter().flat_map(|clip| &clip.windows).filter(|w| !w.held_back) {
        bytes.push(if window.target.is_some() { b'1' } else { b'0' });
        for value in window.values {
            bytes.push(b',');
            bytes.extend(value.to_string().bytes());
        }
        bytes.push(b'\n');
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::cascade::FEATURES;

    fn clip(number: u32) -> MinedClip {
        let window = |i: u32| Window {
            values: core::array::from_fn(|f| (f as u32 * 3 + number + i) as u8),
            target: i.is_multiple_of(2).then_some(number * 10 + i),
            held_back: number == 1,
        };
        MinedClip { number, frames: 4, windows: (0..number).map(window).collect() }
    }

    #[test]
    fn shards_are_joined_in_the_order_of_clips() {
        let folder = tempfile::tempdir().unwrap();
        let files = PartFiles::new(&folder.path().join("m.lkm"), "{\"seed\":1}");
        assert!(files.join(0, b"").unwrap().is_none());
        let shard = |index| Shard { index, count: 2 };
        files.save((0, shard(1)), b"", &[clip(1), clip(3)]).unwrap();
        let said = files.join(0, b"").unwrap_err().to_string();
        assert!(said.contains("shard 0 of 2"), "{said}");
        files.save((0, shard(0)), b"", &[clip(0), clip(2)]).unwrap();
        assert!(files.has(0, shard(0), b"") && !files.has(0, shard(0), b"model"));
        let joined = files.join(0, b"").unwrap().unwrap();
        assert_eq!((joined.clips, joined.frames), (4, 16));
        let targets: Vec<Option<u32>> = joined.windows.iter().map(|w| w.target).collect();
        assert_eq!(targets, [Some(10), Some(20), None, Some(30), None, Some(32)]);
        assert_eq!(joined.windows[2].values, clip(2).windows[1].values);

        let said = files.join(0, b"another").unwrap_err().to_string();
        assert!(said.contains("another model") && said.contains("m.mined-0.0-of-2"), "{said}");
        let other = PartFiles::new(&folder.path().join("m.lkm"), "{\"seed\":2}");
        assert!(other.join(0, b"").unwrap_err().to_string().contains("other settings"));
        let path = folder.path().join("m.mined-0.1-of-2");
        let bytes = fs::read(&path).unwrap();
        for length in [0, 9, 20, bytes.len() - 1] {
            fs::write(&path, &bytes[..length]).unwrap();
            assert!(files.join(0, b"").unwrap_err().to_string().contains("cut short"), "{length}");
        }
        // Shards of another number of shards are not mixed with these.
        files.save((0, Shard { index: 0, count: 3 }), b"", &[clip(4)]).unwrap();
        assert!(files.join(0, b"").unwrap_err().to_string().contains("another number of shards"));
        PartFiles::remove(&folder.path().join("m.lkm"));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn windows_as_csv() {
        let text = String::from_utf8(csv(&[clip(1), clip(2)])).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 2, "a clip that is held back is not learned from");
        assert!(lines[0].starts_with("1,2,5,8,") && lines[1].starts_with("0,3,6,9,"), "{text}");
        assert_eq!(lines[0].split(',').count(), FEATURES + 1);
    }
}
