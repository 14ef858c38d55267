//! The vehicle's attitude at the time of a frame.

use crate::camera::attitude::Attitude;
use crate::math::real::{Real, Vector};
use fixed::types::I16F16;

/// Attitudes kept: 1.3 s at 50 a second; 0.4 s on a board, where memory is scarce.
const KEPT: usize = if cfg!(feature = "std") { 64 } else { 20 };

/// Angular velocities kept, likewise.
const RATES: usize = if cfg!(feature = "std") { 64 } else { 8 };

/// Longest time between two attitudes that are interpolated, in microseconds.
const GAP: i64 = 250_000;

/// Longest extrapolation beyond the newest attitude, in microseconds.
const BEYOND: i64 = 60_000;

/// Longest time between two angular velocities over which they are integrated, in microseconds: a multirotor's change
/// within some tenths of a second.
const RATE_GAP: i64 = 150_000;

/// Longest time from an attitude over which angular velocities are integrated, in microseconds: a gyroscope that is off by
/// half a degree a second is off by half a degree then.
const REACH: i64 = 1_000_000;

/// Attitudes over which their rate is taken.
const COUNTED: usize = 8;

/// An attitude older than the newest by more than this means that the clock was set back, in microseconds.
const SET_BACK: i64 = 1_000_000;

/// The last attitudes and angular velocities, in the order of their times.
///
/// ```
/// use lookout::camera::attitude::Attitude;
/// use lookout::camera::attitude_buffer::AttitudeBuffer;
/// use lookout::math::real::{ZERO, ratio};
///
/// let mut attitudes = AttitudeBuffer::new();
/// // Yaw 0 at 0 s and 0.2 rad at 0.1 s.
/// attitudes.push(0, Attitude::from_euler(ZERO, ZERO, ZERO));
/// attitudes.push(100_000, Attitude::from_euler(ZERO, ZERO, ratio(2, 10)));
/// let between = attitudes.at(50_000).unwrap();
/// let wanted = Attitude::from_euler(ZERO, ZERO, ratio(1, 10));
/// assert!(between.angle_to(wanted) < ratio(1, 1000));
/// // Too long after the newest one.
/// assert!(attitudes.at(300_000).is_none());
/// ```
#[derive(Debug, Clone, Default)]
pub struct AttitudeBuffer {
    kept: heapless::Vec<(i64, Attitude), KEPT>,
    /// About the body's axes, radians a second.
    rates: heapless::Vec<(i64, [I16F16; 3]), RATES>,
    /// How long the newest attitude is held beyond [`BEYOND`], in microseconds.
    held: i64,
}

/// Puts `value` where its time belongs; of too many the oldest goes.
fn insert<T, const N: usize>(kept: &mut heapless::Vec<(i64, T), N>, time_us: i64, value: T) {
    if kept.last().is_some_and(|(newest, _)| time_us < newest.saturating_sub(SET_BACK)) {
        kept.clear();
    }
    let mut place = kept.partition_point(|(time, _)| *time < time_us);
    if let Some(same) = kept.get_mut(place).filter(|(time, _)| *time == time_us) {
        same.1 = value;
        return;
    }
    if kept.is_full() {
        if place == 0 {
            return;
        }
        kept.remove(0);
        place -= 1;
    }
    // There is room now.
    let _ = kept.insert(place, (time_us, value));
}

impl AttitudeBuffer {
    /// A buffer without attitudes.
    pub const fn new() -> Self {
        Self { kept: heapless::Vec::new(), rates: heapless::Vec::new(), held: 0 }
    }

    /// A buffer without attitudes, of something that hardly turns, as a stabilised gimbal: the newest attitude is valid for
    /// `age` microseconds.
    pub const fn held_for(age: i64) -> Self {
        let held = age.saturating_sub(BEYOND);
        Self { kept: heapless::Vec::new(), rates: heapless::Vec::new(), held }
    }

    /// Inserts the attitude at `time_us`, microseconds on the clock of the frames, in the order of times. One that is a second
    /// older than the newest clears the buffer before: its clock was set back.
    pub fn push(&mut self, time_us: i64, attitude: Attitude) {
        insert(&mut self.kept, time_us, attitude);
    }

    /// Takes the angular velocity about the body's axes at `time_us`, in radians a second. Exact zeros are left alone: they
    /// come from senders that do not measure it.
    pub fn push_rate(&mut self, time_us: i64, rate: [I16F16; 3]) {
        if rate != [I16F16::ZERO; 3] {
            insert(&mut self.rates, time_us, rate);
        }
    }

    /// The attitude at `time_us`: between the two nearest if these are at most 0.25 s apart; else, where angular velocities
    /// come at least every 0.15 s, from an attitude at most a second away on by these; else at most 0.06 s beyond the newest;
    /// else, for [`AttitudeBuffer::held_for`], what it would be there; else `None`.
    pub fn at(&self, time_us: i64) -> Option<Attitude> {
        let place = self.kept.partition_point(|(time, _)| *time < time_us);
        if let Some((time, attitude)) = self.kept.get(place)
            && *time == time_us
        {
            return Some(*attitude);
        }
        let before = place.checked_sub(1).and_then(|i| self.kept.get(i)).copied();
        let after = self.kept.get(place).copied();
        if let (Some(before), Some(after)) = (before, after)
            && after.0.saturating_sub(before.0) <= GAP
        {
            return Some(between(before, after, time_us));
        }
        let carried = |from: (i64, Attitude)| {
            let far = time_us.saturating_sub(from.0).saturating_abs();
            (far <= REACH)
                .then(|| self.turned(from.0, time_us))
                .flatten()
                .map(|t| from.1.compose(t))
        };
        let from_before = before.and_then(carried);
        match (from_before, after.and_then(carried), before, after) {
            // What the integration is off by at the other end is spread over the way.
            (Some(a), Some(b), Some((start, _)), Some((end, _))) => {
                let part = Real::from_num(time_us - start) / Real::from_num(end - start);
                return Some(a.nlerp(b, part));
            }
            (Some(found), ..) | (None, Some(found), ..) => return Some(found),
            _ => {}
        }
        // Beyond the newest, as before it.
        let newest = before.filter(|_| after.is_none())?;
        let beyond = time_us.saturating_sub(newest.0);
        if beyond > BEYOND.saturating_add(self.held) {
            return None;
        }
        let time_us = newest.0 + beyond.min(BEYOND);
        match place.checked_sub(2).and_then(|i| self.kept.get(i)).copied() {
            Some(earlier) if newest.0.saturating_sub(earlier.0) <= GAP => {
                Some(between(earlier, newest, time_us))
            }
            _ => Some(newest.1),
        }
    }

    /// The turn of the body from one time to another by its angular velocities; `None` where they leave a gap.
    fn turned(&self, from_us: i64, to_us: i64) -> Option<Attitude> {
        if to_us < from_us {
            return self.turned(to_us, from_us).map(Attitude::inverse);
        }
        let first = self.rates.partition_point(|(time, _)| *time <= from_us).saturating_sub(1);
        let rates = self.rates.get(first..)?;
        let (mut turn, mut at) = (Attitude::IDENTITY, from_us);
        for (i, (time, rate)) in rates.iter().enumerate() {
            // Each stands for the time around it, up to half of the way to the next.
            let apart = rates.get(i + 1).map_or(RATE_GAP, |next| next.0.saturating_sub(*time));
            let until = time.saturating_add(apart.min(RATE_GAP) / 2);
            if time.saturating_sub(RATE_GAP / 2) > at {
                return None;
            }
            let end = until.min(to_us);
            if end > at {
                let dt = Real::from_num(end - at) / 1_000_000;
                let angles: Vector = rate.map(|rate| Real::from(rate) * dt);
                turn = turn.compose(Attitude::from_small(angles));
                at = end;
            }
            if at >= to_us {
                return Some(turn);
            }
        }
        None
    }

    /// Time from the nearest attitude to `time_us`, before or after it, in microseconds.
    pub fn nearest_us(&self, time_us: i64) -> Option<i64> {
        let apart = |(time, _): &(i64, Attitude)| time_us.saturating_sub(*time).saturating_abs();
        self.kept.iter().map(apart).min()
    }

    /// Mean time between the last attitudes, in microseconds; `None` before there were two.
    pub fn interval_us(&self) -> Option<i64> {
        let last = self.kept.get(self.kept.len().saturating_sub(COUNTED)..)?;
        let (first, newest) = (last.first()?.0, last.last()?.0);
        newest.saturating_sub(first).checked_div(i64::try_from(last.len()).ok()? - 1)
    }

    /// The nearest attitude within 0.06 s of `time_us` and its age there (negative where it is later), where no other one is
    /// near enough to interpolate with: attitudes come a few times a second only. Else `None`, and before there were two.
    pub fn isolated(&self, time_us: i64) -> Option<(i64, Attitude)> {
        let place = self.kept.partition_point(|(time, _)| *time <= time_us);
        let before = self.kept[place.checked_sub(1)?];
        let after = self.kept.get(place).copied();
        let apart = match after {
            Some((after, _)) => after.saturating_sub(before.0),
            None => before.0.saturating_sub(self.kept[place.checked_sub(2)?].0),
        };
        let age = |(time, attitude): (i64, Attitude)| (time_us.saturating_sub(time), attitude);
        let ages = [Some(before), after].into_iter().flatten().map(age);
        let nearest = ages.min_by_key(|(age, _)| age.saturating_abs())?;
        (apart > GAP && nearest.0.saturating_abs() <= BEYOND).then_some(nearest)
    }

    /// The time of the newest attitude that is not later than `time_us`.
    pub fn last_before(&self, time_us: i64) -> Option<i64> {
        let place = self.kept.partition_point(|(time, _)| *time <= time_us);
        Some(self.kept[place.checked_sub(1)?].0)
    }

    /// Removes all attitudes, as when the clock changes.
    pub fn clear(&mut self) {
        self.kept.clear();
        self.rates.clear();
    }
}

/// Between two attitudes by the time, or on beyond the later one, at most four times as far.
fn between(before: (i64, Attitude), after: (i64, Attitude), time_us: i64) -> Attitude {
    // Both are below a second, and the span is not 0.
    let span = after.0.saturating_sub(before.0);
    let part = Real::from_num(time_us - before.0) / Real::from_num(span);
    // A newest pair close together would be stretched far.
    before.1.nlerp(after.1, part.min(Real::from_num(4)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn yaw(angle: f64) -> Attitude {
        Attitude::from_euler(Real::ZERO, Real::ZERO, Real::from_num(angle))
    }

    fn close(a: Option<Attitude>, angle: f64) -> bool {
        a.is_some_and(|a| a.angle_to(yaw(angle)) < Real::from_num(1e-3))
    }

    #[test]
    fn between_beyond_and_too_old() {
        let mut attitudes = AttitudeBuffer::new();
        assert_eq!(attitudes.at(0), None);
        // Out of order: 0.1 rad/s at 20 a second.
        for step in [0, 2, 1, 4, 3] {
            attitudes.push(step * 50_000, yaw(0.005 * step as f64));
        }
        assert!(close(attitudes.at(75_000), 0.0075));
        assert!(close(attitudes.at(200_000), 0.02));
        assert!(close(attitudes.at(250_000), 0.025));
        assert_eq!(attitudes.at(270_000), None);
        assert_eq!(attitudes.at(-1), None);
        for (time, before) in
            [(-1, None), (0, Some(0)), (99_999, Some(50_000)), (270_000, Some(200_000))]
        {
            assert_eq!(attitudes.last_before(time), before, "{time}");
        }
        // A gap.
        attitudes.push(600_000, yaw(1.0));
        assert_eq!(attitudes.at(400_000), None);
        assert!(close(attitudes.at(610_000), 1.0));
        // The clock is set back.
        attitudes.push(-5_000_000, yaw(0.3));
        assert_eq!(attitudes.at(600_000), None);
        assert!(close(attitudes.at(-5_000_000), 0.3));
        // Foretold for 0.06 s, then held.
        let mut held = AttitudeBuffer::held_for(300_000);
        (0..3).for_each(|step| held.push(step * 100_000, yaw(0.1 * step as f64)));
        for (time, angle) in [(250_000, 0.25), (260_000, 0.26), (400_000, 0.26), (500_000, 0.26)] {
            assert!(close(held.at(time), angle), "{time}");
        }
        assert_eq!(held.at(500_001), None);
    }

    #[test]
    fn a_rare_attitude_is_given_with_its_age() {
        let mut attitudes = AttitudeBuffer::new();
        assert_eq!(attitudes.isolated(0), None);
        for step in 0..3 {
            attitudes.push(step * 333_000, yaw(0.1 * step as f64));
        }
        for (time, wanted) in [
            (333_000, Some((0, 0.1))),
            (350_000, Some((17_000, 0.1))),
            (320_000, Some((-13_000, 0.1))),
            (450_000, None),
            (700_000, Some((34_000, 0.2))),
            (740_000, None),
            (-20_000, None),
        ] {
            let found = attitudes.isolated(time);
            assert_eq!(found.map(|(age, _)| age), wanted.map(|(age, _)| age), "{time}");
            assert!(wanted.is_none_or(|(_, angle)| close(found.map(|(_, a)| a), angle)), "{time}");
        }
        // At the usual rate there is always a neighbour.
        let mut attitudes = AttitudeBuffer::new();
        (0..20).for_each(|step| attitudes.push(step * 50_000, yaw(0.0)));
        for time in (50_000..1_000_000).step_by(7_000) {
            assert_eq!(attitudes.isolated(time), None, "{time}");
        }
    }

    #[test]
    fn angular_velocities_carry_rare_attitudes() {
        // Yaw swings by 0.5 rad, 0.7 times a second; attitudes 2, velocities 20 a second.
        let angle = |us: i64| 0.5 * (us as f64 * 1e-6 * 4.4).sin();
        let speed = |us: i64| 0.5 * 4.4 * (us as f64 * 1e-6 * 4.4).cos();
        let rate = |us: i64| [0.0, 0.0, speed(us)].map(I16F16::from_num);
        let error = |attitudes: &AttitudeBuffer, us| {
            attitudes.at(us).map(|a| a.angle_to(yaw(angle(us))).to_num::<f64>())
        };
        let mut attitudes = AttitudeBuffer::new();
        for step in 0..=40 {
            let now = step * 50_000;
            attitudes.push_rate(now, rate(now));
            if step % 10 == 0 {
                attitudes.push(now, yaw(angle(now)));
            }
            // A live frame: the newest attitude is up to half a second old.
            if step > 0 {
                let error = error(&attitudes, now - 10_000).expect("carried");
                assert!(error < 0.02, "{now}: {error}");
            }
        }
        // Between two attitudes half a second apart.
        for us in (0..2_000_000).step_by(17_000) {
            assert!(error(&attitudes, us).is_some_and(|error| error < 0.01), "{us}");
        }
        assert_eq!(attitudes.at(2_200_000), None, "beyond the velocities");
        // Without them, and where they are as rare as the attitudes, there is nothing in between.
        let mut rare = AttitudeBuffer::new();
        for step in 0..4 {
            let now = step * 500_000;
            rare.push(now, yaw(angle(now)));
            rare.push_rate(now, rate(now));
        }
        assert_eq!(rare.at(750_000), None);
        // Zeros are no measurement.
        let mut zeros = AttitudeBuffer::new();
        (0..40).for_each(|step| zeros.push_rate(step * 50_000, [I16F16::ZERO; 3]));
        zeros.push(0, yaw(0.0));
        assert_eq!(zeros.at(500_000), None);
    }

    #[test]
    fn how_often_attitudes_come() {
        let mut attitudes = AttitudeBuffer::new();
        assert_eq!(attitudes.interval_us(), None);
        (0..30).for_each(|step| attitudes.push(step * 20_000, yaw(0.0)));
        assert_eq!(attitudes.interval_us(), Some(20_000));
        (1..9).for_each(|step| attitudes.push(600_000 + step * 500_000, yaw(0.0)));
        assert_eq!(attitudes.interval_us(), Some(500_000));
    }

    #[test]
    fn the_oldest_go_first() {
        let mut attitudes = AttitudeBuffer::new();
        for step in 0..200 {
            attitudes.push(step * 10_000, yaw(0.0));
        }
        assert_eq!(attitudes.kept.len(), KEPT);
        assert!(attitudes.at(1_990_000).is_some() && attitudes.at(1_000_000).is_none());
        attitudes.push(1_200_000, yaw(0.0));
        assert_eq!(attitudes.kept.len(), KEPT);
    }

    proptest! {
        #[test]
        fn no_times_panic(times in proptest::collection::vec(any::<i64>(), 0..100), at: i64) {
            let mut attitudes = AttitudeBuffer::new();
            for time in times {
                attitudes.push(time, Attitude::IDENTITY);
                attitudes.push_rate(time, [I16F16::MAX, I16F16::MIN, I16F16::from_bits(time as i32 | 1)]);
                prop_assert!(attitudes.kept.is_sorted_by(|a, b| a.0 < b.0));
                prop_assert!(attitudes.at(time).is_some());
            }
            let _ = (attitudes.at(at), attitudes.isolated(at), attitudes.interval_us());
        }
    }
}
