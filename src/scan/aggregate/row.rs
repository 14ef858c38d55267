//! One row of a map, from the cells of the row and sums over the squares around them.
//!
//! Plane by plane, on a microcontroller as well: cell by cell through all planes takes it three times the instructions.

use crate::channels::window::PADDING;
use crate::channels::{DIFFERENCES, GREY, MAGNITUDE};
use crate::image::gradient::ORIENTATIONS;
use crate::math::slices;
use core::array::from_fn;

/// Half the side of the square over which the map is normalised, in cells.
pub(super) const REACH: usize = 5;

/// Cells in that square.
const AREA: u32 = (2 * REACH as u32 + 1) * (2 * REACH as u32 + 1);

/// Rows and columns of cells over which the map is normalised.
pub(super) const NEAR: usize = 2 * REACH + 1;

/// Channels of which the mean around a cell is needed: magnitude, grey, far and near difference.
pub(super) const AVERAGED: [usize; 4] = [MAGNITUDE, GREY, GREY + 1, GREY + 2];

/// Sums of one channel over the columns of a level, and as many zeros as the square reaches on either side.
pub(super) const fn sums_len(columns: usize) -> usize {
    columns + 2 * REACH
}

/// The byte of a map for a value of 0: they are kept less 128, since vector instructions compare signed bytes.
pub(super) const NOTHING: u8 = 128;

/// Ratios in [`ROOT`]: the largest is 255 times the largest of [`RECIPROCAL`], Q8. Where there is room for a table of all
/// numbers of 16 bits, looking one up needs no check.
const RATIOS: usize = if cfg!(feature = "simd") { 1 << 16 } else { 4096 };

/// `8 * sqrt(i)`, at most 255, as a byte of a map: compresses ratios so that small ones keep their resolution.
static ROOT: [u8; RATIOS] = {
    let mut table = [0; RATIOS];
    let mut root = 0u32;
    let mut i = 0;
    while i < RATIOS as u32 {
        while root < 255 && (root + 1) * (root + 1) <= 64 * i {
            root += 1;
        }
        table[i as usize] = root as u8 ^ NOTHING;
        i += 1;
    }
    table
};

/// `65536 / (i + 16)`: reciprocals of means in quarters of a unit, with a floor of 4 units.
static RECIPROCAL: [u16; 1024] = {
    let mut table = [0; 1024];
    let mut i = 0;
    while i < 1024 {
        table[i] = (65536 / (i + 16)) as u16;
        i += 1;
    }
    table
};

/// Mean over the square in quarters of a unit, from its sum.
#[inline(always)]
fn quarter_mean(sum: u16) -> usize {
    // 4 / 121 in Q16; at most 1020 since a value is at most 255.
    ((u32::from(sum) * (4 * 65536 / AREA)) >> 16) as usize
}

/// [`ROOT`] of four times a magnitude.
static QUARTER_ROOT: [u8; 256] = {
    let mut table = [0; 256];
    let mut i = 0;
    while i < 256 {
        table[i] = ROOT[4 * i];
        i += 1;
    }
    table
};

/// Map values of a difference against the noise, by the difference.
pub(super) type Loud = [u8; 256];

/// For a Q16 reciprocal of the noise, at most 2048.
pub(super) fn loud(calm: u32) -> Loud {
    from_fn(|value| ROOT[((value as u32 * calm) >> 7) as usize % RATIOS])
}

/// Sums over the square around each cell, from sums of columns; `pairs` and `fours` have room for those of one channel.
#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
pub(super) fn sum_across(
    columns: usize,
    sums: &[u16],
    around: &mut [u16],
    [pairs, fours]: [&mut [u16]; 2],
) {
    let planes = slices::rows_mut(around, columns);
    for (out, sums) in planes.zip(slices::rows(sums, sums_len(columns))) {
        if !cfg!(feature = "simd") {
            sum_along(sums, out);
            continue;
        }
        // 11 columns are 4 and 4 and 2 and 1.
        for ((pair, a), b) in pairs.iter_mut().zip(sums).zip(&sums[1..]) {
            *pair = a + b;
        }
        for ((four, a), b) in fours.iter_mut().zip(&*pairs).zip(&pairs[2..]) {
            *four = a + b;
        }
        let ends = fours.iter().zip(&fours[4..]).zip(&pairs[8..]).zip(&sums[10..]);
        for (out, (((a, b), c), d)) in out.iter_mut().zip(ends) {
            *out = a + b + c + d;
        }
    }
}

/// [`sum_across`] of one channel, cell by cell: for processors without vector instructions.
pub(super) fn sum_along(sums: &[u16], out: &mut [u16]) {
    let (first, rest) = slices::split(sums, NEAR - 1);
    let mut sum: u16 = first.iter().sum();
    for ((out, new), gone) in out.iter_mut().zip(rest).zip(sums) {
        sum += new;
        *out = sum;
        sum -= gone;
    }
}

/// Rows of cells and sums that one row of the map is computed from.
#[derive(Debug, Clone, Copy)]
pub(super) struct CellRows<'a> {
    /// Planes of cells.
    pub(super) cells: &'a [u8],
    /// Planes of sums over the square around each cell.
    pub(super) around: &'a [u16],
    pub(super) columns: usize,
    /// Rows of the square that lie in the picture.
    pub(super) down: usize,
    pub(super) oriented: bool,
    pub(super) loud: &'a [Loud; DIFFERENCES],
}

impl<'a> CellRows<'a> {
    fn cells(&self, channel: usize) -> &'a [u8] {
        slices::part(self.cells, channel * self.columns, self.columns)
    }

    fn around(&self, number: usize) -> &'a [u16] {
        slices::part(self.around, number * self.columns, self.columns)
    }
}

/// The high half of a product.
#[inline(always)]
fn high(a: u16, b: u16) -> u16 {
    ((u32::from(a) * u32::from(b)) >> 16) as u16
}

#[cfg_attr(feature = "simd", multiversion::multiversion(targets("x86_64+avx2", "x86_64+sse4.1")))]
pub(super) fn map_row(row: CellRows<'_>, temporaries: &mut [u16], out: &mut [u8]) {
    let columns = row.columns;
    let mut planes = slices::rows_mut(out, columns + 2 * PADDING)
        .map(|plane| slices::part_mut(plane, PADDING, columns));
    let mut plane = || planes.next().unwrap_or_default();
    let (energy, rest) = slices::split_mut(temporaries, columns);
    let (far, rest) = slices::split_mut(rest, columns);
    let (near, rest) = slices::split_mut(rest, columns);
    let indices = slices::part_mut(rest, 0, columns);
    reciprocals(row.around(0), energy);
    reciprocals(row.around(2), far);
    reciprocals(row.around(3), near);
    for channel in 0..ORIENTATIONS {
        let out = plane();
        match row.oriented {
            true => ratios(row.cells(channel), energy, indices, out),
            false => out.fill(NOTHING),
        }
    }
    let magnitude = row.cells(MAGNITUDE);
    ratios(magnitude, energy, indices, plane());
    look_up(magnitude, |value| QUARTER_ROOT[usize::from(value)], plane());
    intensity(&row, energy, indices, [plane(), plane()]);
    let [far_cells, near_cells, plain] = [1, 2, 3].map(|i| row.cells(GREY + i));
    for (cells, loud) in [far_cells, near_cells, plain].into_iter().zip(row.loud) {
        look_up(cells, |value| loud[usize::from(value)], plane());
    }
    ratios(near_cells, near, indices, plane());
    // The plain difference against the magnitude of the cell alone.
    look_up(magnitude, |magnitude| RECIPROCAL[usize::from(magnitude) * 4], energy);
    ratios(plain, energy, indices, plane());
    ratios(far_cells, far, indices, plane());
}

/// Reciprocals of the means over squares of such sums.
#[inline(always)]
fn reciprocals(sums: &[u16], out: &mut [u16]) {
    look_up(sums, |sum| RECIPROCAL[quarter_mean(sum) & 1023], out);
}

/// 64 times each value over the mean of this reciprocal, through [`ROOT`].
#[inline(always)]
fn ratios(values: &[u8], reciprocals: &[u16], indices: &mut [u16], out: &mut [u8]) {
    for ((index, &value), &reciprocal) in indices.iter_mut().zip(values).zip(reciprocals) {
        // A shift by 8 in all.
        *index = high(u16::from(value) << 8, reciprocal);
    }
    look_up(indices, |index| ROOT[usize::from(index) % RATIOS], out);
}

/// Looks each value up, eight at a time so that there is less to do beside.
#[inline(always)]
fn look_up<T: Copy, U>(values: &[T], table: impl Fn(T) -> U, out: &mut [U]) {
    let ((eights, rest), (out, last)) = (values.as_chunks::<8>(), out.as_chunks_mut::<8>());
    for (out, values) in out.iter_mut().zip(eights) {
        for (out, &value) in out.iter_mut().zip(values) {
            *out = table(value);
        }
    }
    for (out, &value) in last.iter_mut().zip(rest) {
        *out = table(value);
    }
}

/// Intensity against the mean around: relative to the magnitude around, and in half grey levels.
#[inline(always)]
fn intensity(
    row: &CellRows<'_>,
    energy: &[u16],
    means: &mut [u16],
    [relative, half]: [&mut [u8]; 2],
) {
    let columns = row.columns;
    let (grey, around) = (row.cells(GREY), row.around(1));
    // Q18 reciprocal of the cells of the square that lie in the picture: they change near edges only.
    let reciprocal = |across: usize| (1u32 << 18).div_ceil((across * row.down).max(1) as u32);
    let whole = reciprocal(NEAR) as u16;
    for (mean, &sum) in means.iter_mut().zip(around) {
        *mean = high(sum, whole);
    }
    let edges = (0..REACH.min(columns)).chain(columns.saturating_sub(REACH)..columns);
    for x in edges {
        let across = (x + REACH + 1).min(columns) - x.saturating_sub(REACH);
        means[x] = ((u32::from(around[x]) * reciprocal(across)) >> 16) as u16;
    }
    let above = |grey: u8, mean: u16| i16::from(grey) * 4 - mean.cast_signed();
    for ((out, &grey), &mean) in half.iter_mut().zip(grey).zip(&*means) {
        *out = (above(grey, mean) >> 1).clamp(-128, 127) as u8;
    }
    for (((out, &grey), &mean), &energy) in relative.iter_mut().zip(grey).zip(&*means).zip(energy) {
        // Both factors have 15 bits: six more than what counts of the product.
        let product = i32::from(above(grey, mean) << 4) * i32::from((energy << 2).cast_signed());
        *out = ((product >> 16) as i16).clamp(-128, 127) as u8;
    }
}
