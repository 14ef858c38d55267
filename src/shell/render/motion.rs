//! Motion of the camera: attitude, path, exposure and readout at every instant.

use super::draw::{by_ratio, even};
use super::settings::RenderSettings;
use super::sway::Sway;
use crate::shell::support::random::Random;
use crate::shell::support::vectors::{Rotation, WorldVector, dot, sin_cos};

/// Path and attitude of a camera. World: x right, y down, z forward; metres and radians; the origin is where the
/// flight starts.
#[derive(Debug, Clone)]
pub(super) struct CameraMotion {
    sway: [Sway; 3],
    vibration: [Sway; 3],
    /// Rate of the sustained turn, radians a second.
    turn: f64,
    /// Mean pitch, nose up positive, radians.
    pub pitch: f64,
    drift: [Sway; 3],
    /// Mean velocity, metres a second.
    pub velocity: WorldVector,
    /// Height above the ground at the start, metres.
    pub height: f64,
    /// Seconds from the first row to the last.
    pub readout: f64,
    /// Exposure time, seconds.
    pub exposure: f64,
    seconds: f64,
}

impl CameraMotion {
    /// Draws a motion with this mean pitch; `may_turn` allows a sustained turn.
    pub(super) fn draw(
        random: &mut Random,
        settings: &RenderSettings,
        pitch: f64,
        may_turn: bool,
    ) -> Self {
        let motion = &settings.motion;
        let agitation = by_ratio(random, motion.agitation);
        let amplitude = by_ratio(random, motion.vibration);
        let turn = if random.chance(motion.turn_probability) && may_turn {
            let sign = if random.chance(0.5) { 1.0 } else { -1.0 };
            sign * by_ratio(random, motion.turn)
        } else {
            0.01 * random.symmetric()
        };
        let speed =
            if random.chance(motion.hover_probability) { 0.0 } else { even(random, motion.speed) };
        // Forward most often, sideways or backwards sometimes.
        let course =
            if random.chance(0.7) { 0.5 } else { core::f64::consts::PI } * random.symmetric();
        let (sine, cosine) = sin_cos(course);
        let climb = 0.15 * speed * random.symmetric();
        let shake = |random: &mut Random| {
            let [low, high] = motion.vibration_hz;
            let low = random.within(low, high);
            let strength = amplitude * random.within(0.3, 1.0);
            Sway::new(random, strength, low, (low + 6.0).min(high))
        };
        Self {
            sway: [0.030, 0.022, 0.035].map(|d| Sway::new(random, d * agitation, 0.08, 1.6)),
            vibration: [shake(random), shake(random), shake(random)],
            turn,
            pitch,
            drift: [0.25, 0.15, 0.25].map(|d| Sway::new(random, d, 0.05, 0.6)),
            velocity: [speed * sine, climb, speed * cosine],
            height: by_ratio(random, motion.height),
            readout: if random.chance(0.2) { 0.0 } else { even(random, motion.readout) },
            exposure: by_ratio(random, motion.exposure),
            seconds: settings.frames as f64 / f64::from(settings.fps),
        }
    }

    /// Brings the height to at least this, metres.
    pub(super) fn raise(&mut self, least: f64) {
        self.height = self.height.max(least);
    }

    /// Slows the flight down until it travels at most this many metres to each side of its middle.
    pub(super) fn limit_travel(&mut self, most: f64) {
        let travel = dot(self.velocity, self.velocity).sqrt() * self.seconds / 2.0;
        if travel > most {
            self.velocity = self.velocity.map(|v| v * most / travel);
        }
    }

    /// Yaw, pitch and roll at `time`, radians.
    pub(super) fn attitude(&self, time: f64) -> [f64; 3] {
        let axis = |axis: usize| self.sway[axis].at(time) + self.vibration[axis].at(time);
        // The turn is centred on the middle of the flight.
        let turned = self.turn * (time - self.seconds / 2.0);
        [turned + axis(0), self.pitch + axis(1), axis(2)]
    }

    /// From camera to world at `time`.
    pub(super) fn rotation(&self, time: f64) -> Rotation {
        let [yaw, pitch, roll] = self.attitude(time);
        Rotation::new(yaw, pitch, roll)
    }

    /// Position at `time`, metres from the flight's middle.
    pub(super) fn position(&self, time: f64) -> WorldVector {
        let time_of_middle = time - self.seconds / 2.0;
        core::array::from_fn(|i| self.velocity[i] * time_of_middle + self.drift[i].at(time))
    }
}
