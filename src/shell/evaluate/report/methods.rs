//! The detections of each method that a report compares, and what is measured beside them on the frames.

use crate::shell::error::Error;
use crate::shell::evaluate::EvaluateError;
use crate::shell::evaluate::contrast::contrast;
use crate::shell::evaluate::matching::{DetectionRecord, WARMUP, must_be_found};
use crate::shell::formats::clips::Clip;
use crate::shell::formats::detections;
use crate::shell::sources::Frame;
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec;
use std::vec::Vec;
use std::{format, fs};

/// Name of the detector's own run.
pub const OURS: &str = "ours";

/// A folder of detections and the name of the method that made them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct External {
    name: String,
    folder: PathBuf,
}

impl External {
    /// Reads `NAME=FOLDER`.
    ///
    /// # Errors
    /// The reason.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (name, folder) = text.split_once('=').ok_or("expected NAME=FOLDER")?;
        let (name, folder) = (name.trim(), folder.trim());
        if name.is_empty() || folder.is_empty() {
            return Err("expected NAME=FOLDER, neither of them empty".into());
        }
        if name == OURS {
            return Err(format!("'{OURS}' is the detector's own run; take another name"));
        }
        Ok(Self { name: name.into(), folder: folder.into() })
    }
}

/// The detections of a method on every clip.
#[derive(Debug, Clone)]
pub struct MethodDetections {
    /// Name of the method in the report.
    pub name: String,
    /// Detections of each clip, in the order of the evaluated list.
    pub clips: Vec<Detected>,
    /// Median time of a frame in milliseconds, where it was measured.
    pub median_ms: Option<f64>,
}

/// The detections of a method on a clip.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Detected {
    /// In the order of frames.
    pub found: Vec<DetectionRecord>,
    /// Contrast of what each of them holds, grey levels.
    pub contrast: Vec<f64>,
}

impl MethodDetections {
    /// Reads CLIP.txt of every clip; a clip without a file has no detections.
    ///
    /// # Errors
    /// [`Error::Read`](crate::shell::support::file_error::FileError::Read) when the folder is missing or holds nothing for
    /// these clips, [`Error::Text`] naming file and line.
    pub fn read(external: &External, clips: &[Clip]) -> Result<Self, Error> {
        let folder = &external.folder;
        readable(folder)?;
        let paths: Vec<PathBuf> = clips.iter().map(|clip| path_of(folder, clip)).collect();
        if !paths.iter().any(|path| path.exists()) {
            return Err(EvaluateError::NoDetections { path: folder.clone() }.into());
        }
        let read = |path: &PathBuf| {
            let mut found = if path.exists() { detections::read_mot(path)? } else { Vec::new() };
            found.sort_by_key(|detection| detection.frame);
            Ok(Detected { found, contrast: Vec::new() })
        };
        let clips = paths.iter().map(read).collect::<Result<Vec<_>, Error>>()?;
        Ok(Self { name: external.name.clone(), clips, median_ms: None })
    }
}

/// Whether `folder` is a folder that can be read.
///
/// # Errors
/// [`Error::Read`](crate::shell::support::file_error::FileError::Read).
pub fn readable(folder: &Path) -> Result<(), Error> {
    fs::read_dir(folder).map(|_| ()).map_err(Error::read(folder))
}

/// The file of a clip's detections in `folder`.
pub fn path_of(folder: &Path, clip: &Clip) -> PathBuf {
    folder.join(format!("{}.txt", clip.name))
}

/// Measurements on the frames of a clip.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameMeasurements {
    /// Contrast of each target that must be found, grey levels.
    pub targets: Vec<f64>,
    /// Contrast of our detections.
    pub ours: Vec<f64>,
    /// Contrast of the detections of the other methods.
    pub others: Vec<Vec<f64>>,
    /// Time of each frame in our detector, milliseconds.
    pub times_ms: Vec<f64>,
}

/// Measures while our detector goes over the frames of a clip.
#[derive(Debug)]
pub struct MeasuringObserver<'a> {
    clip: &'a Clip,
    others: Vec<&'a [DetectionRecord]>,
    seen: FrameMeasurements,
}

impl<'a> MeasuringObserver<'a> {
    /// For clip number `index`.
    pub fn new(clip: &'a Clip, index: usize, others: &'a [MethodDetections]) -> Self {
        let seen = FrameMeasurements {
            others: vec![Vec::new(); others.len()],
            ..FrameMeasurements::default()
        };
        let others = others.iter().map(|m| m.clips[index].found.as_slice()).collect();
        Self { clip, others, seen }
    }

    /// Measures a frame, in the order of frames; `ours` is what our detector found in it.
    pub fn frame(&mut self, number: u64, frame: &Frame, ours: &[DetectionRecord], time_ms: f64) {
        self.seen.times_ms.push(time_ms);
        self.seen.ours.extend(ours.iter().map(|found| contrast(frame, &found.rect)));
        if number > WARMUP {
            let targets = self.clip.ground_truth.frame(number).iter().filter(|t| must_be_found(t));
            let targets =
                targets.map(|t| contrast(frame, &crate::shell::evaluate::matching::rect(t)));
            self.seen.targets.extend(targets);
        }
        for (found, seen) in self.others.iter().zip(&mut self.seen.others) {
            let here = found[seen.len()..].iter().take_while(|found| found.frame == number);
            let measured: Vec<f64> = here.map(|found| contrast(frame, &found.rect)).collect();
            seen.extend(measured);
        }
    }

    /// Contrast of labels and detections; none behind the last frame.
    pub fn finish(mut self) -> FrameMeasurements {
        let targets = self.clip.ground_truth.boxes();
        let targets = targets.filter(|(frame, t)| *frame > WARMUP && must_be_found(t)).count();
        self.seen.targets.resize(targets, 0.0);
        for (found, seen) in self.others.iter().zip(&mut self.seen.others) {
            seen.resize(found.len(), 0.0);
        }
        self.seen
    }
}

/// The middle of some numbers.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}
