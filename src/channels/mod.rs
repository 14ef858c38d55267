//! Channels of one pyramid level: gradient energies and differences of its cells.
//!
//! A frame has eight channels a cell: [`ORIENTATIONS`] gradient energies, their magnitude and the temporal difference.
//! Of the newest frame alone there are four more: intensity and all differences. Cells are computed from pictures where
//! they are asked for; pictures are all that is kept.

mod difference;
pub mod front_end;
pub mod history;
pub mod method;
pub mod scale_space;
pub mod window;

use crate::image::Image;
use crate::image::gradient::{CELL, CellRow, ORIENTATIONS};
use crate::image::gradient_block::{self, SIDE, pairs};
use crate::math::slices;
use difference::{fill_difference, quarters};

pub use difference::{Difference, DifferenceRow, RUN};

/// Number of difference images of the newest frame:
///
/// | image | compared with | value |
/// | --- | --- | --- |
/// | far | a frame further back | distance of a pixel to the range of the 3x3 pixels around it |
/// | near | the frame of the oldest slice | the same |
/// | plain | the frame of the oldest slice | absolute difference |
pub const DIFFERENCES: usize = 3;

/// Channels of every frame, and as many of the newest alone.
pub const CHANNELS: usize = 8;

/// Channel of the gradient magnitude.
pub const MAGNITUDE: usize = ORIENTATIONS;

/// Channel of the temporal difference.
pub const TEMPORAL: usize = ORIENTATIONS + 1;

/// Eight channels of the cells of a square, row by row.
pub type Square<const N: usize> = [[[u8; CHANNELS]; N]; N];

/// Pictures of one frame on one level, of which a slice of a st-cube is cut.
#[derive(Debug, Clone, Copy)]
pub struct Slice<'a> {
    /// Grey levels of the frame, 0 to 255, resampled to the level.
    pub grey: Image<'a>,
    /// Tolerant difference to the frame a few before.
    pub near: Difference<'a>,
}

/// Pictures of the newest frame on one level: a slice, and differences that older frames lack.
#[derive(Debug, Clone, Copy)]
pub struct NewestChannels<'a> {
    /// Grey picture and near difference, as of any frame.
    pub slice: Slice<'a>,
    /// Tolerant difference to a frame far back.
    pub far: Difference<'a>,
    /// Plain difference to the frame a few before.
    pub plain: Difference<'a>,
    /// Whether its cells have orientations.
    pub oriented: bool,
}

/// Whether a square whose upper left cell is at (x, y) has cells of a level of such a size.
fn near(size: (usize, usize), x: i32, y: i32) -> bool {
    let meets = |first: i32, length: usize| {
        first > -(SIDE as i32) && usize::try_from(first).unwrap_or(0) < length
    };
    meets(x, size.0) && meets(y, size.1)
}

/// Cells of a square, channel by channel, in room for a few more.
type Planes = [[u8; 128]; CHANNELS];

/// The cells of a square at (x, y); those outside a level of such a size are 0.
#[inline(always)]
fn cells_of(planes: &Planes, size: (usize, usize), x: i32, y: i32) -> Square<SIDE> {
    let mut cells = [[[0; CHANNELS]; SIDE]; SIDE];
    let inside = |first: i32, length: usize| {
        let start = usize::try_from(-first).unwrap_or(0).min(SIDE);
        let end = usize::try_from(length as i32 - first).unwrap_or(0).min(SIDE);
        start..end.max(start)
    };
    let (columns, rows) = (inside(x, size.0), inside(y, size.1));
    for j in rows {
        for i in columns.clone() {
            cells[j][i] = core::array::from_fn(|channel| planes[channel][(j * SIDE + i) % 128]);
        }
    }
    cells
}

/// Means of a difference over the cells of a square at (x, y), in quarters, at most 255.
#[inline(always)]
fn quarters_of(difference: &Difference<'_>, x: i32, y: i32) -> [u8; 128] {
    let mut out = [0; 128];
    let picture = &difference.picture;
    if picture.width() == 0 || picture.height() == 0 {
        return out;
    }
    if difference.halved {
        for j in 0..SIDE {
            let row = y + j as i32;
            let Some(row) = usize::try_from(row).ok().filter(|&row| row < picture.height()) else {
                continue;
            };
            let row = picture.row(row);
            for i in 0..SIDE {
                let mean = usize::try_from(x + i as i32).ok().and_then(|x| row.get(x));
                out[j * SIDE + i] = mean.map_or(0, |&mean| quarters(mean));
            }
        }
        return out;
    }
    sums_of(picture, x, y, |sum| sum.min(255) as u8)
}

/// A function of the sum of the pixels of each cell of a square at (x, y).
#[inline(always)]
fn sums_of(picture: &Image<'_>, x: i32, y: i32, value: impl Fn(u16) -> u8) -> [u8; 128] {
    let mut words = [[0u16; 128]; CELL];
    for j in 0..SIDE {
        for (k, words) in words.iter_mut().enumerate() {
            let y = CELL as i32 * (y + j as i32) + k as i32;
            let row: [u16; SIDE] = pairs(picture, CELL as i32 * x, y);
            words[j * SIDE..(j + 1) * SIDE].copy_from_slice(&row);
        }
    }
    let [upper, lower] = &words;
    let mut out = [0; 128];
    for ((out, upper), lower) in out.iter_mut().zip(upper).zip(lower) {
        *out = value((upper & 255) + (upper >> 8) + (lower & 255) + (lower >> 8));
    }
    out
}

/// [`Slice::square`] of a square that has cells of the level.
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn square_at_once(slice: &Slice<'_>, x: i32, y: i32) -> Square<SIDE> {
    let mut planes = gradient_block::square(&slice.grey, x, y);
    planes[TEMPORAL] = quarters_of(&slice.near, x, y);
    cells_of(&planes, slice.cells(), x, y)
}

/// [`NewestChannels::square`] of a square that has cells of the level.
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn newest_at_once(newest: &NewestChannels<'_>, x: i32, y: i32) -> Square<SIDE> {
    let mut planes = [[0; 128]; CHANNELS];
    planes[0] = sums_of(&newest.slice.grey, x, y, |sum| ((sum + 2) >> 2) as u8);
    for (plane, difference) in
        planes[1..].iter_mut().zip([&newest.far, &newest.slice.near, &newest.plain])
    {
        *plane = quarters_of(difference, x, y);
    }
    cells_of(&planes, newest.slice.cells(), x, y)
}

/// The cells of a square whose upper left one is at (left, top), one after the other; those outside a level of such a size
/// are 0.
fn square<R>(
    size: (usize, usize),
    (left, top): (i32, i32),
    row: impl Fn(usize) -> R,
    cell: impl Fn(&R, usize) -> [u8; CHANNELS],
) -> Square<SIDE> {
    let mut cells = [[[0; CHANNELS]; SIDE]; SIDE];
    for (j, cells) in cells.iter_mut().enumerate() {
        let Some(y) = place(top, j).filter(|&y| y < size.1) else { continue };
        let row = row(y);
        for (i, out) in cells.iter_mut().enumerate() {
            if let Some(x) = place(left, i).filter(|&x| x < size.0) {
                *out = cell(&row, x);
            }
        }
    }
    cells
}

/// `first + i`, unless it is negative.
fn place(first: i32, i: usize) -> Option<usize> {
    usize::try_from(first.saturating_add(i as i32)).ok()
}

impl<'a> Slice<'a> {
    /// Cells in a row and in a column.
    pub fn cells(&self) -> (usize, usize) {
        (self.grey.width() / CELL, self.grey.height() / CELL)
    }

    /// Energies, magnitude and temporal difference of the cells of a square whose upper left one is at (x, y). Cells
    /// outside the picture are 0.
    pub fn square(&self, x: i32, y: i32) -> Square<SIDE> {
        if !cfg!(feature = "simd") {
            return self.square_by_cells(x, y);
        }
        match near(self.cells(), x, y) {
            true => square_at_once(self, x, y),
            false => [[[0; CHANNELS]; SIDE]; SIDE],
        }
    }

    /// As [`Slice::square`], cell by cell: for processors without vector instructions.
    fn square_by_cells(&self, x: i32, y: i32) -> Square<SIDE> {
        let row = |y| (CellRow::new(&self.grey, y), self.near.row(y));
        square(self.cells(), (x, y), row, |(grey, near), x| {
            let [a, b, c, d, e, f, magnitude] = grey.cell(x).energies();
            [a, b, c, d, e, f, magnitude, near.quarters(x)]
        })
    }
}

impl NewestChannels<'_> {
    /// Intensity, the differences in quarters of a grey level (at most 255) and zeros: of the cells of a square, as
    /// [`Slice::square`].
    pub fn square(&self, x: i32, y: i32) -> Square<SIDE> {
        if !cfg!(feature = "simd") {
            return self.square_by_cells(x, y);
        }
        match near(self.slice.cells(), x, y) {
            true => newest_at_once(self, x, y),
            false => [[[0; CHANNELS]; SIDE]; SIDE],
        }
    }

    /// As [`NewestChannels::square`], cell by cell: for processors without vector instructions.
    fn square_by_cells(&self, x: i32, y: i32) -> Square<SIDE> {
        square(self.slice.cells(), (x, y), |y| self.row(y), |row, x| row.second(x))
    }

    /// Cells of row `y`. Panics if there are fewer rows.
    pub fn row(&self, y: usize) -> NewestRow<'_> {
        NewestRow {
            grey: CellRow::new(&self.slice.grey, y),
            differences: [self.far.row(y), self.slice.near.row(y), self.plain.row(y)],
            oriented: self.oriented,
        }
    }
}

/// Channels of the newest frame: energies (whatever was there before where it has no orientations), magnitude, grey,
/// differences.
pub const CELL_CHANNELS: usize = ORIENTATIONS + 2 + DIFFERENCES;

/// Which of them is the grey level; behind it are the differences.
pub const GREY: usize = MAGNITUDE + 1;

/// A row of cells of the newest frame.
#[derive(Debug)]
pub struct NewestRow<'a> {
    grey: CellRow<'a>,
    /// Rows of the difference images: far, near, plain.
    pub differences: [DifferenceRow<'a>; DIFFERENCES],
    oriented: bool,
}

impl NewestRow<'_> {
    /// Intensity, the differences and zeros.
    #[inline(always)]
    fn second(&self, x: usize) -> [u8; CHANNELS] {
        let [far, near, plain] = &self.differences;
        let grey = self.grey.cell(x).grey();
        [grey, far.quarters(x), near.quarters(x), plain.quarters(x), 0, 0, 0, 0]
    }

    /// Writes the channels of the first `columns` cells, a plane after the other. Panics if there are fewer cells, or
    /// fewer than [`CELL_CHANNELS`] times as many bytes.
    pub fn fill(&self, columns: usize, planes: &mut [u8]) {
        self.grey.fill(columns, self.oriented, planes);
        let planes = slices::rows_mut(planes, columns).skip(GREY + 1);
        for (difference, plane) in self.differences.iter().zip(planes) {
            fill_difference(difference, plane);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    /// The pictures of a level: grey, far, near and plain difference.
    #[derive(Debug, Clone)]
    pub(crate) struct LevelPictures {
        size: (usize, usize),
        halved: bool,
        pixels: [Vec<u8>; 4],
    }

    impl LevelPictures {
        /// Pictures of `width` x `height` pixels with these values; of halved differences every second counts.
        pub(crate) fn new(
            width: usize,
            height: usize,
            halved: bool,
            pixel: impl Fn(usize, usize) -> [u8; 4],
        ) -> Self {
            let step = |i: usize| if halved && i > 0 { 2 } else { 1 };
            let pixels = core::array::from_fn(|i| {
                let (width, height) = (width / step(i), height / step(i));
                let place = |n: usize| pixel(n % width * step(i), n / width * step(i))[i];
                (0..width * height).map(place).collect()
            });
            Self { size: (width, height), halved, pixels }
        }

        /// Changes a pixel of pictures of one size.
        pub(crate) fn set(&mut self, x: usize, y: usize, values: [u8; 4]) {
            let place = y * self.size.0 + x;
            self.pixels.iter_mut().zip(values).for_each(|(pixels, value)| pixels[place] = value);
        }

        pub(crate) fn newest(&self) -> NewestChannels<'_> {
            let (width, height) = self.size;
            let shift = u32::from(self.halved);
            let difference = |i: usize| Difference {
                picture: Image::packed(&self.pixels[i], width >> shift, height >> shift).unwrap(),
                halved: self.halved,
            };
            let grey = Image::packed(&self.pixels[0], width, height).unwrap();
            let slice = Slice { grey, near: difference(2) };
            NewestChannels { slice, far: difference(1), plain: difference(3), oriented: true }
        }
    }

    /// The channels of all cells, row by row.
    pub(crate) fn cells(newest: &NewestChannels<'_>) -> Vec<[u8; CELL_CHANNELS]> {
        let (columns, rows) = newest.slice.cells();
        let mut planes = vec![7; CELL_CHANNELS * columns];
        let mut row = |y| {
            if !newest.oriented {
                planes[..ORIENTATIONS * columns].fill(0);
            }
            newest.row(y).fill(columns, &mut planes);
            let cell = |x| core::array::from_fn(|channel| planes[channel * columns + x]);
            (0..columns).map(cell).collect::<Vec<_>>()
        };
        (0..rows).flat_map(&mut row).collect()
    }

    prop_compose! {
        /// A level of noise, of few values, or plain.
        pub(crate) fn level()(
            width in 2..48usize, height in 2..40usize, halved: bool, few in 0..3u8,
            values in prop::collection::vec(any::<[u8; 4]>(), 211),
        ) -> LevelPictures {
            LevelPictures::new(width, height, halved, |x, y| match few {
                0 => values[(y * width + x * 7) % values.len()],
                1 => values[(y / 5 * width + x / 3) % values.len()].map(|v| v / 32),
                _ => values[0],
            })
        }
    }

    proptest! {
        #[test]
        fn squares_are_cells_of_the_whole_level(level in level(), x in -14..30i32, y in -14..25i32) {
            let newest = level.newest();
            let (columns, rows) = newest.slice.cells();
            let cells = cells(&newest);
            let first = newest.slice.square(x, y);
            let second = newest.square(x, y);
            prop_assert_eq!(first, newest.slice.square_by_cells(x, y));
            prop_assert_eq!(second, newest.square_by_cells(x, y));
            for (j, (first, second)) in first.iter().zip(&second).enumerate() {
                for (i, (first, second)) in first.iter().zip(second).enumerate() {
                    let (cx, cy) = (x + i as i32, y + j as i32);
                    let inside = (0..columns as i32).contains(&cx) && (0..rows as i32).contains(&cy);
                    if !inside {
                        prop_assert_eq!((first, second), (&[0; 8], &[0; 8]));
                        continue;
                    }
                    let (cx, cy) = (cx as usize, cy as usize);
                    let [a, b, c, d, e, f, magnitude, grey, far, near, plain] = cells[cy * columns + cx];
                    prop_assert_eq!(first, &[a, b, c, d, e, f, magnitude, near]);
                    prop_assert_eq!(second, &[grey, far, near, plain, 0, 0, 0, 0]);
                }
            }
        }

        #[test]
        fn cells_agree_with_f64(level in level(), oriented: bool) {
            let newest = NewestChannels { oriented, ..level.newest() };
            let columns = newest.slice.cells().0;
            for (place, cell) in cells(&newest).iter().enumerate() {
                let (x, y) = (place % columns, place / columns);
                let mut energies = CellRow::new(&newest.slice.grey, y).cell(x).energies();
                if !oriented {
                    energies[..ORIENTATIONS].fill(0);
                }
                prop_assert_eq!(&cell[..=MAGNITUDE], &energies);
                let mean = |i: usize, step: usize| {
                    let (width, side) = (level.size.0 / (2 / step), step);
                    let pixel = |n: usize| f64::from(level.pixels[i][(side * y + n / side) * width + side * x + n % side]);
                    (0..side * side).map(pixel).sum::<f64>() / (side * side) as f64
                };
                prop_assert_eq!(f64::from(cell[GREY]), (mean(0, 2) + 0.5).floor());
                let step = if level.halved { 1 } else { 2 };
                for i in 1..4 {
                    prop_assert_eq!(f64::from(cell[GREY + i]), (4.0 * mean(i, step)).min(255.0));
                }
            }
        }
    }

    #[test]
    fn a_halved_picture_may_lack_the_last_cells() {
        let level = LevelPictures::new(4, 4, true, |_, _| [9, 10, 20, 30]);
        let mut newest = level.newest();
        newest.far.picture = Image::packed(&[10], 1, 1).unwrap();
        let cell = |x: usize, y: usize| cells(&newest)[2 * y + x][GREY + 1..].to_vec();
        assert_eq!(
            [cell(0, 0), cell(1, 0), cell(0, 1)],
            [[40, 80, 120], [0, 80, 120], [0, 80, 120]]
        );
        let plain = vec![255; 16];
        newest.far = Difference { picture: Image::packed(&plain, 4, 4).unwrap(), halved: false };
        assert_eq!(cells(&newest)[3][GREY + 1..], [255, 80, 120]);
    }
}
