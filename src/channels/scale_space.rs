//! The pyramid of a frame and its memory.
//!
//! One window size finds targets of all sizes: level i is the frame reduced by `2^(i / scales_per_octave)`. Levels of the
//! first octave are resampled from the frame, the others are halves of those an octave finer.

use crate::channels::history::History;
use crate::channels::window::{PADDING, Position, SLICES, WINDOW, boxed};
use crate::channels::{Difference, NewestChannels, Slice};
use crate::image::Image;
use crate::image::Rect;
use crate::image::gradient::CELL;
use crate::image::pyramid;
use crate::math::{slices, threads};
use core::array::from_fn;
use core::ops::Range;

/// Largest number of levels.
pub const MAX_LEVELS: usize = 20;

/// Length of the nominal target in a window: half the window, 20 of the paper's 40 px.
pub const TARGET_CELLS: usize = WINDOW / 2;

/// Length in pixels of the frame of the nominal target of level 0.
pub const FINEST_TARGET: usize = TARGET_CELLS * CELL;

/// Levels of the frame's own halvings: the frame and three reductions by 2, which registration uses too.
pub const HALVINGS: usize = 4;

/// A frame, its half, its quarter and its eighth.
pub type Halvings<'a> = [Image<'a>; HALVINGS];

/// Q16 steps of the first octave for 1 to 4 scales an octave.
const STEPS: [[u32; 4]; 4] = [
    [65536, 0, 0, 0],
    [65536, 92682, 0, 0],
    [65536, 82570, 104_032, 0],
    [65536, 77936, 92682, 110_218],
];

/// Size and place of one level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PyramidLevel {
    /// Width in pixels of the level.
    pub width: usize,
    /// Height in pixels of the level.
    pub height: usize,
    /// Pixels of the frame to one of the level, Q16, both ways.
    pub scale: u32,
    /// Whether the level is searched; the others are only steps on the way to coarser ones.
    pub active: bool,
    /// Width and height of its difference images.
    pub differences: (usize, usize),
}

impl PyramidLevel {
    /// Cells in a row and in a column.
    pub const fn cells(&self) -> (usize, usize) {
        (self.width / CELL, self.height / CELL)
    }

    /// Box of the nominal target in the middle of a window of this level.
    pub fn nominal_box(&self, position: Position) -> Rect {
        boxed(position.centre(self.scale), self.target_q4(), self.target_q4())
    }

    /// Length of the nominal target in pixels of the frame, Q4.
    pub const fn target_q4(&self) -> i32 {
        ((FINEST_TARGET as u64 * self.scale as u64) >> 12) as i32
    }

    const fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Number of halvings of the frame that give this level, if it is one of [`Halvings`].
    const fn halvings(&self) -> Option<usize> {
        let octave = self.scale.trailing_zeros() as usize;
        let halved = self.scale.is_power_of_two() && octave >= 16 && octave < 16 + HALVINGS;
        if halved { Some(octave - 16) } else { None }
    }

    const fn difference_pixels(&self) -> usize {
        self.differences.0 * self.differences.1
    }
}

/// The levels of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PyramidLayout {
    /// Width and height of the frames in pixels.
    frame: (usize, usize),
    levels: [PyramidLevel; MAX_LEVELS],
    count: usize,
    scales_per_octave: usize,
    history: History,
}

impl PyramidLayout {
    /// Levels for targets of `min_target` to `max_target` pixels (longer side) in frames of `width` x `height`;
    /// `scales_per_octave` is clamped to 1..=4. There are no levels where the frame is smaller than any window.
    pub const fn new(
        width: usize,
        height: usize,
        min_target: usize,
        max_target: usize,
        scales_per_octave: usize,
        history: History,
    ) -> Self {
        let per_octave = match scales_per_octave {
            0 | 1 => 1,
            2 => 2,
            3 => 3,
            _ => 4,
        };
        let none =
            PyramidLevel { width: 0, height: 0, scale: 0, active: false, differences: (0, 0) };
        let mut levels = [none; MAX_LEVELS];
        let mut count = 0;
        let (halved_width, halved_height) = (width >> history.octave(), height >> history.octave());
        // A level serves targets up to half a step larger than its own; the largest step is 2^(1/2).
        while count < MAX_LEVELS {
            let octave = count / per_octave;
            let step = STEPS[per_octave - 1][count % per_octave];
            if octave >= 12 {
                break;
            }
            let level = if octave == 0 {
                PyramidLevel {
                    width: pyramid::resized(width, step),
                    height: pyramid::resized(height, step),
                    scale: step,
                    active: false,
                    differences: (
                        pyramid::resized(halved_width, step),
                        pyramid::resized(halved_height, step),
                    ),
                }
            } else {
                let finer = levels[count - per_octave];
                PyramidLevel {
                    width: finer.width / 2,
                    height: finer.height / 2,
                    scale: finer.scale * 2,
                    active: false,
                    differences: (finer.differences.0 / 2, finer.differences.1 / 2),
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
        Self { frame: (width, height), levels, count, scales_per_octave: per_octave, history }
    }

    /// Width and height of the frames in pixels.
    pub const fn frame(&self) -> (usize, usize) {
        self.frame
    }

    /// The levels, finest first.
    pub const fn levels(&self) -> &[PyramidLevel] {
        self.levels.split_at(self.count).0
    }

    /// Level `number`; of no size where there is none.
    pub fn level(&self, number: usize) -> PyramidLevel {
        self.levels().get(number).copied().unwrap_or_default()
    }

    /// Levels for each doubling of the target's size.
    pub const fn scales_per_octave(&self) -> usize {
        self.scales_per_octave
    }

    /// Number and size of the frames that are kept.
    pub const fn history(&self) -> History {
        self.history
    }

    /// Bytes for the pictures of all levels.
    pub const fn bytes_len(&self) -> usize {
        self.start(self.count)
    }

    /// Where the pictures of a level begin.
    #[inline(never)]
    const fn start(&self, level: usize) -> usize {
        let (mut sum, mut i) = (0, 0);
        while i < level {
            let differences = self.kept(i) + DIFFERENCES_OF_THE_NEWEST;
            sum +=
                self.kept(i) * self.grey_len(i) + differences * self.levels[i].difference_pixels();
            i += 1;
        }
        sum
    }

    /// Frames of which a level keeps the pictures.
    const fn kept(&self, level: usize) -> usize {
        if self.levels[level].active { self.history.slices() } else { 1 }
    }

    /// The grey pictures of levels that are the frame, halved or not, are kept with the frames.
    const fn grey_len(&self, level: usize) -> usize {
        if self.levels[level].halvings().is_some() { 0 } else { self.levels[level].pixels() }
    }

    /// Where a picture of a level is, `slot` its place in the ring of frames.
    #[inline(never)]
    pub fn byte_range(&self, level: usize, picture: Plane, slot: usize) -> Range<usize> {
        let (kept, grey) = (self.kept(level), self.grey_len(level));
        let slot = slot % kept;
        let difference = self.levels[level].difference_pixels();
        let differences = self.start(level) + kept * grey;
        let (start, length) = match picture {
            Plane::Grey => (self.start(level) + slot * grey, grey),
            Plane::Near => (differences + slot * difference, difference),
            Plane::Far => (differences + kept * difference, difference),
            Plane::Plain => (differences + (kept + 1) * difference, difference),
        };
        start..start + length
    }
}

/// Difference images of which only the newest frame's is kept.
const DIFFERENCES_OF_THE_NEWEST: usize = 2;

/// The pictures of a level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plane {
    /// The frame.
    Grey,
    /// [`Slice::near`].
    Near,
    /// [`NewestChannels::far`].
    Far,
    /// [`NewestChannels::plain`].
    Plain,
}

impl Plane {
    const ALL: [Self; 4] = [Self::Grey, Self::Near, Self::Far, Self::Plain];
}

/// A picture in a part of the memory. Panics if it has fewer bytes.
#[allow(clippy::expect_used, reason = "the memory was divided for these pictures")]
pub(super) fn packed(pixels: &[u8], (width, height): (usize, usize)) -> Image<'_> {
    Image::packed(pixels, width, height).expect("the memory was divided for these pictures")
}

/// Fills the pictures of all levels from the frame, its halves and the difference images of level 0, into place `slot` of
/// the rings; the four kinds of pictures at the same time where there are threads for it. Panics if there are fewer than
/// [`PyramidLayout::bytes_len`] bytes.
pub fn build(geometry: &PyramidLayout, bytes: &mut [u8], frame: &Halvings<'_>, slot: usize) {
    let mut kinds: [[&mut [u8]; MAX_LEVELS]; Plane::ALL.len()] =
        from_fn(|_| from_fn(|_| Default::default()));
    let (mut rest, mut at) = (bytes, 0);
    // In the order in which they lie in memory.
    for i in 0..geometry.levels().len() {
        for (levels, picture) in kinds.iter_mut().zip(Plane::ALL) {
            let place = geometry.byte_range(i, picture, slot);
            let (own, behind) = slices::split_mut(rest, place.end - at);
            (rest, at) = (behind, place.end);
            levels[i] = slices::split_mut(own, own.len() - place.len()).1;
        }
    }
    threads::pieces(&mut kinds, 1, true, |number, kinds| {
        for (levels, picture) in kinds.iter_mut().zip(&Plane::ALL[number..]) {
            build_kind(geometry, frame, *picture, levels);
        }
    });
}

/// [`build`] for one kind of pictures.
fn build_kind(
    geometry: &PyramidLayout,
    frame: &Halvings<'_>,
    picture: Plane,
    levels: &mut [&mut [u8]; MAX_LEVELS],
) {
    for (i, level) in geometry.levels().iter().enumerate().skip(1) {
        let (finer, own) = slices::split_mut(levels, i);
        let Some(out) = own.first_mut() else { return };
        let from = i.checked_sub(geometry.scales_per_octave);
        let source = from.unwrap_or(0);
        let finer_level = geometry.level(source);
        let pixels: &[u8] = finer.get(source).map_or(&[], |pixels| pixels);
        let image = match (picture, finer_level.halvings()) {
            (Plane::Grey, _) if level.halvings().is_some() => continue,
            (Plane::Grey, Some(halvings)) => frame[halvings],
            (Plane::Grey, None) => packed(pixels, (finer_level.width, finer_level.height)),
            _ => packed(pixels, finer_level.differences),
        };
        match from {
            Some(_) => pyramid::halve(image, out),
            None => pyramid::resize(image, (level.scale, level.scale), out),
        };
    }
}

/// A level and its pictures.
#[derive(Debug, Clone, Copy)]
pub struct LevelView<'a> {
    /// Number of the level.
    pub number: u8,
    /// Size, scale and role of the level.
    pub level: PyramidLevel,
    /// The level in the last frames, newest first; `None` for slices that the history does not keep. Frames not yet seen
    /// repeat the oldest.
    pub slices: [Option<Slice<'a>>; SLICES],
    /// Channels of the newest frame.
    pub newest: NewestChannels<'a>,
}

/// The levels of the newest frame and of those before it, finest first.
#[derive(Debug, Clone, Copy)]
pub struct Pyramid<'a> {
    geometry: &'a PyramidLayout,
    bytes: &'a [u8],
    frames: [Halvings<'a>; SLICES],
    slots: [usize; SLICES],
}

impl<'a> Pyramid<'a> {
    /// Views the pictures in `bytes`: `frames` are the last ones, newest first (with a history of one slice the newest
    /// counts alone), `slots` their places in the rings.
    pub fn new(
        geometry: &'a PyramidLayout,
        bytes: &'a [u8],
        frames: [Halvings<'a>; SLICES],
        slots: [usize; SLICES],
    ) -> Self {
        Self { geometry, bytes, frames, slots }
    }

    /// Sizes and scales of all levels, finest first.
    pub fn levels(&self) -> &'a [PyramidLevel] {
        self.geometry.levels()
    }

    /// Size and place of all levels.
    pub fn geometry(&self) -> &'a PyramidLayout {
        self.geometry
    }

    /// The frames of the slices of a cube, newest first.
    pub fn frames(&self) -> [Image<'a>; SLICES] {
        self.frames.map(|[frame, ..]| frame)
    }

    /// Pictures of the levels that are searched, finest first.
    pub fn searched(&self) -> impl Iterator<Item = LevelView<'a>> + use<'a> {
        let this = *self;
        let numbers = 0..this.levels().len();
        numbers.filter(move |&i| this.geometry.level(i).active).map(move |i| this.level(i))
    }

    /// Pictures of level `number`. Panics if there is no such level.
    pub fn level(&self, number: usize) -> LevelView<'a> {
        let level = self.geometry.level(number);
        let picture = |picture, age: usize| {
            let place = self.geometry.byte_range(number, picture, self.slots[age]);
            match (picture, level.halvings()) {
                (Plane::Grey, Some(halvings)) => self.frames[age][halvings],
                (Plane::Grey, None) => {
                    packed(slices::of(self.bytes, place), (level.width, level.height))
                }
                _ => packed(slices::of(self.bytes, place), level.differences),
            }
        };
        let halved = self.geometry.history == History::Half;
        let difference = |name, age| Difference { picture: picture(name, age), halved };
        let slice =
            |age| Slice { grey: picture(Plane::Grey, age), near: difference(Plane::Near, age) };
        let kept = self.geometry.kept(number);
        LevelView {
            number: number as u8,
            level,
            slices: core::array::from_fn(|age| (age < kept).then(|| slice(age))),
            newest: NewestChannels {
                slice: slice(0),
                far: difference(Plane::Far, 0),
                plain: difference(Plane::Plain, 0),
                oriented: self.geometry.history.oriented(),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn levels_cover_the_targets() {
        let geometry = PyramidLayout::new(640, 480, 10, 100, 2, History::Full);
        let targets: Vec<i32> = geometry.levels().iter().map(|l| l.target_q4() / 16).collect();
        assert_eq!(targets, [10, 14, 20, 28, 40, 56, 80, 113]);
        assert!(geometry.levels().iter().all(|l| l.active));
        assert_eq!((geometry.levels()[1].width, geometry.levels()[3].height), (452, 169));
        let coarse = PyramidLayout::new(640, 480, 20, 40, 2, History::Full);
        let active: Vec<bool> = coarse.levels().iter().map(|l| l.active).collect();
        assert_eq!(active, [false, false, true, true, true]);
    }

    #[test]
    fn tiny_and_huge_frames() {
        for history in [History::Full, History::Half] {
            for (width, height) in [(0, 0), (1, 1), (7, 5), (8, 8), (9, 400), (4096, 9)] {
                for per_octave in 0..6 {
                    let geometry =
                        PyramidLayout::new(width, height, 1, 100_000, per_octave, history);
                    let mut bytes = vec![0; geometry.bytes_len()];
                    let pixels = vec![50; width * height];
                    let frame =
                        core::array::from_fn(|i| packed(&pixels, (width >> i, height >> i)));
                    build(&geometry, &mut bytes, &frame, 0);
                    let pyramid = Pyramid::new(&geometry, &bytes, [frame; SLICES], [0; SLICES]);
                    for pictures in pyramid.searched() {
                        assert_eq!(pictures.newest.slice.cells(), pictures.level.cells());
                        assert!(pictures.newest.slice.grey.row(0).iter().all(|&grey| grey == 50));
                    }
                }
            }
        }
    }

    #[test]
    fn pictures_do_not_overlap() {
        for history in [History::Full, History::Half] {
            let geometry = PyramidLayout::new(101, 67, 15, 60, 2, history);
            let mut end = 0;
            for level in 0..geometry.levels().len() {
                let kept = geometry.kept(level);
                let newest = [(Plane::Far, 1), (Plane::Plain, 1)];
                for (picture, slots) in
                    [(Plane::Grey, kept), (Plane::Near, kept)].into_iter().chain(newest)
                {
                    for slot in 0..slots {
                        let place = geometry.byte_range(level, picture, slot);
                        assert_eq!(place.start, end, "{history:?} {level} {picture:?} {slot}");
                        end = place.end;
                    }
                }
            }
            assert_eq!(end, geometry.bytes_len());
        }
    }
}
