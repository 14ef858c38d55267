//! Channels of one pyramid level: gradient energies and differences of its cells (level 2).
//!
//! A frame has eight channels a cell: [`ORIENTATIONS`] gradient energies, their magnitude and the temporal difference.
//! Of the newest frame alone there are four more: intensity and all differences. Cells are computed from pictures where
//! they are asked for; pictures are all that is kept.

use crate::gradient::{CELL, CellRow, ORIENTATIONS};
use crate::image::Image;

/// Difference images beside the grey one: tolerant to a frame far back, tolerant and plain to that of the oldest slice.
pub const DIFFERENCES: usize = 3;

/// Channels of every frame, and as many of the newest alone.
pub const CHANNELS: usize = 8;

/// Channel of the gradient magnitude.
pub const MAGNITUDE: usize = ORIENTATIONS;

/// Channel of the temporal difference.
pub const TEMPORAL: usize = ORIENTATIONS + 1;

/// Eight channels of the cells of a square, row by row.
pub type Square<const N: usize> = [[[u8; CHANNELS]; N]; N];

/// A difference image of a level.
#[derive(Debug, Clone, Copy)]
pub struct Difference<'a> {
    /// Grey levels.
    pub picture: Image<'a>,
    /// Whether a pixel is a whole cell of the level, not a pixel of it.
    pub halved: bool,
}

/// The pixels of a difference image for one row of cells.
#[derive(Debug, Clone, Copy)]
enum DifferenceRow<'a> {
    Pixels(CellRow<'a>),
    Cells(&'a [u8]),
}

impl<'a> Difference<'a> {
    #[inline]
    fn row(&self, row: usize) -> DifferenceRow<'a> {
        if !self.halved {
            DifferenceRow::Pixels(CellRow::new(&self.picture, row))
        } else if row < self.picture.height() {
            DifferenceRow::Cells(self.picture.row(row))
        } else {
            DifferenceRow::Cells(&[])
        }
    }
}

impl DifferenceRow<'_> {
    /// The mean over cell `x` in quarters of a grey level, at most 255: the sum of its four pixels. 0 beyond a halved
    /// picture, which may lack the last column and row.
    #[inline(always)]
    fn quarters(&self, x: usize) -> u8 {
        let sum = match self {
            Self::Pixels(row) => row.sum(x),
            Self::Cells(row) => row.get(x).map_or(0, |&mean| 4 * u32::from(mean)),
        };
        sum.min(255) as u8
    }
}

/// What is kept of a frame on a level.
#[derive(Debug, Clone, Copy)]
pub struct Slice<'a> {
    /// Grey levels.
    pub grey: Image<'a>,
    /// Tolerant difference to the frame a few before.
    pub near: Difference<'a>,
}

/// What there is of the newest frame on a level.
#[derive(Debug, Clone, Copy)]
pub struct Newest<'a> {
    /// What is kept of it.
    pub slice: Slice<'a>,
    /// Tolerant difference to a frame far back.
    pub far: Difference<'a>,
    /// Plain difference to the frame a few before.
    pub plain: Difference<'a>,
}

/// The cells of a square whose upper left one is at (left, top); those outside a level of such a size are 0.
fn square<const N: usize, R>(
    size: (usize, usize),
    (left, top): (i32, i32),
    row: impl Fn(usize) -> R,
    cell: impl Fn(&R, usize) -> [u8; CHANNELS],
) -> Square<N> {
    let mut cells = [[[0; CHANNELS]; N]; N];
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
    usize::try_from(i64::from(first) + i as i64).ok()
}

impl<'a> Slice<'a> {
    /// Cells in a row and in a column.
    pub fn cells(&self) -> (usize, usize) {
        (self.grey.width() / CELL, self.grey.height() / CELL)
    }

    /// Energies, magnitude and temporal difference of the cells of a square whose upper left one is at (x, y). Cells
    /// outside the picture are 0.
    pub fn square<const N: usize>(&self, x: i32, y: i32) -> Square<N> {
        let row = |y| (CellRow::new(&self.grey, y), self.near.row(y));
        square(self.cells(), (x, y), row, |(grey, near), x| {
            let [a, b, c, d, e, f, magnitude] = grey.energies(x);
            [a, b, c, d, e, f, magnitude, near.quarters(x)]
        })
    }
}

impl Newest<'_> {
    /// Intensity, the differences in quarters of a grey level (at most 255) and zeros: of the cells of a square, as
    /// [`Slice::square`].
    pub fn square<const N: usize>(&self, x: i32, y: i32) -> Square<N> {
        square(self.slice.cells(), (x, y), |y| self.row(y), |row, x| row.second(x))
    }

    /// Cells of row `y`. Panics if there are not so many.
    pub fn row(&self, y: usize) -> NewestRow<'_> {
        NewestRow {
            grey: CellRow::new(&self.slice.grey, y),
            differences: [self.far.row(y), self.slice.near.row(y), self.plain.row(y)],
        }
    }
}

/// Channels of the newest frame: energies, magnitude, grey, differences.
pub type Cell = [u8; ORIENTATIONS + 2 + DIFFERENCES];

/// Where the grey level of a [`Cell`] is, and behind it the differences.
pub const GREY: usize = MAGNITUDE + 1;

/// A row of cells of the newest frame.
#[derive(Debug)]
pub struct NewestRow<'a> {
    grey: CellRow<'a>,
    differences: [DifferenceRow<'a>; DIFFERENCES],
}

impl NewestRow<'_> {
    /// The differences at cell `x` in quarters of a grey level, at most 255: far, near, plain.
    #[inline(always)]
    pub fn differences(&self, x: usize) -> [u8; DIFFERENCES] {
        self.differences.each_ref().map(|row| row.quarters(x))
    }

    #[inline(always)]
    fn second(&self, x: usize) -> [u8; CHANNELS] {
        let [far, near, plain] = self.differences(x);
        [((self.grey.sum(x) + 2) >> 2) as u8, far, near, plain, 0, 0, 0, 0]
    }

    /// The channels of cell `x`. Panics if there are not so many.
    #[inline(always)]
    pub fn cell(&self, x: usize) -> Cell {
        let [a, b, c, d, e, f, magnitude] = self.grey.energies(x);
        let [grey, far, near, plain, ..] = self.second(x);
        [a, b, c, d, e, f, magnitude, grey, far, near, plain]
    }
}
