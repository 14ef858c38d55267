//! Recorded flights with ground truth: a folder of clips, each with frames and MOTChallenge boxes.

use crate::shell::sources::clip_input as input;
use std::borrow::ToOwned;
use std::format;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;

/// A recorded flight: a folder with `gt.txt` and frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Clip {
    /// Name of the folder.
    pub name: String,
    /// The folder.
    pub directory: PathBuf,
    /// Its video, or the folder with its pictures; for [`crate::shell::sources::open`].
    pub input: PathBuf,
    /// The boxes of `gt.txt`.
    pub ground_truth: GroundTruth,
}

/// The boxes of a clip, by frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GroundTruth {
    frames: Vec<Vec<TruthBox>>,
}

/// A labelled object in one frame; pixels, the left upper corner of the frame is (0, 0).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruthBox {
    /// The object; the same in all frames of a clip.
    pub id: i64,
    /// Left edge.
    pub left: f64,
    /// Upper edge.
    pub top: f64,
    /// Width, above 0.
    pub width: f64,
    /// Height, above 0.
    pub height: f64,
    /// 1 drone, 2 aeroplane, 3 helicopter, 4 bird.
    pub class: u32,
    /// Share of the object that is seen, 0..=1; below 1 it is cut by the frame's edge or covered.
    pub visibility: f64,
}

impl TruthBox {
    /// The box in a frame of so many times the width and height.
    pub fn scaled(&self, across: f64, down: f64) -> Self {
        Self {
            left: self.left * across,
            top: self.top * down,
            width: self.width * across,
            height: self.height * down,
            ..*self
        }
    }
}

impl GroundTruth {
    /// The boxes in `frame`, counted from 1; none in frames that `gt.txt` does not name.
    pub fn frame(&self, frame: u64) -> &[TruthBox] {
        let index = frame.checked_sub(1).and_then(|index| usize::try_from(index).ok());
        index.and_then(|index| self.frames.get(index)).map_or(&[], Vec::as_slice)
    }

    /// The last frame that has a box, counted from 1; 0 when no frame has one.
    pub fn last_frame(&self) -> u64 {
        self.frames.len() as u64
    }

    /// Every box with its frame, counted from 1, in the order of the frames.
    pub fn boxes(&self) -> impl Iterator<Item = (u64, &TruthBox)> {
        (1..)
            .zip(&self.frames)
            .flat_map(|(frame, boxes)| boxes.iter().map(move |truth| (frame, truth)))
    }

    /// Reads a `gt.txt`.
    ///
    /// # Errors
    /// [`ClipsError`] naming the line and the field.
    pub fn read(path: &Path) -> Result<Self, ClipsError> {
        let text = fs::read_to_string(path)
            .map_err(|source| ClipsError::Read { path: path.into(), source })?;
        Self::parse(&text, path)
    }

    /// Reads the text of a `gt.txt`; `path` names it in errors.
    ///
    /// Lines are `frame,id,left,top,width,height[,conf[,class[,visibility]]]`; empty ones are
    /// skipped.
    ///
    /// # Errors
    /// [`ClipsError::Field`] naming the line and the field.
    pub fn parse(text: &str, path: &Path) -> Result<Self, ClipsError> {
        let mut truth = Self::default();
        for (index, line) in text.lines().enumerate() {
            if line.trim().is_empty() {
                continue;
            }
            let (frame, found) = parse_line(line).map_err(|reason| ClipsError::Field {
                path: path.into(),
                line: index + 1,
                reason,
            })?;
            if truth.frames.len() < frame {
                truth.frames.resize_with(frame, Vec::new);
            }
            truth.frames[frame - 1].push(found);
        }
        Ok(truth)
    }
}

/// Frames are kept by number: a mistyped one must not claim all memory (this is 38 hours at 30/s).
const LAST_FRAME: f64 = 4_194_304.0;

fn parse_line(line: &str) -> Result<(usize, TruthBox), String> {
    let mut fields = line.split(',').map(str::trim);
    let mut number = |name: &str, default: Option<f64>| match (fields.next(), default) {
        (Some(text), _) => match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("field '{name}' is '{text}', expected a number")),
        },
        (None, Some(value)) => Ok(value),
        (None, None) => Err(format!("field '{name}' is missing")),
    };
    let frame = number("frame", None)?;
    let id = number("id", None)?;
    let (left, top) = (number("left", None)?, number("top", None)?);
    let (width, height) = (number("width", None)?, number("height", None)?);
    number("conf", Some(1.0))?;
    let class = number("class", Some(1.0))?;
    let visibility = number("visibility", Some(1.0))?;
    let check = |name: &str, value: f64, good: bool, expected: &str| {
        if good { Ok(()) } else { Err(format!("field '{name}' is '{value}', expected {expected}")) }
    };
    let whole =
        |value: f64, low: f64, high: f64| value % 1.0 == 0.0 && (low..=high).contains(&value);
    check("frame", frame, whole(frame, 1.0, LAST_FRAME), "a whole number from 1 to 4194304")?;
    check("id", id, whole(id, -1e9, 1e9), "a whole number")?;
    check("width", width, width > 0.0, "more than 0")?;
    check("height", height, height > 0.0, "more than 0")?;
    check("class", class, whole(class, 1.0, 4.0), "1 drone, 2 aeroplane, 3 helicopter or 4 bird")?;
    check("visibility", visibility, (0.0..=1.0).contains(&visibility), "0 to 1")?;
    let found =
        TruthBox { id: id as i64, left, top, width, height, class: class as u32, visibility };
    Ok((frame as usize, found))
}

/// The clips of `folder` by name: every subfolder with a `gt.txt`; `folder` itself when it has one.
///
/// # Errors
/// [`ClipsError`] when there is none, or one has no frames or a broken `gt.txt`.
pub fn clips(folder: &Path) -> Result<Vec<Clip>, ClipsError> {
    if folder.join("gt.txt").is_file() {
        return Ok([clip(folder)?].into());
    }
    let failed = |source| ClipsError::Read { path: folder.into(), source };
    let mut directories = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.join("gt.txt").is_file() {
            directories.push(path);
        }
    }
    if directories.is_empty() {
        return Err(ClipsError::NoClips { path: folder.into() });
    }
    directories.sort();
    directories.iter().map(|directory| clip(directory)).collect()
}

/// The one clip in `directory`.
///
/// # Errors
/// [`ClipsError`] when it has no frames or its `gt.txt` is missing or broken.
pub fn clip(directory: &Path) -> Result<Clip, ClipsError> {
    let input = input(directory).ok_or_else(|| ClipsError::NoFrames { path: directory.into() })?;
    // `.` and `a/..` have no name of their own.
    let named = directory.canonicalize().unwrap_or_else(|_| directory.into());
    let name = named.file_name().unwrap_or_default();
    Ok(Clip {
        name: name.to_string_lossy().into_owned(),
        directory: directory.to_owned(),
        input,
        ground_truth: GroundTruth::read(&directory.join("gt.txt"))?,
    })
}

/// Why clips cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ClipsError {
    /// A file or folder cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Which one.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A folder without clips.
    #[error("{}: no clip in it; a clip is a subfolder with gt.txt and a video or pictures", path.display())]
    NoClips {
        /// The folder.
        path: PathBuf,
    },
    /// A clip without frames.
    #[error("{}: gt.txt, but no frames; put video.mp4 or a folder frames/ with pictures there", path.display())]
    NoFrames {
        /// The clip's folder.
        path: PathBuf,
    },
    /// A line of `gt.txt` that is not understood.
    #[error("{}:{line}: {reason}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The field, what it is and what is expected.
        reason: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::eprintln;
    use std::string::ToString;

    fn parse(text: &str) -> Result<GroundTruth, String> {
        GroundTruth::parse(text, Path::new("clip/gt.txt")).map_err(|error| error.to_string())
    }

    #[test]
    fn boxes_are_found_by_frame() {
        let truth =
            parse("3,1,0.4,306.9,109.0,47.0,1,2,0.5\n\n1,1,-5, 2,3,4\r\n3,2,5,6,7,8,1,4,1.0\n");
        let truth = truth.unwrap();
        assert_eq!(truth.last_frame(), 3);
        assert_eq!(truth.frame(1)[0].left, -5.0);
        assert_eq!((truth.frame(1)[0].class, truth.frame(1)[0].visibility), (1, 1.0));
        assert_eq!(truth.frame(3)[0].visibility, 0.5);
        assert_eq!(truth.frame(3)[1].class, 4);
        assert_eq!([0, 2, 4, u64::MAX].map(|frame| truth.frame(frame).len()), [0; 4]);
        let frames: Vec<u64> = truth.boxes().map(|(frame, _)| frame).collect();
        assert_eq!(frames, [1, 3, 3]);
        assert_eq!(parse("").unwrap(), GroundTruth::default());
    }

    #[test]
    fn errors_name_line_and_field() {
        for (text, reason) in [
            (
                "1,1,2,3,4,5\n1,1,2,3,abc,5",
                "clip/gt.txt:2: field 'width' is 'abc', expected a number",
            ),
            ("1,1,2,3,4", "clip/gt.txt:1: field 'height' is missing"),
            ("0,1,2,3,4,5", "clip/gt.txt:1: field 'frame' is '0', expected a whole number from 1"),
            ("1.5,1,2,3,4,5", "clip/gt.txt:1: field 'frame' is '1.5'"),
            ("1e18,1,2,3,4,5", "clip/gt.txt:1: field 'frame' is"),
            ("1,1,2,nan,4,5", "clip/gt.txt:1: field 'top' is 'nan', expected a number"),
            ("1,1,2,3,4,0", "clip/gt.txt:1: field 'height' is '0', expected more than 0"),
            ("1,1,2,3,4,5,1,7", "clip/gt.txt:1: field 'class' is '7', expected 1 drone"),
            ("1,1,2,3,4,5,1,1,2", "clip/gt.txt:1: field 'visibility' is '2', expected 0 to 1"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.starts_with(reason), "{error}");
        }
    }

    #[test]
    fn clips_are_found_with_their_frames() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        write("c/gt.txt", "1,1,2,3,4,5");
        write("c/1.PNG", "");
        write("b/gt.txt", "");
        write("b/frames/1.png", "");
        write("a/gt.txt", "");
        write("a/z.avi", "");
        write("a/frames/1.png", "");
        write("no_clip/video.mp4", "");
        let found = clips(folder.path()).unwrap();
        let names: Vec<&str> = found.iter().map(|clip| clip.name.as_str()).collect();
        assert_eq!(names, ["a", "b", "c"]);
        let inputs: Vec<&Path> =
            found.iter().map(|clip| clip.input.strip_prefix(folder.path()).unwrap()).collect();
        assert_eq!(inputs, ["a/z.avi", "b/frames", "c"].map(Path::new));
        assert_eq!(found[2].ground_truth.frame(1).len(), 1);
        assert_eq!(clips(&folder.path().join("c")).unwrap(), found[2..]);
    }

    #[test]
    fn folders_without_clips_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = |path: &Path| clips(path).unwrap_err().to_string();
        assert!(error(folder.path()).contains("no clip in it"));
        assert!(error(&folder.path().join("missing")).contains("missing: cannot be read"));
        fs::write(folder.path().join("gt.txt"), "").unwrap();
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
        assert_eq!(flights[0].ground_truth.frame(1)[0].class, 2);
        assert!(flights.iter().all(|flight| flight.input.ends_with("video.mp4")));
    }

    proptest::proptest! {
        #[test]
        fn no_text_panics(text in "[-0-9,.e\\n a]{0,60}") {
            if let Ok(truth) = parse(&text) {
                assert!(truth.boxes().all(|(_, found)| found.width > 0.0));
            }
        }
    }
}
