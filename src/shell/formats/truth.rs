//! Attitude of the camera and direction of the targets in each frame of a flight: `truth.csv`.

use super::error::FormatError;
use crate::shell::support::file_error::FileError;
use std::collections::BTreeMap;
use std::path::Path;
use std::string::String;
use std::vec::Vec;
use std::{format, fs};

/// The columns of the file.
const COLUMNS: [&str; 10] = [
    "frame",
    "time_s",
    "yaw_rad",
    "pitch_rad",
    "roll_rad",
    "id",
    "azimuth_rad",
    "elevation_rad",
    "range_m",
    "time_to_contact_s",
];

/// One frame of a flight. Angles in radians; the camera looks along the body's forward axis.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameTruth {
    /// Roll, pitch (nose up), yaw (to the right) of the camera.
    pub attitude: [f64; 3],
    /// Targets in the frame.
    pub targets: Vec<TargetRow>,
}

/// Another aircraft in one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TargetRow {
    /// Its number in `gt.txt`.
    pub id: i64,
    /// Bearing from north to the right, radians.
    pub azimuth: f64,
    /// Below the horizon, radians.
    pub elevation: f64,
    /// Distance in metres.
    pub range: f64,
    /// Seconds; `None` when it does not come nearer.
    pub time_to_contact: Option<f64>,
}

impl TargetRow {
    /// Unit vector: north, east, down.
    pub fn direction(&self) -> [f64; 3] {
        let ((sa, ca), (se, ce)) = (self.azimuth.sin_cos(), self.elevation.sin_cos());
        [ca * ce, sa * ce, se]
    }
}

/// Reads the file: what was true in each frame, by its number from 1.
///
/// # Errors
/// [`FileError::Read`], or [`FormatError::Line`] naming the line and the field.
pub fn read(path: &Path) -> Result<BTreeMap<u64, FrameTruth>, FormatError> {
    let text = fs::read_to_string(path).map_err(FileError::read(path))?;
    let mut frames: BTreeMap<u64, FrameTruth> = BTreeMap::new();
    for (index, line) in text.lines().enumerate().skip(1) {
        let wrong = |reason| FormatError::Line { path: path.into(), line: index + 1, reason };
        let (frame, attitude, target) = parse(line).map_err(wrong)?;
        let truth = frames.entry(frame).or_default();
        truth.attitude = attitude;
        truth.targets.extend(target);
    }
    Ok(frames)
}

fn parse(line: &str) -> Result<(u64, [f64; 3], Option<TargetRow>), String> {
    let fields: Vec<&str> = line.split(',').map(str::trim).collect();
    let number = |i: usize| {
        let name = COLUMNS.get(i).copied().unwrap_or_default();
        let text = fields.get(i).copied().unwrap_or_default();
        let value = text.parse::<f64>().ok().filter(|v| v.is_finite());
        value.ok_or_else(|| format!("field '{name}' is '{text}', expected a number"))
    };
    let frame = number(0)?;
    if !(1.0..=1e9).contains(&frame) {
        return Err(format!("field 'frame' is '{frame}', expected a whole number from 1"));
    }
    let attitude = [number(4)?, number(3)?, number(2)?];
    if fields.get(5).is_none_or(|id| id.is_empty()) {
        return Ok((frame as u64, attitude, None));
    }
    let target = TargetRow {
        id: number(5)? as i64,
        azimuth: number(6)?,
        elevation: number(7)?,
        range: number(8)?,
        time_to_contact: number(9).ok(),
    };
    Ok((frame as u64, attitude, Some(target)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn lines_by_hand() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let head = COLUMNS.join(",");
        let body =
            "1,0,0.3,0.2,0.1,1,0.5,-0.1,9,4.5\n1,0,0.3,0.2,0.1,2,0,0,9,nan\n2,0.03,0,0,0,,,,,\n";
        fs::write(&file, format!("{head}\n{body}")).unwrap();
        let truth = read(file.path()).unwrap();
        assert_eq!(truth[&1].attitude, [0.1, 0.2, 0.3]);
        assert_eq!(truth[&1].targets[0].time_to_contact, Some(4.5));
        assert_eq!((truth[&1].targets[1].time_to_contact, truth[&1].targets[1].id), (None, 2));
        assert!(truth[&2].targets.is_empty());
        fs::write(&file, format!("{head}\n1,0,x,0,0\n")).unwrap();
        let error = read(file.path()).unwrap_err().to_string();
        assert!(error.contains("line 2: field 'yaw_rad' is 'x'"), "{error}");
    }
}
