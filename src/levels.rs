//! The pyramid of a frame and its memory (level 4).
//!
//! Targets of every size are looked for with one window: level i shows the frame `2^(i / scales_per_octave)` times
//! smaller. Levels of the first octave are resampled from the frame, the others are halves of those an octave finer.

use crate::channels::{self, DIFFERENCES, MAP_CHANNELS, PADDING};
use crate::cube::{SLICES, WINDOW};
use crate::gradient::CELL;
use crate::image::Image;
use crate::integral::Integral;
use crate::pyramid;

/// Most levels.
pub const MAX_LEVELS: usize = 20;

/// Length of the nominal target in a window: half the window, 20 of the paper's 40 px.
pub const TARGET_CELLS: usize = WINDOW / 2;

/// Length in pixels of the frame of the nominal target of level 0.
pub const FINEST_TARGET: usize = TARGET_CELLS * CELL;

/// Q16 steps of the first octave for 1 to 4 scales an octave.
const STEPS: [[u32; 4]; 4] = [
    [65536, 0, 0, 0],
    [65536, 92682, 0, 0],
    [65536, 82570, 104_032, 0],
    [65536, 77936, 92682, 110_218],
];

/// Size and place of one level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Level {
    /// Width in pixels of the level.
    pub width: usize,
    /// Height in pixels of the level.
    pub height: usize,
    /// Pixels of the frame to one of the level, Q16, both ways.
    pub scale: u32,
    /// Whether the level is searched; the others are only steps on the way to coarser ones.
    pub active: bool,
}

impl Level {
    /// Cells in a row and in a column.
    pub const fn cells(&self) -> (usize, usize) {
        (self.width / CELL, self.height / CELL)
    }

    /// Length of the nominal target in pixels of the frame, Q4.
    pub const fn target_q4(&self) -> i32 {
        ((FINEST_TARGET as u64 * self.scale as u64) >> 12) as i32
    }

    const fn pixels(&self) -> usize {
        self.width * self.height
    }

    const fn map_bytes(&self) -> usize {
        if self.active { channels::map_bytes(self.width, self.height) } else { 0 }
    }

    const fn table_words(&self) -> usize {
        if self.active { channels::table_words(self.width, self.height) } else { 0 }
    }
}

/// The levels of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Geometry {
    levels: [Level; MAX_LEVELS],
    count: usize,
    scales_per_octave: usize,
}

impl Geometry {
    /// Levels for targets of `min_target` to `max_target` pixels (longer side) in frames of `width` x `height`;
    /// `scales_per_octave` counts as 1 to 4. None where the frame is smaller than any window.
    pub const fn new(
        width: usize,
        height: usize,
        min_target: usize,
        max_target: usize,
        scales_per_octave: usize,
    ) -> Self {
        let per_octave = match scales_per_octave {
            0 | 1 => 1,
            2 => 2,
            3 => 3,
            _ => 4,
        };
        let mut levels = [Level { width: 0, height: 0, scale: 0, active: false }; MAX_LEVELS];
        let mut count = 0;
        // A level serves targets up to half a step larger than its own; the largest step is 2^(1/2).
        while count < MAX_LEVELS {
            let octave = count / per_octave;
            let step = STEPS[per_octave - 1][count % per_octave];
            if octave >= 12 {
                break;
            }
            let level = if octave == 0 {
                Level {
                    width: pyramid::resized(width, step),
                    height: pyramid::resized(height, step),
                    scale: step,
                    active: false,
                }
            } else {
                let finer = levels[count - per_octave];
                Level {
                    width: finer.width / 2,
                    height: finer.height / 2,
                    scale: finer.scale * 2,
                    active: false,
                }
            };
            let target_q16 = FINEST_TARGET as u64 * level.scale as u64;
            let (columns, rows) = level.cells();
            let too_small = columns + 2 * PADDING < WINDOW || rows + 2 * PADDING < WINDOW;
            // The level before already reaches the largest target.
            let needless = count > 0
                && FINEST_TARGET as u64 * levels[count - 1].scale as u64 * 19 / 16
                    >= (max_target as u64) << 16;
            if too_small || columns == 0 || rows == 0 || needless {
                break;
            }
            levels[count] = level;
            // Finer levels than the smallest target needs are steps only: the next one must not serve it already.
            let next = STEPS[per_octave - 1][(count + 1) % per_octave];
            let next_scale = (next as u64) << ((count + 1) / per_octave);
            levels[count].active = FINEST_TARGET as u64 * next_scale > (min_target as u64) << 16
                || target_q16 >= (min_target as u64) << 16;
            count += 1;
        }
        Self { levels, count, scales_per_octave: per_octave }
    }

    /// The levels, finest first.
    pub fn levels(&self) -> &[Level] {
        &self.levels[..self.count]
    }

    /// Bytes for the pictures and maps of all levels.
    pub const fn bytes_len(&self) -> usize {
        let (mut sum, mut i) = (0, 0);
        while i < self.count {
            sum += (1 + DIFFERENCES) * self.levels[i].pixels() + self.levels[i].map_bytes();
            i += 1;
        }
        sum
    }

    /// Words for the tables of all levels and frames of the ring.
    pub const fn words_len(&self) -> usize {
        let (mut sum, mut i) = (0, 0);
        while i < self.count {
            sum += (SLICES + 1) * self.levels[i].table_words();
            i += 1;
        }
        sum
    }
}

/// Memory of one level.
#[derive(Debug)]
pub struct LevelBuffers<'a> {
    /// Number of the level.
    pub number: u8,
    /// Size and place.
    pub level: Level,
    grey: &'a mut [u8],
    differences: [&'a mut [u8]; DIFFERENCES],
    map: &'a mut [u8],
    ring: &'a mut [u16],
    newest: &'a mut [u16],
}

/// Memory of all levels, finest first.
pub type Pyramid<'a> = heapless::Vec<LevelBuffers<'a>, MAX_LEVELS>;

/// Divides memory among the levels: [`Geometry::bytes_len`] bytes, [`Geometry::words_len`] words. The same memory
/// gives the same division. Without words the levels have pictures and maps only. Panics if there is less.
pub fn divide<'a>(
    geometry: &Geometry,
    mut bytes: &'a mut [u8],
    mut words: &'a mut [u16],
) -> Pyramid<'a> {
    fn take<'a, T>(from: &mut &'a mut [T], count: usize) -> &'a mut [T] {
        let (head, tail) = core::mem::take(from).split_at_mut(count);
        *from = tail;
        head
    }
    let tables = !words.is_empty();
    geometry
        .levels()
        .iter()
        .enumerate()
        .map(|(number, level)| LevelBuffers {
            number: number as u8,
            level: *level,
            grey: take(&mut bytes, level.pixels()),
            differences: core::array::from_fn(|_| take(&mut bytes, level.pixels())),
            map: take(&mut bytes, level.map_bytes()),
            ring: take(&mut words, if tables { SLICES * level.table_words() } else { 0 }),
            newest: take(&mut words, if tables { level.table_words() } else { 0 }),
        })
        .collect()
}

/// Fills the pictures of all levels from the frame and its difference images, all of one size.
pub fn build(
    geometry: &Geometry,
    pyramid: &mut Pyramid<'_>,
    frame: Image<'_>,
    differences: [Image<'_>; DIFFERENCES],
) {
    let per_octave = geometry.scales_per_octave;
    for i in 0..pyramid.len() {
        let (finer, rest) = pyramid.split_at_mut(i);
        let LevelBuffers { level, grey, differences: out, .. } = &mut rest[0];
        match i.checked_sub(per_octave).map(|i| &finer[i]) {
            None => {
                pyramid::resize(frame, (level.scale, level.scale), grey);
                for (out, difference) in out.iter_mut().zip(differences) {
                    pyramid::resize(difference, (level.scale, level.scale), out);
                }
            }
            Some(finer) => {
                pyramid::halve(finer.picture(finer.grey), grey);
                for (out, difference) in out.iter_mut().zip(&finer.differences) {
                    pyramid::halve(finer.picture(difference), out);
                }
            }
        }
    }
}

impl LevelBuffers<'_> {
    fn picture<'a>(&self, pixels: &'a [u8]) -> Image<'a> {
        Image::packed(pixels, self.level.width, self.level.height)
            .expect("the buffer was made for the level")
    }

    /// Computes the tables of the newest frame into place `slot` of the ring.
    pub fn fill_tables(&mut self, slot: usize) {
        let words = self.level.table_words();
        let picture = |pixels| {
            Image::packed(pixels, self.level.width, self.level.height)
                .expect("the buffer was made for the level")
        };
        let differences = core::array::from_fn(|i| picture(&*self.differences[i]));
        let table = &mut self.ring[slot * words..(slot + 1) * words];
        channels::tables(&picture(&*self.grey), &differences, table, self.newest);
    }

    /// Computes the scan's map of the newest frame, whose tables are in place `slot`.
    pub fn fill_map(&mut self, slot: usize, noise: &[u32; DIFFERENCES]) {
        let words = self.level.table_words();
        let (columns, rows) = self.level.cells();
        let table = Integral::new(&self.ring[slot * words..(slot + 1) * words], columns, rows);
        channels::map(&table, &Integral::new(self.newest, columns, rows), noise, self.map);
    }

    /// The table of the frame in place `slot` of the ring.
    pub fn table(&self, slot: usize) -> Integral<'_> {
        let words = self.level.table_words();
        let (columns, rows) = self.level.cells();
        Integral::new(&self.ring[slot * words..(slot + 1) * words], columns, rows)
    }

    /// The second table of the newest frame.
    pub fn newest(&self) -> Integral<'_> {
        let (columns, rows) = self.level.cells();
        Integral::new(self.newest, columns, rows)
    }

    /// The scan's map of the newest frame: [`MAP_CHANNELS`] bytes a cell.
    pub fn map(&self) -> &[u8] {
        debug_assert_eq!(self.map.len() % MAP_CHANNELS, 0);
        self.map
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn levels_cover_the_targets() {
        let geometry = Geometry::new(640, 480, 10, 100, 2);
        let targets: Vec<i32> = geometry.levels().iter().map(|l| l.target_q4() / 16).collect();
        assert_eq!(targets, [10, 14, 20, 28, 40, 56, 80, 113]);
        assert!(geometry.levels().iter().all(|l| l.active));
        assert_eq!((geometry.levels()[1].width, geometry.levels()[3].height), (452, 169));
        let coarse = Geometry::new(640, 480, 20, 40, 2);
        let active: Vec<bool> = coarse.levels().iter().map(|l| l.active).collect();
        assert_eq!(active, [false, false, true, true, true]);
    }

    #[test]
    fn tiny_and_huge_frames() {
        for (width, height) in [(0, 0), (1, 1), (7, 5), (8, 8), (9, 400), (4096, 9)] {
            for per_octave in 0..6 {
                let geometry = Geometry::new(width, height, 1, 100_000, per_octave);
                let mut bytes = vec![0; geometry.bytes_len()];
                let mut words = vec![0; geometry.words_len()];
                let pixels = vec![50; width * height];
                let frame = Image::packed(&pixels, width, height).unwrap();
                let mut pyramid = divide(&geometry, &mut bytes, &mut words);
                build(&geometry, &mut pyramid, frame, [frame; DIFFERENCES]);
                for level in pyramid.iter_mut().filter(|l| l.level.active) {
                    level.fill_tables(0);
                    level.fill_map(0, &[0; DIFFERENCES]);
                }
            }
        }
    }
}
