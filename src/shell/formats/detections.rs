//! Detections as text: MOTChallenge and JSON Lines.
//!
//! Numbers are printed from the detector's integers: boxes exactly (sixteenths have four decimals), scores with six
//! decimals, which keep all scores apart. A frame is written in one piece, so that a run that is cut off leaves whole
//! lines.

use super::error::FormatError;
use super::traffic::{self, TrafficLine};
use crate::detector::detection::{SHIFTS, Shift};
use crate::detector::{Detection, Detections, MAX_DETECTIONS};
use crate::image::Rect;
use crate::registration::global_motion::GlobalMotion;
use crate::shell::support::file_error::FileError;
use crate::tracking::traffic::Traffic;
use core::fmt;
use fixed::types::I28F4;
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};
use std::string::String;
use std::vec::Vec;
use std::{format, fs, io};

/// A box in pixels: left, top, width, height.
pub type Box4 = [f64; 4];

/// A detection as written to a file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectionRecord {
    /// The frame, from 1.
    pub frame: u64,
    /// Left, top, width and height in frame pixels.
    pub rect: Box4,
    /// Score; larger is more likely a target.
    pub score: f64,
}

/// Fractional bits of [`Detection::score`].
pub const SCORE_BITS: u32 = 16;

/// A fixed-point number as a decimal: `units` / 10^`digits`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decimal {
    units: i64,
    digits: u32,
}

impl Decimal {
    /// A Q28.4 number in pixels, exactly.
    pub fn pixels(value: fixed::types::I28F4) -> Self {
        Self { units: i64::from(value.to_bits()) * 625, digits: 4 }
    }

    /// A score, rounded to the nearest millionth, ties upwards.
    pub fn score(bits: i32) -> Self {
        let half = 1 << (SCORE_BITS - 1);
        Self { units: (i64::from(bits) * 1_000_000 + half) >> SCORE_BITS, digits: 6 }
    }

    /// The nearest `f64`, which is also what reading the printed decimal gives.
    pub fn to_f64(self) -> f64 {
        self.units as f64 / f64::from(10u32.pow(self.digits))
    }
}

impl fmt::Display for Decimal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scale = 10u64.pow(self.digits);
        let size = self.units.unsigned_abs();
        let sign = if self.units < 0 { "-" } else { "" };
        let digits = self.digits as usize;
        write!(f, "{sign}{}.{:0digits$}", size / scale, size % scale)
    }
}

/// The box of a detection in pixels: left, top, width, height.
pub fn rect(detection: &Detection) -> [Decimal; 4] {
    let rect = detection.rect;
    [rect.x, rect.y, rect.width, rect.height].map(Decimal::pixels)
}

/// The detections of a frame as they read in a file.
pub fn found(frame: u64, detections: &Detections) -> impl Iterator<Item = DetectionRecord> + '_ {
    detections.list.iter().map(move |d| DetectionRecord {
        frame,
        rect: rect(d).map(Decimal::to_f64),
        score: Decimal::score(d.score).to_f64(),
    })
}

/// A text file that holds whole pieces only, even when the disk is full.
#[derive(Debug)]
pub struct TextFile {
    path: PathBuf,
    file: File,
    /// Bytes of the pieces written.
    whole: u64,
}

impl TextFile {
    /// Creates the file, or empties it.
    ///
    /// # Errors
    /// [`FileError::Write`].
    pub fn create(path: &Path) -> Result<Self, FormatError> {
        let file = File::create(path).map_err(FileError::write(path))?;
        Ok(Self { path: path.into(), file, whole: 0 })
    }

    /// Writes one piece, at once.
    ///
    /// # Errors
    /// [`FileError::Write`]; what was written of the piece is taken back where the file allows it.
    pub fn write(&mut self, piece: &str) -> Result<(), FormatError> {
        if let Err(source) = self.file.write_all(piece.as_bytes()) {
            // Best effort: the first error is returned.
            let _ = self.file.set_len(self.whole);
            let _ = self.file.seek(io::SeekFrom::Start(self.whole));
            return Err(FileError::Write { path: self.path.clone(), source }.into());
        }
        self.whole += piece.len() as u64;
        Ok(())
    }
}

/// The lines of a frame in MOTChallenge form: `frame,-1,left,top,width,height,score`; `frame` from 1.
pub fn mot_lines(frame: u64, detections: &Detections) -> String {
    let mut lines = String::new();
    for detection in &detections.list {
        let [left, top, width, height] = rect(detection);
        let score = Decimal::score(detection.score);
        // Writing to a string cannot fail.
        let _ = writeln!(lines, "{frame},-1,{left},{top},{width},{height},{score}");
    }
    lines
}

#[derive(Serialize, Deserialize)]
struct FrameLine {
    frame: u64,
    time_us: i64,
    windows: u32,
    kept: u32,
    dropped: u32,
    registered: bool,
    /// [`crate::registration::global_motion::GlobalMotion::parameters`].
    motion: [i32; 8],
    detections: Vec<DetectionLine>,
    /// Tracks, where objects are tracked.
    #[serde(skip_deserializing, skip_serializing_if = "Option::is_none")]
    tracks: Option<Vec<TrafficLine>>,
}

#[derive(Serialize, Deserialize)]
struct DetectionLine {
    /// Left, top, width, height in pixels.
    r#box: [f64; 4],
    score: f64,
    /// By this frame alone.
    frame_score: f64,
    /// Where the centre was 1, 2, .. frames ago, relative to its place now: right, down in pixels.
    shifts: Vec<[f64; 2]>,
}

/// The line of a frame in JSON Lines form; `frame` from 1; `tracks` where objects were followed.
pub fn json_line(
    frame: u64,
    time_us: i64,
    detections: &Detections,
    tracks: Option<&[Traffic]>,
) -> String {
    let pixels = |v| Decimal::pixels(v).to_f64();
    let line = FrameLine {
        frame,
        time_us,
        windows: detections.windows,
        kept: detections.kept,
        dropped: detections.dropped,
        registered: detections.registered,
        motion: detections.motion.parameters(),
        detections: detections
            .list
            .iter()
            .map(|d| DetectionLine {
                r#box: rect(d).map(Decimal::to_f64),
                score: Decimal::score(d.score).to_f64(),
                frame_score: Decimal::score(d.frame_score).to_f64(),
                shifts: d.shifts.iter().map(|s| [pixels(s.x), pixels(s.y)]).collect(),
            })
            .collect(),
        tracks: tracks.map(traffic::lines),
    };
    // Numbers and names always make JSON.
    let mut text = serde_json::to_string(&line).unwrap_or_default();
    text.push('\n');
    text
}

/// Reads the lines that [`json_line`] writes: the time of each frame and its detections, frames of this size.
///
/// # Errors
/// [`FileError::Read`], or [`FormatError::Line`] naming the line.
pub fn read_json(path: &Path, size: (usize, usize)) -> Result<Vec<(i64, Detections)>, FormatError> {
    let text = fs::read_to_string(path).map_err(FileError::read(path))?;
    let mut frames = Vec::new();
    for (index, line) in text.lines().enumerate() {
        let wrong = |reason| FormatError::Line { path: path.into(), line: index + 1, reason };
        let line: FrameLine =
            serde_json::from_str(line).map_err(|e| wrong(format!("not a frame: {e}")))?;
        if line.frame != index as u64 + 1 {
            return Err(wrong(format!("frame {}, expected {}", line.frame, index + 1)));
        }
        frames.push((line.time_us, line.detections(size)));
    }
    Ok(frames)
}

impl FrameLine {
    fn detections(&self, (width, height): (usize, usize)) -> Detections {
        let pixels = |v: f64| I28F4::saturating_from_num(v);
        let detection = |line: &DetectionLine| {
            let [x, y, width, height] = line.r#box.map(pixels);
            let mut shifts = [Shift::default(); SHIFTS];
            for (shift, [x, y]) in shifts.iter_mut().zip(&line.shifts) {
                *shift = Shift { x: pixels(*x), y: pixels(*y) };
            }
            // Back to the nearest unit, which six decimals keep apart.
            let units = |score: f64| (score * f64::from(1 << SCORE_BITS)).round() as i32;
            let (score, frame_score) = (units(line.score), units(line.frame_score));
            Detection { rect: Rect { x, y, width, height }, score, frame_score, shifts }
        };
        Detections {
            list: self.detections.iter().take(MAX_DETECTIONS).map(detection).collect(),
            windows: self.windows,
            kept: self.kept,
            dropped: self.dropped,
            registered: self.registered,
            motion: match self.registered {
                true => GlobalMotion::new(width, height, self.motion),
                false => GlobalMotion::IDENTITY,
            },
            ..Detections::default()
        }
    }
}

/// Reads detections in MOTChallenge form; fields behind the score are ignored.
///
/// # Errors
/// [`FileError::Read`], or [`FormatError::Line`] naming the line.
pub fn read_mot(path: &Path) -> Result<Vec<DetectionRecord>, FormatError> {
    let text = fs::read_to_string(path).map_err(FileError::read(path))?;
    let mut found = Vec::new();
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let detection = parse_mot_line(line).map_err(|reason| FormatError::Line {
            path: path.into(),
            line: index + 1,
            reason,
        })?;
        found.push(detection);
    }
    Ok(found)
}

fn parse_mot_line(line: &str) -> Result<DetectionRecord, String> {
    let fields = line
        .split(',')
        .map(|field| {
            let number = field.trim().parse::<f64>().ok().filter(|v| v.is_finite());
            number.ok_or_else(|| format!("'{}' is not a number", field.trim().escape_debug()))
        })
        .collect::<Result<Vec<f64>, String>>()?;
    let &[frame, _, left, top, width, height, score, ..] = fields.as_slice() else {
        return Err(format!(
            "{} fields; a detection is frame,-1,left,top,width,height,score",
            fields.len()
        ));
    };
    if !(1.0..=u32::MAX.into()).contains(&frame) {
        return Err(format!("frame {frame}; frames count from 1"));
    }
    Ok(DetectionRecord { frame: frame as u64, rect: [left, top, width, height], score })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::string::ToString;

    fn one(rect: [i32; 4], score: i32) -> Detections {
        let [x, y, width, height] = rect.map(I28F4::from_bits);
        let shift = Shift { x: I28F4::from_bits(-1), y: I28F4::from_bits(24) };
        let detection = Detection {
            rect: Rect { x, y, width, height },
            score,
            frame_score: -score,
            shifts: [shift; 3],
        };
        let mut detections = Detections { windows: 9, kept: 2, ..Default::default() };
        detections.list.push(detection).unwrap();
        detections
    }

    #[test]
    fn lines_by_hand() {
        let detections = one([-1, 33, 160, 8], -(1 << (SCORE_BITS - 1)));
        assert_eq!(mot_lines(7, &detections), "7,-1,-0.0625,2.0625,10.0000,0.5000,-0.500000\n");
        assert_eq!(
            json_line(7, 200_000, &detections, None),
            "{\"frame\":7,\"time_us\":200000,\"windows\":9,\"kept\":2,\"dropped\":0,\"registered\":false,\
             \"motion\":[0,0,0,0,0,0,0,0],\"detections\":[{\"box\":[-0.0625,2.0625,10.0,0.5],\"score\":-0.5,\
             \"frame_score\":0.5,\"shifts\":[[-0.0625,1.5],[-0.0625,1.5],[-0.0625,1.5]]}]}\n"
        );
        assert_eq!(mot_lines(1, &Detections::default()), "");
    }

    #[test]
    fn bad_lines_are_refused_with_place_and_reason() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("clip.txt");
        for (text, place, reason) in [
            ("1,-1,0,0,9,9,1\n1,-1,0,x,9,9,1", "line 2", "'x' is not a number"),
            ("1,-1,0,0,9,9", "line 1", "6 fields"),
            ("\n0,-1,0,0,9,9,1", "line 2", "count from 1"),
            ("1,-1,0,0,9,nan,1", "line 1", "'nan' is not a number"),
        ] {
            fs::write(&path, text).unwrap();
            let error = read_mot(&path).unwrap_err().to_string();
            assert!(error.contains("clip.txt") && error.contains(place), "{error}");
            assert!(error.contains(reason), "{error}");
        }
    }

    proptest! {
        #[test]
        fn what_is_written_reads_back_equal(rect: [i32; 4], score: i32, frame in 1..9999u64) {
            let detections = one(rect, score);
            let path = tempfile::NamedTempFile::new().unwrap();
            fs::write(&path, json_line(1, -5, &detections, None)).unwrap();
            prop_assert_eq!(read_json(path.path(), (64, 48)).unwrap(), [(-5, detections.clone())]);
            fs::write(&path, mot_lines(frame, &detections)).unwrap();
            let read = read_mot(path.path()).unwrap();
            prop_assert_eq!(&read, &found(frame, &detections).collect::<Vec<_>>());
            prop_assert_eq!(read[0].rect, rect.map(|v| f64::from(v) / 16.0));
            // Six decimals keep neighbouring scores apart and in order.
            prop_assert!(Decimal::score(score).units < Decimal::score(score.saturating_add(1)).units || score == i32::MAX);
            prop_assert!((read[0].score - f64::from(score) / f64::from(1 << SCORE_BITS)).abs() <= 0.5e-6 + 1e-12 * read[0].score.abs());
        }
    }
}
