//! Sequences as clips: links to their frames, labels in `gt.txt`, rate and size in `seqinfo.ini`.

use super::classes::Mapped;
use super::{ClassMap, ImportError, Sequence, SequenceFrames};
use crate::shell::formats::class::Class;
use crate::shell::formats::ground_truth::{GroundTruth, TruthBox};
use crate::shell::formats::seqinfo::SeqInfo;
use std::collections::BTreeSet;
use std::path::Path;
use std::string::String;
use std::vec::Vec;
use std::{format, fs, io};

/// Counts of clips and labels that were written.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImportCounts {
    /// Clips that were written.
    pub clips: usize,
    /// Number of boxes in `gt.txt`.
    pub boxes: usize,
    /// Of these, boxes that count neither way.
    pub ignored: usize,
    /// Labels left out because their class is mapped to `skip`.
    pub skipped: usize,
    /// Clips whose frames were not found.
    pub without_frames: Vec<String>,
}

/// Writes every sequence as a clip into `out`.
///
/// # Errors
/// [`ImportError`]; classes and names are checked before anything is written.
pub fn clips(
    sequences: &[Sequence],
    map: &ClassMap,
    out: &Path,
    copy: bool,
) -> Result<ImportCounts, ImportError> {
    map.check(sequences)?;
    let mut names = BTreeSet::new();
    for sequence in sequences {
        let name = folder_name(&sequence.name);
        let folder = out.join(&name);
        if folder.exists() {
            return Err(ImportError::Exists { path: folder });
        }
        if !names.insert(name.clone()) {
            return Err(ImportError::SameName { name });
        }
    }
    let mut written = ImportCounts::default();
    for sequence in sequences {
        clip(sequence, map, out, copy, &mut written)?;
    }
    Ok(written)
}

/// A name that makes a folder: no separators, not hidden.
fn folder_name(name: &str) -> String {
    let plain = |c: char| if c.is_alphanumeric() || "-_. ".contains(c) { c } else { '_' };
    let name: String = name.chars().map(plain).collect();
    let name = name.trim_start_matches('.').trim();
    if name.is_empty() { "clip".into() } else { name.into() }
}

fn clip(
    sequence: &Sequence,
    map: &ClassMap,
    out: &Path,
    copy: bool,
    written: &mut ImportCounts,
) -> Result<(), ImportError> {
    let name = folder_name(&sequence.name);
    let folder = out.join(&name);
    fs::create_dir_all(&folder).map_err(ImportError::write(&folder))?;
    let truth = ground_truth(sequence, map, written);
    let mut info = SeqInfo {
        frame_rate: sequence.rate,
        length: sequence.length,
        size: sequence.size,
        directory: None,
    };
    match &sequence.frames {
        SequenceFrames::Missing => written.without_frames.push(name.clone()),
        SequenceFrames::Video(video) => {
            let ending = video.extension().unwrap_or_default().to_string_lossy();
            link(video, &folder.join(format!("video.{ending}")), copy)?;
            // A video knows its own rate and length.
            (info.frame_rate, info.length) = (None, None);
        }
        SequenceFrames::Pictures(pictures) => {
            let frames = folder.join("frames");
            fs::create_dir_all(&frames).map_err(ImportError::write(&frames))?;
            for (picture, number) in pictures.iter().zip(1..) {
                let ending = picture.extension().unwrap_or_default().to_string_lossy();
                link(picture, &frames.join(format!("{number:06}.{ending}")), copy)?;
            }
            info.directory = Some("frames".into());
            info.length = Some(pictures.len() as u64);
        }
    }
    let path = folder.join("gt.txt");
    fs::write(&path, truth.to_text()).map_err(ImportError::write(&path))?;
    if info != SeqInfo::default() {
        let path = folder.join("seqinfo.ini");
        fs::write(&path, info.to_text(&name)).map_err(ImportError::write(&path))?;
    }
    written.clips += 1;
    Ok(())
}

/// The labels under our classes. Objects without numbers get new ones, each its own: no object can be followed there.
fn ground_truth(sequence: &Sequence, map: &ClassMap, written: &mut ImportCounts) -> GroundTruth {
    let mut truth = GroundTruth::default();
    let highest = sequence.labels.iter().filter_map(|label| label.id).max().unwrap_or(0);
    let mut next = highest.max(0);
    for label in &sequence.labels {
        let Some(mapped) = map.get(&label.class) else { continue };
        let (class, visibility) = match mapped {
            Mapped::Class(class) => (class, label.visibility),
            Mapped::Ignore => (Class::Drone, 0.0),
            Mapped::Skip => {
                written.skipped += 1;
                continue;
            }
        };
        let id = label.id.unwrap_or_else(|| {
            next += 1;
            next
        });
        let [left, top, width, height] = label.rect;
        written.boxes += 1;
        written.ignored += usize::from(visibility <= 0.0);
        truth.push(label.frame, TruthBox { id, left, top, width, height, class, visibility });
    }
    truth
}

/// A link to the file's own place, or a copy where links are not to be had.
fn link(from: &Path, to: &Path, copy: bool) -> Result<(), ImportError> {
    let own = fs::canonicalize(from).map_err(ImportError::read(from))?;
    let linked: io::Result<()> = if copy {
        Err(io::ErrorKind::Unsupported.into())
    } else {
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(&own, to)
        }
        #[cfg(not(unix))]
        {
            fs::hard_link(&own, to)
        }
    };
    // File systems without links.
    linked.or_else(|_| fs::copy(&own, to).map(|_| ())).map_err(ImportError::write(to))
}
