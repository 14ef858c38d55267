//! The vehicle's attitude at the time of a frame (level 2).

use crate::camera::attitude::Attitude;
use crate::math::real::Real;

/// Attitudes kept: 1.3 s at 50 a second.
const KEPT: usize = 64;

/// Longest time between two attitudes that are interpolated, in microseconds.
const GAP: i64 = 250_000;

/// Longest extrapolation beyond the newest attitude, in microseconds.
const BEYOND: i64 = 60_000;

/// An attitude older than the newest by more than this means that the clock was set back, in microseconds.
const SET_BACK: i64 = 1_000_000;

/// The last attitudes, in the order of their times.
///
/// ```
/// use lookout::camera::attitude::Attitude;
/// use lookout::camera::attitude_buffer::Attitudes;
/// use lookout::math::real::{ZERO, ratio};
///
/// let mut attitudes = Attitudes::new();
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
pub struct Attitudes {
    kept: heapless::Vec<(i64, Attitude), KEPT>,
}

impl Attitudes {
    /// An empty buffer.
    pub const fn new() -> Self {
        Self { kept: heapless::Vec::new() }
    }

    /// Inserts the attitude at `time_us`, microseconds on the clock of the frames, in the order of times. One that is a second
    /// older than the newest clears the buffer before: its clock was set back.
    pub fn push(&mut self, time_us: i64, attitude: Attitude) {
        if self.kept.last().is_some_and(|(newest, _)| time_us < newest.saturating_sub(SET_BACK)) {
            self.kept.clear();
        }
        let place = self.kept.partition_point(|(time, _)| *time < time_us);
        if let Some(same) = self.kept.get_mut(place).filter(|(time, _)| *time == time_us) {
            same.1 = attitude;
            return;
        }
        if self.kept.is_full() {
            if place == 0 {
                return;
            }
            self.kept.remove(0);
            // There is room now.
            let _ = self.kept.insert(place - 1, (time_us, attitude));
        } else {
            let _ = self.kept.insert(place, (time_us, attitude));
        }
    }

    /// The attitude at `time_us`: between the two nearest if these are at most 0.25 s apart, at most 0.06 s beyond the
    /// newest; else `None`.
    pub fn at(&self, time_us: i64) -> Option<Attitude> {
        let place = self.kept.partition_point(|(time, _)| *time < time_us);
        if let Some((time, attitude)) = self.kept.get(place)
            && *time == time_us
        {
            return Some(*attitude);
        }
        let newest = self.kept.len().checked_sub(1)?;
        let (before, after) = match place {
            0 => return None,
            _ if place > newest => {
                let (time, attitude) = self.kept[newest];
                if time_us.saturating_sub(time) > BEYOND {
                    return None;
                }
                match newest.checked_sub(1).map(|i| self.kept[i]) {
                    Some(before) if time.saturating_sub(before.0) <= GAP => {
                        (before, (time, attitude))
                    }
                    _ => return Some(attitude),
                }
            }
            _ => (self.kept[place - 1], self.kept[place]),
        };
        let span = after.0.saturating_sub(before.0);
        if span > GAP {
            return None;
        }
        // Both are below a second, and the span is not 0.
        let part = Real::from_num(time_us - before.0) / Real::from_num(span);
        // A newest pair close together would be stretched far.
        let part = part.min(Real::from_num(4));
        Some(before.1.towards(after.1, part))
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

    /// Forgets all, for another clock.
    pub fn clear(&mut self) {
        self.kept.clear();
    }
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
        let mut attitudes = Attitudes::new();
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
    }

    #[test]
    fn a_rare_attitude_is_given_with_its_age() {
        let mut attitudes = Attitudes::new();
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
        let mut attitudes = Attitudes::new();
        (0..20).for_each(|step| attitudes.push(step * 50_000, yaw(0.0)));
        for time in (50_000..1_000_000).step_by(7_000) {
            assert_eq!(attitudes.isolated(time), None, "{time}");
        }
    }

    #[test]
    fn the_oldest_go_first() {
        let mut attitudes = Attitudes::new();
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
            let mut attitudes = Attitudes::new();
            for time in times {
                attitudes.push(time, Attitude::IDENTITY);
                prop_assert!(attitudes.kept.is_sorted_by(|a, b| a.0 < b.0));
                prop_assert!(attitudes.at(time).is_some());
            }
            let _ = (attitudes.at(at), attitudes.isolated(at));
        }
    }
}
