//! How many bytes a second a link may carry.

/// A token bucket of one second.
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    bytes_per_second: i64,
    /// Bytes times 10^6 that may be sent now; below zero after urgent ones.
    left: i64,
    last_us: Option<i64>,
}

impl Budget {
    /// A full bucket.
    pub fn new(bytes_per_second: u32) -> Self {
        let bytes_per_second = i64::from(bytes_per_second);
        Self { bytes_per_second, left: bytes_per_second * 1_000_000, last_us: None }
    }

    /// Whether `bytes` may be sent at `now_us`. The urgent ones may down to a debt of one second, which the others pay.
    pub fn take(&mut self, bytes: usize, now_us: i64, urgent: bool) -> bool {
        let full = self.bytes_per_second * 1_000_000;
        let passed = self.last_us.map_or(0, |last| now_us.saturating_sub(last).clamp(0, 2_000_000));
        self.last_us = Some(self.last_us.map_or(now_us, |last| last.max(now_us)));
        self.left = (self.left + passed * self.bytes_per_second).min(full);
        let after = self.left - bytes as i64 * 1_000_000;
        let good = after >= if urgent { -full } else { 0 };
        if good {
            self.left = after;
        }
        good
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_second_s_worth_and_then_the_rate() {
        let mut budget = Budget::new(1000);
        let mut sent =
            |now_us, urgent| (0..1000).filter(|_| budget.take(50, now_us, urgent)).count() * 50;
        assert_eq!(sent(0, false), 1000);
        assert_eq!(sent(500_000, false), 500);
        assert_eq!(sent(500_000, true), 1000, "answers and warnings go into debt");
        assert_eq!(sent(1_500_000, false), 0, "which the others pay");
        assert_eq!(sent(2_000_000, false), 500);
    }

    proptest! {
        #[test]
        fn the_rate_holds(rate in 100u32..100_000, steps in prop::collection::vec((0i64..100_000, 1usize..280), 1..200)) {
            let mut budget = Budget::new(rate);
            let (mut now, mut sent) = (0, 0);
            for (step, bytes) in steps {
                now += step;
                if budget.take(bytes, now, false) {
                    sent += bytes as i64;
                }
            }
            prop_assert!(sent <= i64::from(rate) + now * i64::from(rate) / 1_000_000 + 1);
        }
    }
}
