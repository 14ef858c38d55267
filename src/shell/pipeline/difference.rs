//! Differences between stabilised frames as a detector: pixels that change once the camera's motion is removed; nothing is
//! learned.
//!
//! Two older frames are warped to the newest one. A pixel that differs from both shows the object where it is now (the place
//! that it left differs from one of them only: three-frame differencing). Pixels above the frame's own noise make blobs; a
//! blob's score is how far its mean lies above that noise, and a little how large it is, as a logarithm.
//!
//! The constants are the best of a dozen settings on 20 clips of `airborne/train`.

use crate::detector::{Detection, Detections, Error, MAX_DETECTIONS};
use crate::image::nms;
use crate::image::{Image, Rect};
use crate::registration::warp;
use crate::registration::{GlobalMotion, Registration, buffer_len};
use fixed::types::I28F4;
use std::collections::VecDeque;
use std::vec;
use std::vec::Vec;

/// Frames back to which differences are taken.
const LAGS: [usize; 2] = [5, 10];

/// Least difference of a pixel of a blob, in grey levels.
const LEAST: u32 = 6;

/// Least difference of a pixel, in multiples of the frame's mean difference.
const TIMES_NOISE: u32 = 6;

/// Largest distance between neighbouring pixels of a blob.
const GAP: usize = 4;

/// Exponent of a blob's size in pixels in its score. 1/2 would be standard errors of independent pixels, which
/// lets large patches of wood and field win.
const SIZE_POWER: f64 = 0.2;

/// Least pixels of a blob.
const FEWEST: u32 = 4;

/// Longest side of a blob, in pixels: that of the largest target.
const LONGEST: usize = 240;

/// Overlap (IoU, Q8) above which the weaker of two boxes goes.
const OVERLAP: u8 = 64;

/// Most blobs of a frame that are compared.
const MOST: usize = 512;

/// Finds what moves against the background.
#[derive(Debug)]
pub struct DifferenceDetector {
    width: usize,
    height: usize,
    threshold: i32,
    registration: Registration<Vec<u8>>,
    /// Older frames and the motion from the frame after each to it, newest first.
    older: VecDeque<(Vec<u8>, GlobalMotion)>,
    warped: Vec<u8>,
    difference: Vec<u8>,
    least: Vec<u8>,
}

/// A blob under way.
#[derive(Debug, Clone, Copy)]
struct Blob {
    left: usize,
    top: usize,
    right: usize,
    bottom: usize,
    pixels: u32,
    sum: u64,
}

impl DifferenceDetector {
    /// For frames of `width` x `height`; detections below `threshold` are not reported (units of
    /// [`Detection::score`]; all without one).
    #[allow(clippy::expect_used, reason = "the buffer has the length needed")]
    pub fn new(width: usize, height: usize, threshold: Option<i32>) -> Self {
        let pixels = width * height;
        let buffer = vec![0; buffer_len(width, height)];
        let registration =
            Registration::new(width, height, buffer).expect("the buffer has the length needed");
        Self {
            width,
            height,
            threshold: threshold.unwrap_or(i32::MIN),
            registration,
            older: VecDeque::new(),
            warped: vec![0; pixels],
            difference: vec![0; pixels],
            least: vec![0; pixels],
        }
    }

    /// Looks at one frame.
    ///
    /// # Errors
    /// [`Error::FrameSize`] when the frame has another size.
    pub fn process(&mut self, frame: Image<'_>) -> Result<Detections, Error> {
        let motion = self.registration.register(frame)?;
        if let Some((_, newest)) = self.older.front_mut() {
            *newest = motion;
        }
        let mut found = Detections { registered: motion.is_valid(), ..Detections::default() };
        if self.older.len() >= LAGS[1] {
            self.differences(frame);
            self.blobs(&mut found);
            self.older.truncate(LAGS[1] - 1);
        }
        let pixels = (0..frame.height()).flat_map(|y| frame.row(y)).copied().collect();
        self.older.push_front((pixels, GlobalMotion::IDENTITY));
        Ok(found)
    }

    /// The least of the differences to the older frames.
    #[allow(clippy::expect_used, reason = "frames are kept whole")]
    fn differences(&mut self, frame: Image<'_>) {
        let motions: Vec<GlobalMotion> = self.older.iter().map(|(_, motion)| *motion).collect();
        self.least.fill(u8::MAX);
        for lag in LAGS {
            let older = Image::packed(&self.older[lag - 1].0, self.width, self.height)
                .expect("frames are kept whole");
            warp::warp(older, frame, 0, &motions[..lag], true, &mut self.warped);
            warp::temporal_difference(frame, &self.warped, true, &mut self.difference);
            for (least, difference) in self.least.iter_mut().zip(&self.difference) {
                *least = (*least).min(*difference);
            }
        }
    }

    /// Blobs of pixels above the noise.
    fn blobs(&mut self, found: &mut Detections) {
        let (width, height) = (self.width, self.height);
        let sum: u64 = self.least.iter().map(|&d| u64::from(d)).sum();
        let count = (width * height).max(1) as f64;
        let mean = sum as f64 / count;
        let spread = self.least.iter().map(|&d| (f64::from(d) - mean).powi(2)).sum::<f64>();
        // Neither less than what a camera's noise and compression leave.
        let spread = (spread / count).sqrt().max(1.0);
        let threshold = LEAST.max((mean * f64::from(TIMES_NOISE)) as u32).min(255) as u8;
        let mut boxes: heapless::Vec<(Rect, i32), MOST> = heapless::Vec::new();
        let mut blobs = Vec::new();
        let mut stack = Vec::new();
        for start in 0..width * height {
            if self.least[start] < threshold {
                continue;
            }
            let mut blob =
                Blob { left: width, top: height, right: 0, bottom: 0, pixels: 0, sum: 0 };
            stack.push(start);
            while let Some(at) = stack.pop() {
                // A pixel that was counted is 0.
                let value = std::mem::take(&mut self.least[at]);
                if value < threshold {
                    continue;
                }
                let (x, y) = (at % width, at / width);
                blob.left = blob.left.min(x);
                blob.top = blob.top.min(y);
                blob.right = blob.right.max(x + 1);
                blob.bottom = blob.bottom.max(y + 1);
                blob.pixels += 1;
                blob.sum += u64::from(value);
                for row in y.saturating_sub(GAP)..(y + GAP + 1).min(height) {
                    for column in x.saturating_sub(GAP)..(x + GAP + 1).min(width) {
                        let near = row * width + column;
                        if self.least[near] >= threshold {
                            stack.push(near);
                        }
                    }
                }
            }
            let longest = (blob.right - blob.left).max(blob.bottom - blob.top);
            if blob.pixels >= FEWEST && longest <= LONGEST {
                let n = f64::from(blob.pixels);
                let above = (blob.sum as f64 / n - mean) / spread * n.powf(SIZE_POWER);
                blobs.push((blob.rect(), (above.max(1e-3).log2() * 65536.0) as i32));
            }
        }
        blobs.sort_by_key(|&(rect, score)| (std::cmp::Reverse(score), rect.x, rect.y));
        blobs.retain(|&(_, score)| score >= self.threshold);
        found.dropped = blobs.len().saturating_sub(MOST) as u32;
        boxes.extend(blobs.into_iter().take(MOST));
        let (kept, dropped) = nms::suppress(&mut boxes, |b| b.0, OVERLAP, MAX_DETECTIONS);
        boxes.truncate(kept);
        found.dropped += dropped;
        found.list.extend(boxes.iter().map(|&(rect, score)| Detection {
            rect,
            score,
            frame_score: score,
            shifts: Default::default(),
        }));
    }
}

impl Blob {
    fn rect(&self) -> Rect {
        let [x, y, width, height] =
            [self.left, self.top, self.right - self.left, self.bottom - self.top]
                .map(|v| I28F4::from_num(v as i32));
        Rect { x, y, width, height }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::lucas_kanade::tests::{render, texture};

    const WIDTH: usize = 200;
    const HEIGHT: usize = 160;

    /// Frames of a camera that pans over a landscape, with or without a dark square that crosses the picture.
    fn run(square: bool) -> Vec<Detections> {
        let mut difference = DifferenceDetector::new(WIDTH, HEIGHT, None);
        (0..12)
            .map(|k| {
                let pan = 1.5 * f64::from(k);
                let mut pixels = render(WIDTH, HEIGHT, |x, y| texture(x + pan, y));
                let left = 30 + 5 * k as usize;
                for y in (60..72).filter(|_| square) {
                    pixels[y * WIDTH + left..y * WIDTH + left + 14].fill(10);
                }
                difference.process(Image::packed(&pixels, WIDTH, HEIGHT).unwrap()).unwrap()
            })
            .collect()
    }

    #[test]
    fn a_moving_square_is_found_before_a_panning_landscape() {
        for (k, found) in run(true).iter().enumerate().skip(LAGS[1]) {
            let place = [30 + 5 * k as i32, 60, 14, 12].map(I28F4::from_num::<i32>);
            let [x, y, width, height] = place;
            let best = found.list.first().map(|d| d.rect);
            let near = best.is_some_and(|b| b.overlaps(&Rect { x, y, width, height }, 128));
            assert!(near && found.registered, "{k}: {best:?}");
        }
    }

    #[test]
    fn nothing_moves_nothing_is_found() {
        assert!(run(false).iter().all(|found| found.list.is_empty()));
        let mut difference = DifferenceDetector::new(WIDTH, HEIGHT, None);
        let small = Image::packed(&[0; 4], 2, 2).unwrap();
        let refused = Err(Error::FrameSize { width: 2, height: 2 });
        assert_eq!(difference.process(small), refused);
    }
}
