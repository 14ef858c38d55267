//! Steady times for a log whose clock was set, or went back, while it was written.
//!
//! A step backwards, or forwards by more than a minute, is checked against the vehicle's own time since boot, which most
//! of its messages hold: where that went on by another amount the clock was set, and later times are shifted so that they
//! follow on.

use mavlink_core::MAVLinkMessageRaw;
use std::collections::VecDeque;

/// A step back within this is reordering, microseconds.
const REORDERED_US: i64 = 1_000_000;
/// A step ahead within this is not checked, microseconds.
const SILENCE_US: i64 = 60_000_000;
/// The two clocks may differ by this over a step, microseconds.
const TOLERANCE_US: i64 = 2_000_000;
/// Messages that are searched for a time since boot after a step.
const LOOK_AHEAD: usize = 200;
/// A step ahead of this that no time since boot explains is that of a clock: a day, microseconds.
const DAY_US: i64 = 86_400_000_000;

/// Number of a message with a time since boot, and the place of its milliseconds in the payload.
const BOOT_TIMES: [(u32, usize); 4] = [(2, 8), (30, 0), (31, 0), (33, 0)];

/// Time since boot that a message holds: system id and milliseconds.
fn boot_ms(frame: &MAVLinkMessageRaw) -> Option<(u32, i64)> {
    let (_, at) = BOOT_TIMES.into_iter().find(|(id, _)| *id == frame.message_id())?;
    let payload = frame.payload();
    let bytes: [u8; 4] = core::array::from_fn(|i| payload.get(at + i).copied().unwrap_or_default());
    Some((frame.system_id(), u32::from_le_bytes(bytes).into()))
}

/// Steady times for messages with the times of their receipt, microseconds. Errors pass.
pub struct Timeline<I, E> {
    input: I,
    /// Messages read ahead of their time.
    waiting: VecDeque<Result<(i64, MAVLinkMessageRaw), E>>,
    /// Time of the last message as it was logged.
    last_us: Option<i64>,
    /// Last time since boot: system, milliseconds, logged time.
    boot: Option<(u32, i64, i64)>,
    /// Added to logged times.
    shift_us: i64,
    /// Steps of the clock that were taken out.
    steps: u32,
}

impl<I, E> Timeline<I, E>
where
    I: Iterator<Item = Result<(i64, MAVLinkMessageRaw), E>>,
{
    /// Times of `input` from its first message on.
    pub fn new(input: I) -> Self {
        Self { input, waiting: VecDeque::new(), last_us: None, boot: None, shift_us: 0, steps: 0 }
    }

    fn take(&mut self) -> Option<Result<(i64, MAVLinkMessageRaw), E>> {
        self.waiting.pop_front().or_else(|| self.input.next())
    }

    /// By how much the clock was set between the last message and one at `time_us`, microseconds.
    fn clock_step(&mut self, time_us: i64, frame: &MAVLinkMessageRaw) -> i64 {
        let Some(last_us) = self.last_us else { return 0 };
        let step = time_us.saturating_sub(last_us);
        if (-REORDERED_US..=SILENCE_US).contains(&step) {
            return 0;
        }
        let unexplained = if (0..DAY_US).contains(&step) { 0 } else { step };
        let Some((system, before_ms, before_us)) = self.boot else { return unexplained };
        let of_system = |frame: &MAVLinkMessageRaw| {
            boot_ms(frame).filter(|(from, _)| *from == system).map(|(_, ms)| ms)
        };
        let mut found = of_system(frame).map(|ms| (time_us, ms));
        for at in 0..LOOK_AHEAD {
            if found.is_some() {
                break;
            }
            if at >= self.waiting.len() {
                let Some(next) = self.input.next() else { break };
                self.waiting.push_back(next);
            }
            if let Some(Ok((later_us, later))) = self.waiting.get(at) {
                found = of_system(later).map(|ms| (*later_us, ms));
            }
        }
        match found {
            Some((at_us, ms)) if ms >= before_ms => {
                let wrong = at_us.saturating_sub(before_us).saturating_sub((ms - before_ms) * 1000);
                if wrong.saturating_abs() > TOLERANCE_US { wrong } else { 0 }
            }
            // Started anew: its clock says nothing of this step.
            _ => unexplained,
        }
    }
}

impl<I, E> Iterator for Timeline<I, E>
where
    I: Iterator<Item = Result<(i64, MAVLinkMessageRaw), E>>,
{
    type Item = Result<(i64, MAVLinkMessageRaw), E>;

    fn next(&mut self) -> Option<Self::Item> {
        let (time_us, frame) = match self.take()? {
            Ok(message) => message,
            Err(error) => return Some(Err(error)),
        };
        let wrong = self.clock_step(time_us, &frame);
        if wrong != 0 {
            self.shift_us = self.shift_us.saturating_sub(wrong);
            self.steps = self.steps.saturating_add(1);
            let seconds = wrong as f64 / 1e6;
            tracing::warn!(
                "the log's clock was set by {seconds:+.1} s; times after that are shifted to follow on"
            );
        }
        self.last_us = Some(time_us);
        if let Some((system, ms)) = boot_ms(&frame)
            && self.boot.is_none_or(|(known, ..)| known == system)
        {
            self.boot = Some((system, ms, time_us));
        }
        Some(Ok((time_us.saturating_add(self.shift_us), frame)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mavlink::dialect::{ATTITUDE_DATA, HEARTBEAT_DATA};
    use crate::mavlink::messages::Payload;
    use core::convert::Infallible;
    use std::vec::Vec;

    const START: i64 = 1_767_225_600_000_000;

    fn message(ms: Option<u32>) -> MAVLinkMessageRaw {
        let payload = match ms {
            Some(time_boot_ms) => {
                Payload::new(&ATTITUDE_DATA { time_boot_ms, ..ATTITUDE_DATA::default() })
            }
            None => Payload::new(&HEARTBEAT_DATA::default()),
        };
        MAVLinkMessageRaw::V2(payload.frame(1, 1, 0, false))
    }

    fn steady(messages: &[(i64, Option<u32>)]) -> Vec<i64> {
        let input = messages.iter().map(|&(us, ms)| Ok::<_, Infallible>((us, message(ms))));
        Timeline::new(input).map(|message| message.unwrap().0).collect()
    }

    /// Twelve messages, 0.5 s apart; the clock is set after the fourth.
    fn set_by(step_us: i64, with_boot: bool) -> Vec<(i64, Option<u32>)> {
        (0..12)
            .map(|i| {
                let step = if i >= 4 { step_us } else { 0 };
                let ms = (with_boot && i % 3 != 1).then_some(5000 + i as u32 * 500);
                (START + i * 500_000 + step, ms)
            })
            .collect()
    }

    #[test]
    fn a_clock_that_was_set_keeps_the_rest() {
        let want: Vec<i64> = (0..12).map(|i| START + i * 500_000).collect();
        for step in [-START + 100, -3_600_000_000, 3_600_000_000, 90_000_000, 400 * DAY_US] {
            assert_eq!(steady(&set_by(step, true)), want, "{step}");
        }
        // Without a time since boot the step itself is lost, no more.
        for step in [-3_600_000_000, 400 * DAY_US] {
            let times = steady(&set_by(step, false));
            assert_eq!(times[..4], want[..4]);
            assert!(times.is_sorted() && times[11] == want[11] - 500_000, "{times:?}");
        }
    }

    #[test]
    fn times_of_any_size_are_no_overflow() {
        let wild = [i64::MAX, i64::MIN, 0, i64::MAX, -1, i64::MIN, i64::MIN, START];
        for ms in [None, Some(0), Some(u32::MAX)] {
            assert_eq!(steady(&wild.map(|us| (us, ms))).len(), wild.len());
        }
    }

    #[test]
    fn silence_is_no_step_of_the_clock() {
        let gap: Vec<_> = (0..10)
            .map(|i| {
                let pause = if i >= 5 { 600_000_000 } else { 0 };
                (START + i * 100_000 + pause, Some(((i * 100_000 + pause) / 1000) as u32))
            })
            .collect();
        assert_eq!(steady(&gap), gap.iter().map(|m| m.0).collect::<Vec<_>>());
        let reordered = [(START + 500_000, Some(500)), (START, Some(0)), (START + 900_000, None)];
        assert_eq!(steady(&reordered), reordered.map(|m| m.0));
    }
}
