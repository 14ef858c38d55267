//! Whether anything can be seen in the frames: too dark, glare, frozen, blurred.
//!
//! Each reason must last before it counts, and must be gone for as long before it does not. A picture is blurred when it
//! has strong edges and the steepest of them rise slowly: a night sky or a plain one has none, and tells nothing.
//! Constants were chosen on the recorded flights; a test runs over them.

use crate::message::Blind;
use crate::shell::source::Frame;
use std::sync::Arc;

/// Pixels below this grey are dark, those from this one on are white.
const DARK: u8 = 20;
const WHITE: u8 = 250;
/// Rows and columns from one sample to the next.
const STEP: usize = 4;
/// So many of a thousand pixels make a picture too dark, or a glare; and fewer than this many make it well again.
const DARK_SHARE: [u32; 2] = [980, 950];
const WHITE_SHARE: [u32; 2] = [700, 600];
/// Pixels along which an edge is looked for.
const EDGE: usize = 24;
/// Grey levels by which its ends differ at least.
const HEIGHT: u32 = 40;
/// Fewer edges in a thousand places tell nothing.
const EDGES: u32 = 10;
/// The steepest tenth of the edges rises by this share of its height (of 16) within two pixels; lower is blurred, and
/// this high is sharp again.
const STEEP: [u32; 2] = [5, 6];
/// How long a reason must last, and be gone, microseconds.
const LASTING_US: i64 = 1_000_000;

/// What is measured in one frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Measures {
    /// Of a thousand pixels so many are dark.
    pub dark: u32,
    /// Of a thousand pixels so many are white.
    pub white: u32,
    /// How steep the edges are along rows and along columns, in sixteenths; `None` where there are too few.
    pub steep: [Option<u32>; 2],
}

impl Measures {
    /// Measures a frame.
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
        let Frame { width, height, .. } = *frame;
        let steep = [
            steepness(frame, (width, 1), (height, width)),
            steepness(frame, (height, width), (width, 1)),
        ];
        Self { dark: share(dark), white: share(white), steep }
    }
}

/// The steepness, in sixteenths, that a tenth of the edges reaches along lines of so many pixels that far apart.
fn steepness(frame: &Frame, along: (usize, usize), across: (usize, usize)) -> Option<u32> {
    let mut counts = [0u32; 17];
    let (mut places, mut edges) = (0u32, 0u32);
    for line in (0..across.0).step_by(STEP * 2) {
        for start in (0..along.0.saturating_sub(EDGE)).step_by(STEP * 2) {
            let first = line * across.1 + start * along.1;
            let at = |i: usize| u32::from(frame.pixels[first + i * along.1]);
            places += 1;
            let (low, high) = (at(0) + at(1), at(EDGE - 2) + at(EDGE - 1));
            let height = low.abs_diff(high);
            if height < HEIGHT * 2 {
                continue;
            }
            edges += 1;
            let rise = |i: usize| (at(i) + at(i + 1)).abs_diff(at(i + 2) + at(i + 3));
            let steepest = (0..EDGE - 3).map(rise).max().unwrap_or(0);
            counts[(steepest * 16 / height).min(16) as usize] += 1;
        }
    }
    if edges * 1000 < places * EDGES {
        return None;
    }
    let mut above = 0;
    (0..17u32).rev().find(|&steep| {
        above += counts[steep as usize];
        above * 10 >= edges
    })
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
pub struct Sight {
    last: Option<Arc<Frame>>,
    reasons: [Reason; 4],
}

impl Sight {
    /// Why nothing can be seen after this frame, if so.
    pub fn judge(&mut self, frame: &Arc<Frame>) -> Blind {
        let measures = Measures::of(frame);
        let same = self.last.as_ref().is_some_and(|last| last.pixels == frame.pixels);
        self.last = Some(frame.clone());
        let steep = measures.steep.into_iter().flatten().min();
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
