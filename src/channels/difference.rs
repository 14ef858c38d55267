//! Difference images of a level, as pixels or as the mean of each cell, and their rows.

use crate::image::Image;
use crate::image::gradient::CellRow;

/// A difference image of a level.
#[derive(Debug, Clone, Copy)]
pub struct Difference<'a> {
    /// Absolute differences in grey levels, 0 to 255.
    pub picture: Image<'a>,
    /// Whether a pixel is a whole cell of the level, not a pixel of it.
    pub halved: bool,
}

/// The pixels of a difference image for one row of cells.
#[derive(Debug, Clone, Copy)]
pub enum DifferenceRow<'a> {
    /// The pixels of its cells.
    Pixels(CellRow<'a>),
    /// The mean over each of its cells.
    Cells(&'a [u8]),
}

impl<'a> Difference<'a> {
    #[inline]
    pub(super) fn row(&self, row: usize) -> DifferenceRow<'a> {
        if !self.halved {
            DifferenceRow::Pixels(CellRow::new(&self.picture, row))
        } else if row < self.picture.height() {
            DifferenceRow::Cells(self.picture.row(row))
        } else {
            DifferenceRow::Cells(&[])
        }
    }
}

impl<'a> DifferenceRow<'a> {
    /// The row from cell `first` on.
    #[inline(always)]
    pub(super) fn from(&self, first: usize) -> DifferenceRow<'a> {
        match self {
            Self::Pixels(row) => DifferenceRow::Pixels(row.from(first)),
            Self::Cells(row) => DifferenceRow::Cells(row.get(first..).unwrap_or(&[])),
        }
    }

    /// The mean over cell `x` in quarters of a grey level, at most 255: the sum of its four pixels. 0 beyond a halved
    /// picture, which may lack the last column and row.
    #[inline(always)]
    pub(super) fn quarters(&self, x: usize) -> u8 {
        match self {
            Self::Pixels(row) => row.sum(x).min(255) as u8,
            Self::Cells(row) => row.get(x).map_or(0, |&mean| quarters(mean)),
        }
    }

    /// Writes [`DifferenceRow::quarters`] of the first cells.
    #[inline(always)]
    pub(super) fn fill(&self, out: &mut [u8]) {
        match self {
            Self::Pixels(row) => row.fill_quarters(out),
            Self::Cells(row) => {
                let (inside, outside) = out.split_at_mut(row.len().min(out.len()));
                for (out, &mean) in inside.iter_mut().zip(*row) {
                    *out = quarters(mean);
                }
                outside.fill(0);
            }
        }
    }

    /// Adds `quarters` of each run of [`RUN`] cells to the next of `sums`. Panics if there are fewer cells.
    pub fn sum_runs(&self, sums: &mut [u16]) {
        sum_runs(self, sums);
    }
}

/// Cells of a run of [`DifferenceRow::sum_runs`].
pub const RUN: usize = 8;

#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
fn sum_runs(row: &DifferenceRow<'_>, sums: &mut [u16]) {
    let mut block = [[0; RUN]; 16];
    let (length, mut first) = (block.len(), 0);
    for sums in sums.chunks_mut(length) {
        row.from(first).fill(block[..sums.len()].as_flattened_mut());
        first += length * RUN;
        for (sum, run) in sums.iter_mut().zip(&block) {
            *sum += run.iter().map(|&quarters| u16::from(quarters)).sum::<u16>();
        }
    }
}

/// A grey level in quarters, at most 255.
#[inline(always)]
pub(super) fn quarters(mean: u8) -> u8 {
    mean.min(64).saturating_mul(4)
}

#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
pub(super) fn fill_difference(row: &DifferenceRow<'_>, out: &mut [u8]) {
    row.fill(out);
}
