//! A target's patch followed into older frames by pyramidal Lucas-Kanade flow.

use crate::image::Image;
use crate::image::pyramid;
use crate::registration::lucas_kanade::{WINDOW, track};
use crate::shell::sources::Frame;
use std::vec;
use std::vec::Vec;

/// Levels of the pyramid, each half of the one before; the first is the frame.
const LEVELS: usize = 6;

/// A frame and smaller copies of it.
#[derive(Debug)]
pub struct FlowPyramid(Vec<Frame>);

impl FlowPyramid {
    /// Of `frame`, whose time is not kept.
    pub fn new(frame: &Frame) -> Self {
        let mut levels = vec![frame.clone()];
        for _ in 1..LEVELS {
            let above = levels[levels.len() - 1].view();
            let mut pixels = vec![0; (above.width() / 2) * (above.height() / 2)];
            let (width, height) = pyramid::halve(above, &mut pixels);
            levels.push(Frame { pixels, width, height, time_us: 0 });
        }
        Self(levels)
    }

    fn level(&self, level: usize) -> Image<'_> {
        self.0[level].view()
    }
}

/// Where the surroundings of `point` in `newer` are in `older`, relative to it; Q8 pixels of the frame. `guess` is
/// where to begin. The window covers half of a target `size` pixels long, or more; the search goes from twice that to
/// it. `None` where it ends nowhere.
pub fn follow(
    newer: &FlowPyramid,
    older: &FlowPyramid,
    point: (i32, i32),
    guess: (i32, i32),
    size: f64,
) -> Option<(i32, i32)> {
    let finest = (size / WINDOW as f64).max(1.0).log2() as usize;
    let finest = finest.min(LEVELS - 2);
    let mut shift = guess;
    let mut found = false;
    for level in [finest + 1, finest] {
        let down = |(x, y): (i32, i32)| (x >> level, y >> level);
        let tracked = track(newer.level(level), older.level(level), down(point), down(shift));
        found = tracked.is_some();
        if let Some((x, y)) = tracked {
            shift = (x << level, y << level);
        }
    }
    found.then_some(shift)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two waves in each direction, `size` pixels long, that have moved by (dx, dy).
    fn frame(size: f64, dx: f64, dy: f64) -> Frame {
        let (width, height) = (320, 240);
        let wave = |v: f64| (v * std::f64::consts::TAU / size).sin();
        let grey = |i: usize| {
            let (x, y) = ((i % width) as f64 - dx, (i / width) as f64 - dy);
            (128.0 + 50.0 * wave(x + 0.3 * y) + 50.0 * wave(y * 1.3 - 0.4 * x)) as u8
        };
        let pixels = (0..width * height).map(grey).collect();
        Frame { pixels, width, height, time_us: 0 }
    }

    #[test]
    fn what_moved_is_followed_at_every_size() {
        for (size, (dx, dy)) in
            [(12.0, (1.5, -2.0)), (24.0, (3.0, 2.0)), (60.0, (-6.0, 5.0)), (90.0, (9.0, 8.0))]
        {
            let (newer, older) = (frame(size, 0.0, 0.0), frame(size, dx, dy));
            let pictures = [newer, older].map(|f| FlowPyramid::new(&f));
            let point = (160 << 8, 120 << 8);
            let (x, y) = follow(&pictures[0], &pictures[1], point, (0, 0), size).unwrap();
            let off = (f64::from(x) / 256.0 - dx).hypot(f64::from(y) / 256.0 - dy);
            assert!(off < 0.02 * size, "{size}: {off}");
        }
        let plain = Frame { pixels: vec![90; 320 * 240], width: 320, height: 240, time_us: 0 };
        let plain = FlowPyramid::new(&plain);
        assert_eq!(follow(&plain, &plain, (160 << 8, 120 << 8), (0, 0), 20.0), None);
    }
}
