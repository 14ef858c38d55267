//! Rates of messages, and the error of the autopilot's clock.

use super::finding::{Finding, Mark};
use crate::mavlink::dialect::TIMESYNC_DATA;
use crate::mavlink::messages::Payload;
use std::collections::VecDeque;
use std::format;
use std::vec::Vec;

/// Microseconds from one request for the autopilot's time to the next.
const INTERVAL_US: i64 = 100_000;
/// Requests that may be answered still.
const OPEN: usize = 20;
/// Microseconds of error up to which a frame's attitude is good: at 100 degrees a second one degree.
const GOOD_US: i64 = 10_000;

/// Rate of a message.
#[derive(Debug, Clone, Copy, Default)]
pub struct MessageRate {
    count: u32,
    first_us: i64,
    last_us: i64,
}

impl MessageRate {
    /// Counts a message received at `now_us`.
    pub fn add(&mut self, now_us: i64) {
        if self.count == 0 {
            self.first_us = now_us;
        }
        self.last_us = now_us;
        self.count += 1;
    }

    /// Times a second, over the time from the first to the last; 0 before the second one.
    pub fn hertz(&self) -> f64 {
        let span = (self.last_us - self.first_us) as f64 / 1e6;
        if self.count < 2 || span <= 0.0 { 0.0 } else { f64::from(self.count - 1) / span }
    }
}

/// The autopilot's time by TIMESYNC: a request bears our time, the answer it and the autopilot's.
/// Source: <https://mavlink.io/en/services/timesync.html>.
#[derive(Debug, Default)]
pub struct Sync {
    due_us: i64,
    open: VecDeque<i64>,
    /// Round trip and offset of every answer, microseconds.
    answers: Vec<(i64, i64)>,
}

impl Sync {
    /// The next message to send, if one is due.
    pub fn poll(&mut self, (system, component): (u8, u8), now_us: i64) -> Option<Payload> {
        if now_us < self.due_us {
            return None;
        }
        self.due_us = now_us + INTERVAL_US;
        if self.open.len() == OPEN {
            self.open.pop_front();
        }
        let ts1 = now_us.saturating_mul(1000);
        self.open.push_back(ts1);
        Some(Payload::new(&TIMESYNC_DATA {
            tc1: 0,
            ts1,
            target_system: system,
            target_component: component,
        }))
    }

    /// Hears an answer; requests, and answers to others, are left alone.
    pub fn receive(&mut self, data: &TIMESYNC_DATA, now_us: i64) {
        if data.tc1 == 0 {
            return;
        }
        let Some(place) = self.open.iter().position(|&ts1| ts1 == data.ts1) else { return };
        self.open.remove(place);
        let sent_us = data.ts1 / 1000;
        let round_trip = now_us.saturating_sub(sent_us).max(0);
        let offset = (data.tc1 / 1000).saturating_sub(sent_us).saturating_sub(round_trip / 2);
        self.answers.push((round_trip, offset));
    }

    /// Offset of the autopilot's clock to ours and how far it can be wrong, microseconds.
    ///
    /// The quickest answer bounds it: half its round trip.
    pub fn offset(&self) -> Option<(i64, i64)> {
        let &(round_trip, offset) = self.answers.iter().min()?;
        Some((offset, round_trip / 2))
    }

    /// Estimate of the autopilot's time.
    pub fn find(&self) -> Finding {
        let Some((_, error)) = self.offset() else {
            let text = "time sync: TIMESYNC is not answered; a frame's attitude is taken by the time of arrival".into();
            return Finding { mark: Mark::Note, text };
        };
        let milliseconds = error as f64 / 1000.0;
        let text = format!(
            "time sync: the autopilot's clock is known to {milliseconds:.1} ms ({} answers)",
            self.answers.len()
        );
        if error <= GOOD_US {
            Finding { mark: Mark::Good, text }
        } else {
            let text = format!(
                "{text}; directions are rough while the vehicle turns, a slow link is in between"
            );
            Finding { mark: Mark::Note, text }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::dialect::MavMessage;

    #[test]
    fn rates() {
        let mut rate = MessageRate::default();
        assert_eq!(rate.hertz(), 0.0);
        for time in 0..=50 {
            rate.add(7_000_000 + time * 20_000);
        }
        assert!((rate.hertz() - 50.0).abs() < 1e-9);
    }

    #[test]
    fn the_quickest_answer_counts() {
        let mut sync = Sync::default();
        let true_offset = 123_456_789;
        let mut now = 5_000_000;
        for (there, back) in [(9_000, 21_000), (2_000, 4_000), (500_000, 1_000)] {
            let request = sync.poll((1, 1), now).unwrap().parse();
            let Some(MavMessage::TIMESYNC(request)) = request else { panic!("{request:?}") };
            assert_eq!((request.tc1, request.target_system), (0, 1));
            let answer = TIMESYNC_DATA { tc1: (now + there + true_offset) * 1000, ..request };
            let foreign = TIMESYNC_DATA { ts1: answer.ts1 + 1, ..answer };
            sync.receive(&foreign, now + 10);
            sync.receive(&request, now + 10);
            sync.receive(&answer, now + there + back);
            // The same answer again is nobody's.
            sync.receive(&answer, now + there + back);
            now += 1_000_000;
        }
        let (offset, error) = sync.offset().unwrap();
        assert_eq!(error, 3_000);
        assert!((offset - true_offset).abs() <= error, "{offset}");
        assert!(sync.find().text.contains("3.0 ms (3 answers)"), "{}", sync.find().text);
    }

    #[test]
    fn requests_do_not_pile_up() {
        let mut sync = Sync::default();
        let sent = (0..3_000_000).step_by(1000).filter(|&now| sync.poll((1, 1), now).is_some());
        assert_eq!(sent.count(), 30);
        assert_eq!(sync.open.len(), OPEN);
        assert_eq!(sync.find().mark, Mark::Note);
    }
}
