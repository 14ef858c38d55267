//! Labels of windows from the ground truth: positive, negative or ignored.

use crate::channels::scale_space::{PyramidLevel, TARGET_CELLS};
use crate::channels::window::Position;
use crate::image::gradient::CELL;
use crate::shell::formats::class::Class;
use crate::shell::formats::clips::TruthBox;
use std::vec::Vec;

/// Targets shorter than this many pixels are neither learned nor held against a window.
const SMALLEST: f64 = 7.0;

/// A box of the ground truth, as the trainer uses it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrainingBox {
    /// An aircraft to be found.
    Target(TruthBox),
    /// An aircraft too small or not wholly seen: neither way.
    Ignore(TruthBox),
}

/// The boxes of a frame; birds are left out, they are background.
pub fn truths(boxes: &[TruthBox]) -> Vec<TrainingBox> {
    boxes
        .iter()
        .filter(|b| b.class != Class::Bird)
        .map(
            |b| {
                if b.is_target(SMALLEST) {
                    TrainingBox::Target(*b)
                } else {
                    TrainingBox::Ignore(*b)
                }
            },
        )
        .collect()
}

/// A box seen from a window: its centre from the window's in cells of the level, binary logarithms of width and height
/// over the nominal target's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset {
    /// Centre to the right, cells.
    pub x: f64,
    /// Centre downwards, cells.
    pub y: f64,
    /// Logarithm of the width.
    pub width: f64,
    /// Logarithm of the height.
    pub height: f64,
}

impl Offset {
    /// Of `truth` from the window at `position` of `level`.
    pub fn of(truth: &TruthBox, position: Position, level: &PyramidLevel) -> Self {
        let scale = f64::from(level.scale) / 65536.0;
        let (cx, cy) = position.centre(level.scale);
        let cell = CELL as f64 * scale;
        let target = TARGET_CELLS as f64 * cell;
        Self {
            x: (truth.left + truth.width / 2.0 - f64::from(cx) / 256.0) / cell,
            y: (truth.top + truth.height / 2.0 - f64::from(cy) / 256.0) / cell,
            width: (truth.width.max(1.0) / target).log2(),
            height: (truth.height.max(1.0) / target).log2(),
        }
    }

    /// Farther of the two ways from the centre, cells.
    pub fn distance(&self) -> f64 {
        self.x.abs().max(self.y.abs())
    }

    /// Binary logarithm of the longer side over the nominal one.
    pub fn scale(&self) -> f64 {
        self.width.max(self.height)
    }
}

/// Tolerances of labels: nearer than the first two a window is positive, farther than the last two negative, between
/// them ignored.
#[derive(Debug, Clone, Copy)]
pub struct Tolerance {
    /// Largest distance of the centres of a positive, cells.
    pub distance: f64,
    /// Largest difference of size of a positive, octaves.
    pub scale: f64,
    /// Distance of the centres from which on a window is negative, cells.
    pub far: f64,
    /// Difference of size from which on a window is negative, octaves.
    pub other_scale: f64,
}

/// A window's label.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WindowLabel {
    /// It shows the target of that number among the frame's truths, at that offset.
    Positive(usize, Offset),
    /// Background: no target is near.
    Negative,
    /// Too near to a target for background, too far for a positive.
    Ignore,
}

/// The label of the window at `position` of `level`.
pub fn label(
    truths: &[TrainingBox],
    position: Position,
    level: &PyramidLevel,
    tolerance: &Tolerance,
) -> WindowLabel {
    let mut label = WindowLabel::Negative;
    for (number, truth) in truths.iter().enumerate() {
        let (target, truth) = match truth {
            TrainingBox::Target(truth) => (true, truth),
            TrainingBox::Ignore(truth) => (false, truth),
        };
        let offset = Offset::of(truth, position, level);
        let (distance, scale) = (offset.distance(), offset.scale().abs());
        if target && distance <= tolerance.distance && scale <= tolerance.scale {
            return WindowLabel::Positive(number, offset);
        }
        // A larger target reaches farther, in cells of this level.
        let far = tolerance.far * offset.scale().exp2().max(1.0);
        if distance < far && (scale < tolerance.other_scale || !target) {
            label = WindowLabel::Ignore;
        }
    }
    label
}
