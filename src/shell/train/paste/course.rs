//! Course of a pasted object: random encounters.

use crate::shell::support::random::Random;
use core::f64::consts::TAU;

/// A degree in radians.
const DEGREE: f64 = TAU / 360.0;

/// Lengths of objects in pixels, at first: of those that come nearer, of those that go, of the others.
const LENGTHS: [(f64, f64); 3] = [(8.0, 40.0), (18.0, 110.0), (10.0, 110.0)];

/// Motion of an object relative to the camera's position, and its length in the picture.
#[derive(Debug, Clone, Copy)]
pub struct PasteCourse {
    /// Azimuth (right) and elevation (down) at the time 0, radians.
    start: [f64; 2],
    /// Their change in a second.
    rates: [f64; 2],
    /// Size, angular frequency and phase of a swaying of each.
    sway: [[f64; 3]; 2],
    /// Length at the time 0, pixels.
    length: f64,
    /// Change of its distance.
    approach: Approach,
}

#[derive(Debug, Clone, Copy)]
enum Approach {
    /// It stays as far.
    None,
    /// Contact after this many seconds.
    Contact(f64),
    /// Seconds after which it is twice as far away.
    Away(f64),
}

/// Between `low` and `high`, each ratio as likely.
fn ratio(random: &mut Random, (low, high): (f64, f64)) -> f64 {
    low * (high / low).powf(unit(random))
}

/// 0 to 1.
fn unit(random: &mut Random) -> f64 {
    (random.symmetric() + 1.0) / 2.0
}

impl PasteCourse {
    /// A collision course, a crossing, hovering or receding aircraft; seen for a few seconds.
    pub fn draw(random: &mut Random) -> Self {
        let (speeds, lengths, approach) = match random.below(20) {
            0..7 => ([0.3, 0.2], LENGTHS[0], Approach::Contact(6.2 + 5.8 * unit(random))),
            7..12 => {
                let speed = 2.0 + 13.0 * unit(random);
                ([speed, 2.0], LENGTHS[2], Approach::None)
            }
            12..16 => ([0.6, 0.4], LENGTHS[2], Approach::None),
            _ => ([3.0, 1.0], LENGTHS[1], Approach::Away(3.0 + 5.0 * unit(random))),
        };
        let length = ratio(random, lengths);
        let mut rates = speeds.map(|speed| speed * DEGREE * random.symmetric());
        // Who crosses fast keeps the speed: only the side is drawn.
        if speeds[0] > 3.0 {
            rates[0] = speeds[0] * DEGREE * [-1.0, 1.0][random.below(2)];
        }
        let sway = [(); 2].map(|()| {
            let period = 1.0 + 3.0 * unit(random);
            [0.25 * DEGREE * random.symmetric(), TAU / period, TAU * unit(random)]
        });
        Self { start: [0.0; 2], rates, sway, length, approach }
    }

    /// The same, but at azimuth and elevation `at` at the time `time`, seconds.
    pub fn through(self, at: [f64; 2], time: f64) -> Self {
        let there = self.bearing(time);
        let start = [0, 1].map(|i| self.start[i] + at[i] - there[i]);
        Self { start, ..self }
    }

    /// Azimuth and elevation after `time` seconds, radians.
    pub fn bearing(&self, time: f64) -> [f64; 2] {
        [0, 1].map(|i| {
            let [size, frequency, phase] = self.sway[i];
            self.start[i] + self.rates[i] * time + size * (frequency * time + phase).sin()
        })
    }

    /// Length in the picture after `time` seconds, pixels; 0 after contact.
    pub fn length(&self, time: f64) -> f64 {
        let nearness = match self.approach {
            Approach::None => 1.0,
            Approach::Contact(contact) if time < contact => contact / (contact - time),
            Approach::Contact(_) => 0.0,
            Approach::Away(doubled) => 1.0 / (1.0 + time / doubled),
        };
        self.length * nearness
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn courses_go_where_they_are_sent() {
        let mut random = Random::new(5);
        let (mut grew, mut fell, mut fast) = (0, 0, 0);
        for _ in 0..400 {
            let course = PasteCourse::draw(&mut random).through([0.3, -0.1], 2.0);
            let [azimuth, elevation] = course.bearing(2.0);
            assert!((azimuth - 0.3).abs() < 1e-12 && (elevation + 0.1).abs() < 1e-12);
            let lengths = [0.0, 5.0].map(|time| course.length(time));
            assert!(lengths.iter().all(|length| (5.0..220.0).contains(length)), "{course:?}");
            grew += u32::from(lengths[1] > 1.5 * lengths[0]);
            fell += u32::from(lengths[1] < 0.7 * lengths[0]);
            fast +=
                u32::from((course.bearing(4.0)[0] - course.bearing(2.0)[0]).abs() > 4.0 * DEGREE);
        }
        assert!(grew > 90 && fell > 50 && fast > 60, "{grew} {fell} {fast}");
        let contact =
            PasteCourse { approach: Approach::Contact(3.0), ..PasteCourse::draw(&mut random) };
        assert_eq!(contact.length(3.5), 0.0);
    }
}
