//! Ground truth of a clip: labelled boxes by frame, in MOTChallenge text (`gt.txt`).
//!
//! Lines are `frame,id,left,top,width,height[,conf[,class[,visibility]]]`; frames count from 1, the left upper corner of
//! the frame is (0, 0). Read as people have it: with a byte-order mark, CRLF, empty lines, comments (`#`) and a header
//! whose names say the same columns. `class` and `visibility` of -1 are not given (MOT15); a `conf` of 0 marks a row that
//! is not to be evaluated (MOT16).

use super::class::Class;
use serde::{Deserialize, Serialize};
use std::borrow::ToOwned;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, vec};

/// The boxes of a clip, by frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct GroundTruth {
    frames: Vec<Vec<TruthBox>>,
    /// Rows that were read otherwise than they stand.
    pub notes: Notes,
}

/// Counts of rows of a `gt.txt` that are reported to the user.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Notes {
    /// Rows with a `conf` of 0: kept with a visibility of 0, so that they are ignored.
    pub not_evaluated: usize,
    /// Rows with a class of -1, taken for drones.
    pub without_class: usize,
    /// Rows behind the last frame of the video, left out.
    pub behind_the_end: usize,
}

/// A labelled object in one frame; pixels, the left upper corner of the frame is (0, 0).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TruthBox {
    /// The object; the same in all frames of a clip.
    pub id: i64,
    /// Left edge, pixels from the left border of the frame.
    pub left: f64,
    /// Upper edge, pixels from the upper border of the frame.
    pub top: f64,
    /// Width in pixels, above 0.
    pub width: f64,
    /// Height in pixels, above 0.
    pub height: f64,
    /// Class of the object in the box.
    pub class: Class,
    /// Share of the object that is seen, 0..=1; below 1 it is cut by the frame's edge or covered.
    pub visibility: f64,
}

impl TruthBox {
    /// Its line of `gt.txt` in frame `frame` (from 1), with a line feed; [`super::clips::GroundTruth::parse`] reads it.
    pub fn line(&self, frame: u64) -> String {
        self.line_of(frame, |pixels| pixels.to_string())
    }

    /// As [`TruthBox::line`], pixels rounded to two decimals.
    pub fn rounded_line(&self, frame: u64) -> String {
        self.line_of(frame, |pixels| format!("{pixels:.2}"))
    }

    fn line_of(&self, frame: u64, pixels: impl Fn(f64) -> String) -> String {
        let Self { id, left, top, width, height, class, visibility } = *self;
        let [left, top, width, height] = [left, top, width, height].map(pixels);
        let class = class.number();
        format!("{frame},{id},{left},{top},{width},{height},1,{class},{visibility:.1}\n")
    }

    /// Whether it is a target to learn or to find: no bird, seen whole, and at least `min_side` pixels on the longer side.
    pub fn is_target(&self, min_side: f64) -> bool {
        self.class != Class::Bird && self.visibility >= 1.0 && self.longer_side() >= min_side
    }

    /// The longer of width and height, pixels.
    pub fn longer_side(&self) -> f64 {
        self.width.max(self.height)
    }

    /// The box in a frame scaled by these factors.
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

/// Why a `gt.txt` cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum TruthError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A line that is not understood.
    #[error("{}:{line}: {reason}", path.display())]
    Line {
        /// Path of the file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// Fault of the line.
        reason: LineError,
    },
}

/// Why a line is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LineError {
    /// A field that is no number.
    #[error("field '{field}' is '{text}', expected a number")]
    NotANumber {
        /// Name of the field at fault.
        field: &'static str,
        /// Text of the field.
        text: String,
    },
    /// A line with too few fields.
    #[error("field '{field}' is missing")]
    Missing {
        /// Name of the field at fault.
        field: &'static str,
    },
    /// A number out of its range.
    #[error("field '{field}' is '{value}', expected {expected}")]
    Range {
        /// Name of the field at fault.
        field: &'static str,
        /// Number that is out of range.
        value: f64,
        /// Range that is expected.
        expected: &'static str,
    },
    /// A header that names other columns.
    #[error(
        "the header names '{name}' as column {column}, expected '{expected}': the form is \
         frame,id,left,top,width,height[,conf[,class[,visibility]]]"
    )]
    Header {
        /// Name that is not known.
        name: String,
        /// Its place, from 1.
        column: usize,
        /// The name that belongs there.
        expected: &'static str,
    },
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

    /// Whether any box is labelled as something else than a bird.
    pub fn has_target(&self) -> bool {
        self.boxes().any(|(_, truth)| truth.class != Class::Bird)
    }

    /// Adds a box to `frame`, from 1.
    pub fn push(&mut self, frame: u64, truth: TruthBox) {
        let frame = frame as usize;
        if self.frames.len() < frame {
            self.frames.resize_with(frame, Vec::new);
        }
        if let Some(boxes) = frame.checked_sub(1).and_then(|place| self.frames.get_mut(place)) {
            boxes.push(truth);
        }
    }

    /// Leaves out the rows behind the last frame of a video of `frames` frames, and counts them in the notes.
    pub fn end_at(&mut self, frames: u64) {
        let last = usize::try_from(frames).unwrap_or(usize::MAX).min(self.frames.len());
        let behind = self.frames.drain(last..).map(|boxes| boxes.len()).sum::<usize>();
        self.notes.behind_the_end += behind;
        while self.frames.pop_if(|boxes| boxes.is_empty()).is_some() {}
    }

    /// Reads a `gt.txt`.
    ///
    /// # Errors
    /// [`TruthError`] naming the line and the field.
    pub fn read(path: &Path) -> Result<Self, TruthError> {
        let bytes =
            fs::read(path).map_err(|source| TruthError::Read { path: path.into(), source })?;
        Self::parse(&String::from_utf8_lossy(&bytes), path)
    }

    /// Reads the text of a `gt.txt`; `path` names it in errors.
    ///
    /// # Errors
    /// [`TruthError::Line`] naming the line and the field.
    pub fn parse(text: &str, path: &Path) -> Result<Self, TruthError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut truth = Self::default();
        let lines = text.lines().enumerate().map(|(index, line)| (index, line.trim()));
        let mut lines = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
        let wrong = |index: usize| {
            move |reason| TruthError::Line { path: path.into(), line: index + 1, reason }
        };
        let mut first = lines.next();
        if let Some((index, line)) = first.filter(|(_, line)| is_header(line)) {
            check_header(line).map_err(wrong(index))?;
            first = lines.next();
        }
        for (index, line) in first.into_iter().chain(lines) {
            let (frame, found) = parse_line(line, &mut truth.notes).map_err(wrong(index))?;
            truth.push(frame, found);
        }
        Ok(truth)
    }

    /// The text of a `gt.txt`, one line a box; pixels with up to four decimals.
    pub fn to_text(&self) -> String {
        let round = |v: f64| if v.abs() < 1e9 { (v * 1e4).round() / 1e4 } else { v };
        let line = |(frame, t): (u64, &TruthBox)| {
            let [left, top, width, height] = [t.left, t.top, t.width, t.height].map(round);
            let (class, visibility) = (t.class.number(), round(t.visibility));
            format!("{frame},{},{left},{top},{width},{height},1,{class},{visibility}\n", t.id)
        };
        self.boxes().map(line).collect()
    }
}

/// Names of the columns, the usual one first.
const COLUMNS: [&[&str]; 9] = [
    &["frame", "frame_id", "frame_number"],
    &["id", "track_id", "target_id", "object_id"],
    &["left", "bb_left", "x", "bbox_left"],
    &["top", "bb_top", "y", "bbox_top"],
    &["width", "bb_width", "w", "bbox_width"],
    &["height", "bb_height", "h", "bbox_height"],
    &["conf", "confidence", "score"],
    &["class", "class_id", "category", "object_category"],
    &["visibility", "vis"],
];

/// Whether a first line begins with a word.
fn is_header(line: &str) -> bool {
    let first = line.split(',').next().unwrap_or_default().trim().trim_matches('"');
    first.starts_with(|c: char| c.is_alphabetic()) && first.parse::<f64>().is_err()
}

fn check_header(line: &str) -> Result<(), LineError> {
    let names: Vec<String> =
        line.split(',').map(|name| name.trim().trim_matches('"').to_ascii_lowercase()).collect();
    for (index, expected) in COLUMNS.iter().enumerate() {
        let field = expected.first().copied().unwrap_or_default();
        match names.get(index) {
            Some(name) if expected.contains(&name.as_str()) => {}
            Some(name) => {
                let (name, column, expected) = (name.to_owned(), index + 1, field);
                return Err(LineError::Header { name, column, expected });
            }
            // Six columns must be there.
            None if index < 6 => return Err(LineError::Missing { field }),
            None => {}
        }
    }
    Ok(())
}

/// Frames are kept by number: a mistyped one must not claim all memory (this is 38 hours at 30/s).
const LAST_FRAME: f64 = 4_194_304.0;

fn parse_line(line: &str, notes: &mut Notes) -> Result<(u64, TruthBox), LineError> {
    let mut fields = line.split(',').map(str::trim);
    let mut number = |field: &'static str, default: Option<f64>| match (fields.next(), default) {
        // A comma at the end of a line.
        (Some(""), Some(value)) => Ok(value),
        (Some(text), _) => match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(LineError::NotANumber { field, text: text.into() }),
        },
        (None, Some(value)) => Ok(value),
        (None, None) => Err(LineError::Missing { field }),
    };
    let frame = number("frame", None)?;
    let id = number("id", None)?;
    let (left, top) = (number("left", None)?, number("top", None)?);
    let (width, height) = (number("width", None)?, number("height", None)?);
    let conf = number("conf", Some(1.0))?;
    let class = number("class", Some(1.0))?;
    let mut visibility = number("visibility", Some(1.0))?;
    let check = |field: &'static str, value: f64, good: bool, expected: &'static str| {
        if good { Ok(()) } else { Err(LineError::Range { field, value, expected }) }
    };
    let whole =
        |value: f64, low: f64, high: f64| value % 1.0 == 0.0 && (low..=high).contains(&value);
    check("frame", frame, whole(frame, 1.0, LAST_FRAME), "a whole number from 1 to 4194304")?;
    check("id", id, whole(id, -1e9, 1e9), "a whole number")?;
    check("width", width, width > 0.0, "more than 0")?;
    check("height", height, height > 0.0, "more than 0")?;
    let class = if class == -1.0 {
        notes.without_class += 1;
        Class::Drone
    } else {
        let known = whole(class, 1.0, 4.0).then(|| Class::from_number(class as u32)).flatten();
        known.ok_or(LineError::Range {
            field: "class",
            value: class,
            expected: "1 drone, 2 airplane, 3 helicopter, 4 bird or -1 (not given); \
                       map other numbers with `lookout import mot --classes`",
        })?
    };
    if visibility == -1.0 {
        visibility = 1.0;
    }
    check("visibility", visibility, (0.0..=1.0).contains(&visibility), "0 to 1")?;
    if conf == 0.0 {
        notes.not_evaluated += 1;
        visibility = 0.0;
    }
    let found = TruthBox { id: id as i64, left, top, width, height, class, visibility };
    Ok((frame as u64, found))
}

impl Notes {
    /// A sentence for each kind of row that was changed or left out in reading.
    pub fn sentences(&self) -> Vec<String> {
        let rows = |n: usize| if n == 1 { "1 row".to_owned() } else { format!("{n} rows") };
        let mut all = vec![];
        if self.behind_the_end > 0 {
            all.push(format!(
                "{} behind the video's last frame: left out",
                rows(self.behind_the_end)
            ));
        }
        if self.not_evaluated > 0 {
            all.push(format!(
                "{} with conf 0: neither target nor false alarm",
                rows(self.not_evaluated)
            ));
        }
        if self.without_class > 0 {
            all.push(format!(
                "{} without a class (-1): taken for drones",
                rows(self.without_class)
            ));
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!((truth.frame(1)[0].class, truth.frame(1)[0].visibility), (Class::Drone, 1.0));
        assert_eq!(truth.frame(3)[0].visibility, 0.5);
        assert_eq!(truth.frame(3)[1].class, Class::Bird);
        assert_eq!([0, 2, 4, u64::MAX].map(|frame| truth.frame(frame).len()), [0; 4]);
        let frames: Vec<u64> = truth.boxes().map(|(frame, _)| frame).collect();
        assert_eq!(frames, [1, 3, 3]);
        assert_eq!(parse("").unwrap(), GroundTruth::default());
    }

    #[test]
    fn files_as_people_have_them() {
        let plain = parse("1,7,10,20,30,40,1,1,1\n2,7,11,20,30,40,1,1,1\n").unwrap();
        for text in [
            "\u{feff}1,7,10,20,30,40,1,1,1\r\n2,7,11,20,30,40,1,1,1\r\n",
            "frame,id,bb_left,bb_top,bb_width,bb_height,conf,class,visibility\n1,7,10,20,30,40,1,1,1\n2,7,11,20,30,40\n",
            "\u{feff}\"Frame\",\"ID\",x,y,w,h\r\n1,7,10,20,30,40\r\n2,7,11,20,30,40,\r\n",
            "# made by hand\n1,7,10,20,30,40\n\n2,7,11,20,30,40\n",
        ] {
            assert_eq!(parse(text).unwrap(), plain, "{text}");
        }
        // MOT15: the last three are coordinates in the world, not given.
        let mot15 = parse("1,7,10,20,30,40,1,-1,-1,-1\n2,7,11,20,30,40,1,-1,-1,-1\n").unwrap();
        assert_eq!(mot15.frame(1), plain.frame(1));
        assert_eq!(mot15.notes.without_class, 2);
        // MOT16: rows with conf 0 are not to be evaluated.
        let marked = parse("1,7,10,20,30,40,0,1,1\n").unwrap();
        assert!(!marked.frame(1)[0].is_target(8.0));
        assert_eq!(marked.notes.sentences(), ["1 row with conf 0: neither target nor false alarm"]);
    }

    #[test]
    fn rows_behind_the_end_are_left_out_and_counted() {
        let mut truth = parse("2,1,0,0,9,9\n7,1,0,0,9,9\n7,2,0,0,9,9\n9,1,0,0,9,9\n").unwrap();
        truth.end_at(7);
        assert_eq!((truth.last_frame(), truth.notes.behind_the_end), (7, 1));
        truth.end_at(5);
        assert_eq!((truth.last_frame(), truth.notes.behind_the_end), (2, 3));
        truth.end_at(0);
        assert_eq!((truth.last_frame(), truth.notes.behind_the_end), (0, 4));
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
            (
                "frame,id,x1,y1,x2,y2\n1,1,2,3,4,5",
                "clip/gt.txt:1: the header names 'x1' as column 3, expected 'left'",
            ),
            ("frame,id,left,top,width\n", "clip/gt.txt:1: field 'height' is missing"),
            // A header in the middle of a file is none.
            ("1,1,2,3,4,5\nframe,id,left,top,width,height", "clip/gt.txt:2: field 'frame'"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.starts_with(reason), "{error}");
        }
    }

    proptest::proptest! {
        #[test]
        fn no_text_panics(text in "[-0-9,.e\\n a]{0,60}") {
            if let Ok(mut truth) = parse(&text) {
                proptest::prop_assert!(truth.boxes().all(|(_, found)| found.width > 0.0));
                truth.notes = Notes::default();
                // Pixels are written with four decimals, which is less than a text may hold.
                let again = parse(&truth.to_text());
                if truth.boxes().all(|(_, b)| b.width >= 1e-4 && b.height >= 1e-4) {
                    proptest::prop_assert_eq!(again.unwrap().boxes().count(), truth.boxes().count());
                }
            }
        }
    }
}
