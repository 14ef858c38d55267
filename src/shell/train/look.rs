//! Augmentation of recorded frames: mirrored, smaller, of other contrast.

use crate::image::pyramid;
use crate::shell::formats::clips::TruthBox;
use crate::shell::sources::Frame;
use crate::shell::support::random::Random;
use std::vec::Vec;

/// Augmentation of a run of frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Left and right change places.
    mirrored: bool,
    /// Light and dark change places.
    inverted: bool,
    /// Factor of the contrast, Q8.
    gain: i32,
    /// Grey that keeps its place when the contrast changes.
    pivot: i32,
    /// Pixels of the frame to one shown, across and down, Q16; 1 or more.
    steps: (u32, u32),
}

impl Look {
    /// The frames as they are.
    pub const PLAIN: Self =
        Self { mirrored: false, inverted: false, gain: 256, pivot: 128, steps: (65536, 65536) };

    /// A look at random: a third of them plain in all but the mirror.
    pub fn draw(random: &mut Random) -> Self {
        let mut look = Self { mirrored: random.below(2) == 0, ..Self::PLAIN };
        if random.below(3) > 0 {
            look.inverted = random.below(8) == 0;
            look.gain = 140 + random.below(200) as i32;
            look.pivot = 64 + random.below(128) as i32;
            let step = 65536 + if random.below(2) == 0 { random.below(52429) as u32 } else { 0 };
            // Narrower or flatter by up to a third: few shapes stand for many.
            let stretched = step + ((u64::from(step) * random.below(32768) as u64) >> 16) as u32;
            look.steps = [(step, stretched), (stretched, step)][random.below(2)];
        }
        look
    }

    /// Size of a frame of `width` x `height` as shown.
    pub fn size(&self, width: usize, height: usize) -> (usize, usize) {
        (pyramid::resized(width, self.steps.0), pyramid::resized(height, self.steps.1))
    }

    /// Writes `frame` as shown to `shown`.
    pub fn apply(&self, frame: &Frame, shown: &mut Frame) {
        let (width, height) = self.size(frame.width, frame.height);
        shown.pixels.resize(width * height, 0);
        (shown.width, shown.height, shown.time_us) = (width, height, frame.time_us);
        pyramid::resize(frame.view(), self.steps, &mut shown.pixels);
        let tone: Vec<u8> = (0..256)
            .map(|grey| {
                let grey = if self.inverted { 255 - grey } else { grey };
                ((((grey - self.pivot) * self.gain) >> 8) + self.pivot).clamp(0, 255) as u8
            })
            .collect();
        for row in shown.pixels.chunks_exact_mut(width.max(1)) {
            row.iter_mut().for_each(|pixel| *pixel = tone[usize::from(*pixel)]);
            if self.mirrored {
                row.reverse();
            }
        }
    }

    /// A box of a frame `width` pixels wide as shown.
    pub fn truth(&self, truth: &TruthBox, width: usize) -> TruthBox {
        let scale = |step: u32| 65536.0 / f64::from(step);
        let truth = truth.scaled(scale(self.steps.0), scale(self.steps.1));
        // The mirror is that of the shown frame, whose width is rounded down.
        let shown = pyramid::resized(width, self.steps.0) as f64;
        let left = if self.mirrored { shown - truth.left - truth.width } else { truth.left };
        TruthBox { left, ..truth }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shell::formats::class::Class;
    use std::vec;

    #[test]
    fn a_bright_patch_stays_in_its_box() {
        let (width, height) = (90, 60);
        let mut frame = Frame { pixels: vec![20; width * height], width, height, time_us: 7 };
        for y in 30..42 {
            frame.pixels[y * width + 12..y * width + 32].fill(220);
        }
        let truth = TruthBox {
            id: 1,
            left: 12.0,
            top: 30.0,
            width: 20.0,
            height: 12.0,
            class: Class::Drone,
            visibility: 1.0,
        };
        let mut random = Random::new(3);
        for _ in 0..50 {
            let look = Look::draw(&mut random);
            let mut shown = Frame::default();
            look.apply(&frame, &mut shown);
            let shown_truth = look.truth(&truth, width);
            let at = |x: f64, y: f64| shown.pixels[y as usize * shown.width + x as usize];
            let (cx, cy) = (
                shown_truth.left + shown_truth.width / 2.0,
                shown_truth.top + shown_truth.height / 2.0,
            );
            let inside = at(cx, cy);
            let outside = at(cx, shown_truth.top - 3.0);
            assert!(inside.abs_diff(outside) > 60, "{look:?}");
            for edge in [shown_truth.left + 2.0, shown_truth.left + shown_truth.width - 3.0] {
                assert_eq!(at(edge, cy), inside, "{look:?}");
            }
        }
        assert_eq!(Look::PLAIN.truth(&truth, width), truth);
    }
}
