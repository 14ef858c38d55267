//! Health of the picture: too dark, glare, frozen, blurred.
//!
//! Each reason must last before it counts, and must be gone for as long before it does not. A picture is blurred when it
//! has strong edges and even the steepest of them rise slowly: a night sky or a plain one has none and is not judged.
//!
//! Measured on all development flights (tests/sight.rs): the steepest tenth of the edges rises by 9 to 16 sixteenths
//! within two pixels, by 6 to 8 out of focus by a standard deviation of 2 pixels, 5 to 7 by 3, 4 to 5 by 5.

use crate::mavlink::messages::Blind;
use crate::shell::sources::Frame;
use std::sync::Arc;

/// Pixels below this grey are dark, those from this one on are white.
const DARK: u8 = 20;
const WHITE: u8 = 250;
/// Rows and columns from one sample to the next.
const STEP: usize = 4;
/// Pixels in a thousand that make a picture too dark or a glare, and below which it is well again.
const DARK_SHARE: [u32; 2] = [980, 950];
const WHITE_SHARE: [u32; 2] = [700, 600];
/// Pixels along which an edge is looked for.
const EDGE: usize = 24;
/// Grey levels by which its ends differ at least.
const HEIGHT: u32 = 40;
/// Edges in a thousand places below which sharpness is not assessed.
const EDGES: u32 = 10;
/// Below the first the steepest tenth of the edges makes a picture blurred, from the second on it is sharp again.
const STEEP: [u32; 2] = [7, 8];
/// Time for which a reason must hold, or be absent, microseconds.
const LASTING_US: i64 = 1_000_000;

/// Measurements of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Measures {
    /// Dark pixels in a thousand.
    pub dark: u32,
    /// White pixels in a thousand.
    pub white: u32,
    /// By how many sixteenths of its height the steepest tenth of the edges rises within two pixels; `None` where there
    /// are too few edges.
    pub steep: Option<u32>,
}

impl Measures {
    /// Statistics of the grey levels of `frame`.
    pub fn of(frame: &Frame) -> Self {
        let (mut dark, mut white, mut count) = (0u32, 0u32, 0u32);
        for row in frame.pixels.chunks_exact(frame.width.max(1)).step_by(STEP) {
            for &grey in row.iter().step_by(STEP) {
                dark += u32::from(grey < DARK);
                white += u32::from(grey >= WHITE);
                count += 1;
            }
        }
        let share = |part: u32| part * 1000 / count.max(1);
        Self { dark: share(dark), white: share(white), steep: steepness(frame) }
    }
}

/// See [`Measures::steep`].
fn steepness(frame: &Frame) -> Option<u32> {
    let Frame { width, height, .. } = *frame;
    let mut counts = [0u32; 17];
    let (mut places, mut edges) = (0u32, 0u32);
    // Along rows, then along columns: pixels of a line and from one to the next, lines and from one to the next.
    for ((pixels, along), (lines, across)) in
        [((width, 1), (height, width)), ((height, width), (width, 1))]
    {
        for line in (0..lines).step_by(STEP * 2) {
            for start in (0..pixels.saturating_sub(EDGE)).step_by(STEP * 2) {
                let first = line * across + start * along;
                let pixel = |i: usize| frame.pixels.get(first + i * along).copied();
                let at = |i: usize| u32::from(pixel(i).unwrap_or_default());
                places += 1;
                let (low, high) = (at(0) + at(1), at(EDGE - 2) + at(EDGE - 1));
                let height = low.abs_diff(high);
                if height < HEIGHT * 2 {
                    continue;
                }
                edges += 1;
                let rise = |i: usize| (at(i) + at(i + 1)).abs_diff(at(i + 2) + at(i + 3));
                let steepest = (0..EDGE - 3).map(rise).max().unwrap_or(0);
                if let Some(count) = counts.get_mut((steepest * 16 / height).min(16) as usize) {
                    *count += 1;
                }
            }
        }
    }
    if edges == 0 || edges * 1000 < places * EDGES {
        return None;
    }
    let mut above = 0;
    let steepest = (0..17u32).zip(counts).rev().find(|(_, count)| {
        above += count;
        above * 10 >= edges
    });
    steepest.map(|(steep, _)| steep)
}

/// A reason, and whether it counts.
#[derive(Debug, Clone, Copy, Default)]
struct Reason {
    on: bool,
    /// Since when it is otherwise.
    since_us: Option<i64>,
}

impl Reason {
    /// `bad` is whether it would start to count, `good` whether it would stop.
    fn update(&mut self, bad: bool, good: bool, now_us: i64) -> bool {
        let otherwise = if self.on { good } else { bad };
        if !otherwise {
            self.since_us = None;
        } else if now_us - *self.since_us.get_or_insert(now_us) >= LASTING_US {
            *self = Self { on: !self.on, since_us: None };
        }
        self.on
    }
}

/// Judges frame after frame.
#[derive(Debug, Default)]
pub struct ImageHealth {
    last: Option<Arc<Frame>>,
    reasons: [Reason; 4],
}

impl ImageHealth {
    /// Why nothing can be seen after this frame, if so.
    pub fn assess(&mut self, frame: &Arc<Frame>) -> Blind {
        let measures = Measures::of(frame);
        let same = self.last.as_ref().is_some_and(|last| last.pixels == frame.pixels);
        self.last = Some(frame.clone());
        let steep = measures.steep;
        let states = [
            (Blind::DARK, measures.dark >= DARK_SHARE[0], measures.dark < DARK_SHARE[1]),
            (Blind::GLARE, measures.white >= WHITE_SHARE[0], measures.white < WHITE_SHARE[1]),
            (
                Blind::BLUR,
                steep.is_some_and(|steep| steep < STEEP[0]),
                steep.is_none_or(|steep| steep >= STEEP[1]),
            ),
            (Blind::COVERED, same, !same),
        ];
        let mut blind = Blind::NO;
        for (reason, (name, bad, good)) in self.reasons.iter_mut().zip(states) {
            if reason.update(bad, good, frame.time_us) {
                blind = blind.and(name);
            }
        }
        blind
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    const SECOND: i64 = 1_000_000;

    fn frame(time_us: i64, grey: impl Fn(usize, usize) -> u8) -> Arc<Frame> {
        let mut pixels = vec![0; 160 * 120];
        for (place, pixel) in pixels.iter_mut().enumerate() {
            *pixel = grey(place % 160, place / 160);
        }
        Arc::new(Frame { pixels, width: 160, height: 120, time_us })
    }

    /// Findings for pictures ten times a second whose content depends on the time.
    fn assess(health: &mut ImageHealth, from: i64, grey: impl Fn(usize, usize) -> u8) -> Vec<u8> {
        let picture = |i: i64| {
            let noise = |x: usize, y: usize| ((x * 7 + y * 13 + i as usize * 5) % 3) as u8;
            frame(from + i * SECOND / 10, |x, y| grey(x, y).saturating_add(noise(x, y)))
        };
        (0..30).map(|i| health.assess(&picture(i)).bits()).collect()
    }

    #[test]
    fn a_reason_must_last_and_be_gone_as_long() {
        let mut health = ImageHealth::default();
        let dark = assess(&mut health, 0, |_, _| 3);
        assert_eq!(dark.iter().position(|&bits| bits == 1), Some(10));
        let light = assess(&mut health, 3 * SECOND, |x, _| x as u8);
        assert_eq!(light.iter().position(|&bits| bits == 0), Some(10));
        // A moment is none.
        assess(&mut health, 6 * SECOND, |x, _| x as u8);
        assert_eq!(health.assess(&frame(9 * SECOND, |_, _| 0)), Blind::NO);
        assert!(assess(&mut health, 9 * SECOND + 1, |x, _| x as u8).iter().all(|&bits| bits == 0));
    }

    #[test]
    fn nights_and_plain_skies_are_not_blurred() {
        let stars =
            |x: usize, y: usize| if (x * 31 + y * 17).is_multiple_of(997) { 200 } else { 24 };
        let sky = |_: usize, y: usize| 120 + y as u8 / 2;
        for seen in [
            assess(&mut ImageHealth::default(), 0, stars),
            assess(&mut ImageHealth::default(), 0, sky),
        ] {
            assert!(seen.iter().all(|&bits| bits == 0), "{seen:?}");
        }
        // Steps that are sharp, and the same steps over thirty pixels.
        let sharp = |x: usize, _: usize| if (x / 40).is_multiple_of(2) { 60 } else { 180 };
        let soft = |x: usize, _: usize| 60 + 3 * (x % 80).min(80 - x % 80) as u8;
        assert!(assess(&mut ImageHealth::default(), 0, sharp).iter().all(|&bits| bits == 0));
        assert_eq!(assess(&mut ImageHealth::default(), 0, soft).last(), Some(&4));
    }

    #[test]
    fn the_same_picture_again_and_again_is_frozen() {
        let mut health = ImageHealth::default();
        let still = |i: i64| frame(i * SECOND / 10, |x, y| (x + y) as u8);
        let seen: Vec<u8> = (0..20).map(|i| health.assess(&still(i)).bits()).collect();
        assert_eq!(seen.iter().position(|&bits| bits == 8), Some(11));
    }

    #[test]
    fn any_size_can_be_measured() {
        for (width, height) in [(1, 1), (16, 200), (25, 25), (4, 3)] {
            let frame = Frame { pixels: vec![9; width * height], width, height, time_us: 0 };
            assert_eq!(Measures::of(&frame).dark, 1000);
        }
    }
}
