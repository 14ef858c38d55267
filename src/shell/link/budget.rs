//! Bandwidth of a link: token buckets in bytes a second, which a message uses by its priority.

use crate::mavlink::component::Priority;

/// One second of a rate, filled at that rate.
#[derive(Debug, Clone, Copy)]
struct Bucket {
    /// Bytes times 10^6, as everything here: it is filled by bytes a second times microseconds.
    size: i64,
    left: i64,
}

impl Bucket {
    fn new(bytes_per_second: i64) -> Self {
        let size = bytes_per_second * 1_000_000;
        Self { size, left: size }
    }

    fn fill(&mut self, passed_us: i64) {
        self.left = (self.left + self.size / 1_000_000 * passed_us).min(self.size);
    }

    /// Takes `bytes` if at least `floor` is left then.
    fn take(&mut self, bytes: usize, floor: i64) -> bool {
        let cost = i64::try_from(bytes).unwrap_or(i64::MAX).saturating_mul(1_000_000);
        let after = self.left.saturating_sub(cost);
        let good = after >= floor;
        if good {
            self.left = after;
        }
        good
    }
}

/// Bytes of the largest frame.
const LARGEST: i64 = {
    let bytes = mavlink_core::consts::MAX_FRAME_SIZE;
    assert!(bytes < 1 << 16);
    bytes.cast_signed() as i64
};

/// Bandwidth of one link.
///
/// | priority | bandwidth |
/// | --- | --- |
/// | [`Priority::Urgent`] | the link's rate, and up to a second of it in advance, which the others pay |
/// | [`Priority::Traffic`] | the link's rate |
/// | [`Priority::Status`] | the same, less a quarter of a second kept for traffic |
/// | [`Priority::Answer`] | a quarter of the link's rate in addition: others cannot use it, it cannot use theirs |
#[derive(Debug, Clone, Copy)]
pub struct Budget {
    own: Bucket,
    answers: Bucket,
    last_us: Option<i64>,
}

impl Budget {
    /// A budget of `bytes_per_second` whose token buckets are full.
    pub fn new(bytes_per_second: u32) -> Self {
        let rate = i64::from(bytes_per_second);
        // A single answer has to fit on the slowest link.
        let answers = (rate / 4).max(LARGEST);
        Self { own: Bucket::new(rate), answers: Bucket::new(answers), last_us: None }
    }

    /// Whether `bytes` may be sent at `now_us`, in microseconds; they are counted then.
    pub fn take(&mut self, bytes: usize, now_us: i64, priority: Priority) -> bool {
        let passed = self.last_us.map_or(0, |last| now_us.saturating_sub(last).clamp(0, 2_000_000));
        self.last_us = Some(self.last_us.map_or(now_us, |last| last.max(now_us)));
        self.own.fill(passed);
        self.answers.fill(passed);
        match priority {
            Priority::Urgent => self.own.take(bytes, -self.own.size),
            Priority::Traffic => self.own.take(bytes, 0),
            Priority::Status => self.own.take(bytes, self.own.size / 4),
            Priority::Answer => self.answers.take(bytes, 0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_second_s_worth_and_then_the_rate() {
        let mut budget = Budget::new(2000);
        let mut sent =
            |now_us, priority| (0..1000).filter(|_| budget.take(50, now_us, priority)).count() * 50;
        assert_eq!(sent(0, Priority::Status), 1500, "the rest is for traffic");
        assert_eq!(sent(0, Priority::Traffic), 500);
        assert_eq!(sent(500_000, Priority::Traffic), 1000);
        assert_eq!(sent(500_000, Priority::Urgent), 2000, "warnings go into debt");
        assert_eq!(sent(1_500_000, Priority::Traffic), 0, "which the others pay");
        assert_eq!(sent(2_000_000, Priority::Traffic), 1000);
        assert_eq!(sent(2_000_000, Priority::Answer), 500, "and never for answers");
        assert_eq!(sent(2_000_000, Priority::Answer), 0);
    }

    #[test]
    fn questions_take_nothing_from_reports() {
        let mut budget = Budget::new(2880);
        let mut reports = 0;
        for tick in 0..500i64 {
            for _ in 0..20 {
                budget.take(30, tick * 20_000, Priority::Answer);
            }
            if tick % 25 == 0 {
                reports += usize::from(budget.take(60, tick * 20_000, Priority::Traffic));
            }
        }
        assert_eq!(reports, 20);
    }

    proptest! {
        #[test]
        fn the_rate_holds(
            rate in 1200u32..100_000,
            steps in prop::collection::vec((0i64..100_000, 1usize..280, 0..3usize), 1..200),
        ) {
            let mut budget = Budget::new(rate);
            let (mut now, mut sent) = (0, [0; 3]);
            let kinds = [Priority::Traffic, Priority::Status, Priority::Answer];
            for (step, bytes, kind) in steps {
                now += step;
                if budget.take(bytes, now, kinds[kind]) {
                    sent[kind] += bytes as i64;
                }
            }
            let most = |rate: i64| rate + now * rate / 1_000_000 + 1;
            prop_assert!(sent[0] + sent[1] <= most(rate.into()));
            prop_assert!(sent[2] <= most((i64::from(rate) / 4).max(280)));
        }
    }
}
