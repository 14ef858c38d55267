//! Whether the detector keeps up with its source, and which size of frames would let it.

use std::format;
use std::string::String;

/// Frames of this long are judged together, microseconds.
const WINDOW_US: i64 = 5_000_000;
/// Frames looked at a second from which on a detector that leaves frames out is quick enough all the same.
const ENOUGH: f64 = 10.0;
/// Share of the time that may be spent on frames: what is left over takes up other work of the machine.
const LOAD: f64 = 0.8;
/// Frames a second above which more say little more.
const WANTED: f64 = 30.0;
/// Sides of the advised size are multiples of this, pixels, and the advice changes by at least as much.
const STEP: f64 = 16.0;
const LEAST: f64 = 10.0;

/// Counts what came and what was looked at.
#[derive(Debug, Default)]
pub struct Pace {
    /// Width and height of the frames, pixels.
    size: (usize, usize),
    since_us: Option<i64>,
    looked: u32,
    busy_us: i64,
    /// Frames left out up to the beginning of the window, and up to now.
    left_out: (u32, u32),
    advice: Option<String>,
}

impl Pace {
    /// A frame of this size that took the detector `busy_us` and was finished at `now_us`; `left_out` frames were, since the
    /// start. Gives the advice where it is new.
    pub fn add(
        &mut self,
        size: (usize, usize),
        busy_us: i64,
        left_out: u32,
        now_us: i64,
    ) -> Option<&str> {
        if self.size != size {
            *self = Self { size, left_out: (left_out, left_out), ..Self::default() };
        }
        let Some(since) = self.since_us else {
            self.since_us = Some(now_us);
            self.left_out.0 = left_out;
            return None;
        };
        self.looked += 1;
        self.busy_us += busy_us.max(0);
        self.left_out.1 = left_out;
        if now_us.saturating_sub(since) < WINDOW_US {
            return None;
        }
        let had = self.advice.take();
        self.advice = self.advise((now_us - since) as f64 / 1e6, had.is_some());
        let new = self.advice.is_some() && had.is_none();
        (self.since_us, self.left_out.0) = (Some(now_us), left_out);
        (self.looked, self.busy_us) = (0, 0);
        if let Some(had) = had
            && self.advice.is_some()
        {
            // The same words as before: figures that change by a little are no news.
            self.advice = Some(had);
        }
        self.advice.as_deref().filter(|_| new)
    }

    /// Advice while the detector is slower than the frames; `None` while it keeps up.
    pub fn advice(&self) -> Option<&str> {
        self.advice.as_deref()
    }

    fn advise(&self, seconds: f64, already: bool) -> Option<String> {
        let looked = f64::from(self.looked) / seconds;
        let left_out = f64::from(self.left_out.1.wrapping_sub(self.left_out.0)) / seconds;
        let coming = looked + left_out;
        // Once said it holds until it is clearly better.
        let slack = if already { 1.3 } else { 1.0 };
        if looked >= ENOUGH * slack || looked >= coming / 2.0 * slack {
            return None;
        }
        let cost = self.busy_us as f64 / 1e6 / f64::from(self.looked.max(1));
        let (width, height) = self.size;
        // The time a frame takes grows with its pixels, or less.
        let scale = (LOAD / coming.min(WANTED) / cost.max(1e-6)).sqrt().min(1.0);
        let side = |pixels: usize| ((pixels as f64 * scale / STEP).floor().max(LEAST)) * STEP;
        let fits = side(width) < width as f64 && side(height) < height as f64;
        let remedy = if fits {
            let (width, height) = (side(width), side(height));
            format!(
                "{width:.0}x{height:.0} would keep up: set camera.width = {width:.0} and camera.height = {height:.0}, or scale \
                 a file or program to it"
            )
        } else {
            String::from("end other programs, or take a faster machine")
        };
        Some(format!(
            "the detector is too slow for these frames: {width}x{height} takes {:.0} ms, {coming:.0} frames come a second and \
             {looked:.1} are looked at; {remedy}",
            cost * 1000.0
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    /// Advice given in `seconds` by a detector that takes `busy` ms a frame, at 30 frames a second.
    fn advice(pace: &mut Pace, size: (usize, usize), busy: i64, seconds: i64) -> Vec<String> {
        let (mut now, mut left_out, mut given) = (0, 0, Vec::new());
        while now < seconds * 1_000_000 {
            now += (busy * 1000).max(33_333);
            left_out += u32::try_from(busy * 30 / 1000).unwrap().saturating_sub(1);
            given.extend(pace.add(size, busy * 1000, left_out, now).map(String::from));
        }
        given
    }

    #[test]
    fn one_plain_advice() {
        let mut pace = Pace::default();
        let given = advice(&mut pace, (4000, 3000), 1900, 120);
        assert_eq!(given.len(), 1, "{given:?}");
        for part in ["4000x3000 takes 1900 ms", "464x352 would keep up", "camera.width = 464"] {
            assert!(given[0].contains(part), "{given:?}");
        }
        assert_eq!(pace.advice(), Some(&*given[0]));
        // The smaller frames are quick enough; the advice goes.
        assert_eq!(advice(&mut pace, (464, 352), 26, 20), [""; 0]);
        assert_eq!(pace.advice(), None);
    }

    #[test]
    fn a_detector_that_leaves_out_some_frames_is_no_fault() {
        // 12 frames a second of 30.
        assert_eq!(advice(&mut Pace::default(), (1280, 720), 83, 60), [""; 0]);
        // Every frame of a slow camera.
        let mut pace = Pace::default();
        let slow = (0..100).filter_map(|i| pace.add((640, 480), 90_000, 0, i * 500_000).map(drop));
        assert_eq!(slow.count(), 0);
    }

    #[test]
    fn nothing_smaller_to_advise() {
        let given = advice(&mut Pace::default(), (160, 160), 400, 20);
        assert!(given[0].contains("faster machine"), "{given:?}");
    }
}
