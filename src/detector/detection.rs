//! Detections: box, score, motion over the slices.

use crate::image::Rect;
use fixed::types::I28F4;

/// Shifts of a detection: one for each older slice of its st-cube.
pub const SHIFTS: usize = 3;

/// Movement of an object in the image, in pixels of the frame (Q28.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Shift {
    /// Shift to the right, frame pixels.
    pub x: I28F4,
    /// Shift downwards, frame pixels.
    pub y: I28F4,
}

/// A flying object found in the newest frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Detection {
    /// Its box in the frame.
    pub rect: Rect,
    /// Log-odds that the box shows a target, Q16; any sign. By this frame and those before it
    /// ([`crate::detector::temporal_score`]).
    pub score: i32,
    /// The same by this frame alone, less the log-odds that wing beats take away in `score` as well.
    pub frame_score: i32,
    /// Where the object's centre was 1, 2, .. frames ago, relative to its centre now.
    pub shifts: [Shift; SHIFTS],
}
