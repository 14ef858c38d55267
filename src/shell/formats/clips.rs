//! Recorded flights with ground truth: a folder of clips (a split), each with frames and labelled boxes.
//!
//! Forms that are read in place:
//! - `SPLIT/CLIP/gt.txt` beside one video of any name, or pictures in `frames/` or in the clip's folder itself;
//! - MOTChallenge: `SPLIT/CLIP/gt/gt.txt`, `seqinfo.ini`, pictures in the folder that it names (`img1/`);
//! - a folder of videos: `NAME.mp4` with `NAME.txt`, `NAME-gt.txt`, `NAME_gt.txt` or `NAME.gt.txt` beside it.

use super::ground_truth::TruthError;
pub use super::ground_truth::{GroundTruth, TruthBox};
use super::seqinfo::{SeqInfo, SeqInfoError};
use crate::shell::sources::{self, Frame, FrameSource, SourceError, clip_input as input, is_video};
use std::borrow::ToOwned;
use std::boxed::Box;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;
use std::{format, fs, io};

/// A recorded flight: frames and their labels.
#[derive(Debug, Clone, PartialEq)]
pub struct Clip {
    /// Name of the folder, or of the video without its ending.
    pub name: String,
    /// The folder in which `camera.json` and `truth.csv` are looked for.
    pub directory: PathBuf,
    /// Its video, or the folder with its pictures; for [`crate::shell::sources::open`].
    pub input: PathBuf,
    /// Labelled boxes of all frames.
    pub ground_truth: GroundTruth,
    /// Rate, number and size of the frames by `seqinfo.ini`.
    pub info: SeqInfo,
}

impl Clip {
    /// Its frames, at the rate of `seqinfo.ini` where that names one.
    ///
    /// # Errors
    /// As [`sources::open`].
    pub fn open(&self) -> Result<Box<dyn FrameSource>, SourceError> {
        let source = sources::open(&self.input)?;
        Ok(match self.info.frame_rate {
            Some(rate) => Box::new(AtRate { source, rate, next: 0 }),
            None => source,
        })
    }

    /// Number of frames where it is known without decoding them.
    pub fn frame_count(&self) -> Option<u64> {
        self.info.length.or_else(|| {
            let pictures =
                self.input.is_dir().then(|| sources::Folder::new(&self.input, None).ok());
            pictures.flatten().and_then(|folder| folder.frame_count())
        })
    }
}

/// A source whose frames get times at a constant rate in place of their own.
struct AtRate {
    source: Box<dyn FrameSource>,
    /// Frames a second.
    rate: f64,
    next: u64,
}

impl FrameSource for AtRate {
    fn next_frame(&mut self, frame: &mut Frame) -> Result<bool, SourceError> {
        let more = self.source.next_frame(frame)?;
        frame.time_us = (self.next as f64 * 1e6 / self.rate) as i64;
        self.next += 1;
        Ok(more)
    }

    fn frame_count(&self) -> Option<u64> {
        self.source.frame_count()
    }
}

/// A clip that cannot be read.
#[derive(Debug)]
pub struct BrokenClip {
    /// Name of the clip that cannot be read.
    pub name: String,
    /// Reason why it cannot be read.
    pub error: ClipsError,
}

/// The clips of `folder` by name; all must be readable.
///
/// # Errors
/// [`ClipsError`] when there is none, or of the first one that cannot be read.
pub fn clips(folder: &Path) -> Result<Vec<Clip>, ClipsError> {
    find(folder)?.into_iter().map(|clip| clip.map_err(|broken| broken.error)).collect()
}

/// The clips of `folder` by name, each for itself readable or not; `folder` itself when it is a clip.
///
/// # Errors
/// [`ClipsError`] when the folder cannot be read, or holds no clip.
pub fn find(folder: &Path) -> Result<Vec<Result<Clip, BrokenClip>>, ClipsError> {
    if labels(folder).is_some() {
        return Ok([read(folder)].into());
    }
    let failed = |source| ClipsError::Read { path: folder.into(), source };
    let mut found = Vec::new();
    let mut videos = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if labels(&path).is_some() {
            found.push(read(&path));
        } else if is_video(&path) {
            videos.push(path);
        }
    }
    // Videos without any labels beside them are no split.
    if videos.iter().any(|video| labels_of(video).is_some()) {
        found.extend(videos.iter().map(|video| read_video(video)));
    }
    if found.is_empty() {
        return Err(ClipsError::NoClips { path: folder.into() });
    }
    let name = |clip: &Result<Clip, BrokenClip>| match clip {
        Ok(clip) => clip.name.clone(),
        Err(broken) => broken.name.clone(),
    };
    found.sort_by_key(name);
    Ok(found)
}

/// The one clip in `directory`.
///
/// # Errors
/// [`ClipsError`] when it has no frames, or its labels are missing or broken.
pub fn clip(directory: &Path) -> Result<Clip, ClipsError> {
    let labels = labels(directory).unwrap_or_else(|| directory.join("gt.txt"));
    let info = SeqInfo::beside(directory)?;
    let named = directory.join(info.directory.as_deref().unwrap_or("img1"));
    let named = Some(named).filter(|path| path.is_dir());
    let input = match named {
        Some(pictures) => pictures,
        None => {
            several(directory)?;
            input(directory).ok_or_else(|| ClipsError::NoFrames { path: directory.into() })?
        }
    };
    Ok(Clip {
        name: name_of(directory),
        directory: directory.to_owned(),
        input,
        ground_truth: GroundTruth::read(&labels)?,
        info,
    })
}

/// Which of several videos a lone `gt.txt` is of is not known.
fn several(directory: &Path) -> Result<(), ClipsError> {
    let mut videos: Vec<PathBuf> = entries(directory).filter(|path| is_video(path)).collect();
    videos.sort();
    let known = videos.iter().any(|video| video.file_name() == Some(OsStr::new("video.mp4")));
    match videos.as_slice() {
        [first, second, ..] if !known => Err(ClipsError::SeveralVideos {
            path: directory.into(),
            first: file_name(first),
            second: file_name(second),
        }),
        _ => Ok(()),
    }
}

fn read(directory: &Path) -> Result<Clip, BrokenClip> {
    clip(directory).map_err(|error| BrokenClip { name: name_of(directory), error })
}

/// The clip of a video in a folder of videos.
fn read_video(video: &Path) -> Result<Clip, BrokenClip> {
    let name = video.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let broken = |error| BrokenClip { name: name.clone(), error };
    let labels = labels_of(video).ok_or_else(|| ClipsError::NoLabels { path: video.into() });
    let ground_truth = labels.and_then(|path| Ok(GroundTruth::read(&path)?)).map_err(broken)?;
    let directory = video.parent().unwrap_or(Path::new("")).to_owned();
    Ok(Clip { name, directory, input: video.into(), ground_truth, info: SeqInfo::default() })
}

/// The file of a clip's labels.
pub fn labels_of_clip(clip: &Clip) -> Option<PathBuf> {
    labels(&clip.directory).or_else(|| labels_of(&clip.input))
}

/// The labels in a clip's folder.
pub fn labels(directory: &Path) -> Option<PathBuf> {
    ["gt.txt", "gt/gt.txt"].map(|name| directory.join(name)).into_iter().find(|p| p.is_file())
}

/// The labels beside a video.
fn labels_of(video: &Path) -> Option<PathBuf> {
    let stem = video.file_stem()?.to_string_lossy();
    let names = [".txt", "-gt.txt", "_gt.txt", ".gt.txt"];
    names.iter().map(|end| video.with_file_name(format!("{stem}{end}"))).find(|p| p.is_file())
}

fn name_of(directory: &Path) -> String {
    // `.` and `a/..` have no name of their own.
    let named = directory.canonicalize().unwrap_or_else(|_| directory.into());
    file_name(&named)
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn entries(directory: &Path) -> impl Iterator<Item = PathBuf> {
    fs::read_dir(directory).ok().into_iter().flatten().flatten().map(|entry| entry.path())
}

/// Why clips cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClipsError {
    /// A folder cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Path of the folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A folder without clips.
    #[error(
        "{}: no clip in it; a clip is a subfolder with gt.txt and a video or pictures, a MOTChallenge sequence, or \
         NAME.mp4 with NAME.txt; `lookout import` reads other forms",
        path.display()
    )]
    NoClips {
        /// Path of the folder.
        path: PathBuf,
    },
    /// A clip without frames.
    #[error("{}: gt.txt, but no frames; put a video or a folder frames/ with pictures there", path.display())]
    NoFrames {
        /// The clip's folder.
        path: PathBuf,
    },
    /// One `gt.txt` beside several videos.
    #[error(
        "{}: one gt.txt, but several videos ({first}, {second}); name its video video.mp4, or each one's labels as the \
         video with .txt",
        path.display()
    )]
    SeveralVideos {
        /// The clip's folder.
        path: PathBuf,
        /// One video.
        first: String,
        /// Another one.
        second: String,
    },
    /// A video in a folder of labelled videos that has no labels.
    #[error("{}: no labels beside it; an empty NAME.txt says that nothing flies in it", path.display())]
    NoLabels {
        /// Path of the video.
        path: PathBuf,
    },
    /// Labels that are not understood.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// A `seqinfo.ini` that is not understood.
    #[error(transparent)]
    SeqInfo(#[from] SeqInfoError),
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::formats::class::Class;
    use std::eprintln;
    use std::string::ToString;
    use tempfile::TempDir;

    fn write(folder: &TempDir, name: &str, text: &str) {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn inputs(folder: &TempDir, found: &[Clip]) -> Vec<String> {
        let inside = |clip: &Clip| clip.input.strip_prefix(folder.path()).unwrap().to_owned();
        found.iter().map(|clip| inside(clip).to_string_lossy().into_owned()).collect()
    }

    #[test]
    fn clips_are_found_with_their_frames() {
        let folder = tempfile::tempdir().unwrap();
        write(&folder, "c/gt.txt", "1,1,2,3,4,5");
        write(&folder, "c/1.PNG", "");
        write(&folder, "b/gt.txt", "");
        write(&folder, "b/frames/1.png", "");
        write(&folder, "a/gt.txt", "");
        write(&folder, "a/DJI_0042.MOV", "");
        write(&folder, "a/frames/1.png", "");
        write(&folder, "no_clip/video.mp4", "");
        let found = clips(folder.path()).unwrap();
        let names: Vec<&str> = found.iter().map(|clip| clip.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "c"]);
        assert_eq!(inputs(&folder, &found), ["a/DJI_0042.MOV", "b/frames", "c"]);
        assert_eq!(found[2].ground_truth.frame(1).len(), 1);
        assert_eq!(clips(&folder.path().join("c")).unwrap(), found[2..]);
    }

    #[test]
    fn a_folder_of_videos_is_a_split() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.mp4", "b.mov", "c.avi", "d.mkv", "e.mp4"] {
            write(&folder, name, "");
        }
        for name in ["a.txt", "b-gt.txt", "c_gt.txt", "d.gt.txt"] {
            write(&folder, name, "1,1,2,3,4,5\n");
        }
        let mut found = find(folder.path()).unwrap();
        let unlabelled = found.pop().unwrap().unwrap_err();
        assert_eq!(unlabelled.name, "e");
        assert!(unlabelled.error.to_string().contains("e.mp4: no labels beside it"));
        let found: Vec<Clip> = found.into_iter().map(Result::unwrap).collect();
        assert_eq!(inputs(&folder, &found), ["a.mp4", "b.mov", "c.avi", "d.mkv"]);
        assert!(found.iter().all(|clip| clip.ground_truth.frame(1).len() == 1));
    }

    #[test]
    fn a_motchallenge_tree_is_read_in_place() {
        let folder = tempfile::tempdir().unwrap();
        write(&folder, "SEQ-01/gt/gt.txt", "1,1,2,3,4,5,1,1,1\n1,2,2,3,4,5,0,1,1\n");
        let info = "[Sequence]\nname=SEQ-01\nimDir=pictures\nframeRate=10\nseqLength=2\nimWidth=8\nimHeight=6\nimExt=.png\n";
        write(&folder, "SEQ-01/seqinfo.ini", info);
        fs::create_dir_all(folder.path().join("SEQ-01/pictures")).unwrap();
        for name in ["000001.png", "000002.png"] {
            let picture = image::GrayImage::new(8, 6);
            picture.save(folder.path().join("SEQ-01/pictures").join(name)).unwrap();
        }
        let found = clips(folder.path()).unwrap();
        assert_eq!(inputs(&folder, &found), ["SEQ-01/pictures"]);
        assert_eq!(found[0].ground_truth.notes.not_evaluated, 1);
        assert_eq!(found[0].frame_count(), Some(2));
        let mut frame = Frame::default();
        let mut source = found[0].open().unwrap();
        let mut times = Vec::new();
        while source.next_frame(&mut frame).unwrap() {
            times.push(frame.time_us);
        }
        assert_eq!(times, [0, 100_000]);
    }

    #[test]
    fn one_broken_clip_leaves_the_others() {
        let folder = tempfile::tempdir().unwrap();
        write(&folder, "a/gt.txt", "1,1,2,3,4");
        write(&folder, "a/1.png", "");
        write(&folder, "b/gt.txt", "");
        write(&folder, "b/1.png", "");
        write(&folder, "c/gt.txt", "");
        write(&folder, "d/gt.txt", "");
        write(&folder, "d/x.mp4", "");
        write(&folder, "d/y.mp4", "");
        let found = find(folder.path()).unwrap();
        let read: Vec<bool> = found.iter().map(Result::is_ok).collect();
        assert_eq!(read, [false, true, false, false]);
        let error = |i: usize| found[i].as_ref().unwrap_err().error.to_string();
        assert!(error(0).contains("gt.txt:1: field 'height' is missing"), "{}", error(0));
        assert!(error(2).contains("gt.txt, but no frames"), "{}", error(2));
        assert!(error(3).contains("several videos (x.mp4, y.mp4)"), "{}", error(3));
        assert!(clips(folder.path()).is_err());
    }

    #[test]
    fn folders_without_clips_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = |path: &Path| clips(path).unwrap_err().to_string();
        write(&folder, "alone.mp4", "");
        assert!(error(folder.path()).contains("no clip in it"));
        assert!(error(&folder.path().join("missing")).contains("missing: cannot be read"));
        let folder = tempfile::tempdir().unwrap();
        write(&folder, "gt.txt", "");
        assert!(error(folder.path()).contains("gt.txt, but no frames"));
    }

    #[test]
    fn recorded_flights_are_understood() {
        let data = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data/airborne/dev"));
        if !data.is_dir() {
            eprintln!("skipped: {} is not there", data.display());
            return;
        }
        let flights = clips(data).unwrap();
        assert_eq!(flights[0].name, "flight_000");
        assert_eq!(flights[0].ground_truth.frame(1)[0].class, Class::Airplane);
        assert!(flights.iter().all(|flight| flight.input.ends_with("video.mp4")));
    }
}
