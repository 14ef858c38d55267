//! Interval between messages of one kind, and the time to ask for them again.

/// First and longest wait before a message that comes too rarely is asked for again, microseconds: a slow radio link is
/// not to be filled with questions that it cannot answer better.
const FIRST_US: i64 = 5_000_000;
const LONGEST_US: i64 = 60_000_000;

/// A longer time than this between two messages counts as this, microseconds.
const PAUSE_US: i64 = 10_000_000;

/// Of one message.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Cadence {
    /// When it came last.
    pub last_us: Option<i64>,
    /// Time between two, smoothed with weight 1/8.
    interval_us: Option<i64>,
    asked_us: Option<i64>,
    /// Of the questions in a row without a better answer.
    asked: u8,
}

impl Cadence {
    /// Records that the message arrived at `now_us`.
    pub fn heard(&mut self, now_us: i64) {
        if let Some(last) = self.last_us {
            let new = now_us.saturating_sub(last).clamp(0, PAUSE_US);
            self.interval_us = Some(self.interval_us.map_or(new, |old| old + (new - old) / 8));
        }
        self.last_us = Some(now_us);
    }

    /// Whether nothing came for longer than `limit_us`.
    pub fn is_silent(&self, now_us: i64, limit_us: i64) -> bool {
        self.last_us.is_none_or(|last| now_us.saturating_sub(last) > limit_us)
    }

    /// Whether it comes, but on average less often than every `limit_us`.
    pub fn is_slow(&self, limit_us: i64) -> bool {
        self.interval_us.is_some_and(|interval| interval > limit_us)
    }

    /// Whether it was asked for.
    pub fn has_asked(&self) -> bool {
        self.asked_us.is_some()
    }

    /// Whether to ask for it now, where it is `wanted`: at once, after 5 s, 10 s, and so on up to once a minute. Messages at
    /// the wanted interval reset it.
    pub fn ask(&mut self, wanted: bool, now_us: i64) -> bool {
        if !wanted {
            self.asked = 0;
            return false;
        }
        let wait = (FIRST_US << self.asked.saturating_sub(1).min(4)).min(LONGEST_US);
        let ask = self.asked_us.is_none_or(|last| now_us.saturating_sub(last) > wait);
        if ask {
            self.asked_us = Some(now_us);
            self.asked = self.asked.saturating_add(1);
        }
        ask
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn questions_become_rarer() {
        let mut cadence = Cadence::default();
        let asked: std::vec::Vec<i64> =
            (0..200).filter(|second| cadence.ask(true, second * 1_000_000)).collect();
        assert_eq!(asked, [0, 6, 17, 38, 79, 140]);
        assert!(!cadence.ask(false, 141_000_000));
        assert!(cadence.ask(true, 147_000_000), "anew");
    }

    #[test]
    fn slow_and_silent() {
        let mut cadence = Cadence::default();
        assert!(cadence.is_silent(0, 1_000_000) && !cadence.is_slow(1));
        (0..30).for_each(|step| cadence.heard(step * 333_000));
        assert!(cadence.is_slow(125_000) && !cadence.is_slow(400_000));
        assert!(!cadence.is_silent(10_000_000, 1_500_000));
        assert!(cadence.is_silent(12_000_000, 1_500_000));
    }

    proptest::proptest! {
        #[test]
        fn any_times(times: [i64; 8]) {
            let mut cadence = Cadence::default();
            for time in times {
                cadence.heard(time);
                let _ = (cadence.ask(true, time), cadence.is_slow(time), cadence.is_silent(time, time));
            }
        }
    }
}
