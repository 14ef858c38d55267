//! Sway of a multirotor: the camera's attitude and path as sums of slow waves.

use crate::shell::render::Sway;
use crate::shell::support::random::Random;
use crate::shell::support::vectors::{Rotation, WorldVector};

/// The path and attitude of the camera.
#[derive(Debug, Clone)]
pub(super) struct CameraPath {
    sway: [Sway; 3],
    shake: [Sway; 3],
    drift: Sway,
    turn: f64,
    pitch: f64,
    /// Metres above the ground at the start.
    pub(super) height: f64,
    /// Velocity in metres a second.
    pub(super) velocity: WorldVector,
}

impl CameraPath {
    /// A camera that looks about along z, `pitch` radians above the horizon on average.
    pub(super) fn new(random: &mut Random, height: f64, pitch: f64, velocity: WorldVector) -> Self {
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
    pub(super) fn position(&self, time: f64) -> WorldVector {
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
            let camera = CameraPath::new(&mut random, 50.0, -0.1, [0.0, 0.0, 8.0]);
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
}
