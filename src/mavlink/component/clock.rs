//! The autopilot's clock on ours.
//!
//! TIMESYNC gives the offset: the autopilot's time at the middle of a round trip, the quickest trips counting. Without
//! it the offset is that of the message with the shortest delay, too late by that delay.
//! Source: <https://mavlink.io/en/services/timesync.html>.

/// Longest round trip that is used.
const SLOW_US: i64 = 500_000;

/// An offset this far from the one in use is no noise.
const JUMP_US: i64 = 50_000;

/// Number of deviating round trips in a row after which the new offset is taken.
const JUMPS: u8 = 3;

/// A stamp further in the past than this does not belong to this clock.
const PAST_US: i64 = 1_000_000;

/// Time for which the message of least delay is used.
const WINDOW_US: i64 = 10_000_000;

/// Estimated offset between the autopilot's clock and ours.
#[derive(Debug, Clone, Copy, Default)]
pub struct ClockOffset {
    /// Requests that may still be answered: our time in microseconds.
    asked: [Option<i64>; 4],
    asked_at: usize,
    /// Autopilot's time minus ours, from round trips.
    offset_us: Option<i64>,
    trips: u32,
    quickest_us: i64,
    jumps: u8,
    /// Our time minus the autopilot's of the quickest message: in the window before, and in this one.
    arrival_us: [Option<i64>; 2],
    window_us: i64,
}

impl ClockOffset {
    /// Number of round trips that the estimate is made of.
    pub fn trips(&self) -> u32 {
        self.trips
    }

    /// The autopilot's time minus ours, and how wrong it may be, in microseconds; from TIMESYNC.
    pub fn offset_us(&self) -> Option<(i64, i64)> {
        self.offset_us.map(|offset| (offset, self.quickest_us / 2))
    }

    /// Notes that a request was sent at `now_us`.
    pub fn ask(&mut self, now_us: i64) {
        self.asked[self.asked_at] = Some(now_us);
        self.asked_at = (self.asked_at + 1) % self.asked.len();
    }

    /// Takes an answer: the autopilot's time and the time of our request as it was sent, both in nanoseconds. `false`
    /// for an answer to no question of ours.
    pub fn answer(&mut self, theirs_ns: i64, ours_ns: i64, now_us: i64) -> bool {
        let asked = self
            .asked
            .iter_mut()
            .find(|asked| asked.is_some_and(|asked| asked.checked_mul(1000) == Some(ours_ns)));
        let Some(sent) = asked.and_then(Option::take) else { return false };
        let trip = now_us.saturating_sub(sent);
        if !(0..=SLOW_US).contains(&trip) {
            return true;
        }
        let sample = (theirs_ns / 1000).saturating_sub(sent + trip / 2);
        match self.offset_us {
            Some(offset) if sample.saturating_sub(offset).saturating_abs() > JUMP_US => {
                self.jumps += 1;
                if self.jumps >= JUMPS {
                    *self = Self { asked: self.asked, asked_at: self.asked_at, ..Self::default() };
                    self.start(sample, trip);
                }
                return true;
            }
            Some(offset) => {
                // The quickest trip is forgotten slowly, so that a route that became longer is taken in the end.
                self.quickest_us = (self.quickest_us + self.quickest_us / 64 + 10).min(trip);
                if trip <= self.quickest_us + self.quickest_us / 2 + 500 {
                    self.trips = self.trips.saturating_add(1);
                    let share = i64::from(self.trips.min(16));
                    self.offset_us = Some(offset + (sample - offset) / share);
                }
            }
            None => self.start(sample, trip),
        }
        self.jumps = 0;
        true
    }

    fn start(&mut self, sample: i64, trip: i64) {
        self.offset_us = Some(sample);
        self.quickest_us = trip;
        self.trips = 1;
    }

    /// Our time of what the autopilot measured `boot_ms` after its start and we heard at `now_us`; never later than
    /// that.
    pub fn local_us(&mut self, boot_ms: u32, now_us: i64) -> i64 {
        let theirs = i64::from(boot_ms) * 1000;
        let arrival = now_us.saturating_sub(theirs);
        let known = |arrivals: [Option<i64>; 2]| arrivals.into_iter().flatten().min();
        if known(self.arrival_us)
            .is_some_and(|quickest| arrival.saturating_sub(quickest).saturating_abs() > PAST_US)
        {
            self.arrival_us = [None; 2];
        }
        if now_us.saturating_sub(self.window_us).saturating_abs() > WINDOW_US {
            self.arrival_us = [self.arrival_us[1], None];
            self.window_us = now_us;
        }
        let quickest = self.arrival_us[1].map_or(arrival, |quickest| quickest.min(arrival));
        self.arrival_us[1] = Some(quickest);

        let synchronised = self.offset_us.map(|offset| theirs.saturating_sub(offset));
        // The stamp of TIMESYNC may be another clock than that of the messages (time of day instead of time since boot).
        let plausible = now_us.saturating_sub(PAST_US)..=now_us.saturating_add(JUMP_US);
        match synchronised.filter(|time| plausible.contains(time)) {
            Some(time) => time.min(now_us),
            None => theirs.saturating_add(known(self.arrival_us).unwrap_or(arrival)).min(now_us),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Trips of the autopilot's clock, `offset` ahead, with delays of `there` and `back` microseconds.
    fn trip(clock: &mut ClockOffset, now: i64, offset: i64, there: i64, back: i64) {
        clock.ask(now);
        assert!(clock.answer((now + there + offset) * 1000, now * 1000, now + there + back));
    }

    #[test]
    fn slow_trips_do_not_spoil_the_offset() {
        let mut clock = ClockOffset::default();
        let offset = 7_000_000;
        for i in 0..100 {
            let late = if i % 3 == 0 { 0 } else { 8_000 };
            trip(&mut clock, i * 1_000_000, offset, 1_000, 1_000 + late);
        }
        let (found, error) = clock.offset_us().unwrap();
        assert!((found - offset).abs() <= 200, "{found}");
        assert!((500..=2_500).contains(&error), "{error}");
        // Measured 30 ms ago.
        let now = 101_000_000;
        let stamp = ((now + offset - 30_000) / 1000) as u32;
        assert!((clock.local_us(stamp, now) - (now - 30_000)).abs() < 1_200);
    }

    #[test]
    fn a_jump_is_believed_the_third_time() {
        let mut clock = ClockOffset::default();
        trip(&mut clock, 0, 0, 500, 500);
        for i in 1..=3 {
            assert_eq!(clock.offset_us().unwrap().0, 0);
            trip(&mut clock, i * 1_000_000, -60_000_000, 500, 500);
        }
        assert_eq!(clock.offset_us().unwrap().0, -60_000_000);
    }

    #[test]
    fn answers_to_others_are_left_alone() {
        let mut clock = ClockOffset::default();
        clock.ask(5);
        assert!(!clock.answer(1, 6_000, 10));
        assert!(clock.answer(1, 5_000, 10));
        assert!(!clock.answer(1, 5_000, 11), "once only");
    }

    #[test]
    fn without_timesync_the_quickest_message_counts() {
        let mut clock = ClockOffset::default();
        // Delays of 4 to 44 ms; started 100 s before us.
        let mut worst = 0;
        for i in 0..200i64 {
            let measured = i * 20_000;
            let delay = 4_000 + (i * 7 % 40) * 1_000;
            let local = clock.local_us((100_000 + i * 20) as u32, measured + delay);
            if i > 50 {
                worst = worst.max((local - measured).abs());
            }
        }
        assert!(worst <= 4_000, "{worst}");
        // The autopilot starts again.
        assert_eq!(clock.local_us(10, 9_000_000), 9_000_000);
    }

    proptest! {
        #[test]
        fn any_numbers(steps in prop::collection::vec(any::<(i64, i64, u32, bool)>(), 0..50)) {
            let mut clock = ClockOffset::default();
            for (now, theirs, boot, known) in steps {
                clock.ask(now);
                let ours = if known { now.wrapping_mul(1000) } else { theirs };
                clock.answer(theirs, ours, now.saturating_add(1000));
                prop_assert!(clock.local_us(boot, now) <= now);
            }
        }
    }
}
