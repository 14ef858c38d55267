//! Courses of the camera and the target.

use super::attitude::CameraPath;
use super::shapes::Shape;
use super::{Manoeuvre, SimulateSettings};
use crate::shell::render::Sway;
use crate::shell::support::random::Random;
use crate::shell::support::vectors::{Rotation, WorldVector, add, atan2, direction, dot, sin_cos};
use core::ops::Range;

/// Metres a second that count as flying nearer.
const CLOSING: f64 = 0.05;

/// The other aircraft of a flight.
#[derive(Debug, Clone)]
pub(super) struct OtherAircraft {
    pub(super) shape: Shape,
    /// Wing span, or rotor tip to rotor tip, metres.
    pub(super) span: f64,
    /// Grey level.
    pub(super) tone: f64,
    /// From the camera at time 0, metres in the world.
    start: WorldVector,
    /// Metres a second against the camera.
    velocity: WorldVector,
    hover: Option<[Sway; 3]>,
    heading: f64,
    turn: f64,
    tilt: [Sway; 2],
}

impl OtherAircraft {
    /// From the camera to the target at `time`, metres in the world.
    pub(super) fn place(&self, time: f64) -> WorldVector {
        let mut place = add(self.start, self.velocity, time);
        if let Some(sway) = &self.hover {
            for (along, sway) in place.iter_mut().zip(sway) {
                *along += sway.at(time);
            }
        }
        place
    }

    /// From the target's frame to the world.
    pub(super) fn attitude(&self, time: f64) -> Rotation {
        let [pitch, roll] = [0, 1].map(|axis: usize| self.tilt[axis].at(time));
        Rotation::new(self.heading + self.turn * time, pitch, roll)
    }

    /// Puts the target in this direction at this range, level with the camera.
    #[cfg(test)]
    pub(super) fn aim(&mut self, azimuth: f64, range: f64) {
        self.start = direction(azimuth, 0.0).map(|x| x * range);
    }

    /// Seconds until the camera is reached at the present rate; `None` when it does not come nearer.
    pub(super) fn time_to_contact(&self, time: f64) -> Option<f64> {
        let place = self.place(time);
        let range = dot(place, place).sqrt();
        let later = self.place(time + 0.01);
        let closing = (range - dot(later, later).sqrt()) / 0.01;
        (closing > CLOSING).then(|| range / closing)
    }
}

/// The camera's flight and the target of this `kind`, and how far ahead the trees stand, metres.
pub(super) fn encounter(
    settings: &SimulateSettings,
    focal: f64,
    random: &mut Random,
) -> (CameraPath, Option<OtherAircraft>, f64) {
    let seconds = settings.frames() as f64 / f64::from(settings.fps);
    let speed = random.within(2.0, 9.0);
    let course = random.within(-0.4, 0.4);
    let velocity = [sin_cos(course).0 * speed, 0.0, sin_cos(course).1 * speed];
    // Half of the flights look along the horizon, half down on the ground.
    let (pitch, height) = if random.chance(0.5) {
        (random.within(-0.12, 0.02), random.within(25.0, 80.0))
    } else {
        (random.within(-0.55, -0.2), random.within(30.0, 90.0))
    };
    let camera = CameraPath::new(random, height, pitch, velocity);
    let trees = velocity[2] * seconds + random.within(150.0, 500.0);
    let target = (settings.kind != Manoeuvre::None)
        .then(|| target(settings, focal, seconds, &camera, pitch, random));
    (camera, target, trees)
}

fn target(
    settings: &SimulateSettings,
    focal: f64,
    seconds: f64,
    camera: &CameraPath,
    pitch: f64,
    random: &mut Random,
) -> OtherAircraft {
    let drone = settings.kind == Manoeuvre::Hover || random.chance(0.5);
    let span = if drone { random.within(0.45, 1.1) } else { random.within(1.6, 4.0) };
    // Spans from 10 to 60 px, less in small pictures.
    let largest = f64::min(60.0, settings.height as f64 / 5.0);
    let mut sized = |pixels: Range<f64>| {
        focal * span / random.within(largest * pixels.start, largest * pixels.end)
    };
    let (near, far) = (sized(0.75..1.0), sized(0.2..0.26));
    let middle = sized(0.35..0.7);
    let azimuth = random.within(-0.28, 0.28);
    let down = random.within(-0.2, 0.2) - pitch;
    // Not under the ground, where the target is at its farthest.
    let farthest = if settings.kind == Manoeuvre::Hover { middle } else { far };
    let lowest = (camera.height - 6.0).max(1.0) / farthest;
    let down = down.min(lowest).min(0.7);
    let ahead = direction(azimuth, down);
    let side = if azimuth > 0.0 { -1.0 } else { 1.0 };
    let across = direction(azimuth + side * core::f64::consts::FRAC_PI_2, 0.0);
    let (start, velocity) = match settings.kind {
        Manoeuvre::Collision => (far, -(far - near) / seconds),
        Manoeuvre::Receding => (near, (far - near) / seconds),
        _ => (middle, 0.0),
    };
    let (mut start, mut velocity) = (ahead.map(|x| x * start), ahead.map(|x| x * velocity));
    match settings.kind {
        Manoeuvre::Crossing => {
            let half = direction(side * -0.42, down);
            start = half.map(|x| x * middle);
            let range = middle * random.within(0.8, 1.2);
            let end = direction(side * 0.42, down + random.within(-0.08, 0.08));
            let end = end.map(|x| x * range);
            velocity = add(end, start, -1.0).map(|x| x / seconds);
        }
        Manoeuvre::Receding => velocity = add(velocity, across, 0.05 * far / seconds),
        _ => {}
    }
    let hover = (settings.kind == Manoeuvre::Hover)
        .then(|| [0, 1, 2].map(|_| Sway::new(random, 0.02 * middle, 0.03, 0.4)));
    let flown = add(velocity, camera.velocity, 1.0);
    // An aeroplane points where it flies; a multirotor anywhere.
    let (heading, turn, tilt) = if drone {
        (random.within(0.0, core::f64::consts::TAU), random.within(-0.4, 0.4), 0.12)
    } else {
        (atan2(flown[0], flown[2]), 0.0, 0.05)
    };
    // Dark against the sky; on the ground some are light.
    let light = down > 0.05 && random.chance(0.3);
    let tone = if light { random.within(200.0, 225.0) } else { random.within(28.0, 50.0) };
    OtherAircraft {
        shape: if drone { Shape::multirotor() } else { Shape::aeroplane() },
        span,
        tone,
        start,
        velocity,
        hover,
        heading,
        turn,
        tilt: [0, 1].map(|_| Sway::new(random, tilt, 0.1, 1.0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flights(kind: Manoeuvre) -> impl Iterator<Item = (CameraPath, OtherAircraft)> {
        (0..40).map(move |seed| {
            let settings = SimulateSettings { kind, seed, ..SimulateSettings::default() };
            let (camera, target, trees) = encounter(&settings, 560.0, &mut Random::stream(seed, 0));
            assert!(trees > 100.0);
            (camera, target.unwrap())
        })
    }

    fn bearing(place: WorldVector) -> (f64, f64, f64) {
        let flat = (place[0] * place[0] + place[2] * place[2]).sqrt();
        (atan2(place[0], place[2]), atan2(place[1], flat), dot(place, place).sqrt())
    }

    #[test]
    fn a_collision_keeps_its_bearing_and_ends_soon_after() {
        for (_, target) in flights(Manoeuvre::Collision) {
            let (first, last) = (bearing(target.place(0.0)), bearing(target.place(5.0)));
            assert!((first.0 - last.0).abs() < 1e-9 && (first.1 - last.1).abs() < 1e-9);
            let contact = target.time_to_contact(5.0).unwrap();
            assert!(contact > 0.5 && contact < 3.0, "{contact}");
            assert!((target.time_to_contact(0.0).unwrap() - contact - 5.0).abs() < 1e-6);
        }
    }

    #[test]
    fn kinds_do_what_they_say() {
        for (_, target) in flights(Manoeuvre::Receding) {
            assert_eq!(target.time_to_contact(2.0), None);
        }
        for (_, target) in flights(Manoeuvre::Crossing) {
            let (first, last) = (bearing(target.place(0.0)), bearing(target.place(5.0)));
            assert!((first.0 - last.0).abs() > 0.8);
        }
        for (_, target) in flights(Manoeuvre::Hover) {
            let (first, last) = (bearing(target.place(0.0)), bearing(target.place(5.0)));
            assert!((first.0 - last.0).abs() < 0.2 && (first.2 / last.2 - 1.0).abs() < 0.2);
        }
    }

    #[test]
    fn targets_fly_above_ground_in_size() {
        for kind in
            [Manoeuvre::Collision, Manoeuvre::Receding, Manoeuvre::Crossing, Manoeuvre::Hover]
        {
            for (camera, target) in flights(kind) {
                for time in [0.0, 2.5, 5.0] {
                    let place = target.place(time);
                    assert!(camera.height - place[1] > 1.0, "{kind:?} {place:?}");
                    let pixels = 560.0 * target.span / dot(place, place).sqrt();
                    assert!(pixels > 9.5 && pixels < 70.0, "{kind:?} {pixels}");
                }
            }
        }
    }
}
