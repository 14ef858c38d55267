//! Random features for the boosting to choose from.

use super::random::Random;
use crate::channels::{MAGNITUDE, TEMPORAL};
use crate::cube::{SLICES, WINDOW};
use crate::feature::{Denominator, Feature};
use crate::gradient::ORIENTATIONS;
use crate::motion::FIRST_SCALAR;
use std::vec::Vec;

/// A range of cells: often short, sometimes any, sometimes all.
fn range(random: &mut Random) -> (u8, u8) {
    let length = match random.below(10) {
        0..6 => 1 + random.below(4),
        6..9 => 1 + random.below(WINDOW),
        _ => WINDOW,
    };
    let start = random.below(WINDOW - length + 1);
    (start as u8, (start + length) as u8)
}

/// A range of slices: one, or a random range, or all.
fn slices(random: &mut Random) -> (u8, u8) {
    match random.below(4) {
        0 => (0, 1),
        1 => (0, SLICES as u8),
        _ => {
            let start = random.below(SLICES);
            (start as u8, (start + 1 + random.below(SLICES - start)) as u8)
        }
    }
}

fn distinct(count: usize, mut draw: impl FnMut() -> Feature) -> Vec<Feature> {
    let mut features = Vec::with_capacity(count);
    while features.len() < count {
        features.push(draw());
        if features.len() == count {
            features.sort_unstable();
            features.dedup();
        }
    }
    features
}

/// HoG-like features of a single patch for φ_h and φ_v: energies of boxes against their window (cells, blocks, rows and
/// columns of cells) or against all orientations of the same box.
pub fn patch(count: usize, random: &mut Random) -> Vec<Feature> {
    distinct(count, || {
        let (x, y) = (range(random), range(random));
        let same_box = random.below(5) == 0;
        let (denominator, channels) = if same_box {
            (Denominator::SameBox, ORIENTATIONS)
        } else {
            (Denominator::Window, MAGNITUDE + 1)
        };
        Feature { denominator, channel: random.below(channels) as u8, x, y, t: (0, 1) }
    })
}

/// Features of cubes; without `temporal` none looks at temporal differences.
pub fn cube(count: usize, temporal: bool, random: &mut Random) -> Vec<Feature> {
    let mut features = distinct(count, || {
        let (x, y) = (range(random), range(random));
        let orientation = random.below(ORIENTATIONS);
        // Channels of the newest frame's second table, differences last.
        let newest = 8 + random.below(if temporal { 4 } else { 1 });
        let difference = if temporal { TEMPORAL } else { MAGNITUDE };
        let (denominator, channel) = match random.below(20) {
            0..6 => (Denominator::SameBox, orientation),
            6..8 => (Denominator::SameBox, if temporal { TEMPORAL } else { orientation }),
            8..11 => (Denominator::Window, orientation),
            11..13 => (Denominator::Window, [MAGNITUDE, difference][random.below(2)]),
            13..15 => (Denominator::SameChannel, [MAGNITUDE, difference][random.below(2)]),
            15..18 => (Denominator::SameChannel, newest),
            18 => (Denominator::Cells, [MAGNITUDE, difference][random.below(2)]),
            _ => (Denominator::Cells, if temporal { newest.max(9) } else { MAGNITUDE }),
        };
        let t = if channel >= 8 { (0, 1) } else { slices(random) };
        Feature { denominator, channel: channel as u8, x, y, t }
    });
    features.extend((0..FIRST_SCALAR as u8 + 8).map(Feature::scalar));
    features
}
