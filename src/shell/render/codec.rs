//! Video compression: a small hybrid codec in the manner of H.264.
//!
//! Blocks of 16x16 pixels are predicted from the decoded frame before, moved by the background's motion, or from their
//! decoded neighbours in key frames. The difference goes through an 8x8 cosine transform, is quantised with a dead zone
//! and added back; edges between coded blocks are smoothed. Only what decoding gives is kept: there is no bit stream.
//! As in a real encoder noise freezes where it falls below the quantiser, and small faint objects lag and smear.

use super::draw::by_ratio;
use super::settings::RenderSettings;
use crate::shell::support::random::Random;
use std::vec;
use std::vec::Vec;

/// Side of a block that is predicted as one, pixels.
pub(super) const MACROBLOCK: usize = 16;
/// Side of a block that is transformed, pixels.
const BLOCK: usize = 8;
/// Quantiser step below which nothing is done.
const LEAST_STEP: f64 = 2.0;
/// Rounding of quantised values: of predicted blocks, and of blocks of key frames.
const ROUNDING: [f32; 2] = [1.0 / 6.0, 1.0 / 3.0];

/// Motion of a macroblock: where it was in the frame before, in quarters of a pixel from where it is.
pub(super) type BlockMotion = [i32; 2];

/// A codec of one flight.
#[derive(Debug, Clone)]
pub(super) struct Codec {
    /// Quantiser step, grey levels of a cosine of amplitude 1/4; none: the frames are left alone.
    step: Option<f32>,
    /// Frames from one key frame to the next.
    interval: u64,
    size: [usize; 2],
    /// The decoded frame before.
    reference: Vec<u8>,
    /// Whether each transformed block had a difference.
    coded: Vec<bool>,
    frames: u64,
}

impl Codec {
    /// Draws a codec.
    pub(super) fn draw(random: &mut Random, settings: &RenderSettings) -> Self {
        let step = by_ratio(random, settings.sensor.quantiser);
        let [width, height] = settings.size;
        Self {
            step: (step >= LEAST_STEP).then_some(step as f32),
            interval: [30, 60, 250][random.below(3)],
            size: settings.size,
            reference: vec![0; width * height],
            coded: vec![false; (width / BLOCK) * (height / BLOCK)],
            frames: 0,
        }
    }

    /// Switches the codec off; returns the quantisation parameter of H.264 with this step, 12 to 40.
    pub(super) fn switch_off(&mut self) -> u32 {
        let step = self.step.take().unwrap_or(1.0);
        // Steps grow by 2^(1/6) from 1 at 4.
        let mut parameter = 4;
        let mut size = 1.0f32;
        while size < step && parameter < 40 {
            size *= 1.122_462;
            parameter += 1;
        }
        parameter.max(12)
    }

    /// Replaces a frame by what is left of it after compression; `motions` are those of its macroblocks, row by row.
    pub(super) fn apply(&mut self, pixels: &mut [u8], motions: &[BlockMotion]) {
        let Some(step) = self.step else { return };
        let key = self.frames.is_multiple_of(self.interval);
        self.frames += 1;
        let [width, height] = self.size;
        self.coded.fill(false);
        let mut prediction = [0; MACROBLOCK * MACROBLOCK];
        let mut still = [0; MACROBLOCK * MACROBLOCK];
        for (number, motion) in motions.iter().enumerate() {
            let columns = width / MACROBLOCK;
            let (left, top) = (number % columns * MACROBLOCK, number / columns * MACROBLOCK);
            if !key {
                self.predict(left, top, *motion, &mut prediction);
                self.predict(left, top, [0, 0], &mut still);
                let error = |predicted: &[u8]| -> u32 {
                    let rows = predicted.chunks_exact(MACROBLOCK).enumerate();
                    rows.map(|(y, row)| {
                        let seen = &pixels[(top + y) * width + left..][..MACROBLOCK];
                        row.iter().zip(seen).map(|(a, b)| u32::from(a.abs_diff(*b))).sum::<u32>()
                    })
                    .sum()
                };
                // Rest costs nothing to transmit.
                if error(&still) <= error(&prediction) + 64 {
                    prediction = still;
                }
            }
            for part in 0..4 {
                let (x, y) = (part % 2 * BLOCK, part / 2 * BLOCK);
                let (left, top) = (left + x, top + y);
                let mut predicted = [[0u8; BLOCK]; BLOCK];
                if key {
                    predicted = [[mean_of_neighbours(pixels, width, left, top); BLOCK]; BLOCK];
                } else {
                    for (row, line) in predicted.iter_mut().enumerate() {
                        line.copy_from_slice(&prediction[(y + row) * MACROBLOCK + x..][..BLOCK]);
                    }
                }
                let coded =
                    code(pixels, width, [left, top], &predicted, step, ROUNDING[usize::from(key)]);
                self.coded[top / BLOCK * (width / BLOCK) + left / BLOCK] = coded | key;
            }
        }
        self.smooth(pixels, step, height);
        self.reference.copy_from_slice(pixels);
    }

    /// The macroblock of the frame before at a place, cubic between pixels.
    fn predict(
        &self,
        left: usize,
        top: usize,
        motion: BlockMotion,
        out: &mut [u8; MACROBLOCK * MACROBLOCK],
    ) {
        const REACH: usize = MACROBLOCK + 3;
        let [width, height] = self.size.map(|s| s as i32);
        let (dx, dy) = (motion[0] >> 2, motion[1] >> 2);
        let (first_x, first_y) = (left as i32 + dx - 1, top as i32 + dy - 1);
        let mut lines = [[0i32; MACROBLOCK]; REACH];
        let [a, b, c, d] = TAPS[(motion[0] & 3) as usize];
        let mut seen = [0i32; REACH];
        for (row, line) in lines.iter_mut().enumerate() {
            let y = (first_y + row as i32).clamp(0, height - 1) * width;
            if first_x >= 0 && first_x + REACH as i32 <= width {
                let from = &self.reference[(y + first_x) as usize..][..REACH];
                for (value, pixel) in seen.iter_mut().zip(from) {
                    *value = i32::from(*pixel);
                }
            } else {
                for (i, value) in seen.iter_mut().enumerate() {
                    let x = (first_x + i as i32).clamp(0, width - 1);
                    *value = i32::from(self.reference[(y + x) as usize]);
                }
            }
            for (i, value) in line.iter_mut().enumerate() {
                *value = a * seen[i] + b * seen[i + 1] + c * seen[i + 2] + d * seen[i + 3];
            }
        }
        let [a, b, c, d] = TAPS[(motion[1] & 3) as usize];
        for (y, out) in out.chunks_exact_mut(MACROBLOCK).enumerate() {
            for (x, pixel) in out.iter_mut().enumerate() {
                let sum = a * lines[y][x]
                    + b * lines[y + 1][x]
                    + c * lines[y + 2][x]
                    + d * lines[y + 3][x];
                *pixel = ((sum + 2048) >> 12).clamp(0, 255) as u8;
            }
        }
    }

    /// Smooths the edges between blocks of which one was coded.
    fn smooth(&self, pixels: &mut [u8], step: f32, height: usize) {
        let width = self.size[0];
        let columns = width / BLOCK;
        let (across, along, most) =
            ((1.3 * step) as i32, (0.5 * step) as i32 + 1, 1 + (step / 12.0) as i32);
        let mut filter = |at: usize, stride: usize| {
            let value = |offset: usize| i32::from(pixels[offset]);
            let (p1, p0, q0, q1) =
                (value(at - 2 * stride), value(at - stride), value(at), value(at + stride));
            if (p0 - q0).abs() < across && (p1 - p0).abs() < along && (q1 - q0).abs() < along {
                let change = (((q0 - p0) * 4 + p1 - q1 + 4) >> 3).clamp(-most, most);
                pixels[at - stride] = (p0 + change).clamp(0, 255) as u8;
                pixels[at] = (q0 - change).clamp(0, 255) as u8;
            }
        };
        for row in 0..height / BLOCK {
            for column in 0..columns {
                let here = self.coded[row * columns + column];
                let (x, y) = (column * BLOCK, row * BLOCK);
                if column > 0 && (here || self.coded[row * columns + column - 1]) {
                    (0..BLOCK).for_each(|i| filter((y + i) * width + x, 1));
                }
                if row > 0 && (here || self.coded[(row - 1) * columns + column]) {
                    (0..BLOCK).for_each(|i| filter(y * width + x + i, width));
                }
            }
        }
    }
}

/// Weights of four neighbours for a place between the second and third, in quarters; Q6, Catmull and Rom's cubic.
const TAPS: [[i32; 4]; 4] = [[0, 64, 0, 0], [-5, 56, 15, -2], [-4, 36, 36, -4], [-2, 15, 56, -5]];

/// Mean of the decoded pixels above and to the left of a block.
fn mean_of_neighbours(pixels: &[u8], width: usize, left: usize, top: usize) -> u8 {
    let (mut sum, mut count) = (0, 0);
    if top > 0 {
        let above = &pixels[(top - 1) * width + left..][..BLOCK];
        sum += above.iter().map(|&p| u32::from(p)).sum::<u32>();
        count += BLOCK as u32;
    }
    if left > 0 {
        sum += (top..top + BLOCK).map(|y| u32::from(pixels[y * width + left - 1])).sum::<u32>();
        count += BLOCK as u32;
    }
    sum.checked_div(count).unwrap_or(128) as u8
}

/// Codes a block in place; whether there was any difference left to code.
fn code(
    pixels: &mut [u8],
    width: usize,
    [left, top]: [usize; 2],
    predicted: &[[u8; BLOCK]; BLOCK],
    step: f32,
    rounding: f32,
) -> bool {
    let mut block = [[0f32; BLOCK]; BLOCK];
    for (y, row) in block.iter_mut().enumerate() {
        let seen = &pixels[(top + y) * width + left..][..BLOCK];
        for (x, value) in row.iter_mut().enumerate() {
            *value = f32::from(i16::from(seen[x]) - i16::from(predicted[y][x]));
        }
    }
    transform(&mut block);
    transpose(&mut block);
    transform(&mut block);
    let inverse = 1.0 / step;
    let mut any = 0;
    for value in block.iter_mut().flatten() {
        let level = (value.abs() * inverse + rounding) as i32;
        any |= level;
        *value = (level as f32 * step).copysign(*value);
    }
    if any != 0 {
        restore(&mut block);
        transpose(&mut block);
        restore(&mut block);
    } else {
        block = [[0.0; BLOCK]; BLOCK];
    }
    for (y, row) in block.iter().enumerate() {
        let out = &mut pixels[(top + y) * width + left..][..BLOCK];
        for (x, pixel) in out.iter_mut().enumerate() {
            // Rounded by hand: casts drop the fraction.
            let value = row[x] + f32::from(predicted[y][x]) + 0.5;
            *pixel = value.clamp(0.0, 255.0) as u8;
        }
    }
    any != 0
}

/// Even rows 0, 2, 4, 6 and odd rows 1, 3, 5, 7 of the orthonormal cosine transform of length 8, first four columns; the
/// others follow by symmetry.
const EVEN: [[f32; 4]; 4] = [
    [0.353_553_4, 0.353_553_4, 0.353_553_4, 0.353_553_4],
    [0.461_939_8, 0.191_341_7, -0.191_341_7, -0.461_939_8],
    [0.353_553_4, -0.353_553_4, -0.353_553_4, 0.353_553_4],
    [0.191_341_7, -0.461_939_8, 0.461_939_8, -0.191_341_7],
];
const ODD: [[f32; 4]; 4] = [
    [0.490_392_6, 0.415_734_8, 0.277_785_1, 0.097_545_16],
    [0.415_734_8, -0.097_545_16, -0.490_392_6, -0.277_785_1],
    [0.277_785_1, -0.490_392_6, 0.097_545_16, 0.415_734_8],
    [0.097_545_16, -0.277_785_1, 0.415_734_8, -0.490_392_6],
];

/// Cosine transform along the first index.
fn transform(block: &mut [[f32; BLOCK]; BLOCK]) {
    let mut out = [[0f32; BLOCK]; BLOCK];
    for k in 0..4 {
        for i in 0..4 {
            for x in 0..BLOCK {
                out[2 * k][x] += EVEN[k][i] * (block[i][x] + block[7 - i][x]);
                out[2 * k + 1][x] += ODD[k][i] * (block[i][x] - block[7 - i][x]);
            }
        }
    }
    *block = out;
}

/// The inverse of [`transform`].
fn restore(block: &mut [[f32; BLOCK]; BLOCK]) {
    let mut out = [[0f32; BLOCK]; BLOCK];
    for i in 0..4 {
        for x in 0..BLOCK {
            let (mut even, mut odd) = (0.0, 0.0);
            for k in 0..4 {
                even += EVEN[k][i] * block[2 * k][x];
                odd += ODD[k][i] * block[2 * k + 1][x];
            }
            out[i][x] = even + odd;
            out[7 - i][x] = even - odd;
        }
    }
    *block = out;
}

fn transpose(block: &mut [[f32; BLOCK]; BLOCK]) {
    *block = core::array::from_fn(|y| core::array::from_fn(|x| block[x][y]));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_transform_is_orthonormal(values in proptest::collection::vec(-255.0f32..255.0, 64)) {
            let mut block: [[f32; 8]; 8] = core::array::from_fn(|y| core::array::from_fn(|x| values[y * 8 + x]));
            let energy = |b: &[[f32; 8]; 8]| b.iter().flatten().map(|v| f64::from(v * v)).sum::<f64>();
            let before = energy(&block);
            transform(&mut block);
            transpose(&mut block);
            transform(&mut block);
            prop_assert!((energy(&block) / (before + 1e-3) - 1.0).abs() < 1e-3);
            restore(&mut block);
            transpose(&mut block);
            restore(&mut block);
            for (i, value) in block.iter().flatten().enumerate() {
                prop_assert!((value - values[i]).abs() < 1e-2);
            }
        }
    }

    fn settings(step: f64) -> RenderSettings {
        let mut settings = RenderSettings { size: [64, 48], ..RenderSettings::default() };
        settings.sensor.quantiser = [step, step * 1.0001];
        settings
    }

    /// A picture of smooth waves, moved.
    fn picture(shift: usize) -> Vec<u8> {
        let wave = |i: usize| {
            let (x, y) = ((i % 64 + shift) as f64 * 0.3, (i / 64) as f64 * 0.2);
            (128.0
                + 60.0 * crate::shell::support::vectors::sin_cos(x).0
                + 40.0 * crate::shell::support::vectors::sin_cos(y).0) as u8
        };
        (0..64 * 48).map(wave).collect()
    }

    #[test]
    fn errors_stay_near_the_quantiser_and_fall_with_it() {
        let worst = |step: f64| {
            let mut codec = Codec::draw(&mut Random::new(1), &settings(step));
            let mut worst = 0;
            for shift in 0..12 {
                let mut pixels = picture(shift);
                codec.apply(&mut pixels, &[[4, 0]; 12]);
                let differences = pixels.iter().zip(picture(shift)).map(|(a, b)| a.abs_diff(b));
                worst = worst.max(differences.max().unwrap());
            }
            worst
        };
        let [fine, coarse] = [worst(3.0), worst(24.0)];
        assert!(fine <= 10 && coarse > fine && coarse < 60, "{fine} {coarse}");
    }

    #[test]
    fn noise_below_the_quantiser_freezes() {
        let mut codec = Codec::draw(&mut Random::new(1), &settings(40.0));
        let mut random = Random::new(5);
        let mut before = Vec::new();
        for number in 0..4 {
            let mut pixels = picture(0);
            for pixel in &mut pixels {
                *pixel = pixel.saturating_add(random.below(3) as u8);
            }
            codec.apply(&mut pixels, &[[0, 0]; 12]);
            if number > 1 {
                let same = pixels.iter().zip(&before).filter(|(a, b)| a == b).count();
                assert!(same > 9 * pixels.len() / 10, "{same}");
            }
            before = pixels;
        }
    }
}
