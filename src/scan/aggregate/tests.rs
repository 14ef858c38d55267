//! Maps against the same in numbers of 64 bits.

use super::row::sum_along;
use super::*;
use crate::channels::tests::{LevelPictures, cells, level};
use crate::channels::{GREY, MAGNITUDE};
use core::array::from_fn;
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

/// The whole map of a level, computed in strips of `rows` rows.
fn whole(
    newest: &NewestChannels<'_>,
    noise: [u32; 3],
    rows: (usize, usize),
) -> Vec<[u8; MAP_CHANNELS]> {
    let columns = newest.slice.cells().0;
    let mut bytes = vec![0xa5; strip_bytes(columns, rows.0)];
    let mut words = vec![0xa5a5; strip_words(columns)];
    let mut map: Vec<[u8; MAP_CHANNELS]> = vec![];
    strips(newest, &noise, rows, &mut bytes, &mut words, |strip| {
        let width = columns + 2 * PADDING;
        let rows = strip.bytes.chunks_exact(width * MAP_CHANNELS);
        assert!(rows.remainder().is_empty());
        let cells: Vec<[u8; MAP_CHANNELS]> = rows
            .flat_map(|row| {
                (0..width).map(move |x| from_fn(|channel| row[channel * width + x] ^ 128))
            })
            .collect();
        let known = map.len() - strip.top * (columns + 2 * PADDING);
        assert_eq!(map[map.len() - known..], cells[..known], "rows shared with the strip before");
        map.extend(&cells[known..]);
    });
    map
}

#[test]
fn a_dot_stands_out_and_padding_is_neutral() {
    let (width, height) = (64usize, 48usize);
    let mut level = LevelPictures::new(width, height, false, |_, _| [100, 0, 0, 0]);
    for (x, y) in (20..24).flat_map(|y| (30..34).map(move |x| (x, y))) {
        level.set(x, y, [40, 0, 80, 80]);
    }
    let newest = level.newest();
    let mut words = vec![0; noise_words(width / 2, height / 2)];
    let cells = whole(&newest, noise(&newest, &mut words), (13, 9));
    let stride = width / 2 + 2 * PADDING;
    let outside = OUTSIDE.map(|byte| byte ^ 128);
    let at = |x: usize, y: usize| cells[(y + PADDING) * stride + x + PADDING];
    assert_eq!(cells.len(), stride * (height / 2 + 2 * PADDING));
    assert_eq!((cells[0], cells[cells.len() - 1]), (outside, outside));
    assert_eq!(at(3, 3), outside);
    let dot = at(15, 10);
    assert!(dot[6] > 100 && dot[8] < 100 && dot[9] < 30 && dot[11] > 200, "{dot:?}");
    assert_eq!(dot[10], 0);
}

/// Numbers between which a result lies whatever its steps round to.
#[derive(Debug, Clone, Copy)]
struct Between(f64, f64);

impl Between {
    /// Q16 reciprocal of a number of quarters with the floor of 4 units, rounded down.
    fn reciprocal(self) -> Self {
        Self(65536.0 / (self.1 + 16.0) - 1.0, 65536.0 / (self.0 + 16.0))
    }

    fn times(self, other: Self) -> Self {
        let products = [self.0 * other.0, self.0 * other.1, self.1 * other.0, self.1 * other.1];
        Self(
            products.into_iter().fold(f64::MAX, f64::min),
            products.into_iter().fold(f64::MIN, f64::max),
        )
    }

    /// Divided, then rounded down.
    fn over(self, divisor: f64) -> Self {
        Self(self.0 / divisor - 1.0, self.1 / divisor)
    }

    /// A byte of the map, 8 times the root of this, rounded down.
    fn root(self) -> Self {
        let root = |v: f64| (8.0 * v.clamp(0.0, 1023.0).sqrt()).floor();
        Self(root(self.0), root(self.1))
    }

    /// A byte of the map, this above the middle.
    fn above_middle(self) -> Self {
        Self((128.0 + self.0).clamp(0.0, 255.0), (128.0 + self.1).clamp(0.0, 255.0))
    }

    fn holds(self, byte: u8) -> bool {
        (self.0..=self.1).contains(&f64::from(byte))
    }
}

fn exactly(v: f64) -> Between {
    Between(v, v)
}

proptest! {
    #[test]
    fn map_agrees_with_f64(
        level in level(), noise in prop::array::uniform3(prop_oneof![0..80u32, 0..4100u32]),
        extra in 0..9usize, oriented: bool,
    ) {
        let newest = NewestChannels { oriented, ..level.newest() };
        let (columns, rows) = newest.slice.cells();
        // Strips of any height give the same map.
        let out = whole(&newest, noise, (10 + extra, 9));
        prop_assert_eq!(&out, &whole(&newest, noise, (rows + 2 * PADDING, 0)));
        let cells = cells(&newest);
        for (place, got) in out.iter().enumerate() {
            let stride = columns + 2 * PADDING;
            let (x, y) = ((place % stride).wrapping_sub(PADDING), (place / stride).wrapping_sub(PADDING));
            if x >= columns || y >= rows {
                prop_assert_eq!(got, &OUTSIDE.map(|byte| byte ^ 128));
                continue;
            }
            // Sum over the part of the square of 11 x 11 cells that lies in the picture, and its cells.
            let around = |channel: usize| {
                let (mut sum, mut count) = (0.0, 0.0);
                for j in y.saturating_sub(5)..(y + 6).min(rows) {
                    for i in x.saturating_sub(5)..(x + 6).min(columns) {
                        sum += f64::from(cells[j * columns + i][channel]);
                        count += 1.0;
                    }
                }
                (sum, count)
            };
            // Quarters of the mean over the whole square: 4/121 in Q16, rounded down, is short of it by 3e-4.
            let mean = |channel| {
                let mean = 4.0 * around(channel).0 / 121.0;
                Between((mean * (1.0 - 3e-4) - 1.0).max(0.0), mean)
            };
            let value = |channel: usize| f64::from(cells[y * columns + x][channel]);
            let ratio = |value: f64, mean: Between| exactly(value).times(mean.reciprocal()).over(256.0).root();
            let energy = mean(MAGNITUDE);
            let mut want = [exactly(0.0); MAP_CHANNELS];
            for (channel, want) in want[..=MAGNITUDE].iter_mut().enumerate() {
                *want = ratio(value(channel), energy);
            }
            want[7] = exactly(4.0 * value(MAGNITUDE)).root();
            let [grey, far, near, plain] = [7, 8, 9, 10];
            let (sum, count) = around(grey);
            let above = 4.0 * (value(grey) - sum / count);
            // The mean is rounded down after a division that may be half a quarter too much.
            let above = Between(above - 0.5, above + 1.0);
            want[8] = above.times(energy.reciprocal()).over(1024.0).above_middle();
            want[9] = above.over(2.0).above_middle();
            for (i, channel) in [far, near, plain].into_iter().enumerate() {
                let calm = 65536.0 / (f64::from(noise[i]) + 32.0);
                want[10 + i] = exactly(value(channel)).times(Between(calm - 1.0, calm)).over(128.0).root();
            }
            want[13] = ratio(value(near), mean(near));
            want[14] = ratio(value(plain), exactly(4.0 * value(MAGNITUDE)));
            want[15] = ratio(value(far), mean(far));
            for (channel, (got, want)) in got.iter().zip(want).enumerate() {
                prop_assert!(want.holds(*got), "{x} {y} channel {channel}: {got}, not {want:?}");
            }
        }
    }

    #[test]
    fn sums_along_are_sums_across(columns in 1..90usize, seed in prop::collection::vec(0..2806u16, 100)) {
        let sums = &seed[..sums_len(columns)];
        let (mut across, mut along) = (vec![0; columns], vec![0; columns]);
        let mut rest = [vec![0xa5a5; sums.len()], vec![0xa5a5; sums.len()]];
        sum_across(columns, sums, &mut across, rest.each_mut().map(Vec::as_mut_slice));
        sum_along(sums, &mut along);
        let naive: Vec<u16> = sums.windows(NEAR).map(|sums| sums.iter().sum()).collect();
        prop_assert_eq!(&across, &naive);
        prop_assert_eq!(&along, &naive);
    }

    #[test]
    fn noise_agrees_with_f64(level in level()) {
        let newest = level.newest();
        let (columns, rows) = newest.slice.cells();
        let cells = cells(&newest);
        let mut words = vec![9; noise_words(columns, rows)];
        for (i, got) in noise(&newest, &mut words).into_iter().enumerate() {
            let mut means = vec![];
            for by in 0..rows / 8 {
                for bx in 0..columns / 8 {
                    let cell = |n: usize| f64::from(cells[(8 * by + n / 8) * columns + 8 * bx + n % 8][GREY + 1 + i]);
                    means.push((0..64).map(cell).sum::<f64>() / 64.0);
                }
            }
            let mean = |of: &[f64]| of.iter().sum::<f64>() / (of.len() as f64).max(1.0);
            let all = mean(&means);
            means.retain(|m| *m <= 2.0 * all);
            prop_assert!((f64::from(got) - 16.0 * mean(&means)).abs() < 1.0, "{i}: {got}");
        }
    }
}
