//! Benchmark of the registration alone: how many frames it registered, and how well the frame before, warped by the
//! measured motion, agrees with the frame.
//!
//! Residual: mean absolute grey difference over a grid of pixels; without registration the same pixel of both frames is
//! compared. Moving objects, parallax and noise stay in it.

use crate::detector::Detections;
use crate::shell::sources::Frame;
use crate::shell::support::file_error::FileError;
use crate::shell::support::sorter::Sorter;
use serde::{Deserialize, Serialize};
use std::vec::Vec;

/// Pixels from one point of the grid to the next.
const STEP: usize = 4;

/// Registration over a clip.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ClipRegistration {
    /// Frames with one before them.
    frames: u64,
    /// Of these, registered ones.
    registered: u64,
    /// Residual of each registered frame without and with registration, grey levels.
    residuals: Vec<[f64; 2]>,
}

/// Measures frame by frame.
#[derive(Debug, Default)]
pub struct RegistrationWatch {
    last: Option<Frame>,
    result: ClipRegistration,
}

impl RegistrationWatch {
    /// A frame and its detections, whose motion maps its points to where they were in the frame before.
    pub fn frame(&mut self, frame: &Frame, detections: &Detections) {
        if let Some(last) =
            self.last.as_ref().filter(|last| last.pixels.len() == frame.pixels.len())
        {
            self.result.frames += 1;
            if detections.registered {
                self.result.registered += 1;
                self.result
                    .residuals
                    .push(residuals(frame, last, |x, y| detections.motion.map(x, y)));
            }
        }
        self.last.get_or_insert_default().clone_from(frame);
    }

    /// Figures of a clip.
    pub fn finish(self) -> ClipRegistration {
        self.result
    }
}

/// Mean absolute difference without and with the motion, which maps points in pixels, Q8.
fn residuals(frame: &Frame, last: &Frame, motion: impl Fn(i32, i32) -> (i32, i32)) -> [f64; 2] {
    let (mut still, mut warped, mut count) = (0.0, 0.0, 0.0f64);
    for y in (STEP / 2..frame.height).step_by(STEP) {
        for x in (STEP / 2..frame.width).step_by(STEP) {
            let (old_x, old_y) = motion((x as i32) << 8, (y as i32) << 8);
            // Points that were outside of the frame before have nothing to be compared with.
            let Some(old) = bilinear(last, old_x, old_y) else { continue };
            let at = |frame: &Frame| f64::from(frame.pixels[y * frame.width + x]);
            still += (at(frame) - at(last)).abs();
            warped += (at(frame) - old).abs();
            count += 1.0;
        }
    }
    [still / count.max(1.0), warped / count.max(1.0)]
}

/// Grey level between pixels; none outside. Coordinates in pixels, Q8.
fn bilinear(frame: &Frame, x: i32, y: i32) -> Option<f64> {
    let (column, row) = (usize::try_from(x >> 8).ok()?, usize::try_from(y >> 8).ok()?);
    if column + 1 >= frame.width || row + 1 >= frame.height {
        return None;
    }
    let (right, down) = (f64::from(x & 255) / 256.0, f64::from(y & 255) / 256.0);
    let at = |dx: usize, dy: usize| f64::from(frame.pixels[(row + dy) * frame.width + column + dx]);
    let upper = at(0, 0) * (1.0 - right) + at(1, 0) * right;
    let lower = at(0, 1) * (1.0 - right) + at(1, 1) * right;
    Some(upper * (1.0 - down) + lower * down)
}

/// Registration over all clips.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct RegistrationFigures {
    /// Frames with one before them.
    pub frames: u64,
    /// Share of them that was registered; none without frames.
    pub share_registered: Option<f64>,
    /// Median over the registered frames of the residual without registration, grey levels.
    pub residual_without: Option<f64>,
    /// The same with registration.
    pub residual: Option<f64>,
    /// 95th percentile with registration.
    pub residual_95: Option<f64>,
}

/// Registration over clips that are added one by one.
#[derive(Debug)]
pub struct RegistrationTally {
    frames: u64,
    registered: u64,
    /// Residuals without and with registration.
    residuals: [Sorter; 2],
}

impl Default for RegistrationTally {
    fn default() -> Self {
        let residuals = [(); 2].map(|()| Sorter::new(|a, b| a.total_cmp(&b)));
        Self { frames: 0, registered: 0, residuals }
    }
}

impl RegistrationTally {
    /// Adds a clip.
    ///
    /// # Errors
    /// [`FileError::Write`] of a temporary file.
    pub fn add(&mut self, clip: &ClipRegistration) -> Result<(), FileError> {
        self.frames += clip.frames;
        self.registered += clip.registered;
        let [without, with] = &mut self.residuals;
        clip.residuals.iter().try_for_each(|pair| {
            without.push(pair[0], false)?;
            with.push(pair[1], false)
        })
    }

    /// Figures over the clips.
    ///
    /// # Errors
    /// As [`RegistrationTally::add`].
    pub fn figures(self) -> Result<RegistrationFigures, FileError> {
        let [without, with] = self.residuals.map(Sorter::finish);
        let share = self.registered as f64 / self.frames as f64;
        Ok(RegistrationFigures {
            frames: self.frames,
            share_registered: (self.frames > 0).then_some(share),
            residual_without: without.quantile(0.5)?,
            residual: with.quantile(0.5)?,
            residual_95: with.quantile(0.95)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(shift: f64) -> Frame {
        let grey = |x: usize, y: usize| {
            let x = x as f64 + shift;
            (128.0 + 50.0 * (x / 5.0).sin() + 40.0 * (y as f64 / 7.0).cos()) as u8
        };
        let (width, height) = (80, 60);
        let pixels = (0..width * height).map(|i| grey(i % width, i / width)).collect();
        Frame { pixels, width, height, time_us: 0 }
    }

    #[test]
    fn the_right_motion_leaves_no_residual() {
        // The picture went 2.5 pixels to the left: a point was 2.5 further right.
        let (last, now) = (frame(0.0), frame(2.5));
        let [still, right] = residuals(&now, &last, |x, y| (x + 640, y));
        let [_, wrong] = residuals(&now, &last, |x, y| (x - 640, y));
        assert!(right < 1.5 && still > 10.0 && wrong > still, "{still} {right} {wrong}");
        assert_eq!(residuals(&now, &last, |_, _| (-1, 0)), [0.0; 2]);
    }

    #[test]
    fn shares_and_quantiles() {
        let clip = |frames, residuals: &[[f64; 2]]| ClipRegistration {
            frames,
            registered: residuals.len() as u64,
            residuals: residuals.into(),
        };
        let clips = [clip(4, &[[9.0, 1.0], [8.0, 2.0], [7.0, 3.0]]), clip(0, &[])];
        let figures = |clips: &[ClipRegistration]| {
            let mut tally = RegistrationTally::default();
            clips.iter().for_each(|clip| tally.add(clip).unwrap());
            tally.figures().unwrap()
        };
        let all = figures(&clips);
        assert_eq!((all.frames, all.share_registered), (4, Some(0.75)));
        assert_eq!((all.residual_without, all.residual), (Some(8.0), Some(2.0)));
        assert_eq!(figures(&clips[1..]), RegistrationFigures::default());
    }
}
