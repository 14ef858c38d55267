//! Sway of a craft: a smooth random process as a sum of sines.

use crate::shell::support::random::Random;
use crate::shell::support::vectors::sin_cos;

/// A random process of limited bandwidth: a sum of sines, smooth and known at every instant.
#[derive(Debug, Clone)]
pub(in crate::shell) struct Sway {
    waves: [Wave; 6],
}

#[derive(Debug, Clone, Copy)]
struct Wave {
    amplitude: f64,
    /// Angular frequency, radians a second.
    frequency: f64,
    phase: f64,
}

impl Sway {
    /// A process with about this standard deviation between `low` and `high` Hz; slower waves are
    /// stronger.
    pub(in crate::shell) fn new(random: &mut Random, deviation: f64, low: f64, high: f64) -> Self {
        let mut ratio = 0.0;
        let mut power = 0.0;
        let mut waves = [0; 6].map(|_| {
            // One wave in each part of the band, so that no seed leaves a gap.
            let place = ratio + random.within(0.0, 1.0 / 6.0);
            ratio += 1.0 / 6.0;
            let frequency = low + (high - low) * place * place;
            let amplitude = 1.0 / (1.0 + 2.0 * frequency);
            power += amplitude * amplitude / 2.0;
            Wave {
                amplitude,
                frequency: frequency * core::f64::consts::TAU,
                phase: random.within(0.0, core::f64::consts::TAU),
            }
        });
        for wave in &mut waves {
            wave.amplitude *= deviation / power.sqrt();
        }
        Self { waves }
    }

    /// The value at `time`, seconds.
    pub(in crate::shell) fn at(&self, time: f64) -> f64 {
        let wave = |wave: &Wave| wave.amplitude * sin_cos(wave.frequency * time + wave.phase).0;
        self.waves.iter().map(wave).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sway_has_its_deviation() {
        let mut random = Random::stream(3, 0);
        for deviation in [0.01, 2.0] {
            let sway = Sway::new(&mut random, deviation, 0.5, 3.0);
            let samples = 20_000;
            let power: f64 =
                (0..samples).map(|i| sway.at(f64::from(i) * 0.037)).map(|x| x * x).sum();
            let found = (power / f64::from(samples)).sqrt();
            assert!((found / deviation - 1.0).abs() < 0.1, "{found}");
        }
    }
}
