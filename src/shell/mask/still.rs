//! Parts of the picture that stand still while the background moves: the own craft.
//!
//! The gradients of a thing that is fixed to the camera are the same in every frame; those of a moving background average
//! out. For each block of the picture: the magnitude of the mean gradient over the mean magnitude, 1 for what is fixed and
//! about 1/sqrt(n) after n views of a background that moves.

use crate::image::Image;
use crate::registration::{Registration, buffer_len};
use std::vec;
use std::vec::Vec;

/// Side of a block, pixels.
const BLOCK: usize = 8;

/// Fewest frames in which the camera moved.
pub const MIN_MOVED: u64 = 40;

/// The background's shift since the last frame that was used, pixels: as far as the structures of most backgrounds.
const FAR: i32 = 6;

/// Least ratio of a fixed block.
const FIXED: f32 = 0.55;

/// Least mean magnitude of a fixed block's gradients, grey levels over two pixels, above noise and compression.
const CONTRAST: f32 = 5.0;

/// Largest hole that is filled, as a share of the picture.
const HOLE: f32 = 0.1;

/// Collects frames.
#[derive(Debug)]
pub struct Still {
    width: usize,
    height: usize,
    registration: Option<Registration<Vec<u8>>>,
    /// Sums of the gradients across and down, and of their magnitudes, for each pixel.
    sums: Vec<[f32; 3]>,
    /// Shift since the last frame that was used, pixels, Q8.
    since: (i32, i32),
    frames: u64,
    moved: u64,
}

impl Still {
    /// For frames of this size; none seen.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            // As much memory as it needs.
            registration: Registration::new(width, height, vec![0; buffer_len(width, height)]).ok(),
            sums: vec![[0.0; 3]; width * height],
            since: (0, 0),
            frames: 0,
            moved: 0,
        }
    }

    /// Number of frames seen until now.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Frames in which the background was somewhere else.
    pub fn moved(&self) -> u64 {
        self.moved
    }

    /// Takes a frame; one of another size is left out.
    pub fn frame(&mut self, frame: Image<'_>) {
        let Some(Ok(motion)) = self.registration.as_mut().map(|r| r.register(frame)) else {
            return;
        };
        self.frames += 1;
        let middle = ((self.width as i32) << 7, (self.height as i32) << 7);
        let (x, y) = motion.map(middle.0, middle.1);
        self.since.0 = self.since.0.saturating_add(x.saturating_sub(middle.0));
        self.since.1 = self.since.1.saturating_add(y.saturating_sub(middle.1));
        let far = FAR << 8;
        if self.since.0.saturating_abs().max(self.since.1.saturating_abs()) < far {
            return;
        }
        self.since = (0, 0);
        self.moved += 1;
        for y in 1..self.height.saturating_sub(1) {
            let (above, row, below) = (frame.row(y - 1), frame.row(y), frame.row(y + 1));
            for x in 1..self.width.saturating_sub(1) {
                let across = f32::from(row[x + 1]) - f32::from(row[x - 1]);
                let down = f32::from(below[x]) - f32::from(above[x]);
                let sums = &mut self.sums[y * self.width + x];
                sums[0] += across;
                sums[1] += down;
                sums[2] += across.hypot(down);
            }
        }
    }

    /// The mask: 0 what is fixed to the camera, 255 elsewhere; its width and height, those of the frames.
    pub fn mask(&self) -> (Vec<u8>, usize, usize) {
        let (columns, rows) = (self.width.div_ceil(BLOCK), self.height.div_ceil(BLOCK));
        let fixed: Vec<bool> = (0..columns * rows)
            .map(|block| self.is_fixed(block % columns, block / columns))
            .collect();
        let mut blocks = grown(&fixed, columns);
        fill_holes(&mut blocks, columns, (HOLE * (columns * rows) as f32) as usize);
        let pixel = |at: usize| {
            let (x, y) = (at % self.width, at / self.width);
            if blocks[y / BLOCK * columns + x / BLOCK] { 0 } else { 255 }
        };
        let pixels = (0..self.width * self.height).map(pixel).collect();
        (pixels, self.width, self.height)
    }

    /// Whether a block shows something that is fixed to the camera.
    fn is_fixed(&self, column: usize, row: usize) -> bool {
        let range = |block: usize, most: usize| block * BLOCK..((block + 1) * BLOCK).min(most);
        let (mut mean, mut magnitude, mut count) = (0.0, 0.0, 0.0);
        for y in range(row, self.height) {
            for [across, down, sum] in &self.sums[y * self.width..][range(column, self.width)] {
                mean += across.hypot(*down);
                magnitude += sum;
                count += self.moved as f32;
            }
        }
        magnitude >= CONTRAST * count && mean >= FIXED * magnitude && count > 0.0
    }
}

/// The blocks and those around them: the craft shakes a little, and its edges are wide.
fn grown(blocks: &[bool], columns: usize) -> Vec<bool> {
    let rows = blocks.len().checked_div(columns).unwrap_or(0);
    let near = |at: usize| {
        let (x, y) = (at % columns, at / columns);
        let around = |v: usize, most: usize| v.saturating_sub(1)..(v + 2).min(most);
        around(y, rows).any(|y| around(x, columns).any(|x| blocks[y * columns + x]))
    };
    (0..blocks.len()).map(near).collect()
}

/// Fills holes of at most `most` blocks: plain surfaces between the edges of the craft.
fn fill_holes(blocks: &mut [bool], columns: usize, most: usize) {
    let mut seen = blocks.to_vec();
    for start in 0..blocks.len() {
        if seen[start] {
            continue;
        }
        seen[start] = true;
        let mut hole = vec![start];
        let mut next = 0;
        while let Some(&at) = hole.get(next) {
            next += 1;
            let (x, y) = (at % columns, at / columns);
            let neighbours = [
                (x > 0).then(|| at - 1),
                (x + 1 < columns).then_some(at + 1),
                (y > 0).then(|| at - columns),
                Some(at + columns).filter(|&below| below < seen.len()),
            ];
            for neighbour in neighbours.into_iter().flatten() {
                if !std::mem::replace(&mut seen[neighbour], true) {
                    hole.push(neighbour);
                }
            }
        }
        if hole.len() <= most {
            hole.iter().for_each(|&at| blocks[at] = true);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::lucas_kanade::tests::{render, texture};

    /// A frame of a background that has moved by `shift`, behind a leg that comes in from the left.
    fn frame(shift: f64) -> Vec<u8> {
        render(160, 120, |x, y| {
            let leg = x < 60.0 && (50.0..80.0).contains(&y);
            if leg { 30.0 } else { texture(x + shift, y + shift / 3.0).max(60.0) }
        })
    }

    fn masked(frames: impl Iterator<Item = f64>) -> (u64, Vec<u8>) {
        let mut still = Still::new(160, 120);
        for shift in frames {
            still.frame(Image::packed(&frame(shift), 160, 120).unwrap());
        }
        (still.moved(), still.mask().0)
    }

    #[test]
    fn the_own_leg_is_hidden_and_the_background_is_not() {
        let (moved, mask) = masked((0..60).map(|i| f64::from(i) * 7.0));
        assert!(moved >= MIN_MOVED, "{moved}");
        let (mut leg, mut elsewhere) = (0, 0);
        for (at, &pixel) in mask.iter().enumerate() {
            let (x, y) = (at % 160, at / 160);
            let near = x < 76 && (34..96).contains(&y);
            leg += usize::from(x < 60 && (50..80).contains(&y) && pixel == 0);
            elsewhere += usize::from(!near && pixel == 0);
        }
        assert_eq!(leg, 60 * 30, "all of the leg, its plain middle too");
        assert_eq!(elsewhere, 0);
    }

    #[test]
    fn a_camera_that_stands_still_shows_nothing() {
        let (moved, mask) = masked((0..60).map(|_| 0.0));
        assert_eq!(moved, 0);
        assert!(mask.iter().all(|&pixel| pixel == 255));
    }

    #[test]
    fn only_small_holes_are_filled() {
        let picture = ["......", ".####.", ".#..#.", ".####.", "......"];
        let blocks: Vec<bool> =
            picture.iter().flat_map(|row| row.bytes()).map(|b| b == b'#').collect();
        let mut filled = blocks.clone();
        fill_holes(&mut filled, 6, 2);
        let count = |blocks: &[bool]| blocks.iter().filter(|&&b| b).count();
        assert_eq!((count(&blocks), count(&filled)), (10, 12));
        let mut unfilled = blocks.clone();
        fill_holes(&mut unfilled, 6, 1);
        assert_eq!(unfilled, blocks);
    }
}
