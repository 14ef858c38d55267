//! Vignette, exposure and noise of a camera.

use super::draw::{by_ratio, even};
use super::settings::RenderSettings;
use super::sway::Sway;
use crate::shell::support::random::Random;
use std::vec;
use std::vec::Vec;

/// Values of the noise; a power of two.
const VALUES: usize = 1 << 16;

/// Degradations of a picture between lens and encoder.
#[derive(Debug, Clone)]
pub(super) struct SensorModel {
    /// Factor of each pixel, Q8.
    vignette: Vec<u16>,
    gain: Sway,
    /// Standard deviation 16.
    noise: Vec<i8>,
    /// Noise at mid grey, grey levels.
    deviation: f64,
    seed: u64,
}

impl SensorModel {
    /// Draws a sensor.
    pub(super) fn draw(random: &mut Random, settings: &RenderSettings) -> Self {
        let [width, height] = settings.size;
        let corner = even(random, settings.sensor.vignette);
        let (cx, cy) = (width as i64 / 2, height as i64 / 2);
        let farthest = (cx * cx + cy * cy).max(1);
        let loss = (corner * 256.0) as i64;
        let factor = |i: usize| {
            let (x, y) = ((i % width) as i64 - cx, (i / width) as i64 - cy);
            (256 - loss * (x * x + y * y) / farthest) as u16
        };
        // Sums of four even numbers of the same spread are nearly normal.
        let value = |_| {
            let bits = random.bits();
            let sum: i64 = (0..4).map(|i| ((bits >> (16 * i)) & 0xffff) as i64 - 0x8000).sum();
            (sum * 28 / 0x10000).clamp(-127, 127) as i8
        };
        let noise = (0..VALUES).map(value).collect();
        Self {
            vignette: (0..width * height).map(factor).collect(),
            noise,
            deviation: by_ratio(random, settings.sensor.noise),
            gain: {
                let drift = even(random, settings.sensor.gain_drift);
                Sway::new(random, drift.max(1e-6), 0.05, 0.8)
            },
            seed: random.bits(),
        }
    }

    /// Applies it to the frame at `time`, number `index`.
    pub(super) fn apply(&self, (time, index): (f64, u64), width: usize, pixels: &mut [u8]) {
        let gain = ((1.0 + self.gain.at(time)).clamp(0.5, 1.6) * 256.0) as i32;
        // Shot noise: its variance grows with the light.
        let strength: [i32; 256] = core::array::from_fn(|grey| {
            let share = (0.3 + 0.7 * grey as f64 / 128.0).sqrt();
            (self.deviation * share * 256.0 / 16.0) as i32
        });
        let mut random = Random::stream(self.seed, index);
        let rows = pixels.chunks_exact_mut(width).zip(self.vignette.chunks_exact(width));
        let mut line = vec![0; width];
        for (row, factors) in rows {
            let start = random.below(VALUES - width.min(VALUES - 1));
            for ((value, pixel), factor) in line.iter_mut().zip(row.iter()).zip(factors) {
                *value = (i32::from(*pixel) * i32::from(*factor) * gain) >> 8;
            }
            for ((pixel, value), noise) in row.iter_mut().zip(&line).zip(&self.noise[start..]) {
                let grey = (value >> 8).min(255);
                let noisy = value + i32::from(*noise) * strength[grey as usize];
                *pixel = ((noisy + 128) >> 8).clamp(0, 255) as u8;
            }
        }
    }
}
