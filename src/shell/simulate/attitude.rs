//! How a multirotor sways: the camera's attitude and path as sums of slow waves.

use crate::shell::support::random::Random;
use crate::shell::support::vectors::{Rotation, Vector, sin_cos};

/// A random process of limited bandwidth: a sum of sines, smooth and known at every instant.
#[derive(Debug, Clone)]
pub(super) struct Sway {
    waves: [Wave; 6],
}

#[derive(Debug, Clone, Copy)]
struct Wave {
    amplitude: f64,
    /// Radians a second.
    frequency: f64,
    phase: f64,
}

impl Sway {
    /// A process with about this standard deviation between `low` and `high` Hz; slower waves are
    /// stronger.
    pub(super) fn new(random: &mut Random, deviation: f64, low: f64, high: f64) -> Self {
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
    pub(super) fn at(&self, time: f64) -> f64 {
        let wave = |wave: &Wave| wave.amplitude * sin_cos(wave.frequency * time + wave.phase).0;
        self.waves.iter().map(wave).sum()
    }
}

/// The path and attitude of the camera.
#[derive(Debug, Clone)]
pub(super) struct Camera {
    sway: [Sway; 3],
    shake: [Sway; 3],
    drift: Sway,
    turn: f64,
    pitch: f64,
    /// Metres above the ground at the start.
    pub(super) height: f64,
    /// Metres a second.
    pub(super) velocity: Vector,
}

impl Camera {
    /// A camera that looks about along z, `pitch` radians above the horizon on average.
    pub(super) fn new(random: &mut Random, height: f64, pitch: f64, velocity: Vector) -> Self {
        // From a calm hover to a rough flight.
        let agitation = random.within(0.35, 1.5);
        Self {
            sway: [0.030, 0.022, 0.035]
                .map(|deviation| Sway::new(random, deviation * agitation, 0.08, 1.6)),
            shake: [0.0003, 0.0004, 0.0004]
                .map(|deviation| Sway::new(random, deviation * agitation, 4.0, 11.0)),
            drift: Sway::new(random, 0.3, 0.05, 0.5),
            turn: random.within(-0.01, 0.01),
            pitch,
            height,
            velocity,
        }
    }

    /// Yaw, pitch and roll at `time`, radians.
    pub(super) fn attitude(&self, time: f64) -> [f64; 3] {
        let axis = |axis: usize| self.sway[axis].at(time) + self.shake[axis].at(time);
        // The mean turn ends after some seconds: the target must stay in view.
        let turned = self.turn * time.min(10.0);
        [axis(0) + turned, self.pitch + axis(1), axis(2)]
    }

    /// From camera to world at `time`.
    pub(super) fn rotation(&self, time: f64) -> Rotation {
        let [yaw, pitch, roll] = self.attitude(time);
        Rotation::new(yaw, pitch, roll)
    }

    /// Where it is at `time`, metres; y is minus the height above the ground.
    pub(super) fn position(&self, time: f64) -> Vector {
        let [vx, vy, vz] = self.velocity;
        let drift = self.drift.at(time);
        [vx * time + drift, vy * time - self.height + drift, vz * time]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attitude_is_smooth_and_bounded() {
        for seed in 0..50 {
            let mut random = Random::stream(seed, 0);
            let camera = Camera::new(&mut random, 50.0, -0.1, [0.0, 0.0, 8.0]);
            let mut moved = 0.0;
            for step in 0..3000 {
                let time = f64::from(step) / 100.0;
                let (now, next) = (camera.attitude(time), camera.attitude(time + 0.01));
                for axis in 0..3 {
                    let rate = (next[axis] - now[axis]) / 0.01;
                    assert!(rate.abs() < 1.2, "seed {seed}: {rate} rad/s");
                    moved += rate.abs();
                }
                assert!(now[0].abs() < 0.35 && (now[1] + 0.1).abs() < 0.2 && now[2].abs() < 0.25);
            }
            assert!(moved / 3000.0 > 0.02, "seed {seed} stands still");
        }
    }

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
