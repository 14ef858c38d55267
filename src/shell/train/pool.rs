//! Pools of random features for boosting.

use crate::boxes::NEWEST_CHANNELS;
use crate::channels::window::{SLICES, WINDOW};
use crate::channels::{MAGNITUDE, TEMPORAL};
use crate::image::gradient::ORIENTATIONS;
use crate::shell::pipeline::methods::Sees;
use crate::shell::support::random::Random;
use crate::stcube::compensation::FIRST_SCALAR;
use crate::stcube::feature::{Denominator, Feature};
use std::vec::Vec;

/// Cells of a 3-D HoG along each side of the window.
const GRID: u8 = 5;
const _: () = assert!((WINDOW as u8).is_multiple_of(GRID));

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

/// Features of cubes that look at what `sees` allows; without `temporal` none looks at temporal differences. `count` of
/// them where they are drawn at random.
pub fn cube(count: usize, sees: Sees, temporal: bool, random: &mut Random) -> Vec<Feature> {
    if sees == Sees::Grid {
        return grid(temporal);
    }
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
        let newest_only = channel >= 8 || sees == Sees::Newest;
        let t = if newest_only { (0, 1) } else { slices(random) };
        Feature { denominator, channel: channel as u8, x, y, t }
    });
    let scalars = if sees == Sees::Newest { FIRST_SCALAR } else { FIRST_SCALAR + 8 };
    features.extend((0..scalars as u8).map(Feature::scalar));
    features
}

/// Features of windows that are stretched to a box ([`crate::boxes`]), one slice; without `temporal` none looks at temporal
/// differences.
pub fn stretched(count: usize, temporal: bool, random: &mut Random) -> Vec<Feature> {
    // Of the newest frame's channels the first and the last are not differences.
    let still = [8, 8 + NEWEST_CHANNELS - 1];
    let mut features = distinct(count, || {
        let (x, y) = (range(random), range(random));
        let orientation = random.below(ORIENTATIONS);
        let newest = match temporal {
            true => 8 + random.below(NEWEST_CHANNELS),
            false => still[random.below(2)],
        };
        let (denominator, channel) = match random.below(20) {
            0..4 => (Denominator::SameBox, orientation),
            4..7 => (Denominator::Window, orientation),
            7..9 => (Denominator::Window, MAGNITUDE),
            9..11 => (Denominator::SameChannel, MAGNITUDE),
            11..17 => (Denominator::SameChannel, newest),
            17 => (Denominator::Cells, MAGNITUDE),
            _ => (Denominator::Cells, if newest == 8 { still[1] } else { newest }),
        };
        Feature { denominator, channel: channel as u8, x, y, t: (0, 1) }
    });
    features.push(Feature::scalar(0));
    features
}

/// A 3-D HoG: the energy of each orientation, and with `temporal` that of the change, in every cell of a grid over
/// window and slices, against the window's energy in the same slices; the cells of one slice and of all of them.
fn grid(temporal: bool) -> Vec<Feature> {
    let side = WINDOW as u8 / GRID;
    let range = |i: u8| (i * side, (i + 1) * side);
    let times = (0..SLICES as u8).map(|t| (t, t + 1)).chain([(0, SLICES as u8)]);
    let cells = times.flat_map(|t| (0..GRID).flat_map(move |y| (0..GRID).map(move |x| (t, y, x))));
    let channels = (0..ORIENTATIONS).chain(temporal.then_some(TEMPORAL));
    let mut features: Vec<Feature> = cells
        .flat_map(|(t, y, x)| {
            channels.clone().map(move |channel| Feature {
                denominator: Denominator::Window,
                channel: channel as u8,
                x: range(x),
                y: range(y),
                t,
            })
        })
        .collect();
    features.extend((0..FIRST_SCALAR as u8).map(Feature::scalar));
    features
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a feature depends on older slices, or on the scalars computed from them.
    fn looks_back(feature: &Feature) -> bool {
        match feature.denominator {
            Denominator::Scalar => usize::from(feature.channel) >= FIRST_SCALAR,
            _ => feature.t != (0, 1),
        }
    }

    /// Whether a feature looks at temporal differences.
    fn differs(feature: &Feature) -> bool {
        let channel = usize::from(feature.channel);
        feature.denominator != Denominator::Scalar && (channel == TEMPORAL || channel > 8)
    }

    #[test]
    fn features_see_what_they_may() {
        for sees in [Sees::Cube, Sees::Newest, Sees::Grid] {
            for temporal in [false, true] {
                let features = cube(600, sees, temporal, &mut Random::new(3));
                let back = features.iter().any(looks_back);
                assert_eq!(back, sees != Sees::Newest, "{sees:?}");
                assert_eq!(features.iter().any(differs), temporal, "{sees:?}");
                let valid = |f: &Feature| Feature::decode(&f.encode()) == Some(*f);
                assert!(features.iter().all(valid), "{sees:?}");
            }
        }
    }

    #[test]
    fn stretched_windows_are_of_one_slice() {
        for temporal in [false, true] {
            let features = stretched(900, temporal, &mut Random::new(3));
            assert!(!features.iter().any(looks_back));
            let channels = |f: &Feature| f.denominator == Denominator::Scalar || f.channel < 14;
            assert!(features.iter().all(channels));
            let differs = |f: &Feature| f.channel == 7 || (9..13).contains(&f.channel);
            assert_eq!(features.iter().any(differs), temporal);
            assert!(features.iter().all(|f| Feature::decode(&f.encode()) == Some(*f)));
        }
    }

    #[test]
    fn the_grid_covers_every_cell_once() {
        let features = grid(false);
        for t in 0..SLICES as u8 {
            for (x, y) in (0..WINDOW as u8).flat_map(|y| (0..WINDOW as u8).map(move |x| (x, y))) {
                let inside = |f: &&Feature| {
                    f.denominator == Denominator::Window
                        && f.t == (t, t + 1)
                        && (f.x.0..f.x.1).contains(&x)
                        && (f.y.0..f.y.1).contains(&y)
                };
                assert_eq!(features.iter().filter(inside).count(), ORIENTATIONS);
            }
        }
    }
}
