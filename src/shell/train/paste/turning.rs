//! Attitude of the camera during a recorded flight: directions of the world to pixels.

use crate::shell::error::Error;
use crate::shell::formats::camera_file::CameraFile;
use crate::shell::formats::truth;
use crate::shell::support::vectors::{Rotation, atan2, direction};
use std::collections::BTreeMap;
use std::path::Path;

/// Attitude of a clip's camera in each frame, and its projection.
#[derive(Debug)]
pub struct Turning {
    rotations: BTreeMap<u64, Rotation>,
    /// Pixels of the frame as seen: focal lengths, optical axis.
    focal: [f64; 2],
    centre: [f64; 2],
}

impl Turning {
    /// Whether a clip's folder has what [`Turning::of`] reads.
    ///
    /// # Errors
    /// [`Error`] when a file is there and not understood.
    pub fn is_known(directory: &Path) -> Result<bool, Error> {
        Ok(directory.join("truth.csv").is_file() && CameraFile::beside(directory)?.is_some())
    }

    /// From `truth.csv` and `camera.json` in a clip's folder, for frames of `size`; none where they are not.
    ///
    /// # Errors
    /// [`Error`] when one is there and not understood.
    pub fn of(directory: &Path, size: (usize, usize)) -> Result<Option<Self>, Error> {
        let path = directory.join("truth.csv");
        let Some(camera) = CameraFile::beside(directory)?.filter(|_| path.is_file()) else {
            return Ok(None);
        };
        let frames = truth::read(&path)?;
        let turned = |[roll, pitch, yaw]: [f64; 3]| Rotation::new(yaw, pitch, roll);
        let scale = [
            size.0 as f64 / f64::from(camera.width.max(1)),
            size.1 as f64 / f64::from(camera.height.max(1)),
        ];
        Ok(Some(Self {
            rotations: frames.into_iter().map(|(n, frame)| (n, turned(frame.attitude))).collect(),
            focal: [camera.fx * scale[0], camera.fy * scale[1]],
            // Centres of pixels are at whole numbers in the file, at halves here.
            centre: [(camera.cx + 0.5) * scale[0], (camera.cy + 0.5) * scale[1]],
        }))
    }

    /// Where frame `number`, from 1, sees what is at an azimuth and elevation; none behind the camera.
    pub fn place(&self, number: usize, [azimuth, elevation]: [f64; 2]) -> Option<[f64; 2]> {
        let seen = self.rotations.get(&(number as u64))?.invert(direction(azimuth, elevation));
        (seen[2] > 0.1).then(|| [0, 1].map(|i| self.focal[i] * seen[i] / seen[2] + self.centre[i]))
    }

    /// Azimuth and elevation of what frame `number` sees at a place.
    pub fn bearing(&self, number: usize, place: [f64; 2]) -> Option<[f64; 2]> {
        let [x, y] = [0, 1].map(|i| (place[i] - self.centre[i]) / self.focal[i]);
        let [x, y, z] = self.rotations.get(&(number as u64))?.apply([x, y, 1.0]);
        Some([atan2(x, z), atan2(y, (x * x + z * z).sqrt())])
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::fs;

    pub(in super::super) const SIZE: (usize, usize) = (160, 120);

    /// A camera that turns by a degree a frame, in a folder of its own.
    pub(in super::super) fn turning() -> Turning {
        let folder = tempfile::tempdir().unwrap();
        let camera = r#"{"width":320,"height":240,"fx":300,"fy":300,"cx":159.5,"cy":119.5}"#;
        fs::write(folder.path().join("camera.json"), camera).unwrap();
        assert!(Turning::of(folder.path(), SIZE).unwrap().is_none());
        let mut csv = std::string::String::from("frame,time_s,yaw,pitch,roll,id,a,e,r,t\n");
        for frame in 1..=90 {
            let yaw = f64::from(frame) / 57.3;
            csv += &std::format!("{frame},0,{yaw},0.1,0.2,,,,,\n");
        }
        fs::write(folder.path().join("truth.csv"), csv).unwrap();
        Turning::of(folder.path(), SIZE).unwrap().unwrap()
    }

    #[test]
    fn what_is_seen_at_a_place_is_seen_there() {
        let turning = turning();
        for place in [[10.0, 20.0], [80.0, 60.0], [150.0, 100.0]] {
            let back = turning.place(7, turning.bearing(7, place).unwrap()).unwrap();
            assert!((0..2).all(|i| (back[i] - place[i]).abs() < 1e-9), "{place:?} {back:?}");
        }
        // The camera turns right by 2 degrees: what it sees goes left.
        let bearing = turning.bearing(7, [80.0, 60.0]).unwrap();
        let [x, y] = turning.place(9, bearing).unwrap();
        assert!((x - 80.0 + 150.0 * 2.0 / 57.3).abs() < 0.5 && (y - 60.0).abs() < 2.0, "{x} {y}");
        assert_eq!(turning.bearing(91, [80.0, 60.0]), None);
    }
}
