//! Training rows of the box refinement: boxes around every target with random errors, and the windows stretched to them.

use super::cubes::TrainingRow;
use super::labels::{Offset, TrainingBox, truths};
use super::visit::SampledView;
use crate::boxes::{self, BOX_CELLS, StretchedWindow};
use crate::channels::scale_space::Pyramid;
use crate::image::Rect;
use crate::shell::formats::clips::TruthBox;
use crate::shell::support::random::Random;
use crate::stcube::feature::Feature;
use fixed::types::I28F4;
use std::vec::Vec;

/// Errors of the boxes around a target, in parts of the largest error: most are as large as those of boxes before the fit,
/// the others show where to stop.
const ERRORS: [f64; 8] = [1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.25];

/// Largest error of the length of a side, octaves. With 1.1 boxes are no better, and more of them miss their object (AveP
/// at IoU 0.5 / 0.3 on airborne flights held back 0.592 / 0.725 instead of 0.593 / 0.727).
const OCTAVES: f64 = 0.8;

/// Largest error of the place, in parts of the target's side.
const AWAY: f64 = 0.3;

/// A box that is wrong by up to `error` parts of the largest error.
fn wrong(truth: &TruthBox, error: f64, random: &mut Random) -> Rect {
    let mut side = |start: f64, length: f64| {
        let wrong = length * (error * OCTAVES * random.symmetric()).exp2();
        let away = error * AWAY * random.symmetric() * length;
        let [start, length] = [start + length / 2.0 + away - wrong / 2.0, wrong];
        (I28F4::saturating_from_num(start), I28F4::saturating_from_num(length))
    };
    let (x, width) = side(truth.left, truth.width.max(1.0));
    let (y, height) = side(truth.top, truth.height.max(1.0));
    Rect { x, y, width, height }
}

/// The offset with which [`boxes::moved`] makes the target's box of `window`: cells, and binary logarithms.
fn offset(truth: &TruthBox, window: &Rect) -> Offset {
    let [x, y, width, height] =
        [window.x, window.y, window.width, window.height].map(|v| v.to_num::<f64>());
    let away = |start: f64, length: f64, from: f64, side: f64| {
        (start + length / 2.0 - from - side / 2.0) / side * BOX_CELLS as f64
    };
    Offset {
        x: away(truth.left, truth.width, x, width),
        y: away(truth.top, truth.height, y, height),
        width: (truth.width.max(1.0) / width).log2(),
        height: (truth.height.max(1.0) / height).log2(),
    }
}

/// Boxes around every target, with the values of `pool` in their windows.
pub fn fits(
    view: &SampledView<'_>,
    pyramid: &Pyramid<'_>,
    pool: &[Feature],
    random: &mut Random,
) -> Vec<TrainingRow> {
    let mut rows = Vec::new();
    let mut stretched = StretchedWindow::EMPTY;
    for truth in &truths(&view.boxes) {
        let TrainingBox::Target(truth) = truth else { continue };
        for error in ERRORS {
            let window = boxes::cut(pyramid, &wrong(truth, error, random), &mut stretched);
            let values = pool.iter().map(|feature| stretched.value(feature)).collect();
            rows.push(TrainingRow::of_offset(view, values, offset(truth, &window)));
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::formats::class::Class;

    #[test]
    fn offsets_lead_back_to_the_target() {
        let mut random = Random::new(5);
        for n in 0..200 {
            let (width, height) = (8.0 + f64::from(n), 60.0 - f64::from(n) / 5.0);
            let truth = TruthBox {
                id: 1,
                left: 100.0 - f64::from(n),
                top: 30.0,
                width,
                height,
                class: Class::Drone,
                visibility: 1.0,
            };
            let window = wrong(&truth, 1.0, &mut random);
            let Offset { x, y, width: wider, height: higher } = offset(&truth, &window);
            assert!(wider.abs() < OCTAVES + 0.1 && higher.abs() < OCTAVES + 0.1);
            let q8 = [x, y, wider, higher].map(|v| (v * 256.0).round() as i32);
            let back = boxes::moved(&window, q8);
            let sides = [back.x, back.y, back.width, back.height].map(|v| v.to_num::<f64>());
            let wanted = [truth.left, truth.top, truth.width, truth.height];
            for (side, wanted) in sides.into_iter().zip(wanted) {
                assert!((side - wanted).abs() < 0.8, "{truth:?}: {back:?}");
            }
        }
    }
}
