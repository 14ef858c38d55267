//! Folders of training clips.

use super::{TrainArgs, TrainError};
use crate::shell::error::Error;
use crate::shell::formats::clips::{self, Clip, ClipsError, GroundTruth};
use crate::shell::formats::seqinfo::SeqInfo;
use crate::shell::sources::{self, Frame, has_extension};
use std::borrow::ToOwned;
use std::fs;
use std::path::{Path, PathBuf};
use std::string::ToString;
use std::vec::Vec;

/// Role of a folder of clips in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FolderRole {
    /// Recorded clips with ground truth.
    Data,
    /// Footage without targets.
    Empty,
    /// Rendered flights, which show objects of others already.
    Rendered,
}

/// All folders: those with ground truth, those without targets, that of the rendered flights.
pub fn folders(args: &TrainArgs) -> Vec<(PathBuf, FolderRole)> {
    let of = |paths: &[PathBuf], kind| -> Vec<(PathBuf, FolderRole)> {
        paths.iter().map(|path| (path.clone(), kind)).collect()
    };
    let mut folders =
        [of(&args.data, FolderRole::Data), of(&args.empty, FolderRole::Empty)].concat();
    if args.rendered.render > 0 {
        folders.push((args.flights(), FolderRole::Rendered));
    }
    folders
}

/// The clips of a folder.
///
/// # Errors
/// [`Error`] of a folder without clips, or with one that cannot be used.
pub fn clips(folder: &Path, kind: FolderRole) -> Result<Vec<Clip>, Error> {
    match kind {
        FolderRole::Data | FolderRole::Rendered => Ok(clips::clips(folder)?),
        FolderRole::Empty => empty(folder),
    }
}

/// Extensions of video files.
const VIDEOS: [&str; 7] = ["mp4", "avi", "mkv", "mov", "ts", "webm", "y4m"];

/// The clips of `path`: the video that it is, or the videos and the clips' folders in it, or the clip that it is.
///
/// # Errors
/// [`ClipsError::NoFrames`] where there is no video; [`TrainError::NotEmpty`] for a clip whose `gt.txt` names targets.
fn empty(path: &Path) -> Result<Vec<Clip>, Error> {
    if path.is_file() {
        return Ok([clip(path, path)?].into());
    }
    let failed = |source| ClipsError::Read { path: path.into(), source };
    let mut entries: Vec<PathBuf> = Vec::new();
    for entry in fs::read_dir(path).map_err(failed)? {
        entries.push(entry.map_err(failed)?.path());
    }
    entries.sort();
    let mut found = Vec::new();
    for entry in &entries {
        if entry.is_file() && has_extension(entry, &VIDEOS) {
            found.push(clip(entry, path)?);
        } else if entry.is_dir()
            && let Some(input) = sources::clip_input(entry)
        {
            found.push(clip(&input, entry)?);
        }
    }
    if found.is_empty() {
        let input =
            sources::clip_input(path).ok_or_else(|| ClipsError::NoFrames { path: path.into() })?;
        found.push(clip(&input, path)?);
    }
    Ok(found)
}

/// The clip of the frames `input` in `directory`.
fn clip(input: &Path, directory: &Path) -> Result<Clip, Error> {
    let truth = directory.join("gt.txt");
    if directory.is_dir() && truth.is_file() {
        let targets = GroundTruth::read(&truth).map_err(ClipsError::from)?.boxes().count();
        if targets > 0 {
            return Err(TrainError::NotEmpty { path: directory.into(), boxes: targets }.into());
        }
    }
    let name = input.file_stem().unwrap_or_default().to_string_lossy().to_string();
    Ok(Clip {
        name,
        directory: directory.to_owned(),
        input: input.to_owned(),
        ground_truth: GroundTruth::default(),
        info: SeqInfo::default(),
    })
}

/// Frames of all clips.
///
/// # Errors
/// [`Error`] of one that cannot be decoded.
pub fn frames(clips: &[Clip]) -> Result<u64, Error> {
    let mut total = 0;
    for clip in clips {
        let mut source = sources::open(&clip.input)?;
        total += match source.frame_count() {
            Some(count) => count,
            None => {
                let mut frame = Frame::default();
                let mut count = 0;
                while source.next_frame(&mut frame)? {
                    count += 1;
                }
                count
            }
        };
    }
    Ok(total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;

    #[test]
    fn videos_and_folders_are_found_and_targets_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let write = |name: &str, text: &str| {
            fs::create_dir_all(path(name).parent().unwrap()).unwrap();
            fs::write(path(name), text).unwrap();
        };
        assert!(empty(folder.path()).is_err());
        write("b.MP4", "");
        write("notes.txt", "");
        write("a/frames/1.png", "");
        write("c/clip.avi", "");
        write("c/gt.txt", "\n");
        let names = |path: &Path| -> Vec<String> {
            empty(path).unwrap().into_iter().map(|clip| clip.name).collect()
        };
        assert_eq!(names(folder.path()), ["frames", "b", "clip"]);
        assert_eq!(names(&path("b.MP4")), ["b"]);
        assert_eq!(names(&path("c")), ["clip"]);
        assert_eq!(names(&path("a")), ["frames"]);
        write("c/gt.txt", "1,1,2,3,4,5\n");
        let error = empty(folder.path()).unwrap_err().to_string();
        assert!(error.contains("1 boxes in gt.txt; --empty takes footage without"), "{error}");
    }
}
